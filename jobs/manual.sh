#!/usr/bin/env bash
# Computes the response and the modes of the paper's sample and draws the figure of README.md.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"

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
