"""`pgran plot`: the figures of a result, or of a response with the modes of its lattice marked."""

import argparse
import logging
import os
from pathlib import Path

import pgran
from pgran import figures
from pgran.errors import DONE, FileError

log = logging.getLogger("pgran")


def plot(result, output=None, modes=None):
    """Return the figures of a result by their names, `plot("a.h5")["amplitude"]`; save them too.

    Not collective.

    Parameters
    ----------
    result : pgran.record.Result, str or os.PathLike
        What `load` returns, or the path of its file.
    output : str or os.PathLike, optional
        Where to save: `results/a.png` gives `results/a-amplitude.png` and so on; the ending decides
        the format. A missing folder is made.
    modes : array_like, optional
        Angular frequencies of normal modes, marked by pluses on the frequency axes.

    Returns
    -------
    dict of str: matplotlib.figure.Figure

    Raises
    ------
    FileError
        If the result cannot be read or holds nothing to draw, or a figure cannot be saved.
    PgranError
        If there is no matplotlib.
    """
    shown = pgran.load(result) if isinstance(result, (str, os.PathLike)) else result
    made = figures.make(shown, modes)
    if output is not None:
        figures.save(made, output)
    return made


def run(words):
    """Draw the figures of a result, a response with the modes of another one marked."""
    parser = argparse.ArgumentParser("pgran plot", description=run.__doc__)
    parser.add_argument("result", help="HDF5 file that pgran run has written")
    parser.add_argument("other", nargs="?", help="modes of the response's lattice, or vice versa")
    parser.add_argument("-o", "--output", help="figure file; its ending decides the format")
    given = parser.parse_intermixed_args(words)
    path, shown, modes = given.result, pgran.load(given.result), None
    if given.other:
        other = pgran.load(given.other)
        response, marked = _pair(shown, other)
        path, shown = given.other if response is other else path, response
        modes = marked.modes.omega
        if not marked.modes.count_certified:
            log.warning("modes are missing or inaccurate, so not all are marked")
    output = given.output or Path(path).with_suffix(".png")
    for drawn in figures.save(figures.make(shown, modes), output):
        print(drawn)
    return DONE


def _pair(one, other):
    """Return which of two results of one lattice is a response, and which holds its modes."""
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
