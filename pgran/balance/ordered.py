"""The ordered counterpart of a packing: its stiffnesses, at random on the contacts of a lattice."""

import numpy as np

from pgran.arguments import called_right, whole_number
from pgran.errors import InputError
from pgran.medium.dissipation import of_new
from pgran.medium.network import Network
from pgran.medium.packing import near_pairs
from pgran.medium.springs import AT_REST, DRIVEN, FREE

DIAGONAL = 1.2  # spacings: contacts that are longer are diagonals
KEPT = ("kmax", "median_mass", "damping", "damping_power", "damping_reference")
ROUNDS = 20  # to find the spacing


@called_right
def ordered(packing: Network, seed: int = 1993) -> Network:
    """Return a packing's ordered counterpart: random forces, without random places.

    As in the paper the balls sit on a square lattice, of spheres a simple cubic one, where 4 or 6
    neighbours touch, the isostatic number. What contacts a packing has beyond, about as many a
    ball, are diagonals of the faces, drawn at random. (A triangular lattice would lack a third of
    its contacts, so that balls had more or fewer of them, as they do in a packing.) Stiffnesses and
    masses are the packing's, in another order; so is the unit of frequency. Displacements are
    scalar: those lattices do not resist shear, and forces in another order do not balance.

    Parameters
    ----------
    packing : pgran.Network
        Of `pgran.pack` or an import, under a pressure: periodic but along one axis at most,
        with balls at rest at its lower end and driven ones at the upper.
    seed : int
        What is drawn is a function of it.

    Returns
    -------
    pgran.Network
        With about as many balls, as wide, and as far from wall to wall, to half a spacing.

    Raises
    ------
    InputError
        If the packing is another one, or too small.

    Examples
    --------
    >>> packing = pgran.pack(120, pressure=1e-2, walls="x", seed=2)
    >>> lattice = pgran.ordered(packing, seed=1)
    >>> lattice.displacement, bool(lattice.bonds > 150)
    ('scalar', True)
    """
    rng = np.random.default_rng(whole_number("ordered: seed", seed))
    periodic, sides = _sides(packing)
    free = packing.held == FREE
    balls, axes, spacing = np.count_nonzero(free), len(sides), 0.0
    each = packing.bonds / balls
    for _ in range(ROUNDS):  # between walls there is a ball less than spacings
        spacing = ((sides - spacing * ~periodic).prod() / balls) ** (1 / axes)
    cells = np.rint(sides / spacing - ~periodic).astype(int)
    balls, wide = cells.prod(), (cells + ~periodic).prod()
    spacing = (sides.prod() / wide) ** (1 / axes)
    # walls are a layer of balls at both ends
    places = np.indices(np.where(periodic, cells, cells + 2)).reshape(axes, -1).T
    held = np.full(len(places), FREE)
    for axis in np.flatnonzero(~periodic):
        held[places[:, axis] == 0] = AT_REST
        held[places[:, axis] == cells[axis] + 1] = DRIVEN
    radius = np.full(len(places), spacing / 2)
    box = np.where(periodic, spacing * cells, np.inf)
    near = near_pairs(spacing * places, radius, box, 0.5 * spacing)
    moving = np.any(held[near[0]] == FREE, axis=1)
    pairs, away, distance = (values[moving] for values in near)
    contacts = round(each * balls)
    if contacts > len(pairs):
        raise InputError(f"ordered: {each:.3g} contacts a ball, more than a lattice has neighbours")
    nearest_first = np.lexsort((rng.random(len(pairs)), distance > DIAGONAL * spacing))
    chosen = np.sort(nearest_first[:contacts])
    masses = np.full(len(held), packing.median_mass)
    masses[held == FREE] = np.resize(rng.permutation(packing.masses[free]), balls)
    return Network(
        pairs[chosen],
        np.resize(rng.permutation(packing.stiffness), contacts),
        held,
        masses,
        position=spacing * places,
        normal=away[chosen] / distance[chosen, None],
        distance=distance[chosen],
        radius=radius,
        box=np.where(periodic, box, 0.0),
        **{name: getattr(packing, name) for name in KEPT},
        **of_new(packing, balls=True),
    )


def _sides(packing):
    """Return which axes are periodic, and the periods, or the distance of the walls."""
    if packing.position is None or packing.box is None or packing.gravity is not None:
        raise InputError("ordered: a packing under a pressure is needed, whose box is known")
    periodic, sides = packing.box > 0, packing.box.copy()
    walls = np.flatnonzero(~periodic)
    if len(walls) != len({*packing.held} - {FREE}) / 2:
        raise InputError("ordered: balls at rest and driven ones are at the ends of one axis")
    touched = np.isin(np.arange(len(packing.held)), packing.bond)
    for axis in walls:
        along = packing.position[:, axis]
        rest, driven = (along[touched & (packing.held == kind)] for kind in (AT_REST, DRIVEN))
        sides[axis] = driven.mean() - rest.mean()
        if not driven.min() > rest.max():
            raise InputError("ordered: the driven balls are not beyond those at rest")
    return periodic, sides
