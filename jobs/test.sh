#!/usr/bin/env bash
# Installs what is missing, then runs the style check and all tests, on 1 rank and on 2.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"

ruff check .
ruff format --check .
python -m pytest -q --color=no "$@"
# The tests compare their outcomes over the ranks; the time limit is the last resort.
timeout 900 mpirun -n 2 python -m mpi4py -m pytest -q --color=no "$@"
