#!/usr/bin/env bash
# The paper alone: its experiments, over some samples too, into results/paper/, their figures, and
# results/paper.md, a table of every figure and number of the paper beside what pgran finds, and whether
# the paper is right. 80 seconds on two cores after the installation.
#
#   bash jobs/paper.sh --beads    the heater in packings of glass beads instead, under 1 to 300 of
#                                 their weights: four minutes. The table takes up what it finds,
#   bash jobs/paper.sh --loud     and what it finds of loud sound in such packings: ten minutes.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"
[[ ${1:-} =~ ^(--beads|--loud)?$ ]] || { echo "paper: $1: it takes --beads or --loud" >&2; exit 2; }

folder=results/paper
mkdir -p "$folder"
run() { # NAME EXPERIMENT WORDS ...
  echo "== $1"
  # 3: some numbers miss their accuracy; they are marked, in the figures too
  mpirun -n "${RANKS:-2}" pgran run "options/$2.opts" "${@:3}" \
    -output_file "$folder/$1.h5" -output_overwrite || [ $? -eq 3 ]
}

if [ $# -gt 0 ]; then
  step=${1#--}
  [ "$step" = loud ] && experiment=loud || experiment=heater_packing
  python "jobs/paper_$step.py" "$folder" >"$folder/$step.txt"
  while read -r name words; do
    run "$name" "$experiment" $words </dev/null
  done <"$folder/$step.txt"
  python jobs/paper.py "$folder"
  exit
fi

same=(
  continuum_undamped continuum_damped response modes projection_one_frequency projection_dominant
  projection_three_modes relaxation_long relaxation_seconds response_damping_small
  response_damping_large
)
for name in "${same[@]}"; do
  run "$name" "$name"
done
for steps in 1 10 100 840; do
  run "response_after_$steps" response -bonds_redrawn "$steps"
done
run response_other response -bonds_seed 1994
run response_kmax_small response -bonds_kmax .0625 -sweep_unit omega_mx
run response_kmax_large response -bonds_kmax 1 -sweep_unit omega_mx
run response_damping_least response -lattice_damping .0003
run response_damping_10 response -lattice_damping .01
run response_damping_most response -lattice_damping .1
balls=$(printf ',8,%s' {2..17})
for beta in 1 3 10; do
  run "dips_$beta" response -lattice_damping "${beta}e-3" -detectors "${balls:1}" \
    -sweep_min .3 -sweep_max 1 -sweep_points 701
done
run continuum_smooth continuum_damped -sweep_min 1 -sweep_max 300 -sweep_points 6000
run lattice response -lattice_shape 4,4 -detectors 1,2 -sweep_points 50
run projection_damping_small projection_three_modes -lattice_damping .001

# The paper's sample is not known: how much depends on it.
run ensemble_response ensemble_response -ensemble_keep measures -ensemble_samples 10 \
  -sweep_min .3 -sweep_max 1 -sweep_points 2801 # so fine that every phase is certain
run ensemble_modes ensemble_modes

# A packing, and its stiffnesses on a lattice: what random places add to random forces.
packed=(--balls 500 --law hertz --pressure 1e-5 --sizes .2 --walls x --overwrite)
for kind in "packing --displacement scalar" "ordered --ordered"; do
  read -r kind words <<<"$kind"
  network=(-network_file "$folder/$kind.h5" -network_damping .001) # .003 in the paper's units
  # shellcheck disable=SC2086
  ball=$(pgran pack "${packed[@]}" $words -o "${network[1]}" | sed -n 's/.*-detectors //p')
  run "geometry_response_$kind" packing_response "${network[@]}" -detectors "$ball" \
    -sweep_unit omega_mx -sweep_max 2
  run "geometry_modes_$kind" packing_modes "${network[@]}"
done

beads=(--diameter 5e-3 --material glass) # under a ball's weight; so that 57 m/s is .03 omega_mx cm
pgran units "${beads[@]}" --load 1.6e-3 >"$folder/units_weight.txt"
pgran units "${beads[@]}" --omega_mx 2e5 >"$folder/units_speed.txt"
python jobs/paper.py "$folder"
