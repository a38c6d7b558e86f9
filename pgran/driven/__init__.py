"""S(s) A = f at one s after the other, each amplitude with a proven bound."""
