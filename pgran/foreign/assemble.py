"""The network that `pgran import` makes of contacts: what is held, kept, cut and left out."""

from dataclasses import dataclass

import numpy as np

from pgran.errors import InputError
from pgran.foreign.contacts import AXES
from pgran.medium import packing
from pgran.medium.conditions import hold
from pgran.medium.network import Network
from pgran.medium.springs import DRIVEN, FREE

SAME = 1e-6  # contacts that are listed twice agree to this part


@dataclass(frozen=True, eq=False)
class Imported:
    """What is written of a packing, and what was left out.

    Not among the contacts are those of balls `apart`, those listed `twice`, and those `cut`; of the
    others `kept` says what can vibrate. `stiffness` is what `Contacts.stiffness` returns,
    `unbalanced` the largest total force on a free ball.
    """

    members: dict
    attributes: dict
    kept: packing.Kept
    stiffness: tuple
    apart: int
    twice: int
    cut: int
    unbalanced: float | None

    def network(self):
        """Return the network, which raises an InputError where it is none."""
        values = {name: self.members[name] for name in self.members if name != "id"}
        values["masses"] = values.pop("mass")
        return Network(**values, **self.attributes)


def assemble(contacts, options):
    """Return the network of contacts, as options say: what touches and hangs together uncut."""
    balls = contacts.balls
    kind = options.displacement or ("vector" if balls.axes else "scalar")
    if kind != "scalar" and not balls.axes:
        raise InputError(f"--displacement {kind} needs positions of the balls")
    if kind == "rotations" and balls.radius is None:
        raise InputError("--displacement rotations needs radii of the balls")
    known = stiffness, _ = contacts.stiffness(options.law, options.hertz)
    touch = stiffness != 0
    once = touch & _first_of_each(contacts, stiffness, touch)
    across = _crossing(contacts, options.cut)
    held = _held(balls, options)
    index = np.flatnonzero(once)  # of contacts in the file: all that could be kept
    kept = packing.keep(contacts.bond[index], held, across[index])
    rows = index[kept.contacts]
    if not len(rows):
        raise InputError("no contact is left that a free ball has: see --rest, --drive, --cut")
    if options.drive and not np.any(held[kept.balls] == DRIVEN):
        raise InputError(f"--drive {options.drive}: none of these balls touches a free one")
    if balls.axes:  # balls that are half a period apart can touch twice
        half, lengths = balls.periods.min() / 2, contacts.lengths
        for row in rows[lengths[rows] >= half][:1]:
            why = f"these balls are {lengths[row]:.6g} apart, and half a period is {half:.6g}"
            contacts.table.refuse(row, f"{why}: the box is too small to tell their images apart")

    number = np.cumsum(kept.balls) - 1  # of a ball, once others are left out
    bond, held = number[contacts.bond[rows]], held[kept.balls]
    members = {
        "position": None if balls.position is None else balls.position[kept.balls],
        "mass": balls.mass[kept.balls],
        "held": held,
        "bond": bond,
        "radius": None if balls.radius is None else balls.radius[kept.balls],
        "stiffness": stiffness[rows],
        "id": balls.id[kept.balls],
    }
    attributes = {
        "displacement": kind,
        "damping": options.damping,
        # the unit of frequency is that of all balls and contacts, whatever is held, cut or left out
        "kmax": float(np.abs(stiffness).max()),
        "median_mass": float(np.median(balls.mass)),
    }
    normal, force = contacts.normal, contacts.force
    ratio = None
    if normal is not None and force is not None:
        ratio = packing.unbalanced(bond, normal[rows], force[rows], held == FREE)
    if kind != "scalar":
        members |= {"normal": normal[rows], "distance": contacts.distance[rows]}
        if options.prestress and force is None:
            raise InputError("--prestress needs forces; --columns says which column they are in")
        if options.prestress is not False and force is not None:
            members["force"] = force[rows]
        shear = contacts.column("tangential")
        if options.tangential is not None:
            shear = options.tangential * stiffness
        if shear is not None:
            members["tangential"] = shear[rows]
            attributes["kmax"] = max(attributes["kmax"], float(np.abs(shear[touch]).max()))
        attributes["direction"] = _components(options.direction, balls.axes)
    if options.law in packing.POWERS and "force" in members and np.all(force[rows] > 0):
        attributes["power"] = packing.POWERS[options.law]
    if balls.axes:
        cut = np.isin(list(AXES[: balls.axes]), list(options.cut or ""))
        attributes["box"] = np.where(np.isfinite(balls.periods) & ~cut, balls.periods, 0.0)
    left_out = (~touch, touch & ~once, across & once)
    return Imported(members, attributes, kept, known, *map(np.count_nonzero, left_out), ratio)


def _first_of_each(contacts, stiffness, touch):
    """Return which contacts are the first of the same two balls; those listed again must agree."""
    low, high = np.sort(contacts.bond, axis=1).T
    # contacts that touch come first, those of the same two balls together, in the file's order
    order = np.lexsort((np.arange(len(low)), high, low, ~touch))
    order = order[: np.count_nonzero(touch)]
    again = (np.diff(low[order]) == 0) & (np.diff(high[order]) == 0)
    one, other = stiffness[order[:-1]], stiffness[order[1:]]
    differ = np.zeros(len(low), dtype=bool)
    differ[order[1:]] = again & ~(np.abs(one - other) <= SAME * np.abs(one))
    contacts.table.refuse_any(differ, "these balls touch twice, with different stiffness")
    first = np.ones(len(low), dtype=bool)
    first[order[1:][again]] = False
    return first


def _crossing(contacts, cut):
    """Return which contacts lead through the ends that are cut."""
    across = np.zeros(len(contacts.bond), dtype=bool)
    for axis in map(AXES.index, cut or ""):
        if axis >= contacts.balls.axes or not np.isfinite(contacts.balls.periods[axis]):
            raise InputError(f"--cut {AXES[axis]}: the packing is not periodic along {AXES[axis]}")
        across |= contacts.crossing[:, axis]
    return across


def _held(balls, options):
    """Return which balls are free, at rest, driven: as the file says, and then --rest, --drive."""
    held = np.full(len(balls.id), FREE) if balls.held is None else balls.held
    return hold(held, balls.id, balls.column, rest=options.rest, drive=options.drive)


def _components(direction, axes):
    """Return the direction of the drive, an axis or components, as components of length 1."""
    if direction is None or isinstance(direction, str):
        axis = AXES.index(direction or "x")
        if axis >= axes:
            raise InputError(f"--direction {direction}: the packing has {axes} axes")
        return np.eye(axes)[axis]
    if len(direction) != axes:
        raise InputError(f"--direction: the packing has {axes} axes")
    return direction / np.linalg.norm(direction)
