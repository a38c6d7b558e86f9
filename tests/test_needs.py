"""A scene leaves out what it does not need: a table of what some import, make and store.

Each runs in a process of its own; Python's profiler counts the calls of the functions that import,
assemble, factor, search and gather.
"""

import json
import sys

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
    "adjoints": "Detectors.unit_vectors",
    "blocks of solves": "Windows._flexibility",
    "counts of modes": "ModeCounter._inertia",
    "searches for modes": "ModeSolver._search",
    "fields gathered": "Layout.field",
    "spectra": "power_spectrum",
}
SMALL = "-lattice_shape 6,5 -detectors 3,2 -sweep_min .1 -sweep_max 1 -sweep_points 3"
# What each scene needs; a number, or True for any but none. What is not named is none.
NEEDS = {
    "-scene continuum -sweep_points 3": {"imports": {"h5py"}, "stores": {"continuum"}},
    f"-scene response -output_fields {SMALL}": {
        "imports": {"PETSc", "h5py"},
        "Laplacians": 2, "S": 1, "factorizations": 3, "adjoints": 1, "fields gathered": 3,
        "stores": {"lattice", "response", "response/field"},
    },
    f"-scene response -lattice_damping 0 {SMALL}": {
        "imports": {"PETSc", "h5py"},
        "Laplacians": 1, "S": 1, "factorizations": 3, "adjoints": 1, "counts of modes": True,
        "stores": {"lattice", "response"},
    },
    "-scene modes -modes_omega_min .3 -modes_omega_max .4 -lattice_shape 6,5": {
        "imports": {"PETSc", "SLEPc", "h5py"},
        "Laplacians": 1, "counts of modes": 4, "searches for modes": 1,
        "stores": {"lattice", "modes"},
    },
    "-scene projection -lattice_shape 6,5 -sweep_omega .3,.5": {
        "imports": {"PETSc", "SLEPc", "h5py"},
        "Laplacians": 3, "S": 1, "factorizations": 2, "adjoints": 1,  # of no detector
        "searches for modes": 1,
        "fields gathered": 2, "stores": {"lattice", "projection"},
    },
    "-scene relaxation -lattice_shape 6,5 -detectors 3,2 -relax_steps 400 -spectrum_fit_min .1": {
        "imports": {"PETSc", "SciPy", "h5py"},
        "Laplacians": 2, "S": 1, "factorizations": True, "adjoints": 1, "blocks of solves": True,
        "spectra": 1, "stores": {"lattice", "relaxation", "spectrum"},
    },
}  # fmt: skip


@pytest.mark.parametrize("options", NEEDS)
def test_a_scene_leaves_out_what_it_does_not_need(options, start, place):
    watch, path = (sys.executable, "-c", WATCH, "watched.json"), place("none.opts", "")
    done = start("run", path.name, *options.split(), "-output_file", "a.h5", program=watch)
    assert done.returncode == 0, done.stderr
    watched = json.loads(path.with_name("watched.json").read_text())
    found = {name: watched["calls"].get(function, 0) for name, function in MAKES.items()}
    found["imports"] = {name for name, module in IMPORTS.items() if module in watched["modules"]}
    with h5py.File(path.with_name("a.h5")) as file:
        large = {name for name in ("response/field", "modes/vector") if name in file}
        found["stores"] = large.union(file)
    for name, value in found.items():
        needed = NEEDS[options].get(name, 0)
        assert value > 0 if needed is True else value == needed, name


def test_reading_results_needs_no_petsc(start):
    names = "petsc4py", "mpi4py"
    code = f"import pgran, pgran.draw.pages, sys; print(*(n in sys.modules for n in {names}))"
    assert start(program=(sys.executable, "-c", code)).stdout.split() == ["False", "False"]
