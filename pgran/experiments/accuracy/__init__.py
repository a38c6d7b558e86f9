"""Error against run time, of several solvers."""
