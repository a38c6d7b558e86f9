"""Experiments made small, for tests that run commands and snippets as they are written."""

import re
import shutil
from pathlib import Path

OPTIONS = Path(__file__).parents[1] / "options"
SMALL = {
    r"-lattice_shape 20,20": "-lattice_shape 6,5",
    r"detectors 8,10": "detectors 2,3",
    r"-lattice_shape 56,30": "-lattice_shape 9,6",
    r"-drive_part .*": "-drive_part 'y>=2 and y<4'",
    r"-detectors 12,10,4,10": "-detectors 4,3,2,3",
    r"-detectors 48,15": "-detectors 5,3",
    r"-detectors 1[69],10.*": "-detectors 5,3,4,3,2,3,0,3",
    r"-green_sources 8,10,12,10": "-green_sources 2,3,4,3",
    r"-sweep_points \d{3,}": "-sweep_points 200",
    r"-relax_steps \d+": "-relax_steps 3000",
    r"-heat_samples \d+": "-heat_samples 2",
    r"-accuracy_repeats \d+": "-accuracy_repeats 1",
    r"-lattice_shape 40,250*\b": "-lattice_shape 6,5",
    r"-lattice_shape 40,20": "-lattice_shape 12,5",
    r"-detectors 34,10.*": "-detectors 10,3,7,3,4,3,2,3",
    r"-loud_amplitudes 1e-7.*": "-loud_amplitudes 1e-7,7e-7 -loud_stability false",
    r"-structure_count \d+": "-structure_count 2",
    r"-pulse_time 600": "-pulse_time 200",
    r"-pulse_points 2401": "-pulse_points 401",
    # in Python
    r"\(20, 20\)": "(11, 10)",
    r"\(8, 10\)": "(2, 3)",
    r"\b1291\b": "200",
    r"\btime=600\b": "time=200",
}


def made_small(text):
    """Return options or Python with sizes that take little time."""
    for long, short in SMALL.items():
        text = re.sub(long, short, text)
    return text


def copy_options(folder):
    """Make `folder`/options, with small experiments of the same names."""
    shutil.copytree(OPTIONS, folder / "options")
    for path in (folder / "options").glob("*.opts"):
        path.write_text(made_small(path.read_text()))
