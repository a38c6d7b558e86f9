#!/usr/bin/env bash
# Installs what is missing, computes the paper's main experiments on 2 ranks and draws their figures
# into results/. Under a minute after the installation.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"
[ $# -eq 0 ] || { echo "quickstart: $1: it takes no words" >&2; exit 2; }

for experiment in modes response relaxation; do
  mpirun -n 2 pgran run "options/$experiment.opts" -output_overwrite
done
pgran plot results/response.h5 results/modes.h5
pgran plot results/modes.h5
pgran plot results/relaxation.h5
echo "done: look at the figures in $PWD/results"
