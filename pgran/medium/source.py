"""What drives a medium: a wall, a part of it, or a push, and on which sides a lattice has walls.

A source is w, how far it stretches each spring, and p, a force on each unknown:

    f(s) = -B^T (k + s beta d) w + p.

Walls and held balls that move make w, a push makes p; the solvers see both alike. A push of the
size kmax moves balls by some spacings, as a wall does that moves by 1: amplitudes are in units of
F / kmax.
"""

import contextlib
import dataclasses

import numpy as np

from pgran.arguments import called_right, choice, shown
from pgran.errors import InputError
from pgran.medium.bonds import AXES
from pgran.medium.conditions import choose
from pgran.medium.springs import AT_REST, DRIVEN
from pgran.run.numbers import numbers
from pgran.run.options import INTEGERS, TEXT, Option
from pgran.store.estimate import counted

ALONG = "the direction in the file (drive), x, y, z, or components as 1,0,1"
OF_SOURCE = (
    Option(
        "drive_part", TEXT, None,
        "which part drives: places of the wall, or held balls, by a condition such as 'y>=5 and "
        "y<15'; all else is at rest"
    ),
    Option(
        "drive_direction", TEXT, "drive", f"of networks with vectors: how held balls move: {ALONG}"
    ),
    Option(
        "drive_balls", INTEGERS, None,
        "a force on these balls drives instead: indices from 0, as of -detectors; in all it has "
        "the size kmax, and amplitudes are in units of that force over kmax",
        low=0, high=2**63 - 1
    ),
    Option("drive_force", TEXT, "drive", f"of networks with vectors: how it acts: {ALONG}"),
)  # fmt: skip


@called_right
def with_source(medium, part=None, direction="drive", balls=None, force="drive"):
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
    """
    if part is not None and balls is not None:
        raise InputError("-drive_part and -drive_balls: give one, a wall or a force drives")
    if balls is None and not is_drive(force):
        raise InputError("-drive_force: points the force on -drive_balls; give them too")
    for name, chosen in (("drive_direction", direction), ("drive_force", force)):
        if not is_drive(chosen):
            medium = dataclasses.replace(medium, direction=along(medium, chosen, name))
    if part is not None:
        medium = dataclasses.replace(medium, **_part(medium, part))
    if balls is not None:
        places = medium.numbers_of(medium.sites(balls, "-drive_balls"))
        shares = np.bincount(places, minlength=medium.free_balls) / len(places)
        medium = dataclasses.replace(medium, **medium.pushed_by(medium.kmax * shares))
    return medium


def is_drive(direction):
    """Return whether a direction is that of the drive."""
    return isinstance(direction, str) and direction == "drive"


def along(medium, direction, name):
    """Return the direction that is asked for, of length 1; (1,) where balls have one displacement.

    Raises InputError, which calls it by its `name`, if there is no such direction.
    """
    own = getattr(medium, "direction", np.ones(1))
    if is_drive(direction):
        return own
    if len(own) == 1:
        raise InputError(f"-{name}: balls of this medium have one displacement")
    if isinstance(direction, str):
        components = [float(direction == axis) for axis in AXES[: len(own)]]
        with contextlib.suppress(ValueError):
            components = [float(word) for word in direction.split(",")]
    else:
        components = numbers(f"-{name}", direction)
    size = np.linalg.norm(components)
    if np.shape(components) != own.shape or not 0 < size < np.inf:
        possible = f"drive, {', '.join(AXES[: len(own)])}, or {len(own)} components"
        raise InputError(f"-{name}: choose {possible}, not {shown(direction)}")
    return np.asarray(components) / size


def _part(medium, condition):
    """Return what is driven where a condition chooses a part of what is held."""
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


def checked_sides(sides, axes):
    """Return sides such as `y+`, in order; raise InputError if a lattice has none of that name."""
    sides = tuple(sides.split(",")) if isinstance(sides, str) else tuple(sides)
    possible = [f"{axis}{end}" for axis in AXES[:axes] for end in "-+"]
    for side in sides:
        choice("-lattice_free", side, possible)
    return tuple(side for side in possible if side in sides)


def checked_drive(name, value, shape):
    """Return motions or forces that drive, as a copy that nobody can change, or None."""
    if value is None:
        return None
    array = np.array(numbers(f"lattice: {name}", value))
    if array.shape != shape or not np.all(np.isfinite(array)) or not np.any(array):
        raise InputError(
            f"lattice: {name}: finite numbers of the shape {shape} are needed, not all zero"
        )
    array.flags.writeable = False
    return array


def nearest(places, driving):
    """Return the distance of each place (n, d) from the nearest that drives, (m, d)."""
    away = np.asarray(places)[:, None] - driving
    return np.sqrt(np.sum(away**2, axis=2)).min(axis=1)


def in_words(medium):
    """Yield in words what drives a medium, if it is no whole wall, and which walls are missing."""
    if medium.push is not None:
        yield f"driven by a force on {counted(np.count_nonzero(medium.push_sizes), 'ball')}"
    elif medium.is_grid and medium.wall is not None:
        yield f"driven at {np.count_nonzero(medium.wall)} of {medium.wall.size} places of a wall"
    if medium.is_grid and medium.free:
        yield f"no wall at {', '.join(medium.free)}"
