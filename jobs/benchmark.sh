#!/usr/bin/env bash
# The program against what a user would write with SciPy, in one run: ratios and errors. About ten
# minutes, or less with words that the names of rows hold (modes "200 x 200"); nothing else should
# run meanwhile. With --small all rows are only tried out.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"
mpirun -n 2 python jobs/benchmark.py "$@"
