#!/usr/bin/env bash
# Every figure of the paper, error against run time, and the extreme cases, into results/. A result
# that is there already is not computed again, so the script goes on where it stopped; remove a
# result to compute it anew.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"

ranks=${RANKS:-2}
experiments=(
  continuum_undamped continuum_damped response modes
  projection_one_frequency projection_dominant projection_three_modes relaxation_long
  accuracy_response accuracy_response_middle accuracy_response_large accuracy_curve
  accuracy_modes accuracy_relaxation
)
for experiment in "${experiments[@]}"; do
  if [ ! -e "results/$experiment.h5" ]; then
    echo "== $experiment"
    # 3: some numbers miss their accuracy; they are marked, in the figure too
    mpirun -n "$ranks" pgran run "options/$experiment.opts" || [ $? -eq 3 ]
  fi
done
for experiment in "${experiments[@]}"; do
  others=()
  # The modes' frequencies go under the response, as in the paper.
  [ "$experiment" = response ] && others=(results/modes.h5)
  pgran plot "results/$experiment.h5" "${others[@]}"
done
if [ ! -e results/stability.txt ]; then
  echo "== extreme cases"
  bash jobs/stability.sh | tee results/stability.part
  mv results/stability.part results/stability.txt
fi
echo "done: look at the figures in $PWD/results"
