"""Sound in a granular material: Leibig's lattice of balls and random springs."""

from os import PathLike

__version__ = "0.1.0"


def load(path):
    """Return a result file as attributes that hold NumPy arrays. See `pgran.files.store.load`."""
    from pgran.files import store

    return store.load(path)


def plot(result, output=None, modes=None):
    """Return the figures of a result by their names, `plot("a.h5")["amplitude"]`; save them too.

    Not collective.

    Parameters
    ----------
    result : pgran.results.Result, str or os.PathLike
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
    from pgran import figures

    made = figures.make(load(result) if isinstance(result, (str, PathLike)) else result, modes)
    if output is not None:
        figures.save(made, output)
    return made
