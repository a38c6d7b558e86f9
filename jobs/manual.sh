#!/usr/bin/env bash
# Draws the figure of README.md, and writes the tables of the manual's pages on options and files.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"
[ $# -eq 0 ] || { echo "manual: $1: it takes no words" >&2; exit 2; }

for experiment in modes response; do
  mpirun -n 2 pgran run "options/$experiment.opts" -output_file "results/manual_$experiment.h5" \
    -output_overwrite
done
python - <<'END'
import pgran

modes = pgran.load("results/manual_modes.h5").modes.omega
figure = pgran.plot("results/manual_response.h5", modes=modes)["amplitude"]
figure.savefig("pgran/manual/response.png", dpi=130)  # below 100 kB
END
python jobs/tables.py
