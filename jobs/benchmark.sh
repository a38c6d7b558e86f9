#!/usr/bin/env bash
# The program against what a user would write with SciPy, in one run: ratios and errors. About ten
# minutes, or less with the names of some tables (sweeps, curves, bounds, modes, relaxations,
# networks); nothing else should run meanwhile.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"
mpirun -n 2 python jobs/benchmark.py "$@"
