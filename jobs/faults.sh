#!/usr/bin/env bash
# The fault campaign: pgran never hangs, never loses what is finished, and no file does harm. About
# 25 minutes on two cores; bash jobs/faults.sh [--short] [PART ...] for less.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"
python jobs/faults.py "$@"
