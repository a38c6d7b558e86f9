#!/usr/bin/env bash
# Installs what is missing, then runs the style check and all tests, on 1 rank and on 2.
#
#   bash jobs/test.sh [WORDS FOR PYTEST ...]
#   bash jobs/test.sh --stack wheel [...]    the tests on 1 rank, on PETSc, MPI and all else from PyPI
set -euo pipefail
if [ "${1:-}" = --stack ]; then
  export PGRAN_STACK=${2:?which one? bash jobs/test.sh --stack wheel}
  shift 2
fi
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"

if [ -n "${PGRAN_STACK:-}" ]; then
  python -m pytest -q --color=no "$@"
  exit
fi
ruff check .
ruff format --check .
python -m pytest -q --color=no "$@"
# The tests compare their outcomes over the ranks; the time limit is the last resort.
timeout 900 mpirun -n 2 python -m mpi4py -m pytest -q --color=no "$@"
