"""What is computed: NumPy only. No PETSc, no MPI, no files."""
