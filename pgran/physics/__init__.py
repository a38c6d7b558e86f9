"""What is computed: NumPy and SciPy only. No PETSc, no MPI, no files."""
