#!/usr/bin/env bash
# Every figure of the paper, into results/. A result that is there already is not computed again, so
# the script goes on where it stopped; remove a result to compute it anew.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"

ranks=${RANKS:-2}
experiments=(
  continuum_undamped continuum_damped response modes
  projection_one_frequency projection_dominant projection_three_modes relaxation_long
)
for experiment in "${experiments[@]}"; do
  if [ ! -e "results/$experiment.h5" ]; then
    echo "== $experiment"
    mpirun -n "$ranks" pgran run "options/$experiment.opts"
  fi
done
for experiment in "${experiments[@]}"; do
  others=()
  # The modes' frequencies go under the response, as in the paper.
  [ "$experiment" = response ] && others=(results/modes.h5)
  pgran plot "results/$experiment.h5" "${others[@]}"
done
echo "done: look at the figures in $PWD/results"
