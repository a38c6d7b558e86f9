"""What a run loads of pgran, by a table: what is seldom needed is imported where it is used."""

import sys

import pytest

WATCH = """
import sys
from pgran.__main__ import console
try:
    console()
finally:
    ours = [module for name, module in sys.modules.items() if name.split(".")[0] == "pgran"]
    lines = [len(open(module.__file__).readlines()) for module in ours]
    print("LOADED", len(lines), sum(lines))
"""
SMALL = "-lattice_shape 6,5 -detectors 3,2"
SWEEP = f"{SMALL} -sweep_points 5"
# Of what a run is, the modules that it may load, and their lines.
PATHS = {
    "-scene continuum -sweep_points 5": (31, 4310),
    f"-scene response {SWEEP}": (53, 9480),
    f"-scene pulse {SMALL}": (53, 9450),
    f"-scene relaxation {SMALL} -relax_steps 40": (53, 9350),
    "-scene modes -lattice_shape 6,5": (51, 8930),
    f"-scene ensemble -ensemble_samples 2 {SWEEP}": (56, 10340),
    "plot": (46, 7060),
}


@pytest.mark.parametrize("path", PATHS)
def test_a_run_loads_what_its_scene_needs(path, start, place, shared_path):
    watch = sys.executable, "-c", WATCH
    if path == "plot":
        assert start("run", "a.opts", "-output_file", "a.h5").returncode == 0
        done = start("plot", "a.h5", program=watch)
    else:
        place("none.opts", "")
        done = start("run", "none.opts", *path.split(), "-output_file", "a.h5", program=watch)
    assert done.returncode == 0, done.stderr
    modules, lines = map(int, done.stdout.rpartition("LOADED")[2].split())
    most, longest = PATHS[path]
    said = f"{modules} modules, {lines} lines of pgran are loaded: import late what is seldom used"
    assert modules <= most, said
    assert lines <= longest, said
