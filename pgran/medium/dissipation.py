"""How a medium loses sound: dashpots at contacts, drag on balls, loss angles of springs.

    S(s) = K + i L + s (C + alpha M) + s^2 M,    C = B^T diag(beta d) B,    L = B^T diag(eta k) B.

The dashpot of a spring of stiffness k, pre-stress left out, is beta d, d = part (|k| / k_ref)^p: of
p = 0 they are all alike, of p = 1 all springs have the same loss angle, contacts of simulations
have p = 1/2. k_ref is the mean stiffness of the normal springs as they were first: it stays when
bonds are redrawn. A spring of no stiffness has no dashpot unless p = 0.
"""

import dataclasses
from functools import cached_property

import numpy as np

from pgran.errors import InputError, log
from pgran.medium.base import BETA, Medium, check_size
from pgran.run.numbers import number

# Of what damps, by option.
LETTERS = {
    "lattice_damping": "beta", "damping_power": "p", "damping_mass": "alpha", "damping_loss": "eta",
}  # fmt: skip
FIELDS = ("damping", "damping_power", "damping_reference", "drag", "loss")


class Damped(Medium):
    """What follows from the `FIELDS` of a medium: beta, p, k_ref, alpha and eta.

    `drags` and `losses` are alpha of each unknown and eta k of each spring, None where there is
    none; `damped_springs` holds d of each spring.
    """

    def _check_dissipation(self, stiffness, tangential=()):
        """Set k_ref where it is not given; raise InputError where the law makes no dashpots."""
        for name in ("drag", "loss"):
            value = getattr(self, name)
            if np.ndim(value) == 0 and value is not None:
                check_size(f"damping: {name}", value)
        power, reference = self.damping_power, self.damping_reference
        power = 0.0 if power is None else number("-damping_power", power)
        if reference is not None:
            reference = number("damping_reference", reference)
        if not np.isfinite(power):
            raise InputError(f"-damping_power: must be finite, not {power}")
        if not power:
            reference = None
        elif reference is None:
            reference = float(np.abs(stiffness).mean())
        vars(self).update(damping_power=power, damping_reference=reference)
        if power:
            check_size("damping_reference", reference, positive=True)
            with np.errstate(all="ignore"):
                most = self.dashpot_law(np.append(stiffness, tangential)).max()
            if not np.isfinite(most * self.damping):
                raise InputError(
                    f"-damping_power {power:g}: (k / k_ref)^p is too large; take p nearer to 0"
                )

    def dashpot_law(self, elastic):
        """Return (|k| / k_ref)^p of springs of some stiffness."""
        if not self.damping_power:
            return np.ones(np.shape(elastic))
        size = np.abs(elastic)
        there = size > 0
        part = np.where(there, size, self.damping_reference) / self.damping_reference
        return np.where(there, part**self.damping_power, 0.0)

    @property
    def has_law(self):
        """Whether kappa of a spring is other than k + s beta d with the same d for all k."""
        return bool(self.damping_power) or self.losses is not None

    @property
    def dissipates(self):
        """Whether anything damps."""
        return self.damping > 0 or self.drags is not None or self.losses is not None

    @property
    def damping_unit(self):
        """What all of C is given in: beta, 1 where something else damps, 0 where nothing does."""
        return self.damping or float(self.dissipates)

    @property
    def dragged(self):
        """alpha m of all unknowns in units of `damping_unit`, 0 where there is no drag."""
        return 0.0 if self.drags is None else self.mass * self.drags / self.damping_unit

    @property
    def dashpots(self):
        """The parts of `damping_unit` of all springs' dashpots, shape (springs,)."""
        return self.damped_springs if self.damping else np.zeros(len(self.damped_springs))

    @cached_property
    def damping_norm(self):
        """No less than |C|_2, drag included, in units of `damping_unit`."""
        return (self.dashpot_norm if self.damping else 0.0) + np.max(self.dragged)

    @property
    def moduli(self):
        """k (1 + i eta) of all springs, real where there is no loss angle."""
        return self.constants if self.losses is None else self.constants + 1j * self.losses

    def kappa(self, s):
        """Return kappa(s) = k (1 + i eta) + s beta d of each spring."""
        return self.moduli + s * self.damping * self.damped_springs

    def stiffer(self, growth, s, springs=..., elastic=None):
        """Return how far kappa of some springs, of stiffness `elastic`, changes by its growth."""
        if not self.has_law:
            return growth
        elastic = self.springs.elastic[springs] if elastic is None else elastic
        eta = self.springs.loss_angles[springs]
        more = self.dashpot_law(elastic + growth) - self.dashpot_law(elastic)
        dashpots = self.springs.shares[springs] * more
        return growth * (1 + 1j * eta) + s * self.damping * dashpots

    def slope(self, s):
        """Return d kappa / d k by each spring's stiffness, shape (springs,)."""
        springs, power = self.springs, self.damping_power
        there = springs.elastic != 0
        ratio = np.divide(springs.damped, springs.elastic, out=0.0 * springs.elastic, where=there)
        return 1 + 1j * springs.loss_angles + s * self.damping * power * ratio

    def other_widths(self, vectors):
        """Return the widths that drag and loss angles give to motions, arrays over unknowns.

        f^T alpha f / |f|^2 and f^T L f / (m omega |f|^2), with omega^2 = f^T K f / (m |f|^2).
        """
        flat = vectors.reshape(len(vectors), self.size)
        width, squares = np.zeros(len(flat)), np.sum(flat**2, axis=1)
        if self.drags is not None:
            width += flat**2 @ self.drags / squares
        if self.losses is not None:
            stretched = (self.springs.B @ flat.T) ** 2
            size = self.mass * squares * np.maximum(self.constants @ stretched, 0.0)
            lost, there = self.losses @ stretched, size > 0  # not at rest, nor unstable
            width += np.divide(lost, np.sqrt(size), out=np.zeros_like(size), where=there)
        return width

    @property
    def damping_facts(self):
        """The least and largest beta, and p, alpha and eta if not 0, by these names."""
        values = self.damping, self.damping_power, self.drag, self.loss
        named = dict(zip(LETTERS.values(), values, strict=True))
        there = {name: value for name, value in named.items() if name == "beta" or np.any(value)}
        return {name: (np.min(value), np.max(value)) for name, value in there.items()}

    @property
    def law_in_words(self):
        """The same as text."""
        return ", ".join(
            f"{name} {low:g}" + (f" to {high:g}" if high > low else "")
            for name, (low, high) in self.damping_facts.items()
        )

    def undamped(self):
        """Return the medium without anything that damps."""
        return dataclasses.replace(self, damping=0.0, drag=0.0, loss=0.0)


def of_new(medium, balls=False):
    """Return the damping of contacts made anew, of balls too if asked; raise if the old differ."""
    names = ["dashpot", "tangential_dashpot", "loss"] + ["drag"] * balls
    found = {name: getattr(medium, name) for name in names}
    for name, values in found.items():
        if values is not None and np.ptp(values):
            what = "balls" if name == "drag" else "contacts"
            raise InputError(f"network: {name} differs, and is not known of {what} made anew")
    return {name: None if v is None else float(v[0]) for name, v in found.items()}


def warn_of_damping(network, option):
    """Warn where most modes are overdamped, or where the default damping is of another unit."""
    unit, contacts = network.mass * network.omega_mx, slice(network.bonds)
    with np.errstate(all="ignore"):
        rates = network.constants[contacts] / (network.damping * network.dashpots[contacts])
    # k / (beta omega_mx) of contacts; the median mode has half of it as its quality
    over = ": most modes are overdamped" * bool(np.median(np.abs(rates)) < network.omega_mx)
    if over or (network.damping == BETA and not 0.1 < unit < 10):
        log.warning(
            "the damping %g, in mass times frequency, is %.2g m omega_mx here%s; %s %.3g would be "
            "%g m omega_mx, the default where m and omega_mx are 1",
            network.damping, network.damping / unit, over, option, BETA * unit, BETA,
        )  # fmt: skip
