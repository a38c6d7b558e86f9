"""What contacts by their own law add to the springs and dashpots of a medium.

A contact that overlaps by h pushes with F(x) = C x_+^alpha, x = h - e, when it is stretched by e,
and its dashpot c(x) = beta (k(x) / k_ref)^p follows its stiffness k(x) = F'(x) at each instant. To
the tension k e + c e' of the medium's spring and dashpot this adds phi + d psi / dt,

    phi(e) = F(h) - F(h - e) - k e,     psi(e) = int_0^e (c(h - y) - c(h)) dy.

So no derivative of c is needed, which is infinite where a contact by Hertz's law opens. For p = 1
psi is phi beta / k_ref; for p = 0 dashpots stay as they are, psi = 0. Normals are those at rest.
Balls that nearly touch are contacts of h < 0, without a spring or a dashpot at rest. NumPy only.
"""

import dataclasses
from dataclasses import dataclass

import numpy as np

from pgran.errors import InputError
from pgran.medium.overlaps import overlaps_of


@dataclass(frozen=True, eq=False)
class Contacts:
    """Contacts, then near pairs: rows of B, shape (n, w), and numbers of each, shape (n,).

    `number` is that of the medium's spring, -1 of a near pair, whose `overlap` is minus its gap.
    """

    columns: np.ndarray  # unknowns of the medium, -1 for none
    entries: np.ndarray
    drive: np.ndarray  # how far what is driven stretches it when it moves by 1
    number: np.ndarray
    overlap: np.ndarray
    constant: np.ndarray  # C
    stiffness: np.ndarray  # k, and
    dashpot: np.ndarray  # c, both at rest
    share: np.ndarray  # beta / k_ref^p
    power: float  # alpha
    p: float

    def of(self, chosen):
        """Return some of them."""
        arrays = {name: x for name, x in vars(self).items() if np.ndim(x)}
        return dataclasses.replace(self, **{name: x[chosen] for name, x in arrays.items()})

    def forces(self, stretch):
        """Return phi and psi at stretches (n, times)."""
        rest = self._pushing(np.maximum(self.overlap, 0.0)[:, None])
        now = self._pushing(np.maximum(self.overlap[:, None] - stretch, 0.0))
        phi = rest[0] - now[0] - self.stiffness[:, None] * stretch
        if self.p in (0, 1):
            return phi, self.p * self.share[:, None] * phi
        return phi, rest[1] - now[1] - self.dashpot[:, None] * stretch

    def tangents(self, stretch):
        """Return the derivatives of phi and psi at stretches (n, times)."""
        height = np.maximum(self.overlap[:, None] - stretch, 0.0)
        k = self.power * self.constant[:, None] * (height > 0) * self._root(height)
        phi = k - self.stiffness[:, None]
        if self.p in (0, 1):
            return phi, self.p * self.share[:, None] * phi
        return phi, self.share[:, None] * k**self.p - self.dashpot[:, None]

    def _pushing(self, height):
        """Return F and, for other p than 0 and 1, the integral of c, from 0 to a height."""
        C, grown = self.constant[:, None], (self.power - 1) * self.p + 1
        force = C * height * self._root(height)
        if self.p in (0, 1):
            return force, 0.0
        return force, self.share[:, None] * (self.power * C) ** self.p * height**grown / grown

    def _root(self, height):
        return np.sqrt(height) if self.power == 1.5 else height ** (self.power - 1)


def contacts_of(medium, reach=0.0):
    """Return the contacts of a medium, and pairs nearer than `reach` mean overlaps to touching.

    Raises InputError where the law of the contacts is unknown, or is none of normal forces alone.
    """
    for impossible, why in (
        (medium.losses is not None, "-damping_loss: motions of one frequency alone have a loss "
         "angle; take -damping_power 1"),
        (not medium.dissipates, "nothing is damped here, so that no motion becomes periodic"),
        (medium.damping_power < 0, "-damping_power: dashpots of contacts that open take 0 or more"),
        (not medium.is_grid and medium.tangential is not None, "contacts have no friction, and the "
         "network has tangential springs"),
    ):  # fmt: skip
        if impossible:
            raise InputError(f"loud: {why}")
    law, springs, p = overlaps_of(medium), medium.springs, medium.damping_power
    share = medium.damping * springs.shares / (medium.damping_reference or 1.0) ** p
    entries = np.broadcast_to(springs.values, springs.columns.shape)
    arrays = springs.columns, entries, springs.drive, np.arange(len(springs.drive))
    arrays = [x[law.contact] for x in arrays] + [law.overlap, law.constant]
    others = springs.elastic, medium.damping * springs.damped, share
    arrays += [x[law.contact] for x in others]
    if reach and not medium.is_grid and medium.axes > 1 and medium.radius is not None:
        near = _near(medium, reach * float(law.overlap.mean()), share.mean())
        arrays = map(np.concatenate, zip(arrays, near, strict=True))
    return Contacts(*arrays, law.power, p)


def _near(network, reach, share):
    """Return arrays as of `Contacts` of the pairs of balls besides its contacts."""
    from pgran.balance.motion import listed
    from pgran.balance.networks import balls_of

    balls, known = balls_of(network)
    pairs = listed(balls, known, reach=reach).of(slice(len(known.pairs), None))
    count = len(pairs.pairs)
    normal = pairs.away / np.linalg.norm(pairs.away, axis=1)[:, None]
    without = ("force", "distance", "dashpot", "tangential_dashpot", "power")
    width, zero = network.springs.columns.shape[1], np.zeros(count)
    rows = [np.zeros((0, width), int), np.zeros((0, width)), zero]
    if count:
        near = dataclasses.replace(
            network, bond=pairs.pairs, normal=normal, stiffness=np.ones(count), damping_power=0.0,
            **dict.fromkeys(without),
        ).springs  # fmt: skip
        rows = [x[:count] for x in (near.columns, near.values, near.drive)]
    gap = np.minimum(pairs.overlap, 0.0)
    return *rows, np.full(count, -1), gap, pairs.constants, zero, zero, np.full(count, share)
