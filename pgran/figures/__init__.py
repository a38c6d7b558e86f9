"""The figures of a result, from its file alone. The only part of pgran that imports matplotlib."""

import importlib
from pathlib import Path

from pgran.errors import FileError, PgranError, reason_of

# What draws which group of a result: a module whose `figures(result, modes)` yields names and
# figures, and whose NEEDS lists what it reads of that group, besides the lattice.
DRAWN = {
    group: f"pgran.figures.{group}"
    for group in ("response", "continuum", "modes", "projection", "relaxation", "accuracy")
}
WITHOUT_LATTICE = {"continuum"}

# What matplotlib can write and nobody calls a figure, or what needs a LaTeX installation.
NO_FIGURES = {"pgf", "raw", "rgba"}


def draw(result, output, modes=None):
    """Draw all figures of a result and save each.

    Not collective.

    Parameters
    ----------
    result : types.SimpleNamespace
        What `pgran.load` returns.
    output : str or os.PathLike
        `results/response.png` gives `results/response-amplitude.png` and so on; the ending decides
        the format. A missing folder is made.
    modes : array_like, optional
        Angular frequencies of normal modes, marked by pluses on the frequency axes.

    Returns
    -------
    list of pathlib.Path
        The files written.

    Raises
    ------
    FileError
        If the result holds nothing to draw, or the figures cannot be written.
    PgranError
        If there is no matplotlib.
    """
    output = Path(output)
    groups = [group for group in DRAWN if hasattr(result, group)]
    if not groups:
        scene = getattr(result, "scene", "unknown")
        raise FileError(f"nothing to draw in this result (scene {scene})")
    check_matplotlib()
    ending = check_ending(output)
    from pgran.figures import style

    written = []
    with style.applied():
        for group in groups:
            module = importlib.import_module(DRAWN[group])
            check_complete(result, group, module.NEEDS)
            for name, figure in module.figures(result, modes):
                path = output.with_name(f"{output.stem}-{name}{ending}")
                save(figure, path)
                written.append(path)
    return written


def check_matplotlib():
    """Raise unless matplotlib can be imported."""
    try:
        import matplotlib.figure  # noqa: F401
    except ImportError as error:
        raise PgranError(
            f"figures need matplotlib, which cannot be imported ({error}): "
            "pip install matplotlib, or apt install python3-matplotlib"
        ) from None


def check_ending(output):
    """Return the ending of a file name, dot included; raise if no figure can have it."""
    from matplotlib.backend_bases import FigureCanvasBase

    endings = sorted(set(FigureCanvasBase.get_supported_filetypes()) - NO_FIGURES)
    if output.suffix[1:].lower() not in endings:
        raise FileError(f"{output}: a figure's name ends in one of .{', .'.join(endings)}")
    return output.suffix


def check_complete(result, group, needs):
    """Raise unless a result holds a whole lattice, and in `group` all that it needs."""
    if group not in WITHOUT_LATTICE:
        stiffness = [f"stiffness_{name}" for name in "xyz"]
        check_group(result, "lattice", ("shape", "mass", "omega_mx"))
        check_group(result, "lattice", stiffness[: len(result.lattice.shape)])
        if not result.lattice.omega_mx > 0:
            raise FileError("nothing to draw in this result: without stiff bonds omega_mx is 0")
    check_group(result, group, needs)


def check_group(result, group, names):
    """Raise unless there is a group of a result with all of `names`."""
    for name in names:
        if getattr(getattr(result, group, None), name, None) is None:
            raise FileError(f"the result is incomplete: {group}/{name} is missing")


def pair(one, other):
    """Return which of two results of one lattice is a response, and which holds its modes.

    Not collective.

    Parameters
    ----------
    one, other : types.SimpleNamespace
        What `pgran.load` returns, in any order.

    Returns
    -------
    response, modes : types.SimpleNamespace
    swapped : bool
        Whether `other` is the response.

    Raises
    ------
    FileError
        If they are not a response and modes, or belong to different lattices.
    """
    swapped = not hasattr(one, "response")
    response, modes = (other, one) if swapped else (one, other)
    if not (hasattr(response, "response") and hasattr(modes, "modes")):
        scenes = " and ".join(getattr(each, "scene", "unknown") for each in (one, other))
        raise FileError(
            f"two results are drawn together if one holds a response and the other modes, "
            f"not {scenes}"
        )
    check_group(modes, "modes", ("omega",))
    for result in (response, modes):
        check_group(result, "lattice", ("shape", "mass"))
    if not same_lattice(response, modes):
        raise FileError("the response and the modes belong to different lattices")
    return response, modes, swapped


def same_lattice(one, other):
    """Return whether two results have the same bonds and masses."""
    known = [getattr(result, "bonds_sha256", None) for result in (one, other)]
    return (
        known[0] is not None
        and known[0] == known[1]
        and one.lattice.mass == other.lattice.mass
        and list(one.lattice.shape) == list(other.lattice.shape)
    )


def save(figure, path):
    """Write a figure; make its folder."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path)
    except OSError as error:
        raise FileError(
            f"{path}: cannot be written: {error.strerror or reason_of(error)}"
        ) from None
