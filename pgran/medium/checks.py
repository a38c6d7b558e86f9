"""Whether what is given makes a network: arrays that fit, and values that are possible."""

import math

import numpy as np

from pgran.arguments import choice
from pgran.errors import InputError
from pgran.medium.bonds import AXES
from pgran.medium.springs import AT_REST, DRIVEN, FREE
from pgran.run.numbers import number, numbers

KINDS = ("scalar", "vector", "rotations")
REQUIRED = ("held", "bond", "stiffness")
OF_CONTACTS = ("dashpot", "tangential_dashpot", "loss")  # numbers that damping has of each


def checked_values(network):
    """Return the arrays and the damping of a network, by name, as copies that nobody can change.

    Normals and distances that are needed and not given follow from positions. Raises InputError if
    an array does not fit the others.
    """
    values = {}

    def check(dtype, rest, count, *names):
        for name in names:
            value = values.get(name, getattr(network, name))
            if value is not None or name in REQUIRED:
                values[name] = checked_array(name, value, dtype, rest, count)

    check(int, (), None, "held")
    check(int, (2,), None, "bond")
    contacts, balls = len(values["bond"]), len(values["held"])
    for name, count in (("masses", balls), ("drag", balls), *((n, contacts) for n in OF_CONTACTS)):
        value = getattr(network, name)
        if value is not None and numbers(f"network: {name}", value).ndim == 0:
            values[name] = np.full(count, value, float)  # one number for all
    values["damping"] = number("network: damping", network.damping)
    choice("network: displacement", network.displacement, KINDS)
    check(float, (None,), balls, "position")
    if network.displacement != "scalar" and network.normal is None:
        values["normal"], distance = _normals(values.get("position"), values["bond"], balls)
        if network.distance is None:
            values["distance"] = distance
    check(float, (None,), contacts, "normal")
    check(float, (), contacts, "stiffness", "distance", "force", "tangential", *OF_CONTACTS)
    check(float, (), balls, "masses", "radius", "drag")
    for name in (*OF_CONTACTS, "drag"):
        value = values.get(name)
        if value is not None and np.any(value < 0):
            raise InputError(f"network: {name}: must be 0 or more")
        if value is not None and name in ("drag", "loss") and not np.any(value):
            values[name] = None  # as if it was not given
    axes = 1 if network.displacement == "scalar" else values["normal"].shape[1]
    check(float, (axes,), balls, "push")
    if network.power is not None:
        values["power"] = number("network: power", network.power)
    if values.get("position") is not None:
        check(float, (), values["position"].shape[1], "box", "gravity")
    elif network.box is not None or network.gravity is not None:
        raise InputError("network: a box or gravity is that of balls with positions")
    return values


def _normals(position, bond, balls):
    """Return the normals of contacts and the distances of their balls by the positions."""
    if position is None:
        raise InputError("network: vectors need normals, or positions to find them by")
    bond = np.clip(bond, 0, balls - 1)  # balls that are not there are refused later
    away = position[bond[:, 1]] - position[bond[:, 0]]
    distance = np.linalg.norm(away, axis=1)
    if not np.all(distance > 0):
        at = np.argmin(distance)
        raise InputError(f"network: the balls of contact {at} are at the same place")
    return away / distance[:, None], distance


def checked_array(name, value, dtype, rest, count=None):
    """Return an array of finite numbers, ints or floats, as a copy that nobody can change.

    Raises InputError unless its shape is (count, *rest), where None is any length.
    """
    array = np.array(numbers(f"network: {name}", value, whole=dtype is int))
    wanted = (count if count is not None else len(array) if array.ndim else 0, *rest)
    lengths = zip(wanted, array.shape, strict=False)
    if array.ndim != len(wanted) or any(n not in (None, m) for n, m in lengths):
        raise InputError(f"network: {name}: shape {array.shape} is not {wanted}")
    if not np.all(np.isfinite(array)):
        raise InputError(f"network: {name}: every number must be finite")
    array.flags.writeable = False
    return array


def check_network(network):
    """Raise InputError where values of a network, whose arrays fit, are impossible."""
    held, balls = network.held, len(network.held)
    if len(network.bond) == 0 or balls == 0:
        raise InputError("network: it has no contacts")
    outside = np.flatnonzero(np.any((network.bond < 0) | (network.bond >= balls), axis=1))
    if outside.size:
        pair = tuple(network.bond[outside[0]].tolist())
        raise InputError(f"network: contact {outside[0]}: no balls {pair} among {balls}")
    if np.any(network.bond[:, 0] == network.bond[:, 1]):
        raise InputError("network: a ball touches itself")
    if not np.all(np.isin(held, (FREE, AT_REST, DRIVEN))):
        raise InputError("network: held must be 0 (free), 1 (at rest) or 2 (driven)")
    if not np.any(held == FREE):
        raise InputError("network: every ball is held")
    if not np.any(held[network.bond] == FREE):
        raise InputError("network: no free ball has a contact")
    if not np.all(network.masses[held == FREE] > 0):
        raise InputError("network: masses must be positive")
    choice("network: damped", network.damped, ("all", "normal"))
    if network.tangential_dashpot is not None and network.damped == "normal":
        raise InputError("network: tangential_dashpot contradicts damped = normal")
    if network.displacement != "scalar":
        if network.normal.shape[1] not in (2, 3):
            raise InputError("network: vectors have 2 or 3 components")
        if np.any(np.abs(np.linalg.norm(network.normal, axis=1) - 1) > 1e-6):
            raise InputError("network: normals must have the length 1")
    distance = network.distance
    if network.force is not None and (distance is None or not np.all(distance > 0)):
        raise InputError("network: forces need positive distances")
    if network.power is not None:
        if not network.power >= 1:
            raise InputError("network: power: of a contact law F = c h^power it is 1 or more")
        if network.force is not None and np.any(network.stiffness <= 0):
            raise InputError("network: a contact under a law has a positive stiffness")
    if network.box is not None and np.any(network.box < 0):
        raise InputError("network: box: periods are positive, 0 where there is none")
    if network.push is not None:
        if np.any(network.push[held != FREE]) or not np.any(network.push):
            raise InputError("network: push: forces on free balls, not all zero, are needed")
        if np.any(held == DRIVEN):
            raise InputError("network: either held balls are driven (2) or a push drives, not both")
    if network.turns and network.radius is None:
        raise InputError("network: rotations need radii")
    if network.turns and not np.all(network.radius[held == FREE] > 0):
        raise InputError("network: radii must be positive")
    components = AXES[: network.axes] if network.axes > 1 else ""
    choice("-detectors_component", network.component, ("drive", *components))


def unit_direction(direction, axes):
    """Return the direction of a drive, of length 1; along x unless given."""
    if direction is None:
        return np.eye(axes)[0]
    direction = numbers("network: the direction of the drive", direction)
    size = np.linalg.norm(direction)
    if direction.shape != (axes,) or not 0 < size < math.inf:
        raise InputError(f"network: the direction of the drive needs {axes} numbers, not all 0")
    return direction / size
