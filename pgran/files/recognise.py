"""Which column of a table of contacts is what.

The columns of `dump local` have names such as c_d[2], which say nothing. They are named by the
user, or recognised by what they hold: numbers of balls, the distance of these balls, a force that
is there where they touch and nowhere else.
"""

import dataclasses
import itertools

import numpy as np

from pgran.errors import FileError, InputError
from pgran.files.foreign import AXES, PRINTED, Contacts, rows_of

# What contacts have, and what it may be called in a file.
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
MOST = 0.9  # of the rows of a column must hold what makes it a column of ids


def read_contacts(table, balls, columns=None):
    """Return the contacts in a table.

    Not collective.

    Parameters
    ----------
    table : pgran.files.tables.Table
    balls : Balls
    columns : str, optional
        Names for the columns in their order, `_` for none, or NAME=COLUMN, by name or from 1.
        Columns without names of their own are recognised by what they hold unless this is given.

    Raises
    ------
    InputError, FileError
    """
    if None not in (table.step, balls.table.step) and table.step != balls.table.step:
        why = f"is of the time step {table.step}, {balls.table.path} of {balls.table.step}"
        raise FileError(f"{table.path}: {why}")
    if columns:
        table = _renamed(table, columns)
    there = (*table.columns, *table.texts)
    roles = {
        role: next(name for name in names if name in there)
        for role, names in ROLES.items()
        if any(name in there for name in names)
    }
    guess = not columns and table.step is not None
    if guess and not {"id1", "id2"} <= roles.keys():
        roles |= _guess_balls(table, balls)
    rows = [rows_of(table, roles.get(role, role), balls) for role in ("id1", "id2")]
    bond = np.stack(rows, axis=1)
    alone = np.flatnonzero(bond[:, 0] == bond[:, 1])
    if alone.size:
        table.refuse(alone[0], "a ball touches itself")
    contacts = Contacts(table, balls, bond, roles)
    if guess and balls.axes:
        _guess_rest(contacts)
    ordered = {role: roles[role] for role in ROLES if role in roles}
    return dataclasses.replace(contacts, roles=ordered)


def _renamed(table, columns):
    """Return a table whose columns have the names that the user gives them."""
    old, words = [*table.columns], [word.strip() for word in columns.split(",")]
    found = {}
    for number, word in enumerate(words, 1):
        name, _, source = word.partition("=")
        source = source or str(number)
        if source.isascii() and source.isdigit() and 0 < int(source[:9]) <= len(old):
            source = old[int(source) - 1]
        if source not in old or (name in found and name != "_"):
            raise InputError(f"--columns {word}: the file has the columns {', '.join(old[:30])}")
        found[name] = table.columns[source]
    found.pop("_", None)
    return dataclasses.replace(table, columns=found | table.columns)


def _guess_balls(table, balls):
    """Return which two columns hold the balls, by their distance where several could.

    If no two do so in all rows, a few rows may be wrong, so that it is these that are refused.
    """
    numbered = np.arange(len(table.places)) + 1
    columns = {k: v for k, v in table.columns.items() if not np.array_equal(v, numbered)}
    for part in (1.0, MOST):
        ids = [k for k, v in columns.items() if np.mean(np.isin(v, balls.id)) >= part]
        pairs = [
            {"id1": a, "id2": b}
            for a, b in itertools.combinations(ids[:12], 2)
            if np.mean(columns[a] != columns[b]) >= part
        ]
        if pairs:
            break
    for pair in pairs if len(pairs) > 1 and balls.axes else ():
        bond = np.stack([rows_of(table, name, balls) for name in pair.values()], axis=1)
        if _columns_like_distance(Contacts(table, balls, bond, pair)):
            return pair
    if len(pairs) != 1:
        why = "two columns, and no others, must hold ids of balls"
        raise FileError(f"{table.path}: {why}; --columns id1,id2,distance,force names them")
    return pairs[0]


def _columns_like_distance(contacts):
    """Return which columns hold the distance of the balls."""
    return [
        name
        for name, values in contacts.table.columns.items()
        if np.all(np.abs(values - contacts.lengths) <= contacts.balls.tolerance)
    ]


def _guess_rest(contacts):
    """Add to the roles of contacts what the geometry tells: distance, force, its components."""
    roles, table, limit = contacts.roles, contacts.table, contacts.balls.tolerance
    if "distance" not in roles and (like := _columns_like_distance(contacts)):
        roles["distance"] = like[0]
    if contacts.overlap is None:
        return
    surely, never = contacts.overlap > limit, contacts.overlap < -limit
    rest = {name: values for name, values in table.columns.items() if name not in roles.values()}
    if "fx" not in roles:
        _guess_components(contacts, rest, never)
    if {"force", "stiffness"} & roles.keys():
        return
    along = contacts.force  # by its components
    found = [
        name
        for name, values in rest.items()
        if name not in roles.values()
        and np.all(values >= 0)
        and np.all(values[never] == 0)
        and np.all(values[surely] > 0)
        and np.any(values != np.rint(values))
        and (along is None or _alike(values, along))
    ]
    lengths = [name for name in found if np.all(np.abs(rest[name] - contacts.overlap) <= limit)]
    found = [name for name in found if name not in lengths] or found
    if len(found) > 1:
        said = f"{', '.join(found[:9])} could each be the force"
        raise FileError(f"{table.path}: {said}; --columns id1,id2,distance,force names them")
    if found:
        roles["force"] = found[0]


def _alike(one, other):
    """Return whether two columns of forces are the same but for what was not printed."""
    return bool(np.all(np.abs(one - other) <= PRINTED * np.abs(other).max()))


def _guess_components(contacts, rest, never):
    """Add which columns are a force of one sign along the normal, and nothing where none touch."""
    force, normal = contacts.given("force"), contacts.normal
    for first in range(len(rest) - contacts.balls.axes + 1):
        chosen = [*rest][first : first + contacts.balls.axes]
        vectors = np.stack([rest[name] for name in chosen], axis=1)
        along = np.sum(vectors * normal, axis=1)
        across = np.linalg.norm(vectors - along[:, None] * normal, axis=1)
        along *= np.sign(along.sum())
        if (
            np.any(along > 0)
            and np.all(along >= 0)
            and np.all(across <= along)
            and np.all(vectors[never] == 0)
            and (force is None or _alike(along, force))
        ):
            contacts.roles.update(zip((f"f{x}" for x in AXES), chosen, strict=False))
            return
