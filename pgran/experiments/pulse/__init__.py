"""Motion in time, proven by Laplace or estimated by TS."""
