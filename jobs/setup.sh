#!/usr/bin/env bash
# Installs what pgran needs and makes .venv with pgran in it.
#
#   bash jobs/setup.sh      install; nothing is done that is done already
#   source jobs/setup.sh    the same, and the environment of a job script:
#                           the project's folder, .venv, one thread a rank
#
# On Debian and Ubuntu the distribution's packages are used (sudo where you are not root). Where a
# python3 with complex petsc4py and slepc4py works already (conda-forge, a cluster's module), that
# python3 is used and nothing is installed but pgran.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

# A .venv that is active already must not be mistaken for the python3 to build on.
PATH=${PATH//"$PWD/.venv/bin:"/}

packages=(
  python3-petsc4py python3-petsc4py-complex python3-slepc4py python3-slepc4py-complex
  python3-mpi4py python3-h5py-mpi python3-numpy python3-scipy python3-matplotlib python3-tqdm
  python3-pytest python3-mpmath python3-xarray python3-h5netcdf python3-venv python3-setuptools python3-wheel
  openmpi-bin libopenblas0-pthread
)
extras=(matplotlib scipy tqdm pytest mpmath) # figures, spectra and tests; from PyPI where missing
ruff="ruff==0.14.4" # pinned: its formatting changes between versions

say() { echo "setup: $*" >&2; }

# Debian's petsc4py is found through PETSC_DIR only; the folder with the plain name comes with
# some versions of the packages only.
debian_folder() { # petsc | slepc
  local folder
  for folder in "/usr/lib/$1dir/$1-complex" /usr/lib/"$1"dir/"$1"*/*-complex /usr/lib/"$1"dir/"$1"*-complex; do
    [ -d "$folder/lib/python3/dist-packages" ] && { echo "$folder"; return; }
  done
  return 0
}

works() { # PYTHON: has it what pgran cannot do without, with complex scalars?
  "$1" - <<'PYTHON' >/dev/null 2>&1
import sys
assert sys.version_info >= (3, 11)
import h5py, mpi4py.MPI, numpy, slepc4py
import petsc4py
petsc4py.init(["setup", "-skip_petscrc"])
from petsc4py import PETSc
assert numpy.dtype(PETSc.ScalarType).kind == "c"
PYTHON
}

find_python() { # sets python, or leaves it empty
  python=
  if command -v python3 >/dev/null && works python3; then
    python=$(command -v python3)
    return
  fi
  local petsc slepc
  petsc=$(debian_folder petsc)
  slepc=$(debian_folder slepc)
  if [ -n "$petsc" ] && [ -n "$slepc" ] &&
    PETSC_DIR=$petsc SLEPC_DIR=$slepc works /usr/bin/python3; then
    export PETSC_DIR=$petsc SLEPC_DIR=$slepc
    python=/usr/bin/python3
  fi
}

install_packages() {
  if ! command -v apt-get >/dev/null; then
    say "no python3 with complex petsc4py and slepc4py was found, and this is no Debian or Ubuntu."
    say "With conda:     conda create -n pgran -c conda-forge python=3.12 'petsc=*=complex*' \\"
    say "                'slepc=*=complex*' petsc4py slepc4py mpi4py h5py ${extras[*]}"
    say "                conda activate pgran"
    say "On a cluster:   load the modules of a complex PETSc with petsc4py and slepc4py"
    say "then start this script again."
    exit 2
  fi
  local root=()
  if [ "$(id -u)" -ne 0 ]; then
    command -v sudo >/dev/null || { say "installing packages needs root: no sudo here"; exit 2; }
    root=(sudo)
  fi
  say "installing Debian packages (about a minute) ..."
  "${root[@]}" apt-get update -qq
  "${root[@]}" env DEBIAN_FRONTEND=noninteractive \
    apt-get install -y -qq --no-install-recommends "${packages[@]}" >/dev/null
}

make_venv() {
  say "making .venv with $python ..."
  "$python" -m venv --system-site-packages .venv
  local site
  site=$(.venv/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
  # So that pgran finds PETSc without an exported PETSC_DIR.
  for folder in "${PETSC_DIR:-}" "${SLEPC_DIR:-}"; do
    [ -d "$folder/lib/python3/dist-packages" ] && echo "$folder/lib/python3/dist-packages"
  done >"$site/pgran_petsc.pth" || true
  # The distribution's packages stay as they are: pip does not recognise all of them.
  local build=(--no-build-isolation)
  .venv/bin/python -c 'import setuptools, wheel' 2>/dev/null || build=()
  .venv/bin/python -m pip install -q --no-deps "${build[@]}" -e .
  local missing=() name
  for name in "${extras[@]}"; do
    .venv/bin/python -c "import $name" 2>/dev/null || missing+=("$name")
  done
  local complete=yes
  for name in "$ruff" "${missing[@]}"; do
    .venv/bin/python -m pip install -q "$name" || { complete=; say "$name: not installed (no PyPI?)"; }
  done
  .venv/bin/python -c 'import pgran'
  [ -z "$complete" ] || touch .venv/complete # else the next call tries again
}

if [ ! -e .venv/complete ] || [ pyproject.toml -nt .venv/complete ] || [ jobs/setup.sh -nt .venv/complete ]; then
  find_python
  [ -n "$python" ] || { install_packages; find_python; }
  [ -n "$python" ] || { say "the packages are installed, but petsc4py does not work:"; \
    PETSC_DIR=$(debian_folder petsc) /usr/bin/python3 -c 'from petsc4py import PETSc'; exit 2; }
  make_venv
fi

source .venv/bin/activate
export OMP_NUM_THREADS=1
# Open MPI refuses root (a container) and more ranks than cores unless told so.
export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 OMPI_MCA_rmaps_base_oversubscribe=1
export PRTE_MCA_rmaps_default_mapping_policy=:oversubscribe # the same for Open MPI 5
