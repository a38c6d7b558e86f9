"""Which column of a table of contacts is what.

The columns of `dump local` have names such as c_d[2], which say nothing. They are named by the
user, or recognised by what they hold: numbers of balls, the distance of these balls, a force that
is there where they touch and nowhere else.
"""

import dataclasses
import itertools

import numpy as np

from pgran.errors import FileError, InputError
from pgran.foreign.contacts import AXES, PRINTED, Contacts, rows_of

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
    table : pgran.foreign.tables.Table
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
    """Return which two columns hold the balls: those that the geometry tells the most of.

    What other columns hold must be the distance of these balls, a force that is there where they
    touch, or its components. A few rows may be wrong, so that it is these that are refused.
    """
    known = {name: np.isin(values, balls.id) for name, values in table.columns.items()}
    ids = [name for name, each in known.items() if np.mean(each) >= MOST]
    found = []
    for a, b in itertools.combinations(ids[:12], 2):
        right = known[a] & known[b] & (table.columns[a] != table.columns[b])
        if np.mean(right) >= MOST:
            some = table.of_rows(right)
            bond = np.stack([rows_of(some, name, balls) for name in (a, b)], axis=1)
            told = _told(Contacts(some, balls, bond, {"id1": a, "id2": b}))
            found.append(((told, np.mean(right)), (a, b), bond))
    best = max((score for score, *_ in found), default=(0, 0.0))
    pairs = [(pair, bond) for score, pair, bond in found if score == best]
    if not best[0]:
        why = "no two columns hold ids of balls whose distance or force another column holds"
    elif any(not np.array_equal(bond, pairs[0][1]) for _, bond in pairs):
        names = ", or ".join(" and ".join(pair) for pair, _ in pairs[:5])
        why = f"the balls could be in {names}, by the geometry"
    else:
        return dict(zip(("id1", "id2"), pairs[0][0], strict=True))
    raise FileError(f"{table.path}: {why}; --columns id1,id2,distance,force names them")


def _told(contacts):
    """Return how many things the geometry recognises in the other columns."""
    like = _columns_like_distance, _columns_like_force, _columns_like_components
    return sum(bool(columns(contacts)) for columns in like)


def _rest(contacts):
    """Return the columns that have no role yet."""
    taken = contacts.roles.values()
    return {name: v for name, v in contacts.table.columns.items() if name not in taken}


def _columns_like_distance(contacts):
    """Return which columns hold the distance of the balls."""
    return [
        name
        for name, values in _rest(contacts).items()
        if np.all(np.abs(values - contacts.lengths) <= contacts.balls.tolerance)
    ]


def _guess_rest(contacts):
    """Add to the roles of contacts what the geometry tells: distance, force, its components."""
    roles = contacts.roles
    if "distance" not in roles and (like := _columns_like_distance(contacts)):
        roles["distance"] = like[0]
    if "fx" not in roles:
        roles |= _columns_like_components(contacts)
    if {"force", "stiffness"} & roles.keys():
        return
    found = _columns_like_force(contacts)
    if len(found) > 1:
        said = f"{', '.join(found[:9])} could each be the force"
        raise FileError(
            f"{contacts.table.path}: {said}; --columns id1,id2,distance,force names them"
        )
    if found:
        roles["force"] = found[0]


def _touching(contacts):
    """Return which balls surely touch, and which surely do not; None where radii are unknown."""
    if contacts.overlap is None:
        return None
    limit = contacts.balls.tolerance
    return contacts.overlap > limit, contacts.overlap < -limit


def _columns_like_force(contacts):
    """Return which columns are a force that is there where balls touch, and nowhere else.

    Overlaps are as well: they are returned if nothing else is found.
    """
    if (touching := _touching(contacts)) is None:
        return []
    (surely, never), along = touching, contacts.force  # by its components
    rest = _rest(contacts)
    found = [
        name
        for name, values in rest.items()
        if np.all(values >= 0)
        and np.all(values[never] == 0)
        and np.all(values[surely] > 0)
        and np.any(values != np.rint(values))
        and (along is None or _alike(values, along))
    ]
    limit = contacts.balls.tolerance
    lengths = [name for name in found if np.all(np.abs(rest[name] - contacts.overlap) <= limit)]
    return [name for name in found if name not in lengths] or found


def _alike(one, other):
    """Return whether two columns of forces are the same but for what was not printed."""
    return bool(np.all(np.abs(one - other) <= PRINTED * np.abs(other).max()))


def _columns_like_components(contacts):
    """Return which columns are a force of one sign along the normal, 0 where no balls touch.

    They are returned by the names of its components, and none if there is no such force.
    """
    if (touching := _touching(contacts)) is None:
        return {}
    force, normal, rest = contacts.given("force"), contacts.normal, _rest(contacts)
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
            and np.all(vectors[touching[1]] == 0)
            and (force is None or _alike(along, force))
        ):
            return dict(zip((f"f{x}" for x in AXES), chosen, strict=False))
    return {}
