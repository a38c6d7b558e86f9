#!/usr/bin/env bash
# The fault campaign: pgran never hangs, never loses what is finished, and no file does harm. About
# 25 minutes on two cores; bash jobs/faults.sh --short takes three.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"
export PYTHONPATH=tests${PYTHONPATH:+:$PYTHONPATH}
cases=1000
[ "${1:-}" != --short ] || cases=100
python -m campaigns.faults "$@"
python -m campaigns.fuzz "$cases"
