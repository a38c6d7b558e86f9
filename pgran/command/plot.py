"""`pgran plot`: the figures of a result, or of a response with the modes of its lattice marked."""

import argparse
import logging
from pathlib import Path

import pgran
from pgran import figures
from pgran.errors import DONE, FileError

log = logging.getLogger("pgran")


def plot(words):
    """Draw the figures of a result, a response with the modes of another one marked."""
    parser = argparse.ArgumentParser("pgran plot", description=plot.__doc__)
    parser.add_argument("result", help="HDF5 file that pgran run has written")
    parser.add_argument("other", nargs="?", help="modes of the response's lattice, or vice versa")
    parser.add_argument("-o", "--output", help="figure file; its ending decides the format")
    given = parser.parse_intermixed_args(words)
    path, shown, modes = given.result, pgran.load(given.result), None
    if given.other:
        other = pgran.load(given.other)
        response, marked = pair(shown, other)
        path, shown = given.other if response is other else path, response
        modes = marked.modes.omega
        if not marked.modes.count_certified:
            log.warning("modes are missing or inaccurate, so not all are marked")
    output = given.output or Path(path).with_suffix(".png")
    for drawn in figures.save(figures.make(shown, modes), output):
        print(drawn)
    return DONE


def pair(one, other):
    """Return which of two results of one lattice is a response, and which holds its modes.

    Raises
    ------
    FileError
        If they are not a response and modes, or belong to different lattices.
    """
    import numpy as np  # late: `pgran --help` loads nothing

    response, modes = (one, other) if hasattr(one, "response") else (other, one)
    if not (hasattr(response, "response") and hasattr(modes, "modes")):
        raise FileError(
            f"two results are drawn together if one holds a response and the other modes, "
            f"not {one.scene} and {other.scene}"
        )
    for name in ("mass", "stiffness_x", "stiffness_y", "stiffness_z"):
        values = [getattr(result.lattice, name, None) for result in (response, modes)]
        if not np.array_equal(*values):
            raise FileError("the response and the modes belong to different lattices")
    return response, modes
