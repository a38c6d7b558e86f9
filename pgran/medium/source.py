"""What drives a medium: a wall, a part of it, or a push.

A source is w, how far it stretches each spring, and p, a force on each unknown:

    f(s) = -B^T (k + s beta d) w + p.

Walls and held balls that move make w, a push makes p; the solvers see both alike. A push of the
size kmax moves balls by some spacings, as a wall does that moves by 1: amplitudes are in units of
F / kmax.
"""

import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from pgran.arguments import called_right
from pgran.errors import InputError
from pgran.medium.base import AXES, Medium, is_drive
from pgran.medium.conditions import choose
from pgran.medium.springs import AT_REST, DRIVEN


@called_right
def with_source(
    medium: Medium, part: str | None = None, direction: "str | ArrayLike" = "drive",
    balls: "ArrayLike | None" = None, force: "str | ArrayLike" = "drive",
) -> Medium:  # fmt: skip
    """Return a medium with another drive: the options `-drive_part` and so on.

    Parameters
    ----------
    medium : pgran.Lattice or pgran.Network
    part : str, optional
        A condition on places of the wall, or on held balls: these move, the others are at rest.
    direction : str or array_like of float, shape (d,)
        How held balls of networks with vectors move: `drive` (as before), `x`, `y`, `z`, or
        components.
    balls : array_like of int, optional
        Balls under a force, which drives instead of held balls or walls: kmax in all, in equal
        shares.
    force : str or array_like of float, shape (d,)
        The direction of that force, likewise.

    Returns
    -------
    pgran.Lattice or pgran.Network

    Raises
    ------
    InputError
        If there are no such balls or places, or the choices contradict each other.

    Examples
    --------
    >>> import pgran
    >>> lattice = pgran.Lattice.random((6, 5), seed=1)
    >>> pgran.with_source(lattice, part="y>=2").wall
    array([0., 0., 1., 1., 1.])
    """
    if part is not None and balls is not None:
        raise InputError("-drive_part and -drive_balls: give one, a wall or a force drives")
    if balls is None and not is_drive(force):
        raise InputError("-drive_force: points the force on -drive_balls; give them too")
    for name, chosen in (("drive_direction", direction), ("drive_force", force)):
        if not is_drive(chosen):
            medium = dataclasses.replace(medium, direction=medium.along(chosen, name))
    if part is not None:
        medium = dataclasses.replace(medium, **_part(medium, part))
    if balls is not None:
        places = medium.numbers_of(medium.sites(balls, "-drive_balls"))
        shares = np.bincount(places, minlength=medium.free_balls) / len(places)
        medium = dataclasses.replace(medium, **medium.pushed_by(medium.kmax * shares))
    return medium


def _part(medium, condition):
    """Return the fields that let the held balls, or places of the wall, of a condition drive."""
    if medium.is_grid:
        places = np.indices(medium.shape[1:]).reshape(medium.axes - 1, -1)
        held = np.arange(places.shape[1])
    else:
        held = np.flatnonzero(medium.held)
        places = [] if medium.position is None else medium.position[held].T
    columns = dict(zip(AXES[medium.is_grid :], places, strict=False))

    def column(name):
        if name not in columns:
            there = ", ".join(columns) or "none"
            raise InputError(f"there is no {name} along what is held; coordinates are: {there}")
        return columns[name]

    chosen = choose("-drive_part", condition, held, column)
    if medium.is_grid:
        return {"wall": chosen.astype(float).reshape(medium.shape[1:])}
    kinds = medium.held.copy()
    kinds[held] = np.where(chosen, DRIVEN, AT_REST)
    return {"held": kinds}
