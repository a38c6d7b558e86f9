"""How alike two response curves, or two codas, are."""
