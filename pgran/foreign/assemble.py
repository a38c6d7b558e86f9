"""The network that `pgran import` makes of contacts: what is held, kept, cut and left out."""

from dataclasses import dataclass

import numpy as np

from pgran.errors import InputError
from pgran.foreign.conditions import choose
from pgran.foreign.contacts import AXES
from pgran.medium import packing
from pgran.medium.network import Network
from pgran.medium.springs import AT_REST, DRIVEN, FREE

SAME = 1e-6  # contacts that are listed twice agree to this part


@dataclass(frozen=True, eq=False)
class Made:
    """What is written, and what has been left out."""

    members: dict
    attributes: dict
    kept: packing.Kept
    apart: int
    twice: int
    cut: int
    unbalanced: float | None

    def network(self):
        """Return the network, which raises an InputError where it is none."""
        values = {name: self.members[name] for name in self.members if name != "id"}
        values["masses"] = values.pop("mass")
        return Network(**values, **self.attributes)


def assemble(found, given):
    """Return the network of contacts: what touches, is not cut, and hangs together.

    Not collective.

    Parameters
    ----------
    found : pgran.foreign.contacts.Contacts
    given : argparse.Namespace
        The words of `pgran import`.

    Returns
    -------
    Made

    Raises
    ------
    InputError, FileError
    """
    balls = found.balls
    kind = given.displacement or ("vector" if balls.axes else "scalar")
    if kind != "scalar" and not balls.axes:
        raise InputError(f"--displacement {kind} needs positions of the balls")
    if kind == "rotations" and balls.radius is None:
        raise InputError("--displacement rotations needs radii of the balls")
    stiffness = found.stiffness(given.law, given.hertz)
    touch = stiffness != 0
    once = touch & _first_of_each(found, stiffness, touch)
    across = _crossing(found, given.cut)
    held = _held(balls, given)
    index = np.flatnonzero(once)
    kept = packing.keep(found.bond[index], held, across[index])
    rows = index[kept.contacts]
    if not len(rows):
        raise InputError("no contact is left that a free ball has: see --rest, --drive, --cut")
    if given.drive and not np.any(held[kept.balls] == DRIVEN):
        raise InputError(f"--drive {given.drive}: none of these balls touches a free one")
    if balls.axes:
        _check_images(found, rows)

    number = np.cumsum(kept.balls) - 1
    bond, held = number[found.bond[rows]], held[kept.balls]
    members = {"position": None if balls.position is None else balls.position[kept.balls]}
    members |= {"mass": balls.mass[kept.balls], "held": held, "bond": bond}
    members["radius"] = None if balls.radius is None else balls.radius[kept.balls]
    members["stiffness"] = stiffness[rows]
    members["id"] = balls.id[kept.balls]
    attributes = {"displacement": kind, "damping": given.damping}
    # the unit of frequency is that of all balls and contacts, whatever is held, cut or left out
    attributes |= {
        "kmax": float(np.abs(stiffness).max()),
        "median_mass": float(np.median(balls.mass)),
    }
    normal, force = found.normal, found.force
    ratio = None
    if normal is not None and force is not None:
        ratio = packing.unbalanced(bond, normal[rows], force[rows], held == FREE)
    if kind != "scalar":
        members |= {"normal": normal[rows], "distance": found.distance[rows]}
        if given.prestress and force is None:
            raise InputError("--prestress needs forces; --columns says which column they are in")
        if given.prestress is not False and force is not None:
            members["force"] = force[rows]
        shear = found.given("tangential")
        if given.tangential is not None:
            shear = given.tangential * stiffness
        if shear is not None:
            members["tangential"] = shear[rows]
            attributes["kmax"] = max(attributes["kmax"], float(np.abs(shear[touch]).max()))
        attributes["direction"] = _along(given.direction, balls.axes)
    return Made(
        members, attributes, kept, np.count_nonzero(~touch), np.count_nonzero(touch & ~once),
        np.count_nonzero(across & once), ratio,
    )  # fmt: skip


def _first_of_each(found, stiffness, touch):
    """Return which contacts are the first of the same two balls; those listed again must agree."""
    low, high = np.sort(found.bond, axis=1).T
    order = np.lexsort((np.arange(len(low)), high, low, ~touch))
    order = order[: np.count_nonzero(touch)]
    again = (np.diff(low[order]) == 0) & (np.diff(high[order]) == 0)
    one, other = stiffness[order[:-1]], stiffness[order[1:]]
    wrong = np.flatnonzero(again & ~(np.abs(one - other) <= SAME * np.abs(one)))
    if wrong.size:
        why = "these balls touch twice, with different stiffness"
        found.table.refuse(order[wrong[0] + 1], why)
    first = np.ones(len(low), dtype=bool)
    first[order[1:][again]] = False
    return first


def _check_images(found, rows):
    """Refuse contacts that are as long as half a period: these balls can touch twice."""
    half = found.balls.periods.min() / 2
    wrong = rows[found.lengths[rows] >= half]
    if wrong.size:
        why = (
            f"these balls are {found.lengths[wrong[0]]:.6g} apart, and half a period is {half:.6g}"
        )
        found.table.refuse(wrong[0], f"{why}: the box is too small to tell their images apart")


def _crossing(found, cut):
    """Return which contacts lead through the ends that are cut."""
    across = np.zeros(len(found.bond), dtype=bool)
    for axis in map(AXES.index, cut or ""):
        if axis >= found.balls.axes or not np.isfinite(found.balls.periods[axis]):
            raise InputError(f"--cut {AXES[axis]}: the packing is not periodic along {AXES[axis]}")
        across |= found.crossing[:, axis]
    return across


def _held(balls, given):
    """Return which balls are free, at rest, driven."""
    held = np.full(len(balls.id), FREE) if balls.held is None else balls.held.copy()
    chosen = {}
    for option, kind in (("rest", AT_REST), ("drive", DRIVEN)):
        condition = getattr(given, option)
        if condition is not None:
            try:
                chosen[kind] = choose(condition, balls.id, balls.column)
            except InputError as error:
                raise InputError(f"--{option}: {error}") from None
            held[chosen[kind]] = kind
    if len(chosen) == 2 and np.any(chosen[AT_REST] & chosen[DRIVEN]):
        ball = balls.id[chosen[AT_REST] & chosen[DRIVEN]][0]
        raise InputError(f"--rest and --drive: ball {ball} cannot be both")
    return held


def _along(direction, axes):
    """Return the direction of the drive as components."""
    if direction is None or isinstance(direction, str):
        axis = AXES.index(direction or "x")
        if axis >= axes:
            raise InputError(f"--direction {direction}: the packing has {axes} axes")
        return np.eye(axes)[axis]
    if len(direction) != axes:
        raise InputError(f"--direction: the packing has {axes} axes")
    return direction / np.linalg.norm(direction)
