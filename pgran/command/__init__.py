"""What `pgran WORD` does, a file a word."""
