"""Balls of a network in space, for pictures and other programs: contacts, displacements."""

import numpy as np


def in_space(vectors):
    """Return vectors of 1 to 3 components with 3, the last ones 0. Not collective."""
    missing = 3 - vectors.shape[-1]
    return np.pad(vectors, [(0, 0)] * (vectors.ndim - 1) + [(0, missing)])


def reaches(network):
    """Return how far each contact reaches from its first ball, and which cross the box.

    Not collective. The box of a packing may be periodic. Where two balls that touch are not apart
    by the normal and the distance of their contact, one touches an image of the other.

    Parameters
    ----------
    network : pgran.results.NetworkRecord
        With positions.

    Returns
    -------
    along : numpy.ndarray, shape (nb, 3)
        To the second ball, or to its image.
    crosses : numpy.ndarray of bool, shape (nb,)
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

    Not collective.

    Parameters
    ----------
    network : pgran.results.NetworkRecord
    values : numpy.ndarray, shape (n, unknowns)
        Displacements and rotations of the free balls.
    drive : array_like, shape (n,), optional
        Of the driven balls, along the direction of the drive.
    """
    built = network.built
    moves = np.zeros((len(values), len(network.held), built.components), dtype=values.dtype)
    moves[:, built.free] = values.reshape(len(values), -1, built.components)
    moves[:, network.held == 2, : built.axes] = np.reshape(drive, (-1, 1, 1)) * network.direction
    return moves
