"""The exact box, without lattice and PETSc."""
