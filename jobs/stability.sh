#!/usr/bin/env bash
# The extreme cases in options/extreme/, each with several solvers on one and two ranks, judged
# against elimination with 60 digits: one table. About five minutes; with names of files, only those.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"
PYTHONPATH=tests${PYTHONPATH:+:$PYTHONPATH} python -m campaigns.stability "$@"
