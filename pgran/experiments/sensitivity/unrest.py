"""How far off amplitudes of a packing may be because its balance leaves forces, and rounds.

Let no eigenvalue of the packing's stiffness K be below c, and the forces left be below c p / 2 in
the 2-norm, in mass-weighted unknowns. Unless K changes by c / 2 on the way, there is a rest at a u
with |u| < p and u^T K u < c p^2. So the balls of a contact, whose rows have the norm l, move by l p
at most, and, K being B_n^T k B_n but for the pre-stress of the norm P, by y, k y^2 = (c + P) p^2,
along the normal. Its part of S, kappa along the normal and -F / d across, changes by less than

    m = 1.1 [(alpha - 1) k y / h |dkappa/dk| + l p (k + |kappa| + 2 F / d) / d],   y < h / 1000.

With N(v)^2 the sum of m |v_j - v_i|^2 over contacts, what is driven counted in A, and |dS| <= eta
amplitudes change by z^T dS A', N(A') <= N(A) + eta |S^-1| N(A'), so by less than N(z) N(A) / (1 -
eta |S^-1|). NumPy and SciPy only.
"""

import numpy as np

from pgran.driven.certify import least_stiffness
from pgran.experiments.sensitivity.radii import Radii
from pgran.experiments.sensitivity.warmth import with_vectors
from pgran.medium.rounding import EPSILON
from pgran.medium.springs import norm_of

ROOM = 1e-3  # of an overlap: how far contacts may stray


class Unrest:
    """How near a packing, in its own unit, is to a rest, and what that does to amplitudes.

    `left` (free balls,) bounds the forces left, `blurred` (contacts,) what rounds in overlaps;
    `gap` is the narrowest gap between other balls.
    """

    def __init__(self, network, left, blurred, gap):
        """Find how near a rest is, if one is for certain."""
        self.seen, weights = Radii(network, relax=False), network.weights[:: network.components]
        least, d = least_stiffness(with_vectors(network)), network.distance
        reach = 2.1 * np.linalg.norm(weights * left) / least if least else np.inf
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
        """Return m of all contacts, and what rounds in their parts of S."""
        net, d, some = self.seen.network, self.seen.distance, slice(self.seen.network.bonds)
        size = net.stiffness + np.abs(net.kappa(s)[some]) + 2 * net.force / d
        bent = (net.power - 1) * net.stiffness / net.overlap * np.abs(net.slope(s)[some])
        return 1.1 * (self.pressed * bent + self.moved * size / d) + 8 * EPSILON * size

    def _norm(self, changes):
        """Return no less than |B^T diag(changes) B|_2, B parting the balls of each contact."""
        return norm_of(self.seen.apart, np.repeat(changes, self.seen.network.axes))
