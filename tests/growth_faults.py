"""What is false of balls that grow in random packings: rest, amplitudes, derivatives by radii.

A packing after the growth is held against the equations of its rest, summed anew, and against the
rest near it with 64 bits or more of mantissa; amplitudes there, and derivatives, against as exact
dense solves, the derivatives forward: the packing's own response to the radius, and what all that
changes in S. Half of the cases are heard at a resonance of the packing that has grown.
"""

import dataclasses
import itertools
from types import SimpleNamespace

import numpy as np
from mpi4py import MPI
from packing_samples import pushes
from scipy.linalg import lu_factor, lu_solve
from sensitivity_samples import heated

import pgran
from pgran.balance.networks import contact_changes
from pgran.experiments.sensitivity.growth import LOST, Packing
from pgran.experiments.sensitivity.record import OUTCOMES
from pgran.run.crew import Crew

LONG, COMPLEX = np.longdouble, np.clongdouble


@dataclasses.dataclass(frozen=True)
class GrowthCase:
    """A packing, the ball that grows and by how much, and where and how that is heard.

    `units` are those of force and length; if `resonant`, the last frequency is that of a mode.
    """

    seed: int
    choices: dict
    others: dict
    units: tuple
    omegas: np.ndarray
    growth: float
    tolerance: float
    resonant: bool


def random_growth(seed):
    """A small packing of any kind between walls; the growth is in mean overlaps, of any sign."""
    rng = np.random.default_rng([29, seed])
    dimension = int(rng.integers(2, 4))
    push = {"pressure": 10 ** rng.uniform(-7, -2)}
    if rng.random() < 0.25:
        push = {"gravity": 10 ** rng.uniform(-4, -2)}
    choices = {
        "balls": int(rng.integers(32, 60) if dimension == 2 else rng.integers(70, 100)),
        "dimension": dimension, "law": ["harmonic", "hertz", 2.0, 1.2, 3.0][rng.integers(5)],
        "sizes": rng.uniform(0, 0.3), "walls": "x", "seed": seed,
    }  # fmt: skip
    others = {"damping": 10 ** rng.uniform(-6, 0)}
    others["displacement"] = str(rng.choice(["vector", "scalar"], p=[0.75, 0.25]))
    if others["displacement"] == "vector" and rng.random() < 0.3:
        others["damped"] = "normal"
    growth = rng.choice([-1.0, 1.0]) * 10 ** rng.uniform(-3, 0.3)
    omegas = np.sort(10 ** rng.uniform(-1.5, 0.2, 2))
    tolerance = 10 ** rng.uniform(-10, -2)
    units = 10 ** rng.uniform(-6, 6), 10 ** rng.uniform(-3, 1)
    resonant = bool(rng.random() < 0.5)
    return GrowthCase(seed, choices | push, others, units, omegas, growth, tolerance, resonant)


def in_units(network, force, length):
    """The same network, with the same frequencies, in other units of force and length."""
    stiff, factors = force / length, {"force": force, "gravity": length}
    factors |= dict.fromkeys(["stiffness", "masses", "damping", "kmax", "median_mass"], stiff)
    factors |= dict.fromkeys(["position", "radius", "distance", "box"], length)
    values = {name: getattr(network, name) for name in factors}
    scaled = {name: factors[name] * x for name, x in values.items() if x is not None}
    return dataclasses.replace(network, **scaled)


def growth_faults(case, seen):
    """Yield what is false of a heater of one ball; count what was `seen`."""
    rng = np.random.default_rng([30, case.seed])
    try:
        packed = pgran.pack(**case.choices)
    except pgran.PgranError:  # too few balls for their box, or too heavy ones
        seen["not packed"] += 1
        return
    others = dict(case.others)
    if others["displacement"] == "scalar":
        others["direction"] = None
    network = in_units(dataclasses.replace(packed, **others), *case.units)
    ball, detector = (int(rng.choice(network.free)) for _ in range(2))
    size, omegas = case.growth * network.overlap.mean(), case.omegas * network.omega_mx
    if network.radius.min() + size <= 0:  # refused
        return
    what = f"case {case.seed} ball {ball} growth {case.growth:.2g} detector {detector}"
    asked = {"radius": size, "balls": [ball], "error_tolerance": case.tolerance}
    grown = Packing(network).grown(ball, size)
    if case.resonant and grown.outcome != LOST:
        with Crew(MPI.COMM_SELF, 1) as crew:
            modes = pgran.find_modes(grown.network, crew, method="dense").omega
        omegas[1] = rng.choice(modes[modes > 1e-6 * modes.max()])
    found = heated(network, np.sort(omegas), [detector], **asked)
    seen["heaters"] += 1
    seen[found.outcome[0]] += 1
    if OUTCOMES[grown.outcome] != found.outcome[0]:
        yield f"OUTCOME {what}: {found.outcome[0]}, and then {OUTCOMES[grown.outcome]}"
    if grown.outcome == LOST:
        if np.isfinite(found.warmed).any() or np.isfinite(found.warmed_bound).any():
            yield f"LOST {what}: amplitudes are finite"
        return
    exact = long_rest(network, grown.network, ball, size)
    for fault in rest_faults(network, grown.network, exact, ball, size):
        yield f"REST {what}: {fault}"
    seen["rattlers"] += np.count_nonzero(grown.network.held != network.held)
    try:
        alike = pgran.equilibrate(network, grown.network.radius)
        if network.gravity is not None or any(contact_changes(alike, grown.network)):
            seen["other loads or contacts"] += 1
        elif not np.allclose(alike.force.sum(), grown.network.force.sum(), rtol=1e-9, atol=0):
            yield f"EQUILIBRATE {what}: other forces"
    except pgran.PgranError:
        seen["equilibrate found no rest"] += 1
    pairs = [{(*sorted(pair),) for pair in each.bond.tolist()} for each in (exact, grown.network)]
    forces, told = grown.network.force, np.isfinite(found.warmed_bound).any()
    if told and not forces.min() > 1e-11 * forces.mean():
        yield f"FORCES {what}: rounding decides on a contact"
    if told and pairs[0] != pairs[1]:
        yield f"CONTACTS {what}: {pairs[0] ^ pairs[1]}"
    for n, omega in enumerate(found.omega):
        after = Dense(exact, 1j * omega).amplitude(detector)
        before = Dense(network, 1j * omega)
        at = np.searchsorted(network.free, ball)
        for name, got, bound, right in (
            ("displacement", found.displacement[n, 0], found.error_bound[n, 0],
             before.amplitude(detector)),
            ("warmed", found.warmed[n, 0, 0], found.warmed_bound[n, 0, 0], after),
            ("by_radius", found.by_radius[n, 0, at], found.by_radius_bound[n, 0, at],
             before.derivative(ball, detector)),
        ):  # fmt: skip
            seen[name] += 1
            seen[f"{name} bounded"] += bool(np.isfinite(bound))
            seen[f"{name} to 1e-6"] += bool(bound <= 1e-6 * abs(right))
            if np.isfinite(bound) and not abs(COMPLEX(got) - right) <= bound:
                wrong = float(abs(COMPLEX(got) - right))
                yield f"BROKEN {name} {what} omega {omega:.6g}: {wrong} > {bound} of {abs(right)}"


def rest_faults(before, after, exact, ball, size):
    """What a packing at rest is not, or not as the exact one is, after a ball has grown."""
    totals = [pushes(network)[network.free] for network in (before, after)]
    left = np.linalg.norm(totals[1] - totals[0][np.isin(before.free, after.free)], axis=1)
    mean = after.force.mean()
    if not left.max() <= 3e-12 * mean:
        yield f"{left.max() / mean:.1e} of the mean force is left"
    if not np.array_equal(
        after.radius, before.radius + size * (np.arange(len(before.held)) == ball)
    ):
        yield "other radii"
    forces = np.zeros((2, len(before.held), len(before.held)))
    for force, network in zip(forces, (exact, after), strict=True):
        i, j = np.sort(network.bond, axis=1).T
        force[i, j] = network.force
    wrong = np.abs(forces[0] - forces[1]).max() / mean
    if not wrong <= 1e-9:
        yield f"a force is wrong by {wrong:.1e} of the mean one"


def long_rest(before, after, ball, size):
    """The rest near `after`, by Newton's method with long numbers on all pairs but of rattlers."""
    axes, known, carried = before.position.shape[1], before.bonds, after.held == before.held
    numbers = np.array([len(carried), 1])
    others = np.array([*itertools.combinations(range(len(carried)), 2)])
    others = others[~np.isin(others @ numbers, np.sort(before.bond, axis=1) @ numbers)]
    i, j = pairs = np.concatenate([before.bond, others]).T
    x, R, power = LONG(before.position), LONG(before.radius), LONG(before.power)
    periods = np.zeros(axes) if before.box is None else before.box
    apart = after.position[j] - after.position[i]
    turns = np.rint(apart / np.where(periods > 0, periods, np.inf))
    apart = R[i] + R[j] + R.mean() - np.linalg.norm(apart - turns * periods, axis=1)
    away = x[j] - x[i] - LONG(turns * periods)
    away[:known] = LONG(before.normal) * LONG(before.distance)[:, None]
    length, curved = np.sqrt(np.sum(away**2, axis=1)), (R[i] * R[j] / (R[i] + R[j])) ** (power - 1)
    h, c = R[i] + R[j] - length, curved.copy()
    h[:known] = power * LONG(before.force) / LONG(before.stiffness)
    c[:known] = LONG(before.force) / h[:known] ** power
    c[known:] *= np.median(c[:known] / curved[:known])
    load = {"bond": before.bond, "force": LONG(before.force), "position": x}
    load = pushes(SimpleNamespace(**load, normal=away[:known] / length[:known, None]))
    R[ball] += LONG(size)
    h += LONG(size) * (pairs == ball).any(axis=0)
    c *= (R[i] * R[j] / (R[i] + R[j])) ** (power - 1) / curved
    near = carried[pairs].all(axis=0) & (before.held[pairs] == 0).any(axis=0) & (apart > 0)
    pairs, away, length, h, c = pairs.T[near], away[near], length[near], h[near], c[near]
    u, free = LONG(after.position) - x, np.flatnonzero(np.repeat(after.held == 0, axes))
    values = {name: getattr(after, name) for name in ("masses", "held", "damping", "damped")}
    rest = SimpleNamespace(**values, position=x, axes=axes, direction=np.eye(axes)[0])
    for _ in range(9):
        v = away + u[pairs[:, 1]] - u[pairs[:, 0]]
        d = np.sqrt(np.sum(v**2, axis=1))
        overlap = h - (d - length)
        on = overlap > 0
        rest.bond, rest.normal, rest.distance = pairs[on], v[on] / d[on, None], d[on]
        rest.force, rest.bonds = c[on] * overlap[on] ** power, np.count_nonzero(on)
        rest.stiffness = power * rest.force / overlap[on]
        K, left = Dense(rest, 0.0).S.real[np.ix_(free, free)], (pushes(rest) - load).ravel()[free]
        step = np.zeros(u.size)
        step[free] = np.linalg.solve(K.astype(float), left.astype(float))
        u += step.reshape(u.shape)
    rest.axes, rest.direction = before.axes, before.direction
    return rest


class Dense:
    """S of all balls of a network, dense, with long numbers."""

    def __init__(self, network, s):
        """Sum it up contact by contact."""
        self.net, self.axes, self.damping = network, network.axes, COMPLEX(s * network.damping)
        self.k, self.F = LONG(network.stiffness), LONG(network.force)
        if self.axes > 1:
            n = LONG(network.normal)
            self.n, self.d = n / np.sqrt(np.sum(n * n, axis=1))[:, None], LONG(network.distance)
        self.S = self.summed(self.blocks())
        self.S += COMPLEX(s) ** 2 * np.diag(np.repeat(LONG(network.masses), self.axes))
        moved = np.zeros((len(network.held), self.axes), COMPLEX)
        moved[network.held == 2] = network.direction
        self.A = moved.ravel() + self.solved(self.S, -(self.S @ moved.ravel()))

    def blocks(self):
        """What each contact adds for each of its ends."""
        eye, (k, F) = np.eye(self.axes, dtype=LONG), (x[:, None, None] for x in (self.k, self.F))
        if self.axes == 1:
            return (k + self.damping) * eye
        along = self.n[:, :, None] * self.n[:, None]
        damped = along if self.net.damped == "normal" else eye
        return k * along - F / self.d[:, None, None] * (eye - along) + self.damping * damped

    def summed(self, blocks):
        """The sum over contacts of blocks b on the diagonal and -b beside it."""
        balls, (i, j) = len(self.net.held), self.net.bond.T
        K = np.zeros((balls, balls, self.axes, self.axes), COMPLEX)
        for end, other in ((i, j), (j, i)):
            np.add.at(K, (end, end), blocks)
            np.subtract.at(K, (end, other), blocks)
        return K.swapaxes(1, 2).reshape(balls * self.axes, -1)

    def solved(self, S, f):
        """The solution of S x = f for free balls, 0 for others, refined with long residuals."""
        free = np.flatnonzero(np.repeat(self.net.held == 0, self.axes))
        inside = S[np.ix_(free, free)]
        factors = lu_factor(inside.astype(complex))
        x = np.zeros(len(free), COMPLEX)
        for _ in range(12):
            x += lu_solve(factors, (f[free] - inside @ x).astype(complex))
        whole = np.zeros(len(S), COMPLEX)
        whole[free] = x
        return whole

    def amplitude(self, detector, field=None):
        """The field at a ball, along the drive."""
        field = self.A if field is None else field
        return field.reshape(-1, self.axes)[detector] @ self.net.direction

    def derivative(self, ball, detector):
        """The derivative by a ball's radius: all find their rest anew, and S changes with them."""
        net, R, (i, j) = self.net, LONG(self.net.radius), self.net.bond.T
        still = dataclasses.replace(net, displacement="vector", direction=None)
        still = Dense(still, 0.0)  # as balls move while they find their rest
        n, d, k, F = still.n, still.d, self.k, self.F
        grows = (net.bond == ball).any(axis=1) * LONG(1)
        other = np.where(i == ball, j, i)
        bent = grows * (net.power - 1) * R[other] / (R[ball] * (R[ball] + R[other]))  # d ln c
        load = np.zeros((len(net.held), still.axes), COMPLEX)
        for end, sign in ((i, -1), (j, 1)):
            np.add.at(load, end, sign * (k * grows + F * bent)[:, None] * n)
        w = still.solved(still.S, load.ravel()).real.reshape(load.shape)
        w = w[j] - w[i]
        dd = np.sum(n * w, axis=1)
        dn = (w - dd[:, None] * n) / d[:, None]
        dh = grows - dd
        dF = k * dh + F * bent
        dk = (net.power - 1) * k**2 * dh / (net.power * F) + k * bent
        across = dF / d - F * dd / d**2
        dk, across, kappa = (x[:, None, None] for x in (dk, across, k + F / d))
        changes = dk * np.ones((1, 1))
        if self.axes > 1:
            along, turned = (x[:, :, None] * n[:, None] for x in (n, dn))
            kappa = kappa + (self.damping if net.damped == "normal" else 0.0)
            changes = dk * along - across * (np.eye(still.axes, dtype=LONG) - along)
            changes = changes + kappa * (turned + turned.swapaxes(1, 2))
        dA = self.solved(self.S, -(self.summed(changes) @ self.A))
        return self.amplitude(detector, dA)
