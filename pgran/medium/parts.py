"""Parts of networks: what floats, and what is left of a network without some of it."""

import dataclasses

import numpy as np

from pgran.medium.springs import FREE


def without_floating(network):
    """Return a network without what floats, and the numbers of the balls that are kept, ascending.

    A free ball floats if no path of contacts leads from it to a held ball: its motion is no answer
    to the drive, and K and C are singular. Where no ball is held, all parts but the largest float.
    The unit of frequency, `kmax`, stays. Raises InputError if nothing free is left.
    """
    kept = np.flatnonzero(anchored(network.bond, network.held))
    return part(network, kept), kept


def anchored(bond, held):
    """Return which balls do not float, shape (balls,)."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    balls = len(held)
    graph = coo_matrix((np.ones(len(bond)), tuple(bond.T)), (balls, balls))
    count, label = connected_components(graph, directed=False)
    if not np.any(held):
        return label == np.argmax(np.bincount(label))
    anchors = np.zeros(count, dtype=bool)
    anchors[label[held != FREE]] = True
    return anchors[label]


def part(network, balls=None, contacts=None):
    """Return the network of some balls, and of those contacts that join two of them.

    `balls` and `contacts` are the numbers of those that are kept, ascending, or None for all.
    Raises InputError if nothing free is left.
    """
    balls = np.arange(len(network.held)) if balls is None else np.asarray(balls)
    contacts = np.arange(len(network.bond)) if contacts is None else np.asarray(contacts)
    number = np.full(len(network.held), -1)
    number[balls] = np.arange(len(balls))
    bond = number[network.bond[contacts]]
    whole = np.all(bond >= 0, axis=1)
    kept = {"bond": bond[whole]}
    for names, which in (
        (("held", "masses", "position", "radius"), balls),
        (("stiffness", "normal", "distance", "force", "tangential"), contacts[whole]),
    ):
        values = {name: getattr(network, name) for name in names}
        kept |= {name: value[which] for name, value in values.items() if value is not None}
    return dataclasses.replace(network, **kept)
