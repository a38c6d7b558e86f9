#!/usr/bin/env bash
# The fault campaign: pgran never hangs, never loses what is finished, never mixes two runs, and no
# file does harm. About 35 minutes on two cores; bash jobs/faults.sh --short takes four.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"
export PYTHONPATH=tests${PYTHONPATH:+:$PYTHONPATH}
cases=1000 changes=110
[ "${1:-}" != --short ] || cases=100 changes=11
python -m campaigns.faults "$@"
python -m campaigns.changes "$changes"
python -m campaigns.fuzz "$cases"
