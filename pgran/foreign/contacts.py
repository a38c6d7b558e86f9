"""Balls and contacts in other programs' tables, checked by the geometry, and the law of contacts.

What a column holds follows from its name. The columns of `dump local` have names such as c_d[2],
which say nothing: they are named by the user, or recognised by what they hold, numbers of balls,
the distance of these balls, a force that is there where they touch and nowhere else.
"""

import dataclasses
import itertools
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pgran.arguments import meant, nearest
from pgran.errors import FileError, InputError
from pgran.foreign.tables import Box
from pgran.medium import packing

AXES = "xyz"
ROUNDING = 1e-5  # by this part of the packing lengths may differ: dumps print six digits
# What a contact has, its role, and what the column may be called in a file.
ROLES = {
    "id1": ("id1", "i", "source"),
    "id2": ("id2", "j", "target"),
    "distance": ("distance", "dist"),
    "overlap": ("overlap", "delta"),
    "force": ("force", "normal_force"),
    "fx": ("fx",),
    "fy": ("fy",),
    "fz": ("fz",),
    "stiffness": ("stiffness", "weight"),
    "tangential": ("tangential",),
}
ID_PART = 0.9  # the part of a column that must hold ids of balls if it is to be one of ids
CURE = "--columns id1,id2,distance,force names them"
# The law of contacts is found of those that tell it, and taken where most obey it.
MISFIT, OBEYING = 2.0, 0.9  # errors of an overlap by a law, and the part of the contacts within
CLEAR, FEWEST = 10.0, 9  # errors that an overlap must have to tell the power, and how many do,
SHORTEST_RANGE = 0.5  # unless their logarithms lie as near to each other
EXACT = 1e-8  # of an overlap: errors that need no law
DERIVED = 1e-13  # of overlaps: if all forces are as near to them they follow from them
POWER_GAP = 0.1  # of two powers that differ, beyond three standard errors


class Balls:
    """The balls in a table: `id`, `mass`, shape (N,), and so `radius` and `held`, or None.

    Positions, shape (N, d), or None, lie in the box where that is periodic; `periods`, shape (d,),
    are infinite where it is not. `weighed` says whether the file says what they weigh.
    """

    def __init__(self, table, box=None):
        self.table, self.id = table, table.integers("id")
        _, first = np.unique(self.id, return_index=True)
        again = ~np.isin(np.arange(len(self.id)), first)
        table.refuse_any(again, lambda row: f"a second ball has the id {self.id[row]}")
        self.position, self.periods = _positions(table, box)
        self.radius = self.held = None
        if "radius" in table:
            self.radius = table.numbers("radius", positive=True)
        elif "diameter" in table:
            self.radius = 0.5 * table.numbers("diameter", positive=True)
        # a file says a mass, or the density of what has a radius, or nothing: then all are alike
        self.mass, self.weighed = np.ones(len(self.id)), True
        if "mass" in table:
            self.mass = table.numbers("mass", positive=True)
        elif "density" in table and self.radius is not None:  # of spheres, in a plane as well
            self.mass = table.numbers("density", positive=True) * 4 / 3 * np.pi * self.radius**3
        else:
            self.weighed = False
        if "held" in table:
            self.held = table.integers("held")
            wrong = ~np.isin(self.held, (0, 1, 2))
            table.refuse_any(wrong, "held must be 0 (free), 1 (at rest) or 2 (driven)")

    @property
    def axes(self):
        """How many components a position has, 0 without positions."""
        return 0 if self.position is None else self.position.shape[1]

    @property
    def tolerance(self):
        """By how much lengths may differ that were printed with six digits."""
        return ROUNDING * float(np.abs(self.position).max() + np.ptp(self.position, axis=0).max())

    def column(self, name):
        """Return numbers to choose balls by: a coordinate in the box, or a column of the file."""
        if name in AXES[: self.axes]:
            return self.position[:, AXES.index(name)]
        if name not in self.table:
            there = ", ".join(dict.fromkeys([*AXES[: self.axes], *self.table.columns][:30]))
            raise InputError(f"balls have no column {name}; there are {there}")
        return self.table.numbers(name)


def _positions(table, lengths):
    """Return positions in the box, and its periods; of two axes where all balls have the same z."""
    # LAMMPS prints coordinates as x, unwrapped as xu, in units of the box as xs, or both as xsu
    ending = next((end for end in ("", "u", "s", "su") if f"x{end}" in table), None)
    if ending is None:
        if table.places.dtype.kind == "U" and lengths is None:  # a graph may lie nowhere
            return None, np.empty(0)
        table.numbers("x")
    axes = "xyz" if f"z{ending}" in table else "xy"
    position = np.stack([table.numbers(name + ending) for name in axes], axis=1)
    if len(axes) == 3 and len(position) > 1 and np.ptp(position[:, 2]) == 0:  # a plane
        axes, position = axes[:2], position[:, :2]
    periods, box = np.full(len(axes), np.inf), table.box
    if lengths is not None:  # of the box of a table without one, 0 where it is not periodic
        if box is not None or len(lengths) != len(axes):
            raise InputError(f"--box: {len(axes)} lengths are needed, and a table without a box")
        box = Box(np.zeros(len(axes)), np.array(lengths), np.array(lengths) > 0)
    if box is not None:
        low, size = box.low[: len(axes)], (box.high - box.low)[: len(axes)]
        inside = box.periodic[: len(axes)]
        periods[inside] = size[inside]
        if ending.startswith("s"):
            position = low + position * size
        away = (position - low)[:, inside]
        position[:, inside] = low[inside] + np.mod(away, periods[inside])
    endless = ~np.isfinite(position).all(axis=1)
    table.refuse_any(endless, "the position is too large a number")
    return position, periods


def touching(balls, law):
    """Return the table of contacts between balls that overlap, with the forces of a law."""
    if not balls.axes or balls.radius is None:
        raise FileError(f"{balls.table.path}: without CONTACTS balls need positions and radii")
    box = np.where(np.isfinite(balls.periods), balls.periods, 0.0)
    found = packing.touching(balls.position, balls.radius, box, law)
    first, other = balls.id[found["bond"]].T
    columns = {"i": first, "j": other, "force": found["force"]}
    places = np.array([f"balls {i} and {j}" for i, j in zip(first, other, strict=True)])
    return dataclasses.replace(balls.table, columns=columns, texts={}, places=places)


def read_contacts(table, balls, columns=None):
    """Return the contacts in a table between some balls.

    `columns` are names for the columns in their order, `_` for none, or NAME=COLUMN, by name or
    from 1. Columns without names of their own are recognised by what they hold where it is None.
    """
    if None not in (table.step, balls.table.step) and table.step != balls.table.step:
        why = f"is of the time step {table.step}, {balls.table.path} of {balls.table.step}"
        raise FileError(f"{table.path}: {why}")
    if columns:
        table = _renamed(table, columns)
    called = {role: [name for name in names if name in table] for role, names in ROLES.items()}
    roles = {role: names[0] for role, names in called.items() if names}
    unnamed = not columns and table.step is not None
    if unnamed and not {"id1", "id2"} <= roles.keys():
        roles |= _roles_of_balls(table, balls)
    bond = _bonds(table, roles.get("id1", "id1"), roles.get("id2", "id2"), balls)
    table.refuse_any(bond[:, 0] == bond[:, 1], "a ball touches itself")
    contacts = Contacts(table, balls, bond, roles)
    return _recognised(contacts) if unnamed and balls.axes else contacts


def _renamed(table, columns):
    """Return a table whose columns have the names that the user gives them."""
    names, renamed = [*table.columns], {}
    for number, word in enumerate(map(str.strip, columns.split(",")), 1):
        name, _, source = word.partition("=")
        source = source or str(number)
        if source.isascii() and source.isdigit() and 0 < int(source[:9]) <= len(names):
            source = names[int(source) - 1]
        if source not in names or (name in renamed and name != "_"):
            raise InputError(f"--columns {word}: the file has the columns {table}")
        renamed[name] = table.columns[source]
    renamed.pop("_", None)
    return dataclasses.replace(table, columns=renamed | table.columns)


def _bonds(table, one, other, balls):
    """Return the rows of the balls whose ids two columns hold, shape (nb, 2)."""
    bonds, order = [], np.argsort(balls.id)
    for ids in map(table.integers, (one, other)):
        # the row that each id would have in a sorted list, which is its ball's only if it is there
        rows = order[np.searchsorted(balls.id[order], ids).clip(max=len(order) - 1)]
        unknown = balls.id[rows] != ids
        table.refuse_any(unknown, lambda row, ids=ids: f"no ball {ids[row]} in {balls.table.path}")
        bonds.append(rows)
    return np.stack(bonds, axis=1)


def _roles_of_balls(table, balls):
    """Return which two columns hold the balls: those that the geometry tells the most of.

    What other columns hold must be the distance of these balls, a force that is there where they
    touch, or its components. A few rows may be wrong, so that it is these that are refused.
    """
    known = {name: np.isin(values, balls.id) for name, values in table.columns.items()}
    ids = [name for name, each in known.items() if np.mean(each) >= ID_PART]
    scored = []
    for one, other in itertools.combinations(ids[:12], 2):
        right = known[one] & known[other] & (table.columns[one] != table.columns[other])
        if np.mean(right) >= ID_PART:
            some, roles = table.of_rows(right), {"id1": one, "id2": other}
            contacts = Contacts(some, balls, _bonds(some, one, other, balls), roles)
            distances = _columns_near(contacts, contacts.lengths)
            told = sum(map(bool, (distances, _forces(contacts), _components(contacts))))
            scored.append(((told, np.mean(right)), contacts))
    # (how many things the other columns are, in how many rows they hold balls): the most wins
    best = max((score for score, _ in scored), default=(0, 0.0))
    likely = [contacts for score, contacts in scored if score == best]
    if not best[0]:
        why = "no two columns hold ids of balls whose distance or force another column holds"
    elif any(not np.array_equal(each.bond, likely[0].bond) for each in likely):
        names = ", or ".join(" and ".join(each.roles.values()) for each in likely[:5])
        why = f"the balls could be in {names}, by the geometry"
    else:
        return likely[0].roles
    raise FileError(f"{table.path}: {why}; {CURE}")


def _recognised(contacts):
    """Return contacts with the roles that the geometry tells: distance, force, its components."""
    if "distance" not in contacts.roles:
        names = _columns_near(contacts, contacts.lengths)
        contacts = contacts.with_roles({"distance": names[0]} if names else {})
    if "fx" not in contacts.roles:
        contacts = contacts.with_roles(_components(contacts))
    if {"force", "stiffness"} & contacts.roles.keys():
        return contacts
    names = _forces(contacts)
    if len(names) > 1:
        could = f"{', '.join(names[:9])} could each be the force"
        raise FileError(f"{contacts.table.path}: {could}; {CURE}")
    return contacts.with_roles({"force": names[0]} if names else {})


def _without_role(contacts):
    """Return the columns that have no role yet."""
    taken = contacts.roles.values()
    return {name: v for name, v in contacts.table.columns.items() if name not in taken}


def _columns_near(contacts, lengths):
    """Return which columns without a role are these lengths, as far as they were printed."""
    limit, columns = contacts.balls.tolerance, _without_role(contacts)
    return [name for name, v in columns.items() if np.all(np.abs(v - lengths) <= limit)]


def _same_forces(one, other):
    """Return whether two columns of forces are the same but for what was not printed."""
    return bool(np.all(np.abs(one - other) <= ROUNDING * np.abs(other).max()))


def _forces(contacts):
    """Return which columns are a force that is there where balls touch, and nowhere else.

    Overlaps are as well: they are returned if nothing else is found.
    """
    if contacts.overlap is None:  # radii are unknown
        return []
    limit, along = contacts.balls.tolerance, contacts.force  # by its components
    surely, never = contacts.overlap > limit, contacts.overlap < -limit
    forces = [
        name
        for name, values in _without_role(contacts).items()
        if np.all(values >= 0)
        and np.all(values[never] == 0)
        and np.all(values[surely] > 0)
        and np.any(values != np.rint(values))
        and (along is None or _same_forces(values, along))
    ]
    overlaps = _columns_near(contacts, contacts.overlap)
    return [name for name in forces if name not in overlaps] or forces


def _components(contacts):
    """Return by role three neighbouring columns, in a plane two, that are a force's components.

    It has one sign along the normal, where it is the largest, and is 0 where no balls touch.
    """
    if contacts.overlap is None:
        return {}
    never = contacts.overlap < -contacts.balls.tolerance
    force, normal = contacts.column("force"), contacts.normal
    axes, columns = contacts.balls.axes, _without_role(contacts)
    for first in range(len(columns) - axes + 1):
        names = [*columns][first : first + axes]
        vectors = np.stack([columns[name] for name in names], axis=1)
        along = np.sum(vectors * normal, axis=1)
        across = np.linalg.norm(vectors - along[:, None] * normal, axis=1)
        along *= np.sign(along.sum())
        if (
            np.any(along > 0)
            and np.all(along >= 0)
            and np.all(across <= along)
            and np.all(vectors[never] == 0)
            and (force is None or _same_forces(along, force))
        ):
            return dict(zip((f"f{x}" for x in AXES), names, strict=False))
    return {}


class Contacts:
    """The contacts in a table: what its columns hold, checked by what follows from the balls.

    `bond` are the rows of their two balls, shape (nb, 2), `roles` the columns' names by what they
    hold, keys of ROLES. By positions there are `lengths`, normals from the first ball to the
    second, shape (nb, d), and through which ends of the box they lead, `crossing`; by positions or
    columns the `distance` of the centres, the `overlap` R_i + R_j - distance, and the repulsive
    `force`. What is unknown is None.
    """

    def __init__(self, table, balls, bond, roles):
        self.table, self.balls, self.bond, self.roles = table, balls, bond, roles
        self.lengths = self.normal = self.crossing = overlap = None
        if balls.axes:
            away = balls.position[bond[:, 1]] - balls.position[bond[:, 0]]
            away, self.crossing = packing.nearest_images(away, balls.periods)
            lengths = np.linalg.norm(away, axis=1)
            odd = ~((lengths > 0) & (lengths < np.inf))  # balls at one place have no normal
            table.refuse_any(odd, lambda row: f"these balls are {lengths[row]} apart")
            self.lengths, self.normal = lengths, away / lengths[:, None]
        self.distance = self._agreeing("distance", self.lengths)
        if balls.radius is not None and self.distance is not None:
            overlap = balls.radius[bond].sum(axis=1) - self.distance
        self.overlap = self._agreeing("overlap", overlap)
        self.force = self._force()

    def with_roles(self, roles):
        """Return the contacts by more columns, those of some roles."""
        return Contacts(self.table, self.balls, self.bond, self.roles | roles)

    def column(self, role):
        """Return the column of a role, shape (nb,), or None."""
        return self.table.numbers(self.roles[role]) if role in self.roles else None

    def _agreeing(self, role, computed):
        """Return what the file says, if anything, once it is what follows from the balls."""
        printed = self.column(role)
        if printed is None or computed is None:
            return computed if printed is None else printed
        limit = self.balls.tolerance if self.balls.axes else ROUNDING * np.abs(computed).max()
        self.table.refuse_any(
            ~(np.abs(printed - computed) <= limit),
            lambda row: f"the {role} is {printed[row]:.6g}, but {computed[row]:.6g} by the balls: "
            "another snapshot, or another column?",
        )
        return printed

    def _force(self):
        """Return repulsive forces by their column or, along the normal, by their components."""
        force, axes = self.column("force"), AXES[: self.balls.axes]
        if not axes or any(f"f{x}" not in self.roles for x in axes):
            return force
        along = np.sum(np.stack([self.column(f"f{x}") for x in axes], axis=1) * self.normal, axis=1)
        along *= -1.0 if along.sum() <= 0 else 1.0  # on the first ball, or on the second
        if force is None:
            return along
        self.table.refuse_any(
            ~(np.abs(along - force) <= ROUNDING * np.abs(force).max()),
            lambda row: f"the force is {force[row]:.6g}, but {along[row]:.6g} by its components",
        )
        return force

    @property
    def precision(self):
        """Half of the last digit of a number between 1 and 10 in both files."""
        return 0.5 * 10.0 ** (1 - min(self.table.digits, self.balls.table.digits))

    @cached_property
    def _measured(self):
        """Forces, overlaps, their errors by the printed digits, and scales: see `power_of`."""
        radii = [] if self.balls.radius is None else [*self.balls.radius[self.bond].T]
        if "overlap" in self.roles:
            lengths = [self.overlap]
        elif "distance" in self.roles:
            lengths = [self.distance, *radii]
        else:
            lengths = [np.abs(self.balls.position).max()] * (2 * self.balls.axes) + radii
        error = sum(self.precision * 10 ** np.floor(np.log10(np.abs(x))) for x in lengths)
        return self.force, self.overlap, error, (1.0, 1 / sum(1 / x for x in radii or [1.0]))

    @cached_property
    def power(self):
        """The `Power` of their law, as far as forces and overlaps are known."""
        known = self.force is not None and self.overlap is not None
        return power_of(*self._measured) if known else Power()

    def stiffness(self, law, c=None):
        """Return the stiffness of contacts, 0 where balls do not touch, shape (nb,), and its error.

        The law is `hertz`, `harmonic` or a column, that of the role `stiffness` where it is None. c
        is that of F = c h^(3/2), used instead of overlaps. By a column, two balls apart without a
        force do not touch. The error is the largest part that digits of overlaps leave open.
        """
        if law in packing.POWERS:
            return self._by_law(law, c)
        name = law or self.roles.get("stiffness")
        if name is None or name not in self.table:
            lacks = "is needed" if law is None else f"{law}: there is no such column"
            hint = meant(nearest(law or "", packing.POWERS)) or f"; {self.power.words}".rstrip("; ")
            raise InputError(f"--law {lacks}; it is hertz, harmonic, or one of {self.table}{hint}")
        stiffness = self.table.numbers(name)
        if self.force is not None and self.overlap is not None:
            stiffness = np.where((self.force == 0) & (self.overlap <= 0), 0.0, stiffness)
        return stiffness, 0.0

    def _by_law(self, law, c):
        """Return the stiffness by force and overlap, or by the force alone, and its error."""
        force, power, error = self.force, packing.POWERS[law], self.precision
        if force is None:
            raise InputError(f"--law {law} needs forces; --columns says which column they are in")
        if c is not None:
            overlap = (force / c) ** (1 / power)
        elif self.overlap is None:
            hint = ", or --hertz" if law == "hertz" else ""
            raise InputError(f"--law {law} needs overlaps: radii and positions of the balls{hint}")
        else:
            overlap, off = overlaps_by_law(*self._measured, power)
            error += off
        touch = force != 0
        self.table.refuse_any(
            touch & ~((force > 0) & (overlap > 0)),
            lambda row: f"a {law} contact has no force of {force[row]:.6g} at an overlap of "
            f"{overlap[row]:.6g}; {self.power.words}".rstrip("; "),
        )
        return np.divide(power * force, overlap, out=np.zeros(len(force)), where=touch), error


class Power(NamedTuple):
    """The power of a law of contacts, and what it rests on."""

    value: float = np.nan
    far: float = np.inf  # how far another power is from it for certain
    clear: np.ndarray | None = None  # which contacts tell it
    words: str = ""  # none where nothing tells it


def power_of(force, overlap, error, scales):
    """Return the power of the law F = c h^power, unless overlaps are too few or too similar.

    c is one number, or goes like R^(power - 1), R = R_i R_j / (R_i + R_j), as of one material: then
    F R = c (h R)^power. `scales` are 1 and R, `error` is what rounding changes h by, at most.
    """
    weight = overlap / error
    clear = (force > 0) & (weight > CLEAR) & (weight < np.inf)
    F, h, weight = np.log(force[clear]), np.log(overlap[clear]), weight[clear]
    if len(h) < FEWEST or min(np.ptp(F), np.ptp(h)) < SHORTEST_RANGE:
        return Power()
    logs = [np.broadcast_to(np.log(r), clear.shape)[clear] for r in scales]
    lines = [np.polyfit(F + r, h + r, 1, w=weight, cov=True) for r in logs]
    best = int(np.argmin([spread[0, 0] for _, spread in lines]))
    (line, spread), x = lines[best], F + logs[best]  # of h by F, whose scatter makes it flatter
    power, scatter = 1 / line[0], np.var(h + logs[best] - np.polyval(line, x))
    sigma = power**2 * (np.sqrt(spread[0, 0]) + power * scatter / np.var(x))
    far = POWER_GAP + 3 * sigma
    laws = [law for law, other in packing.POWERS.items() if abs(other - power) < far]
    fits = f": --law {laws[0]} fits" if len(laws) == 1 else ""
    words = f"forces go like h^({power:.3g} +- {sigma:.1g}), h the overlap{fits}"
    return Power(power, far, clear, words)


def overlaps_by_law(force, overlap, error, scales, power):
    """Return overlaps by forces under a law, and by which part one is off, at most.

    Contacts that do not obey it, or have all digits, keep their own; all where few obey it.
    """
    pushing, found = force > 0, []
    for scale in scales:
        unit = (np.where(pushing, force, 0.0) * scale) ** (1 / power) / scale
        size, off = (_median(x / unit, unit / error) for x in (overlap, error))
        misfits = (np.abs(overlap - size * unit) / error)[pushing]
        if np.count_nonzero(misfits <= MISFIT) >= OBEYING * len(misfits):
            found.append((misfits.sum(), off / size, size * unit))
    _, off, own = min(found, key=lambda each: each[0], default=(0, 0, np.inf))
    off += sum(np.abs(other / own - 1)[pushing].max(initial=0.0) for *_, other in found)
    obeying = pushing & (np.abs(overlap - own) <= MISFIT * error) & (error > EXACT * overlap)
    obeying &= np.any(np.abs(overlap / own - 1)[pushing] > DERIVED)
    off = np.where(obeying, off, error / overlap)[pushing].max(initial=0.0)
    return np.where(obeying, own, overlap), off


def _median(values, weights):
    """Return the median of values that have weights."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return values[order[np.searchsorted(total, total[-1] / 2)]]
