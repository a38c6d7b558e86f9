"""`pgran plot`: the figures of a result, alone or with another of the same lattice laid over."""

import argparse
import logging
import os
from pathlib import Path

import pgran
from pgran import figures
from pgran.errors import DONE, FileError

log = logging.getLogger("pgran")

LAID_OVER = {"response": "modes", "pulse": "response"}  # and over what


def plot(result, output=None, modes=None, response=None):
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
        Angular frequencies of normal modes, marked by pluses on the frequency axes of a response.
    response : pgran.results.Response, optional
        Of the same lattice; its amplitudes are laid over the spectra of a pulse.

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
    made = figures.make(shown, modes=modes, response=response)
    if output is not None:
        figures.save(made, output)
    return made


def run(words):
    """Draw the figures of a result.

    With another one of the same lattice its modes are marked in a response, or its response is laid
    over the spectra of a pulse.
    """
    parser = argparse.ArgumentParser("pgran plot", description=run.__doc__)
    parser.add_argument("result", help="HDF5 file that pgran run has written")
    parser.add_argument("other", nargs="?", help="another one, in either order")
    parser.add_argument("-o", "--output", help="figure file; its ending decides the format")
    given = parser.parse_intermixed_args(words)
    path, shown, over = given.result, pgran.load(given.result), {}
    if given.other:
        other = pgran.load(given.other)
        drawn, name, record = _pair(shown, other)
        path, shown = given.other if drawn is other else path, drawn
        over[name] = record.omega if name == "modes" else record
        if name == "modes" and not record.count_certified:
            log.warning("modes are missing or inaccurate, so not all are marked")
    output = given.output or Path(path).with_suffix(".png")
    for drawn in figures.save(figures.make(shown, **over), output):
        print(drawn)
    return DONE


def _pair(one, other):
    """Return which of two results of one lattice is drawn, and what is laid over: name, record."""
    import numpy as np  # late: `pgran --help` loads nothing

    for drawn, over in ((one, other), (other, one)):
        for group, name in LAID_OVER.items():
            if not (hasattr(drawn, group) and hasattr(over, name)):
                continue
            same = ["shape", "mass", "bonds_sha256"]
            if name == "response":  # modes have neither damping nor drive
                same += ["damping", "damped", "held", "direction", "component"]
            for fact in same:
                values = [getattr(result.medium, fact, None) for result in (drawn, over)]
                if not np.array_equal(*values):
                    raise FileError(f"the {group} and the {name} belong to different lattices")
            return drawn, name, getattr(over, name)
    pairs = " or ".join(f"{group} and {name}" for group, name in LAID_OVER.items())
    raise FileError(
        f"two results that are drawn together are {pairs}, not {one.scene} and {other.scene}"
    )
