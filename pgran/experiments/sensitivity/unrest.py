"""How far off amplitudes are because a packing's balance leaves forces, and rounds.

`pgran manual sensitivity` has the inequalities. NumPy and SciPy only.
"""

import dataclasses

import numpy as np

from pgran.driven.certify import least_stiffness
from pgran.experiments.sensitivity.radii import Radii
from pgran.experiments.sensitivity.warmth import with_vectors
from pgran.medium.rounding import EPSILON
from pgran.medium.springs import AT_REST, norm_of

ROOM = 1e-3  # of an overlap: how far contacts may stray


class Unrest:
    """How near a packing, in its own unit, is to a rest, and what that does to amplitudes.

    `left` (free balls,) bounds the forces left, `blurred` (contacts,) what rounds in overlaps,
    `gap` is the narrowest one. The balls of contacts are off by `moved`, `pressed` along normals.
    """

    def __init__(self, network, left, blurred, gap):
        self.seen, weights = Radii(network, relax=False), network.weights[:: network.components]
        floats, held = int(not network.held[network.bond].any()), network.held.copy()
        held[network.free[:floats]] = AT_REST  # forces add up to nothing: the others balance it
        fixed = dataclasses.replace(with_vectors(network), held=held, push=None)
        least, d = least_stiffness(fixed), network.distance
        reach = 2.1 * np.linalg.norm((weights * left)[floats:]) / least if least else np.inf
        self.moved = self.seen.lengths * reach
        pressed = np.sqrt((least + self._norm(network.force / d)) / network.stiffness) * reach
        self.pressed = pressed + self.moved**2 / d + blurred
        near = np.all(self.pressed <= ROOM * network.overlap) and 2 * weights.max() * reach < gap
        self.is_near = near and 2 * self._norm(self._changes(0.0)) <= least

    def missed(self, s, fields, errors, inverse_norm):
        """Return what that does to amplitudes at detectors (nd,), at most; infinite: not known.

        `fields` and `errors` are as in `Radii.derivatives`; |S^-1| is at most `inverse_norm`.
        """
        changes, seen = self._changes(s), self.seen
        eta = self._norm(changes)
        if not self.is_near or not eta * inverse_norm < 1:
            return np.full(len(fields) - 1, np.inf)
        parted = (seen.apart @ fields.T).T.reshape(len(fields), len(changes), -1)
        parted[0] += seen.drive
        norms = np.sqrt(np.sum(np.abs(parted) ** 2, axis=2) @ changes) + np.sqrt(eta) * errors
        return 1.01 * norms[0] * norms[1:] / (1 - eta * inverse_norm)

    def _changes(self, s):
        """Return by how much the parts of S of all contacts may be off at an s."""
        net, d, some = self.seen.network, self.seen.distance, slice(self.seen.network.bonds)
        size = net.stiffness + np.abs(net.kappa(s)[some]) + 2 * net.force / d
        bent = (net.power - 1) * net.stiffness / net.overlap * np.abs(net.slope(s)[some])
        return 1.1 * (self.pressed * bent + self.moved * size / d) + 8 * EPSILON * size

    def _norm(self, changes):
        """Return no less than |B^T diag(changes) B|_2, B parting the balls of each contact."""
        return norm_of(self.seen.apart, np.repeat(changes, self.seen.network.axes))
