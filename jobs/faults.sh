#!/usr/bin/env bash
# The fault campaign: pgran never hangs, never loses what is finished, never mixes two runs, and neither a
# file nor a call does harm. About 35 minutes on two cores; bash jobs/faults.sh --short takes four.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"
export PYTHONPATH=tests${PYTHONPATH:+:$PYTHONPATH}
cases=1000 changes=110
[ "${1:-}" != --short ] || cases=100 changes=11
python -m campaigns.faults "$@"
python -m campaigns.changes "$changes"
python -m campaigns.fuzz "$cases"
python -m campaigns.abuse "$((2 * cases))"
mpirun -n 2 python -m campaigns.abuse "$((2 * cases / 5))"
