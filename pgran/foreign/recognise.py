"""Which column of a table of contacts is what.

The columns of `dump local` have names such as c_d[2], which say nothing. They are named by the
user, or recognised by what they hold: numbers of balls, the distance of these balls, a force that
is there where they touch and nowhere else.
"""

import dataclasses
import itertools

import numpy as np

from pgran.errors import FileError, InputError
from pgran.foreign.contacts import AXES, ROLES, ROUNDING, Contacts, bonds_of

ID_PART = 0.9  # the part of a column that must hold ids of balls if it is to be one of ids
CURE = "--columns id1,id2,distance,force names them"


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
    bond = bonds_of(table, roles.get("id1", "id1"), roles.get("id2", "id2"), balls)
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


def _roles_of_balls(table, balls):
    """Return which two columns hold the balls: those that the geometry tells the most of.

    What other columns hold must be the distance of these balls, a force that is there where they
    touch, or its components. A few rows may be wrong, so that it is these that are refused.
    """
    known = {name: np.isin(values, balls.id) for name, values in table.columns.items()}
    ids = [name for name, each in known.items() if np.mean(each) >= ID_PART]
    scored = []
    for pair in itertools.combinations(ids[:12], 2):
        a, b = pair
        right = known[a] & known[b] & (table.columns[a] != table.columns[b])
        if np.mean(right) >= ID_PART:
            some = table.of_rows(right)
            bond = bonds_of(some, a, b, balls)
            contacts = Contacts(some, balls, bond, {"id1": a, "id2": b})
            distances = _columns_near(contacts, contacts.lengths)
            told = sum(map(bool, (distances, _forces(contacts), _components(contacts))))
            scored.append(((told, np.mean(right)), pair, bond))
    # (how many things the other columns are, in how many rows they hold balls): the most wins
    best = max((score for score, *_ in scored), default=(0, 0.0))
    pairs = [(pair, bond) for score, pair, bond in scored if score == best]
    if not best[0]:
        why = "no two columns hold ids of balls whose distance or force another column holds"
    elif any(not np.array_equal(bond, pairs[0][1]) for _, bond in pairs):
        names = ", or ".join(" and ".join(pair) for pair, _ in pairs[:5])
        why = f"the balls could be in {names}, by the geometry"
    else:
        return dict(zip(("id1", "id2"), pairs[0][0], strict=True))
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
