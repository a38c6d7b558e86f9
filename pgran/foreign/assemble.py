"""The network that `pgran import` makes of contacts: what is held, kept, cut and left out."""

from dataclasses import dataclass

import numpy as np

from pgran.errors import InputError
from pgran.foreign.contacts import AXES
from pgran.medium import packing
from pgran.medium.base import unit_vector
from pgran.medium.conditions import hold
from pgran.medium.network import Network
from pgran.medium.springs import DRIVEN, FREE

SAME = 1e-6  # contacts that are listed twice agree to this part


@dataclass(frozen=True, eq=False)
class Imported:
    """A packing as a network, what is written of it, and what was left out.

    Not among the contacts are those of balls `apart`, those listed `twice`, and those `cut`; of the
    others `kept` says what can vibrate. `error` is the largest part that digits leave open of a
    stiffness, `unbalanced` the largest total force on a free ball.
    """

    network: Network
    members: dict
    attributes: dict
    kept: packing.Kept
    stiffness: np.ndarray  # of all contacts in the file
    error: float
    apart: int
    twice: int
    cut: int
    unbalanced: float | None


def assemble(contacts, options, names=None):
    """Return the network of contacts, as options say: what touches and hangs together uncut.

    `names` are those of a graph's nodes, for which balls without numbers are known.
    """
    balls = contacts.balls
    kind = options.displacement or ("vector" if balls.axes else "scalar")
    if kind != "scalar" and not balls.axes:
        raise InputError(f"--displacement {kind} needs positions of the balls")
    if kind == "rotations" and balls.radius is None:
        raise InputError("--displacement rotations needs radii of the balls")
    stiffness, error = contacts.stiffness(options.law, options.hertz)
    touch = stiffness != 0
    once = _listed_once(contacts, stiffness)
    across = _crossing(contacts, options.cut)
    held = np.full(len(balls.id), FREE) if balls.held is None else balls.held
    held = hold(held, balls.id, balls.column, rest=options.rest, drive=options.drive)
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

    def kept_of(values):
        """Return what values of balls are of those that are kept; None stays None."""
        return None if values is None else values[kept.balls]

    number = np.cumsum(kept.balls) - 1  # of a ball, once others are left out
    bond, free = number[contacts.bond[rows]], held[kept.balls] == FREE
    members = {
        "position": kept_of(balls.position),
        "mass": kept_of(balls.mass),
        "held": kept_of(held),
        "bond": bond,
        "radius": kept_of(balls.radius),
        "stiffness": stiffness[rows],
        "id": kept_of(balls.id),
    }
    if names is not None and names != [*map(str, balls.id)]:
        members["id"] = kept_of(np.char.encode(names, "utf-8"))
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
        ratio = packing.unbalanced(bond, normal[rows], force[rows], free)
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
        attributes["direction"] = unit_vector("--direction", options.direction, balls.axes)
    if options.law in packing.POWERS and "force" in members and np.all(force[rows] > 0):
        attributes["power"] = packing.POWERS[options.law]
    if balls.axes:
        cut = np.isin(list(AXES[: balls.axes]), list(options.cut or ""))
        attributes["box"] = np.where(np.isfinite(balls.periods) & ~cut, balls.periods, 0.0)
    values = {name: member for name, member in members.items() if name not in ("id", "mass")}
    network = Network(**values, masses=members["mass"], **attributes)
    left_out = map(np.count_nonzero, (~touch, touch & ~once, across & once))
    return Imported(network, members, attributes, kept, stiffness, error, *left_out, ratio)


def _listed_once(contacts, stiffness):
    """Return which contacts touch, of the same two balls the first; the others must agree."""
    rows = np.flatnonzero(stiffness)
    low, high = np.sort(contacts.bond[rows], axis=1).T
    pair = low * len(contacts.balls.id) + high  # a number for each two balls
    _, first, which = np.unique(pair, return_index=True, return_inverse=True)
    expected = stiffness[rows[first[which]]]
    differ = np.zeros(len(stiffness), dtype=bool)
    differ[rows] = ~(np.abs(stiffness[rows] - expected) <= SAME * np.abs(expected))
    contacts.table.refuse_any(differ, "these balls touch twice, with different stiffness")
    once = np.zeros(len(stiffness), dtype=bool)
    once[rows[first]] = True
    return once


def _crossing(contacts, cut):
    """Return which contacts lead through the ends that are cut."""
    across = np.zeros(len(contacts.bond), dtype=bool)
    for axis in map(AXES.index, cut or ""):
        if axis >= contacts.balls.axes or not np.isfinite(contacts.balls.periods[axis]):
            raise InputError(f"--cut {AXES[axis]}: the packing is not periodic along {AXES[axis]}")
        across |= contacts.crossing[:, axis]
    return across
