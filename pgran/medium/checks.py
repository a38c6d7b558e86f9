"""Checks of a network: arrays fit each other, and values are possible."""

import numpy as np

from pgran.arguments import choice
from pgran.errors import InputError
from pgran.medium.base import AXES
from pgran.medium.springs import AT_REST, DRIVEN, FREE
from pgran.run.numbers import number, numbers

KINDS = ("scalar", "vector", "rotations")
REQUIRED = ("held", "bond", "stiffness")
OF_DAMPING = ("drag", "dashpot", "tangential_dashpot", "loss")
UNIFORM = ("masses", *OF_DAMPING)  # may be one number for all


def checked_values(network, arrays):
    """Return the arrays and the damping of a network, by name, as copies that nobody can change.

    `arrays` says of what type each is, and along which axes. Normals and distances that are needed
    and not given follow from positions. Raises InputError if an array does not fit the others.
    """
    values, lengths = {}, {"end": 2}

    def check(*names):
        for name in names:
            value = values.get(name, getattr(network, name))
            if value is None and name not in REQUIRED:
                continue
            axes = arrays[name]["axes"]
            if name in UNIFORM and numbers(f"network: {name}", value).ndim == 0:
                value = np.full(lengths[axes[0]], value, float)
            wanted = [lengths.get(axis) for axis in axes]
            values[name] = checked_array(name, value, arrays[name]["dtype"], wanted)
            lengths.update(zip(axes, values[name].shape, strict=True))

    check("held", "bond")
    values["damping"] = number("network: damping", network.damping)
    choice("network: displacement", network.displacement, KINDS)
    check("position")
    coordinates = lengths.pop("coordinate", None)  # normals may have others
    if network.displacement != "scalar" and network.normal is None:
        values["normal"], distance = _normals(values.get("position"), values["bond"])
        if network.distance is None:
            values["distance"] = distance
    # what positions give is checked as what is handed in
    others = [name for name in arrays if name not in (*values, "normal", "distance", "push")]
    check("normal", "distance", *others)
    for name in OF_DAMPING:
        value = values.get(name)
        if value is not None and np.any(value < 0):
            raise InputError(f"network: {name}: must be 0 or more")
        if value is not None and name in ("drag", "loss") and not np.any(value):
            values[name] = None  # as if it was not given
    scalar = network.displacement == "scalar"
    lengths["drive_coordinate"] = 1 if scalar else values["normal"].shape[1]
    check("push")
    if network.power is not None:
        values["power"] = number("network: power", network.power)
    for name in ("box", "gravity"):
        value = getattr(network, name)
        if value is not None and coordinates is None:
            raise InputError("network: a box or gravity is that of balls with positions")
        if value is not None:
            values[name] = checked_array(name, value, float, [coordinates])
    return values


def _normals(position, bond):
    """Return the normals of contacts and the distances of their balls by the positions."""
    if position is None:
        raise InputError("network: vectors need normals, or positions to find them by")
    bond = np.clip(bond, 0, len(position) - 1)  # balls that are not there are refused later
    away = position[bond[:, 1]] - position[bond[:, 0]]
    distance = np.linalg.norm(away, axis=1)
    if not np.all(distance > 0):
        at = np.argmin(distance)
        raise InputError(f"network: the balls of contact {at} are at the same place")
    return away / distance[:, None], distance


def checked_array(name, value, dtype, wanted):
    """Return finite numbers of the shape `wanted`, None for any length, as a read-only copy."""
    array = np.array(numbers(f"network: {name}", value, whole=dtype is int))
    if wanted[0] is None:
        wanted = [len(array) if array.ndim else 0, *wanted[1:]]
    fits = [n in (None, m) for n, m in zip(wanted, array.shape, strict=False)]
    if array.ndim != len(wanted) or not all(fits):
        raise InputError(f"network: {name}: shape {array.shape} is not {tuple(wanted)}")
    if not np.all(np.isfinite(array)):
        raise InputError(f"network: {name}: every number must be finite")
    array.flags.writeable = False
    return array


def check_network(network):
    """Raise InputError where values of a network, whose arrays fit, are impossible."""
    choice("network: damped", network.damped, ("all", "normal"))
    for impossible, why in _conditions(network):
        if impossible:
            raise InputError(f"network: {why}")
    components = AXES[: network.axes] if network.axes > 1 else ""
    choice("-detectors_component", network.component, ("drive", *components))


def _conditions(network):
    """Yield whether a condition is broken, and its name; each presupposes those before it."""
    held, bond, balls = network.held, network.bond, len(network.held)
    moving = held == FREE
    yield len(bond) == 0 or balls == 0, "it has no contacts"
    for contact in np.flatnonzero(np.any((bond < 0) | (bond >= balls), axis=1))[:1]:
        yield True, f"contact {contact}: no balls {tuple(bond[contact].tolist())} among {balls}"
    yield np.any(bond[:, 0] == bond[:, 1]), "a ball touches itself"
    known = np.isin(held, (FREE, AT_REST, DRIVEN))
    yield not np.all(known), "held must be 0 (free), 1 (at rest) or 2 (driven)"
    yield not np.any(moving), "every ball is held"
    yield not np.any(moving[bond]), "no free ball has a contact"
    yield not np.all(network.masses[moving] > 0), "masses must be positive"
    if network.tangential_dashpot is not None:
        yield network.damped == "normal", "tangential_dashpot contradicts damped = normal"
    if network.displacement != "scalar":
        yield network.normal.shape[1] not in (2, 3), "vectors have 2 or 3 components"
        sizes = np.linalg.norm(network.normal, axis=1)
        yield np.any(np.abs(sizes - 1) > 1e-6), "normals must have the length 1"
    if network.force is not None:
        apart = network.distance is not None and np.all(network.distance > 0)
        yield not apart, "forces need positive distances"
    if network.power is not None:
        low = not network.power >= 1
        yield low, "power: of a contact law F = c h^power it is 1 or more"
        soft = network.force is not None and np.any(network.stiffness <= 0)
        yield soft, "a contact under a law has a positive stiffness"
    if network.box is not None:
        yield np.any(network.box < 0), "box: periods are positive, 0 where there is none"
    if network.push is not None:
        nowhere = np.any(network.push[~moving]) or not np.any(network.push)
        yield nowhere, "push: forces on free balls, not all zero, are needed"
        driven = np.any(held == DRIVEN)
        yield driven, "either held balls are driven (2) or a push drives, not both"
    if network.displacement == "rotations":
        yield network.radius is None, "rotations need radii"
        yield not np.all(network.radius[moving] > 0), "radii must be positive"
