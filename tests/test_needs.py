"""A scene leaves out what it does not need: a table of what each one imports, makes and stores.

    python tests/test_needs.py     prints the table

Each scene runs in a process of its own; Python's profiler counts the calls of the functions that
import, assemble, factor, search and gather.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import h5py
import pytest

WATCH = """
import json, sys
from collections import Counter
calls, out = Counter(), sys.argv.pop(1)
def note(frame, event, argument):
    if event == "call":
        calls[frame.f_code.co_qualname] += 1
from pgran.__main__ import console
sys.setprofile(note)
try:
    console()
finally:
    sys.setprofile(None)
    with open(out, "w") as stream:
        json.dump({"calls": calls, "modules": sorted(sys.modules)}, stream)
"""

# What it costs, and the function or module that shows it.
IMPORTS = {
    "PETSc": "petsc4py.PETSc",
    "SLEPc": "slepc4py.SLEPc",
    "SciPy": "scipy",
    "h5py": "h5py",
    "matplotlib": "matplotlib",
}
MAKES = {
    "Laplacians": "Operators._assemble",
    "S": "Operators.S",
    "factorizations": "SteadySolver._factor",
    "adjoints": "Detectors.unit_vector",
    "blocks of solves": "Windows._flexibility",
    "counts of modes": "ModeCounter._inertia",
    "searches for modes": "ModeSolver._search",
    "fields gathered": "Operators.field",
    "spectra": "power_spectrum",
}
SMALL = "-lattice_shape 6,5 -detectors 3,2 -sweep_min .1 -sweep_max 1 -sweep_points 3"
MODES = "-lattice_shape 6,5"
RELAX = "-lattice_shape 6,5 -detectors 3,2 -relax_steps 400 -spectrum_fit_min .1"
BASE = {"imports": {"PETSc", "h5py"}}
# The options file of these tests is empty: as a solver's, the defaults.
ONE_SOLVER = "-accuracy_solvers a.opts -accuracy_repeats 1 -accuracy_tolerances 1e-4"
# What each scene needs; a number, or True for any but none. What is not named is none.
NEEDS = {
    "-scene continuum -sweep_points 3": {"imports": {"h5py"}, "stores": {"continuum"}},
    f"-scene response {SMALL}": {
        **BASE,
        "Laplacians": 2, "S": 1, "factorizations": 3, "adjoints": 1,
        "stores": {"lattice", "response"},
    },
    f"-scene response -output_fields {SMALL}": {
        **BASE,
        "Laplacians": 2, "S": 1, "factorizations": 3, "adjoints": 1, "fields gathered": 3,
        "stores": {"lattice", "response", "response/field"},
    },
    f"-scene response -lattice_damping 0 {SMALL}": {
        **BASE,
        "Laplacians": 1, "S": 1, "factorizations": 3, "adjoints": 1, "counts of modes": True,
        "stores": {"lattice", "response"},
    },
    f"-scene modes {MODES}": {
        "imports": {"PETSc", "SLEPc", "h5py"},
        "Laplacians": 1, "searches for modes": 1,
        "stores": {"lattice", "modes"},
    },
    f"-scene modes -output_fields -modes_omega_min .3 -modes_omega_max .4 {MODES}": {
        "imports": {"PETSc", "SLEPc", "h5py"},
        "Laplacians": 1, "counts of modes": 4, "searches for modes": 1,
        "stores": {"lattice", "modes", "modes/vector"},
    },
    "-scene projection -lattice_shape 6,5 -sweep_omega .3,.5": {
        "imports": {"PETSc", "SLEPc", "h5py"},
        "Laplacians": 3, "S": 1, "factorizations": 2, "searches for modes": 1,
        "fields gathered": 2, "stores": {"lattice", "projection"},
    },
    f"-scene relaxation {RELAX}": {
        "imports": {"PETSc", "SciPy", "h5py"},
        "Laplacians": 2, "S": 1, "factorizations": True, "adjoints": 1, "blocks of solves": True,
        "spectra": 1, "stores": {"lattice", "relaxation", "spectrum"},
    },
    f"-scene relaxation -relax_method direct {RELAX}": {
        "imports": {"PETSc", "SciPy", "h5py"},
        "Laplacians": 2, "S": 1, "factorizations": 401, "adjoints": 1,
        "spectra": 1, "stores": {"lattice", "relaxation", "spectrum"},
    },
    f"-scene accuracy {ONE_SOLVER} {SMALL}": {  # a reference, and one run
        **BASE,
        "Laplacians": 4, "S": 2, "factorizations": 6, "adjoints": 2,
        "stores": {"lattice", "accuracy"},
    },
    f"-scene accuracy {ONE_SOLVER} -accuracy_of modes {MODES}": {
        "imports": {"PETSc", "SLEPc", "h5py"},
        "Laplacians": 2, "searches for modes": 2,
        "stores": {"lattice", "accuracy"},
    },
}  # fmt: skip


def seen(options, folder, environment):
    """Run a scene and return what it imported, made and stored."""
    (folder / "a.opts").write_text("")
    watched = folder / "watched.json"
    words = [sys.executable, "-c", WATCH, str(watched), "run", "a.opts", *options.split()]
    words += ["-output_file", "a.h5", "-output_overwrite"]
    done = subprocess.run(
        words, cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(watched.read_text())
    with h5py.File(folder / "a.h5") as file:
        large = [name for name in ("response/field", "modes/vector") if name in file]
        stores = {*file, *large}
    return {
        "imports": {name for name, module in IMPORTS.items() if module in found["modules"]},
        **{name: found["calls"].get(function, 0) for name, function in MAKES.items()},
        "stores": stores,
    }


@pytest.mark.parametrize("options", NEEDS)
def test_a_scene_leaves_out_what_it_does_not_need(options, tmp_path, clean_environment):
    found, needed = seen(options, tmp_path, clean_environment), NEEDS[options]
    for name in found:
        if needed.get(name) is True:
            assert found[name] > 0, name
        else:
            assert found[name] == needed.get(name, 0), name


def test_reading_results_needs_no_petsc(tmp_path, clean_environment):
    names = "petsc4py", "mpi4py"
    code = f"import pgran, pgran.figures, sys; print(*(n in sys.modules for n in {names}))"
    words = [sys.executable, "-c", code]
    done = subprocess.run(words, env=clean_environment, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "False"]


def main():
    """Print the table."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        for options in NEEDS:
            found = seen(options, Path(folder), os.environ)
            print(options)
            for name, value in found.items():
                if value:
                    words = ", ".join(sorted(value)) if isinstance(value, set) else value
                    print(f"    {name:20} {words}")


if __name__ == "__main__":
    main()
