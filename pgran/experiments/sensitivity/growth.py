"""A ball of a packing grows, and the packing finds its new rest: which contacts bear what then.

Contacts open and close, stiffnesses, forces, normals and distances change. What the forces of a
network leave unbalanced, as gravity does, or rounding, is a load that stays as it is. Balls grow in
steps of at most half an overlap, so that the packing follows one path. Where contacts have changed
it is shrunk again, at once, and if that leads elsewhere, by the steps by which it was grown: if it
does not return to where it was, it has been rearranged, and what it does then depends on how it was
grown. NumPy and SciPy only.
"""

import contextlib
import dataclasses
import logging
import math
from functools import partial
from typing import NamedTuple

import numpy as np

from pgran.balance.motion import pair_numbers
from pgran.balance.networks import GROWTH, balls_of, changed_contacts, grown, network_of
from pgran.errors import PgranError
from pgran.experiments.sensitivity.adjoint import AdjointSweep
from pgran.experiments.sensitivity.record import OUTCOMES
from pgran.experiments.sensitivity.warmth import with_vectors
from pgran.medium.network import Network
from pgran.medium.packing import total_forces
from pgran.medium.rounding import EPSILON
from pgran.medium.springs import FREE
from pgran.run.agreement import on_root
from pgran.run.task import Task

log = logging.getLogger("pgran")
SMOOTH, CHANGED, REARRANGED, LOST = range(len(OUTCOMES))
UNBALANCED = 1e-3  # of the mean force: what is said of a network
RETURNED = 1e-6  # of the mean overlap: how far overlaps may be from where they were


class Grown(NamedTuple):
    """A packing after a ball has grown.

    `network` is None where the balls found no rest; `opened` and `closed` count contacts, `balance`
    is the largest force left on a ball, in units of the mean one. `left` is what `Unrest` takes.
    """

    network: Network | None
    outcome: int
    opened: int = 0
    closed: int = 0
    balance: float = math.nan
    left: tuple = ()


class Packing:
    """A network as balls at rest under its contact law, which `warmth.check_law` has seen."""

    def __init__(self, network):
        self.network, packing = network, with_vectors(network)
        balls, self.contacts = balls_of(packing)
        pushes = network.force[:, None] * packing.normal
        load = -total_forces(network.bond, pushes, len(network.held))
        self.balls = dataclasses.replace(balls, load=load)
        left = np.linalg.norm((load - balls.load)[network.free], axis=1)
        self.unbalanced = float(left.max() / network.force.mean())

    def warn(self):
        """Warn where the network is no packing at rest under its contact law alone."""
        if self.unbalanced > UNBALANCED:
            log.warning(
                "the forces of the network leave %.1e of the mean one unbalanced, which is taken "
                "as a load that stays while balls grow; pgran.equilibrate finds a rest without it",
                self.unbalanced,
            )

    def grown(self, ball, growth):
        """Return the packing at rest after a ball's radius has grown by so much."""
        radius, contacts = self.balls.radius.copy(), self.contacts
        radius[ball] += growth
        rounded = growth - (radius[ball] - self.balls.radius[ball])
        overlap = contacts.overlap + rounded * np.any(contacts.pairs == ball, axis=1)
        try:
            rest = grown(self.balls, dataclasses.replace(contacts, overlap=overlap), radius)
        except PgranError:  # no rest, or too narrow a box
            return Grown(None, LOST)
        network = network_of(rest, self.network)
        opened, closed = changed_contacts(self.network, network)
        outcome = SMOOTH
        if opened or closed:
            returns = any(self._is_reached_from(rest, step) for step in (math.inf, GROWTH))
            outcome = CHANGED if returns else REARRANGED
        left = self._left(rest, network, abs(growth))
        return Grown(network, outcome, opened, closed, rest.residual, left)

    def _left(self, rest, network, growth):
        """Return what `Unrest` takes: forces left, rounding of overlaps, the narrowest gap.

        Overlaps are summed up step by step, those of contacts that have closed from positions.
        """
        position, both, size = rest.balls.position, (network, self.network), len(network.held)
        closed = ~np.isin(*(pair_numbers(one.bond, size) for one in both))
        moved = 4 * np.abs(position - self.balls.position).max() + growth
        blurred = network.overlap + moved + 2 * closed * np.ptp(position, axis=0).max()
        blurred *= 4 * EPSILON * (2 + growth / self.network.overlap.mean())
        forces = np.concatenate([one.force for one in both]) * 8 * EPSILON
        forces[: network.bonds] += network.stiffness * blurred
        left = total_forces(network.bond, network.force[:, None] * network.normal, size)
        left = np.linalg.norm(left + self.balls.load, axis=1)
        ends = np.concatenate([one.bond.ravel() for one in both])
        left += np.bincount(ends, np.repeat(forces, 2), size)
        overlap, known = rest.contacts.overlap, np.isin(rest.contacts.pairs, network.bond)
        gap = -overlap[(overlap <= 0) & known.all(axis=1)].max(initial=-network.radius.min())
        return left[network.free], blurred, 0.0 if rest.undecided else gap

    def _is_reached_from(self, rest, step):
        """Return whether balls shrink back to where they were: who touches, and overlaps."""
        try:
            back = grown(rest.balls, rest.contacts, self.balls.radius, step)
        except PgranError:
            return False
        network = network_of(back, self.network)
        if any(changed_contacts(self.network, network)):
            return False
        orders = [np.argsort(pair_numbers(x.bond, len(x.held))) for x in (self.network, network)]
        here, there = self.network.overlap[orders[0]], network.overlap[orders[1]]
        return bool(np.abs(here - there).max() <= RETURNED * here.mean())


class ExpansionTask(Task):
    """The steady states of a network after each of some balls has grown, ball after ball.

    `balls` are their numbers, `growth` that of their radii; frequencies and `sites` as in
    `FrequencySweep`.
    """

    items = "warm balls"

    def __init__(self, network, omegas, sites, balls, growth, error_tolerance):
        self.packing, self.omegas, self.sites = Packing(network), omegas, sites
        self.balls, self.growth, self.error_tolerance = balls, growth, error_tolerance
        self.units = [range(n, n + 1) for n in range(len(balls))]
        amplitudes, count = (len(omegas), len(sites)), np.int64
        self.row = np.dtype(
            [
                ("warmed", complex, amplitudes), ("warmed_bound", float, amplitudes),
                ("opened", count), ("closed", count), ("balance", float), ("outcome", count),
            ]
        )  # fmt: skip

    @contextlib.contextmanager
    def open(self, group):
        """See `Task`."""
        yield partial(self._work, group)

    def _work(self, group, unit):
        """Return the row of one ball. Collective over a group."""
        rows, (number,) = np.zeros(1, self.row), unit
        ball, growth = int(self.balls[number]), float(self.growth[number])
        network, *facts, left = on_root(group, lambda: self.packing.grown(ball, growth))
        for name, value in zip(("outcome", "opened", "closed", "balance"), facts, strict=True):
            rows[name] = value
        rows["warmed"], rows["warmed_bound"] = math.nan, math.inf
        if network is not None:
            rows["warmed"], rows["warmed_bound"] = self._amplitudes(network, left, group)
        return rows

    def _amplitudes(self, network, left, group):
        """Return the amplitudes at all detectors and frequencies, and bounds. Collective.

        A detector without contacts is at rest.
        """
        from pgran.driven.operators import Operators
        from pgran.driven.steady import SteadySolver
        from pgran.experiments.sensitivity.unrest import Unrest

        there = network.held[self.sites[:, 0]] == FREE
        amplitudes = np.zeros((len(self.omegas), len(there)), complex)
        bounds = np.zeros(amplitudes.shape)
        if not there.any():
            return amplitudes, bounds
        sites, (scaled, unit), (forces, *lengths) = self.sites[there], network.in_own_unit(), left
        unrest = Unrest(scaled, forces / unit, *lengths)
        with (
            Operators(scaled, group) as operators,
            SteadySolver(operators, sites, self.error_tolerance, whole_field=True) as solver,
        ):
            for number, omega in enumerate(self.omegas):
                state = solver.solve(1j * omega)
                amplitudes[number, there] = state.displacement
                bounds[number, there] = np.nan_to_num(state.error_bound, nan=np.inf)
                if not np.isfinite(state.error_bound).any():
                    continue
                systems, errors = AdjointSweep.systems(state._asdict(), solver)
                fields = operators.layout.gathered([x.solution for x in systems])
                if fields is not None:  # on the first rank of the group
                    found = fields.reshape(len(systems), -1), errors, solver.bounds.inverse_norm
                    bounds[number, there] += unrest.missed(operators.s, *found)
        return amplitudes, bounds

    def collect(self, rows, seconds):
        """Return what becomes of the balls, by the names of `Heat`'s arrays; see `Task`."""
        turned = {name: np.moveaxis(rows[name], 0, -1).copy() for name in self.row.names}
        turned["outcome"] = np.array(OUTCOMES)[turned["outcome"]]
        return turned
