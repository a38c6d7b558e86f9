#!/usr/bin/env bash
# Draws the figure of README.md, and writes the tables of the manual's page on options.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"

for experiment in modes response; do
  mpirun -n 2 pgran run "options/$experiment.opts" -output_file "results/manual_$experiment.h5" \
    -output_overwrite
done
python - <<'END'
from pathlib import Path

import pgran
from pgran.command.listing import tables

modes = pgran.load("results/manual_modes.h5").modes.omega
figure = pgran.plot("results/manual_response.h5", modes=modes)["amplitude"]
figure.savefig("pgran/manual/response.png", dpi=130)  # below 100 kB
page = Path("pgran/manual/options.md")
text, _, _ = page.read_text().partition("| key |")
page.write_text(text + "\n".join(tables()) + "\n")
END
