"""Packings in mechanical equilibrium: what may be asked of one, and the network that it becomes.

Lengths are in mean diameters, constants in the law's modulus: a harmonic contact has c = 1, a
Hertzian one c = sqrt(R_i R_j / (R_i + R_j)); a ball of the mean diameter has the mass 1.
"""

import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from pgran.arguments import called_right, choice, whole_number
from pgran.balance.networks import network_of
from pgran.balance.settle import DENSITY, under_gravity, under_pressure
from pgran.errors import InputError
from pgran.medium.conditions import columns_in, hold
from pgran.medium.network import Network
from pgran.medium.packing import ContactLaw
from pgran.medium.springs import AT_REST, DRIVEN, FREE
from pgran.run.numbers import number, numbers

SIZE_RATIO = 1.4  # of the larger over the smaller diameter of bidisperse balls


@called_right
def pack(
    balls: int,
    dimension: int = 2,
    law: str | float = "harmonic",
    *,
    pressure: float | None = None,
    gravity: float | None = None,
    seed: int = 1993,
    sizes: "str | float | ArrayLike" = "bidisperse",
    shape: "ArrayLike | None" = None,
    walls: str | None = None,
    rest: str | None = None,
    drive: str | None = None,
) -> Network:
    """Return a packing in mechanical equilibrium, without friction.

    Lengths are in mean diameters, masses in that of a ball of this diameter, and forces in the
    contact law's constant: F = h is harmonic, F = sqrt(R_i R_j / (R_i + R_j)) h^(3/2) is Hertz.
    Where the enthalpy sum F h / (alpha + 1) - load . u + P V is least, forces balance (C. S.
    O'Hern et al., Phys. Rev. E 68, 011306 (2003)).

    Parameters
    ----------
    balls : int
        How many balls are packed; the rattlers among them are left out of the network.
    dimension : int
        2: discs, 3: spheres.
    law : str or float
        `harmonic`, `hertz`, or the power of the overlap.
    pressure : float, optional
        Pressure, in a box that is periodic along all axes.
    gravity : float, optional
        The acceleration, instead of a pressure: on a floor of held balls, under a free surface,
        down the last axis.
    seed : int
        Which packing.
    sizes : str, float or array_like of float, shape (balls,)
        Diameters: `bidisperse`, half of them 1.4 times as large; `equal`; a spread to both
        sides, such as .1; a list.
    shape : array_like of float, shape (dimension,), optional
        Ratios of the sides of the box; all equal unless given.
    walls : str, optional
        `x`, `y` or `z`: balls at both ends of this axis are held, those at the far end driven.
    rest, drive : str, optional
        Which other balls are held, at rest or driven, by place or radius: `y<1.5`, `x>max-1 and
        y>2`. Walls are at rest where a `drive` is given.

    Returns
    -------
    pgran.Network
        In balance to 1e-13 of the mean force.

    Raises
    ------
    InputError
        If the arguments contradict each other.
    PgranError
        If no rest is found.

    Examples
    --------
    >>> packing = pgran.pack(40, pressure=1e-2, seed=2)
    >>> packing.axes, bool(packing.force.min() > 0)
    (2, True)
    """
    return packed_network(**locals())[0]


def packed_network(
    balls, dimension=2, law="harmonic", *, pressure=None, gravity=None, seed=1993,
    sizes="bidisperse", shape=None, walls=None, rest=None, drive=None,
):  # fmt: skip
    """Return the network of `pack`, and the `Packed` that it was made of."""
    balls, seed = whole_number("pack: balls", balls), whole_number("pack: seed", seed)
    dimension = whole_number("pack: dimension", dimension)
    if dimension not in DENSITY:
        raise InputError(f"pack: dimension: discs have 2 and spheres 3, not {dimension}")
    for name, value, least in (("balls", balls, 1), ("seed", seed, 0)):
        if value < least:
            raise InputError(f"pack: {name}: must be {least} or more, not {value}")
    if (pressure is None) == (gravity is None):
        raise InputError("pack: give either a pressure or gravity")
    name, push = ("pressure", pressure) if gravity is None else ("gravity", gravity)
    push = number(f"pack: {name}", push)
    if not push > 0:
        raise InputError(f"pack: {name}: must be positive, not {push}")
    rule = ContactLaw.named("pack", law)
    if shape is not None:
        sides = numbers("pack: shape", shape)
        if sides.shape != (dimension,) or not np.all(sides > 0) or gravity is not None:
            raise InputError(f"pack: shape: needs {dimension} positive ratios, and a pressure")
    axes = "xyz"[:dimension]
    choice("pack: walls", "x" if walls is None else walls, axes if gravity is None else axes[:-1])
    for name, condition in (("rest", rest), ("drive", drive)):
        for column in () if condition is None else columns_in(str(condition)):
            choice(f"pack: {name}: a column", column, (*axes, "radius"))
    rng = np.random.default_rng(seed)
    diameter = diameters(balls, sizes, rng)
    if gravity is None:
        packed = under_pressure(diameter, dimension, rule, push, rng, shape)
    else:
        packed = under_gravity(diameter, dimension, rule, push, rng)
    median = float(np.median(diameter**dimension))  # rattlers included, as of an import
    return _network(packed, axes, walls, gravity, rest, drive, median), packed


def diameters(balls, sizes, rng):
    """Return diameters (N,) of mean 1: `bidisperse`, `equal`, a spread such as .1, or a list."""
    if isinstance(sizes, str):
        choice("pack: sizes", sizes, ("bidisperse", "equal"))
        large = np.arange(balls) >= balls // 2
        values = np.where(large & (sizes == "bidisperse"), SIZE_RATIO, 1.0)
    elif np.ndim(sizes) == 0:
        if not 0 <= sizes < 1:
            raise InputError(f"pack: sizes: a spread is 0 or more and less than 1, not {sizes}")
        values = 1 + float(sizes) * rng.uniform(-1, 1, balls)
    else:
        values = np.asarray(sizes, dtype=float)
        if values.shape != (balls,) or not np.all((values > 0) & np.isfinite(values)):
            raise InputError(f"pack: sizes: {balls} positive diameters are needed, one a ball")
    return values / values.mean()


def _network(packed, axes, walls, gravity, rest, drive, median):
    """Return the network of a packing, of a median mass, held by walls and conditions."""
    balls, contacts = packed.rest.balls, packed.contacts
    held, box, position = balls.held.astype(int), balls.box.copy(), balls.position.copy()
    periodic = np.isfinite(box)
    position[:, periodic] %= box[periodic]
    if walls is not None:
        axis, thickness = axes.index(walls), 2 * balls.radius.max()
        along = np.where(balls.held, np.nan, position[:, axis])  # a floor stays at rest
        held[along < thickness] = AT_REST
        held[along > box[axis] - thickness] = DRIVEN if drive is None else AT_REST
        box[axis] = np.inf
    columns = dict(zip(axes, position.T, strict=True)) | {"radius": balls.radius}
    ids = np.arange(len(held))
    held = hold(held, ids, columns.__getitem__, rest=rest, drive=drive)
    contacts = contacts.of(np.any(held[contacts.pairs] == FREE, axis=1))
    if not len(contacts.pairs):
        raise InputError("pack: rest, drive, walls: no ball is left free")
    if drive is not None and not np.any(held[contacts.pairs] == DRIVEN):
        raise InputError(f"pack: drive: {drive}: none of these balls touches a free one")
    balls = dataclasses.replace(balls, position=position, box=box)
    down = None if gravity is None else -gravity * np.eye(len(axes))[-1]
    return network_of(
        packed.rest._replace(balls=balls, contacts=contacts),
        held=held,
        masses=(2 * balls.radius) ** len(axes),
        median_mass=median,
        displacement="vector",
        gravity=down,
        direction=None if walls is None else np.eye(len(axes))[axis],
    )
