#!/usr/bin/env bash
# The fault campaign: pgran never hangs, never loses what is finished, never mixes two runs, and neither a
# file nor a call does harm. About 40 minutes on two cores; bash jobs/faults.sh 10 takes five, for ten
# per cent of it.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"
export PYTHONPATH=tests${PYTHONPATH:+:$PYTHONPATH}
percent=${1:-100}
[[ $percent =~ ^[0-9]+$ ]] || { echo "faults: $percent: it takes a percentage" >&2; exit 2; }
python -m campaigns.faults "$percent"
python -m campaigns.changes $((percent + percent / 10))
python -m campaigns.fuzz $((10 * percent))
python -m campaigns.abuse $((20 * percent))
mpirun -n 2 python -m campaigns.abuse $((4 * percent))
