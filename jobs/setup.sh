#!/usr/bin/env bash
# Installs what pgran needs and makes .venv with pgran in it.
#
#   bash jobs/setup.sh      install; nothing is done that is done already
#   source jobs/setup.sh    the same, and the environment of a job script:
#                           the project's folder, .venv
#
# A python3 with complex petsc4py and slepc4py (conda-forge, a cluster's module) is used as it is, and
# nothing is installed but pgran. Else the distribution's packages are, on Debian and Ubuntu (sudo
# where you are not root). Where they cannot be, all comes from PyPI, PETSc in a wheel.
#
#   PGRAN_STACK=wheel bash jobs/setup.sh    all from PyPI at once, in .venv-wheel beside .venv
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

case ${PGRAN_STACK:-} in
  "") venv=.venv ;;
  wheel) venv=.venv-wheel ;;
  *) echo "setup: PGRAN_STACK is $PGRAN_STACK; it can be wheel, or nothing" >&2; exit 2 ;;
esac

# One of these that is active already must not be mistaken for the python3 to build on.
PATH=${PATH//"$PWD/.venv/bin:"/}
PATH=${PATH//"$PWD/.venv-wheel/bin:"/}
export PATH # in an empty environment it is the shell's alone

packages=(
  python3-petsc4py python3-petsc4py-complex python3-slepc4py python3-slepc4py-complex
  python3-mpi4py python3-h5py-mpi python3-numpy python3-scipy python3-matplotlib python3-tqdm
  python3-pytest python3-mpmath python3-xarray python3-h5netcdf python3-pandas python3-venv
  python3-setuptools python3-wheel openmpi-bin libopenblas0-pthread
)
# The same from PyPI: a wheel of another project's with PETSc, SLEPc, petsc4py and slepc4py in it.
wheels=(
  dolfinx-solver-complex==0.11.0.post0 mpich==5.0.2 mpi4py==4.1.2 h5py==3.16.0 numpy==2.5.5
  scipy==1.18.1 matplotlib==3.11.2 tqdm==4.70.1 pytest==9.2.0 mpmath==1.4.1 xarray==2026.9.0
  h5netcdf==1.8.2 setuptools wheel
)
# Figures, spectra and tests; from PyPI where missing.
extras=(matplotlib scipy tqdm pytest mpmath meshio networkx pandas nbclient ipykernel)
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
  # Alone Open MPI would start a daemon, for which it needs ssh.
  OMPI_MCA_ess_singleton_isolated=1 "$1" - <<'PYTHON'
import sys
assert sys.version_info >= (3, 11), "Python is older than 3.11"
import h5py, mpi4py.MPI, numpy
import petsc4py
petsc4py.init(["setup", "-skip_petscrc"])
from petsc4py import PETSc
from slepc4py import SLEPc
assert numpy.dtype(PETSc.ScalarType).kind == "c", "this PETSc has real scalars"
PYTHON
}

find_python() { # sets python, or leaves it empty
  python=
  if works python3 2>/dev/null; then
    python=$(command -v python3)
  elif debian_works 2>/dev/null; then
    PETSC_DIR=$(debian_folder petsc)
    SLEPC_DIR=$(debian_folder slepc)
    export PETSC_DIR SLEPC_DIR
    python=/usr/bin/python3
  fi
}

debian_works() {
  PETSC_DIR=$(debian_folder petsc) SLEPC_DIR=$(debian_folder slepc) works /usr/bin/python3
}

root=()
can_install() { # Debian packages
  command -v apt-get >/dev/null || return
  [ "$(id -u)" -eq 0 ] && return
  root=(sudo)
  command -v sudo >/dev/null && sudo apt-get --version >/dev/null
}

install_packages() {
  say "installing Debian packages (about a minute) ..."
  "${root[@]}" apt-get update -qq || say "apt-get update fails: going on with the lists there are"
  "${root[@]}" env DEBIAN_FRONTEND=noninteractive \
    apt-get install -y -qq --no-install-recommends "${packages[@]}" >/dev/null
}

find_wheel_python() { # sets python to one that the wheels are made for, or leaves it empty
  local name
  for name in python3 python3.{13,12,14} "${PYENV_ROOT:-${HOME:-}/.pyenv}"/versions/3.1[234].*/bin/python3; do
    "$name" - 2>/dev/null <<'PYTHON' || continue
import ensurepip, os, sys, sysconfig, venv
assert (3, 12) <= sys.version_info < (3, 15) and not sysconfig.get_config_var("Py_GIL_DISABLED")
assert sysconfig.get_platform() == "linux-x86_64"
assert tuple(map(int, os.confstr("CS_GNU_LIBC_VERSION").split()[1].split("."))) >= (2, 34)
PYTHON
    python=$(command -v "$name")
    return
  done
}

give_up() {
  say "With conda:     conda create -n pgran -c conda-forge python=3.12 'petsc=*=complex*' \\"
  say "                'slepc=*=complex*' petsc4py slepc4py mpi4py h5py ${extras[*]}"
  say "                conda activate pgran"
  say "On a cluster:   load the modules of a complex PETSc with petsc4py and slepc4py"
  say "then start this script again."
  exit 2
}

# A venv made with the python3 of another venv sees nothing of that one: its packages, nor an MPI from
# PyPI, which mpi4py looks for in the lib folder of the venv that it runs in.
hand_on() { # FOLDER of that other venv
  local file
  file=$("$1/bin/python3" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
  echo "import site; site.addsitedir('$file')" >>"$site/pgran_petsc.pth"
  for file in "$1"/lib/*; do
    [ -e "$venv/lib/${file##*/}" ] || ln -sfn "$file" "$venv/lib/${file##*/}"
  done
  for file in "$1"/bin/mpirun "$1"/bin/mpiexec; do # no links: they look for their helpers beside them
    [ -x "$file" ] || continue
    printf '#!/bin/sh\nexec "%s" "$@"\n' "$file" >"$venv/bin/${file##*/}"
    chmod +x "$venv/bin/${file##*/}"
  done
}

make_venv() {
  say "making $venv with $python${wheel:+, and PETSc from PyPI (about a minute)} ..."
  local made site outer= folder build=(--no-build-isolation) missing=() name complete=yes
  local -x PIP_DISABLE_PIP_VERSION_CHECK=1
  local flags=(--system-site-packages)
  if [ "$wheel" ]; then
    flags=()
    unset PETSC_DIR SLEPC_DIR # of another PETSc, if any
  else
    outer=$("$python" -c 'import sys; print(sys.prefix if sys.prefix != sys.base_prefix else "")')
  fi
  made="$python ${flags[*]}"
  if [ "$(cat "$venv/made" 2>/dev/null)" != "$made" ]; then
    [ ! -e "$venv" ] || say "$venv was made in another way: it is made anew"
    flags+=(--clear)
  fi
  "$python" -m venv "${flags[@]}" "$venv"
  echo "$made" >"$venv/made"
  site=$("$venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
  # What mpirun needs: Open MPI refuses root (a container) and more ranks than cores unless told so,
  # and ends where there is no ssh to other machines.
  cat >>"$venv/bin/activate" <<'ACTIVATE'
export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 OMPI_MCA_rmaps_base_oversubscribe=1
export PRTE_MCA_rmaps_default_mapping_policy=:oversubscribe # the same for Open MPI 5
command -v ssh >/dev/null || command -v rsh >/dev/null || export OMPI_MCA_plm_rsh_agent= # for one machine
ACTIVATE
  # So that pgran finds PETSc without an exported PETSC_DIR.
  for folder in "${PETSC_DIR:-}" "${SLEPC_DIR:-}"; do
    folder=${folder:+$folder/lib/python3/dist-packages}
    [ ! -d "$folder" ] || echo "$folder"
  done >"$site/pgran_petsc.pth"
  # So that pgran is found where a folder of its name, such as the clone, lies beside a script: Python
  # takes that for a package in parts unless its path holds a whole one, and pip keeps an editable
  # one off the path.
  echo "$PWD" >>"$site/pgran_petsc.pth"
  [ -z "$outer" ] || hand_on "$outer"
  [ -z "$wheel" ] || "$venv/bin/pip" install -q --only-binary :all: "${wheels[@]}" ||
    { say "PETSc cannot be installed from PyPI: see above"; give_up; }
  # The distribution's packages stay as they are: pip does not recognise all of them.
  "$venv/bin/python" -c 'import setuptools, wheel' 2>/dev/null || build=()
  "$venv/bin/python" -m pip install -q --no-deps "${build[@]}" -e .
  for name in "${extras[@]}"; do
    "$venv/bin/python" -c "import $name" 2>/dev/null || missing+=("$name")
  done
  # All at once is quicker; one by one says which cannot be had.
  "$venv/bin/python" -m pip install -q "$ruff" "${missing[@]}" 2>/dev/null ||
    for name in "$ruff" "${missing[@]}"; do
      "$venv/bin/python" -m pip install -q "$name" || { complete=; say "$name: not installed (no PyPI?)"; }
    done
  if ! (unset PETSC_DIR SLEPC_DIR; works "$venv/bin/python"; "$venv/bin/pgran" --version >/dev/null); then
    say "$venv is made, but does not work with $python: see above"
    exit 2
  fi
  [ -z "$complete" ] || touch "$venv/complete" # else the next call tries again
}

# OVITO's own reader, which reads what is exported: 500 MB that users of pgran do without. Where it
# cannot be had its tests are skipped.
install_ovito() { # called by jobs/test.sh alone
  python -c "import ovito.io" 2>/dev/null && return
  say "installing OVITO for the tests ..."
  local packages=(libegl1 libgl1 libglib2.0-0 libxkbcommon0 libfontconfig1 libdbus-1-3 libx11-6 libgssapi-krb5-2)
  ! can_install || install_packages || true
  python -m pip install -q --only-binary :all: ovito==3.17.2 && python -c "import ovito.io" ||
    say "OVITO cannot be had: its tests are skipped"
}

if [ ! -e "$venv/complete" ] || [ pyproject.toml -nt "$venv/complete" ] || [ jobs/setup.sh -nt "$venv/complete" ]; then
  python='' wheel=''
  if [ -z "${PGRAN_STACK:-}" ]; then
    find_python
    if [ -z "$python" ] && can_install; then
      if install_packages; then
        find_python
        [ -n "$python" ] || { say "the packages are installed, but do not work:"; debian_works || true; }
      else
        say "the packages cannot be installed: see above"
      fi
    fi
  fi
  if [ -z "$python" ]; then
    find_wheel_python
    wheel=yes
  fi
  if [ -z "$python" ]; then
    [ -n "${PGRAN_STACK:-}" ] || say "no python3 with complex petsc4py and slepc4py was found, and" \
      "Debian packages cannot be installed (no apt-get, or neither root nor sudo)."
    say "PETSc from PyPI needs Python 3.12 to 3.14 with its venv, on x86_64 with glibc 2.34 or later:" \
      "none was found. pyenv installs one without root."
    give_up
  fi
  make_venv
fi

source "$venv/bin/activate"
