"""Balls and contacts in tables of other programs, checked against each other by the geometry."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgran.errors import InputError
from pgran.foreign.tables import Table
from pgran.medium import packing

AXES = "xyz"
PRINTED = 1e-5  # lengths may differ by this part of the packing: dumps print six digits
LAWS = ("hertz", "harmonic")


@dataclass(frozen=True, eq=False)
class Balls:
    """The balls in a table.

    Attributes
    ----------
    table : pgran.foreign.tables.Table
    id : numpy.ndarray of int, shape (N,)
    position : numpy.ndarray, shape (N, d), or None
        In the box where that is periodic.
    periods : numpy.ndarray, shape (d,)
        Infinite where it is not.
    mass : numpy.ndarray, shape (N,)
    radius : numpy.ndarray, shape (N,), or None
    held : numpy.ndarray of int, shape (N,), or None
    """

    table: Table
    id: np.ndarray
    position: np.ndarray | None
    periods: np.ndarray
    mass: np.ndarray
    radius: np.ndarray | None
    held: np.ndarray | None

    @property
    def axes(self):
        """How many components a position has, 0 without positions."""
        return 0 if self.position is None else self.position.shape[1]

    @property
    def tolerance(self):
        """By how much lengths may differ that were printed with six digits."""
        return PRINTED * float(np.abs(self.position).max() + np.ptp(self.position, axis=0).max())

    def column(self, name):
        """Return numbers to choose balls by: a coordinate in the box, or a column of the file."""
        if name in AXES[: self.axes]:
            return self.position[:, AXES.index(name)]
        if name not in (*self.table.columns, *self.table.texts):
            there = ", ".join([*AXES[: self.axes], *self.table.columns][:30])
            raise InputError(f"balls have no column {name}; there are {there}")
        return self.table.numbers(name)


def read_balls(table):
    """Return the balls in a table; raise a FileError where it is wrong. Not collective."""
    ids = table.integers("id")
    order = np.argsort(ids, kind="stable")
    again = np.flatnonzero(np.diff(ids[order]) == 0)
    if again.size:
        row = order[again[0] + 1]
        table.refuse(row, f"a second ball has the id {ids[row]}")
    position, periods = _positions(table)
    radius = mass = held = None
    for name, part in (("radius", 1.0), ("diameter", 0.5)):
        if radius is None and name in (*table.columns, *table.texts):
            radius = part * _positive(table, name)
    if "mass" in (*table.columns, *table.texts):
        mass = _positive(table, "mass")
    elif "density" in table.columns and radius is not None:  # of spheres, in a plane as well
        mass = _positive(table, "density") * 4 / 3 * np.pi * radius**3
    else:
        mass = np.ones(len(ids))
    if "held" in (*table.columns, *table.texts):
        held = table.integers("held")
        wrong = np.flatnonzero(~np.isin(held, (0, 1, 2)))
        if wrong.size:
            table.refuse(wrong[0], "held must be 0 (free), 1 (at rest) or 2 (driven)")
    return Balls(table, ids, position, periods, mass, radius, held)


def _positive(table, name):
    """Return a column of positive numbers."""
    column = table.numbers(name)
    wrong = np.flatnonzero(column <= 0)
    if wrong.size:
        table.refuse(wrong[0], f"{name} must be positive, not {column[wrong[0]]}")
    return column


def _positions(table):
    """Return positions in the box, and its periods; of two axes where all balls have the same z.

    LAMMPS prints coordinates as x, unwrapped as xu, in units of the box as xs, or both as xsu.
    """
    there, box = (*table.columns, *table.texts), table.box
    ending = next((end for end in ("", "u", "s", "su") if f"x{end}" in there), None)
    if ending is None:
        if isinstance(table.places, list):  # a graph may lie nowhere
            return None, np.empty(0)
        table.numbers("x")
    axes = "xyz" if f"z{ending}" in there else "xy"
    position = np.stack([table.numbers(name + ending) for name in axes], axis=1)
    if box is None:
        periods = np.full(len(axes), np.inf)
    else:
        low, size = box.low[: len(axes)], (box.high - box.low)[: len(axes)]
        periods = np.where(box.periodic[: len(axes)], size, np.inf)
        if ending.startswith("s"):
            position = low + position * size
        inside = np.isfinite(periods)
        away = (position - low)[:, inside]
        position[:, inside] = low[inside] + np.mod(away, periods[inside])
    if not np.all(np.isfinite(position)):
        row = np.flatnonzero(~np.isfinite(position).all(axis=1))[0]
        table.refuse(row, "the position is too large a number")
    if len(axes) == 3 and len(position) > 1 and np.ptp(position[:, 2]) == 0:
        position, periods = position[:, :2], periods[:2]
    return position, periods


@dataclass(frozen=True, eq=False)
class Contacts:
    """The contacts in a table, between given balls.

    Attributes
    ----------
    table : pgran.foreign.tables.Table
    balls : Balls
    bond : numpy.ndarray of int, shape (nb, 2)
        The rows of the balls.
    roles : dict of str: str
        Which column is what.
    """

    table: Table
    balls: Balls
    bond: np.ndarray
    roles: dict

    def given(self, role):
        """Return the column of a role, or None."""
        return self.table.numbers(self.roles[role]) if role in self.roles else None

    @cached_property
    def _away(self):
        """Vectors from the first ball to the second, and whether they lead through an end."""
        position = self.balls.position
        away = position[self.bond[:, 1]] - position[self.bond[:, 0]]
        return packing.nearest_images(away, self.balls.periods)

    @property
    def crossing(self):
        """Whether each leads through an end of the box, along each axis, shape (nb, d)."""
        return self._away[1]

    @cached_property
    def lengths(self):
        """Distances by the positions, shape (nb,); of balls at one place there is no normal."""
        lengths = np.linalg.norm(self._away[0], axis=1)
        wrong = np.flatnonzero(~((lengths > 0) & (lengths < np.inf)))
        if wrong.size:
            self.table.refuse(wrong[0], f"these balls are {lengths[wrong[0]]} apart")
        return lengths

    @property
    def normal(self):
        """From the first ball to the second, shape (nb, d); None without positions."""
        return self._away[0] / self.lengths[:, None] if self.balls.axes else None

    @cached_property
    def distance(self):
        """Of the centres, shape (nb,), or None; as printed, if it is that of the positions."""
        printed = self.given("distance")
        if not self.balls.axes:
            return printed
        return self._agreeing("distance", printed, self.lengths)

    @cached_property
    def overlap(self):
        """R_i + R_j - distance, shape (nb,), or None; as printed, if it is that of the balls."""
        printed = self.given("overlap")
        if self.balls.radius is None or self.distance is None:
            return printed
        overlap = self.balls.radius[self.bond].sum(axis=1) - self.distance
        return self._agreeing("overlap", printed, overlap)

    def _agreeing(self, name, printed, found):
        """Return what the file says, once it is found to be what follows from the balls."""
        if printed is None:
            return found
        limit = self.balls.tolerance if self.balls.axes else PRINTED * np.abs(found).max()
        wrong = np.flatnonzero(~(np.abs(printed - found) <= limit))
        if wrong.size:
            row = wrong[0]
            why = f"the {name} is {printed[row]:.6g}, but {found[row]:.6g} by the balls"
            self.table.refuse(row, f"{why}: another snapshot, or another column?")
        return printed

    @cached_property
    def force(self):
        """Repulsive normal forces, shape (nb,), or None."""
        force = self.given("force")
        names = [f"f{x}" for x in AXES[: self.balls.axes]]
        if not names or any(name not in self.roles for name in names):
            return force
        along = np.sum(np.stack([self.given(x) for x in names], axis=1) * self.normal, axis=1)
        along *= -1.0 if along.sum() <= 0 else 1.0  # on the first ball, or on the second
        if force is not None:
            wrong = np.flatnonzero(~(np.abs(along - force) <= PRINTED * np.abs(force).max()))
            if wrong.size:
                row = wrong[0]
                why = f"the force is {force[row]:.6g}, but {along[row]:.6g} by its components"
                self.table.refuse(row, why)
        return along if force is None else force

    def stiffness(self, law, c=None):
        """Return the stiffness of contacts, 0 where balls do not touch, shape (nb,).

        Not collective.

        Parameters
        ----------
        law : str or None
            `hertz`, `harmonic` or a column; None is the column `stiffness`.
        c : float, optional
            Of F = c h^(3/2), to be used instead of overlaps.

        Raises
        ------
        InputError, FileError
        """
        force = self.force
        if law not in LAWS:
            name = law or self.roles.get("stiffness")
            if name is None or name not in (*self.table.columns, *self.table.texts):
                there = ", ".join([*self.table.columns][:30])
                said = "is needed" if law is None else f"{law}: there is no such column"
                raise InputError(f"--law {said}; it is hertz, harmonic, or one of {there}")
            apart = np.zeros(len(self.bond), dtype=bool)
            if force is not None and self.overlap is not None:
                apart = (force == 0) & (self.overlap <= 0)
            return np.where(apart, 0.0, self.table.numbers(name))
        if force is None:
            raise InputError(f"--law {law} needs forces; --columns says which column they are in")
        touch = force != 0
        overlap = np.ones(len(force)) if c is not None else self.overlap
        if overlap is None:
            raise InputError(f"--law {law} needs overlaps: radii and positions of the balls"
                             + (", or --hertz" if law == "hertz" else ""))  # fmt: skip
        wrong = np.flatnonzero(touch & ~((force > 0) & (overlap > 0)))
        if wrong.size:
            said = f"a force of {force[wrong[0]]:.6g} at an overlap of {overlap[wrong[0]]:.6g}"
            self.table.refuse(wrong[0], f"{said} is none of a {law} contact")
        stiffness = np.zeros(len(force))
        if c is not None:
            stiffness[touch] = packing.hertz_of_force(force[touch], c)
        else:
            stiffness[touch] = getattr(packing, law)(force[touch], overlap[touch])
        return stiffness


def rows_of(table, name, balls):
    """Return the rows of the balls whose ids a column holds. Not collective."""
    ids, order = table.integers(name), np.argsort(balls.id)
    at = np.searchsorted(balls.id[order], ids).clip(max=len(order) - 1)
    unknown = np.flatnonzero(balls.id[order[at]] != ids)
    if unknown.size:
        table.refuse(unknown[0], f"no ball {ids[unknown[0]]} in {balls.table.path}")
    return order[at]
