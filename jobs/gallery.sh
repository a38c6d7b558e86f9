#!/usr/bin/env bash
# Draws each kind of figure once, with its caption and what made it, and writes FOLDER/index.html,
# results/gallery by default: of those files of options/ that take seconds, without variations.
#
#   bash jobs/gallery.sh [FOLDER]    two minutes; what is complete in the folder is not run again
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"
folder=${1:-results/gallery}
[ $# -lt 2 ] || { echo "gallery: $2: it takes one folder" >&2; exit 2; }

mkdir -p "$folder"
for file in options/*.opts; do
  name=$(basename "$file" .opts)
  less=()
  case $name in # what no quick file draws
    modes_density) less=(-lattice_shape 100,100) ;;
    ensemble_statistics) less=(-ensemble_samples 100) ;;
    modes_damped | loud | loud_frequency) ;;
    *)
      [ ! -f "options/${name%%_*}.opts" ] || [ "$name" = "${name%%_*}" ] || continue # a variation
      grep -Eq "Run time: (about [12]?[0-9] s|below|less)" "$file" || continue
      ;;
  esac
  [ -f "$folder/$name.h5" ] || pgran run "$file" ${less[@]+"${less[@]}"} -output_file "$folder/$name.h5"
done
[ -f "$folder/likeness.h5" ] ||
  pgran compare "$folder/damping.h5" "$folder/response.h5" -o "$folder/likeness.h5"
python jobs/gallery.py "$folder"
