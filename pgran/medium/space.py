"""Balls of a network in space, for pictures and other programs: contacts, displacements."""

import numpy as np

from pgran.medium.bonds import bond_ends
from pgran.medium.dissipation import FIELDS
from pgran.medium.network import Network, NetworkRecord


def in_space(vectors):
    """Return vectors of 1 to 3 components with 3, the last ones 0."""
    missing = 3 - vectors.shape[-1]
    return np.pad(vectors, [(0, 0)] * (vectors.ndim - 1) + [(0, missing)])


def reaches(network):
    """Return how far each contact reaches from its first ball, (nb, 3), and whether across the box.

    Where balls that touch are not apart by the normal and the distance of their contact, one
    touches an image of the other, and the contact reaches to that image.
    """
    i, j = network.bond.T
    away = in_space(network.position[j] - network.position[i])
    if network.normal is None:
        return away, np.zeros(len(away), dtype=bool)
    apart = np.linalg.norm(away, axis=1)
    size = apart if network.distance is None else network.distance
    normal = in_space(network.normal)
    crosses = np.linalg.norm(away - normal * size[:, None], axis=1) > 0.5 * size
    if network.distance is None and not crosses.all():  # as long as the others
        size = np.where(crosses, np.median(apart[~crosses]), apart)
    return np.where(crosses[:, None], normal * size[:, None], away), crosses


def everywhere(network, values, drive=0.0):
    """Return displacements of all balls, held ones too, shape (n, N, components).

    `values` (n, unknowns) are displacements and rotations of the free balls, `drive` (n,) those of
    the driven balls along the direction of the drive.
    """
    built = network.built
    moves = np.zeros((len(values), len(network.held), built.components), dtype=values.dtype)
    moves[:, built.free] = values.reshape(len(values), -1, built.components)
    moves[:, network.held == 2, : built.axes] = np.reshape(drive, (-1, 1, 1)) * network.direction
    return moves


def mesh(result):
    """Return points in space (n, 3), lines between them (m, 2), and data of both.

    The data of points and of lines are arrays of as many rows, by name; vectors have 3 components.
    """
    network = as_network(result.medium)
    of_points = {"mass": network.mass, "radius": network.radius, "held": network.held}
    names = ("stiffness", "tangential", "force", "distance", "normal")
    of_lines = {name: getattr(network, name) for name in names}
    if of_lines["normal"] is not None:
        of_lines["normal"] = in_space(network.normal)
    of_lines["crosses"] = reaches(network)[1].astype(int)
    of_points, of_lines = (
        {name: values for name, values in data.items() if values is not None}
        for data in (of_points, of_lines)
    )
    return in_space(network.position), network.bond, of_points, of_lines | dict(_of_bonds(result))


def motions(result):
    """Yield name, omega or time in words, and arrays of all balls for each motion that is stored.

    These are displacements, "", (N,) if they are scalar, else (N, 3), and any "_rotation" (N, 3).
    """
    network = as_network(result.medium)
    for name, fact, values, drive in _motions(result):
        moves = everywhere(network, values.reshape(1, -1), [drive])[0]
        axes = 1 if network.displacement == "scalar" else len(network.direction)
        arrays = {"": moves[:, 0] if axes == 1 else in_space(moves[:, :axes])}
        turned = moves[:, axes:]
        if turned.shape[1]:
            arrays["_rotation"] = np.pad(turned, ((0, 0), (3 - turned.shape[1], 0)))
        yield name, fact, arrays


def as_network(medium):
    """Return the record of a network as it is, of a lattice as one, its bonds and balls in order.

    Where a bond of the lattice ends at a wall there is a held ball of no mass.
    """
    if medium.group == "network":
        return medium
    built, count, shape = medium.built, medium.free_balls, medium.shape
    bond, driven = bond_ends(np.arange(count).reshape(shape)), built.drive != 0
    axis, _ = built.bond_places(np.arange(built.bonds))
    sites = np.indices(shape).reshape(len(shape), -1).T
    wall, end = np.nonzero(bond < 0)
    outward = np.where(end, 1, -1)[:, None] * np.eye(len(shape), dtype=int)[axis[wall]]
    beside = sites[bond[wall, 1 - end]] + outward
    bond[wall, end] = count + np.arange(len(wall))
    held = np.append(np.zeros(count, dtype=int), np.where(driven[wall] & (end == 1), 2, 1))
    mass = np.append(np.full(count, medium.mass), np.zeros(len(wall)))
    position = np.concatenate([sites, beside]).astype(float)
    dissipation = {name: getattr(built, name) for name in FIELDS}
    network = Network(bond, built.constants, held, mass, position=position, **dissipation)
    return NetworkRecord.of(network)


def _of_bonds(result):
    """Yield power and derivatives of signals by bonds, by name, at frequencies that succeeded."""
    record = getattr(result, "sensitivity", None)
    for n in [] if record is None else np.flatnonzero(record.converged_reason > 0):
        yield f"flux_{n + 1:04}", record.flux[n]
        yield f"loss_{n + 1:04}", record.loss[n]
        for d, site in enumerate(record.detector.tolist()):
            name = "_".join(map(str, ["log_amplitude", f"{n + 1:04}", *site]))
            yield name, record.on_bonds(n, d)


def _motions(result):
    """Yield name, omega or time, displacements of free balls and of the drive for each motion."""
    modes, response, pulse = (getattr(result, x, None) for x in ("modes", "response", "pulse"))
    if modes is not None and modes.vector is not None:
        for n, (omega, vector) in enumerate(zip(modes.omega, modes.vector, strict=True), 1):
            yield f"mode_{n:04}", f"{omega=!s}", result.medium.built.displacements(vector), 0.0
    if response is not None and response.field is not None:
        for n, (omega, field) in enumerate(zip(response.omega, response.field, strict=True), 1):
            yield f"response_{n:04}_real", f"{omega=!s}", field.real, 1.0
            yield f"response_{n:04}_imag", f"{omega=!s}", field.imag, 0.0
    if pulse is not None and pulse.field is not None:
        walls = np.interp(pulse.field_time, pulse.time, pulse.wall)
        for n, (time, field) in enumerate(zip(pulse.field_time, pulse.field, strict=True), 1):
            yield f"field_{n:04}", f"{time=!s}", field, walls[n - 1]
