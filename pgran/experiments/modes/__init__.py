"""Modes, their counts, and a drive in terms of them."""
