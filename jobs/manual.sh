#!/usr/bin/env bash
# Draws the figures of README.md and of the manual's pages by user, with the commands of these pages,
# and writes the lists that end its pages on options, files and results. Three minutes on two cores.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"
[ $# -eq 0 ] || { echo "manual: $1: it takes no words" >&2; exit 2; }

run() { # NAME EXPERIMENT WORDS ...
  # 3: some numbers miss their accuracy; they are marked, in the figures too
  mpirun -n 2 pgran run "options/$2.opts" "${@:3}" \
    -output_file "results/manual_$1.h5" -output_overwrite || [ $? -eq 3 ]
}
run modes modes
run response response
pgran pack --balls 300 --dimension 3 --law hertz --sizes .1 --pressure 1.02e-7 --shape 2,1,1 \
  --walls x -o results/manual_cell.h5 --overwrite
run beads packing_response -network_file results/manual_cell.h5 -network_damping 7.36e-4 \
  -detectors 268 -units_length 5e-3 -units_time 8.169e-7 -sweep_unit Hz -sweep_min 200 \
  -sweep_max 20e3 -sweep_points 991
pgran import options/packings/discs.atoms options/packings/discs.contacts --law harmonic \
  -o results/manual_jammed.h5 --overwrite
run lammps packing_modes -network_file results/manual_jammed.h5
run cluster accuracy_response
run loud loud

python - <<'END'
import io
from PIL import Image
import pgran

modes = pgran.load("results/manual_modes.h5").modes.omega
for page, kind, others in (
    ("response", "amplitude", {"modes": modes}),
    ("beads", "amplitude", {}),
    ("lammps", "reduced", {}),
    ("cluster", "front", {}),
    ("loud", "harmonics", {}),
):
    drawn = io.BytesIO()
    pgran.plot(f"results/manual_{page}.h5", **others)[kind].savefig(drawn, dpi=150)
    # below 80 kB by few colours
    small = Image.open(drawn).convert("RGB").quantize(128)
    small.save(f"pgran/manual/{page}.png", optimize=True)
END
python jobs/tables.py
