"""What comments of options files offer instead runs as well, in small."""

import re

import pytest
from small import OPTIONS

# A comment that is a line of options, and those that follow it at once: they belong together.
OFFERED = re.compile(r"(?:^#-.*\n)+", re.MULTILINE)
SMALL = {
    "lattice_shape": "6,5", "detectors": "2,3", "modes_detectors": "2,3", "sweep_points": "20",
    "relax_steps": "40", "ensemble_samples": "40", "modes_density": "4",
    "loud_amplitudes": "1e-7", "loud_stability": "false",
}  # fmt: skip


def offers():
    """Yield each file of an experiment with each of the alternatives that it offers."""
    for path in sorted([*OPTIONS.glob("*.opts"), *OPTIONS.glob("solvers/*.opts")]):
        for number, lines in enumerate(OFFERED.findall(path.read_text()), 1):
            yield pytest.param(path, lines, id=f"{path.stem}-{number}")


@pytest.mark.parametrize(("path", "lines"), list(offers()))
def test_an_alternative(call, place, path, lines):
    """On its own line, or several together."""
    text = path.read_text() + lines.replace("#-", "-")
    if path.parent != OPTIONS:
        text = "-scene response\n-lattice_shape\n-detectors\n" + text
    keys = set(re.findall(r"^-(\w+)", text, re.MULTILINE))
    if "network_file" in keys:
        keys -= {"detectors"}
        text += "-modes_target .3\n-modes_count 3\n" * ("-scene modes\n" in text)
    few = {key: value for key, value in SMALL.items() if key in keys}
    text = "".join(f"{line}\n" for line in text.splitlines() if line[1:].split(" ")[0] not in few)
    text += "".join(f"-{key} {value}\n" for key, value in few.items())
    place("a.opts", text.replace("options/", f"{OPTIONS}/"))
    done = call("run", "a.opts", "-output_file", "a.h5", "-output_progress", "none")
    assert done.returncode == 0, done.stderr
