"""What a signal depends on: derivatives, warm balls, cut bonds."""
