"""Balls and contacts of other programs become a network; a packing for LAMMPS."""
