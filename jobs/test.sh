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

# Two processes share out the files; what the second one says comes after the first one's words.
on_one_rank() (
  PGRAN_TESTS_TAKEN=$(mktemp -d)
  export PGRAN_TESTS_TAKEN
  python -m pytest -q --color=no "$@" >"$PGRAN_TESTS_TAKEN/second.log" 2>&1 &
  second=$!
  trap 'kill $second 2>/dev/null || true; rm -r "$PGRAN_TESTS_TAKEN"' EXIT
  failed=0
  python -m pytest -q --color=no "$@" || failed=$?
  wait $second || failed=$?
  cat "$PGRAN_TESTS_TAKEN/second.log"
  exit $failed
)

if [ -n "${PGRAN_STACK:-}" ]; then
  install_ovito
  on_one_rank "$@"
  exit
fi
ruff check .
ruff format --check .
on_one_rank "$@"
# The tests compare their outcomes over the ranks; the time limit is the last resort.
timeout 900 mpirun -n 2 python -m mpi4py -m pytest -q --color=no "$@"
