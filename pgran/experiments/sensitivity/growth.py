"""A ball of a packing grows, and the packing finds its new rest: which contacts bear what then.

Contacts open and close, stiffnesses, forces, normals and distances change. What the forces of a
network leave unbalanced, as gravity does, or rounding, is a load that stays as it is. Balls grow in
steps of at most half an overlap, so that the packing follows one path. Where contacts have changed
it is shrunk again, at once, and if that leads elsewhere, by the steps by which it was grown: if it
does not return to where it was, it has been rearranged, and what it does then depends on how it was
grown. NumPy and SciPy only.
"""

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from pgran.balance.motion import pair_numbers
from pgran.balance.networks import GROWTH, balls_of, contact_changes, grown, law_of, network_of
from pgran.errors import InputError, PgranError, log
from pgran.experiments.sensitivity.gradient import fields_of, systems_of
from pgran.experiments.sensitivity.radii import Radii, with_vectors
from pgran.experiments.sensitivity.record import OUTCOMES
from pgran.medium.base import EPSILON
from pgran.medium.dissipation import of_new
from pgran.medium.network import Network
from pgran.medium.packing import total_forces
from pgran.medium.springs import AT_REST, FREE, norm_of
from pgran.run.agreement import on_root
from pgran.run.task import Task

SMOOTH, CHANGED, REARRANGED, LOST = range(len(OUTCOMES))
UNBALANCED = 1e-3  # of the mean force: what is said of a network
ASTRAY = 1e-3  # of an overlap: how far contacts may stray from their rest
RETURNED = 1e-6  # of the mean overlap: how far overlaps may be from where they were


def ways_to_rest(medium, relax):
    """Return whether a packing finds its rest anew around a ball that grows, and knows its law.

    `relax` as in `heat`. Raises an InputError where it should relax and cannot.
    """
    if not isinstance(medium, Network):
        raise InputError("-heat_radius, -heat_kelvin: only for a network whose balls have radii")
    try:
        _check_law(medium)
    except InputError:
        if relax:
            raise
        return False, False
    if relax is False:
        return False, True
    try:
        of_new(medium)
    except InputError as error:
        raise InputError(f"{error}; -heat_relax false keeps neighbours in place") from None
    return True, True


def _check_law(network):
    """Raise an InputError where the network does not say what larger radii do to it."""
    if network.turns:
        raise InputError(
            "-heat_relax: the rest of balls that turn depends on their past; take -heat_relax false"
        )
    law_of(with_vectors(network))
    pulling = np.flatnonzero(network.force <= 0)
    if len(pulling):
        raise InputError(f"-heat_relax: contact {pulling[0]} bears no repulsive force")


class GrowthTask(Task):
    """The steady states of a network after each of some balls has grown, ball after ball.

    `balls` are their numbers, `growth` that of their radii; frequencies and `sites` as in
    `FrequencySweep`.
    """

    items = "warm balls"

    def __init__(self, network, balls, growth, omegas, sites, error_tolerance):
        self.packing, self.omegas, self.sites = Packing(network), omegas, sites
        self.balls, self.growth, self.error_tolerance = balls, growth, error_tolerance
        self.units = range(len(balls))
        amplitudes = len(omegas), len(sites)
        self.row = np.dtype(
            [
                ("warmed", complex, amplitudes), ("warmed_bound", float, amplitudes),
                ("opened", int), ("closed", int), ("balance", float), ("outcome", int),
            ]
        )  # fmt: skip

    def work(self, unit, group):
        """See `Task`."""
        row, ball, growth = np.zeros(1, self.row), int(self.balls[unit]), float(self.growth[unit])
        found = on_root(group, lambda: self.packing.grown(ball, growth))
        for name in ("outcome", "opened", "closed", "balance"):
            row[name] = getattr(found, name)
        row["warmed"], row["warmed_bound"] = math.nan, math.inf
        if found.network is not None:
            row["warmed"], row["warmed_bound"] = self._amplitudes(found, group)
        return row

    def _amplitudes(self, found, group):
        """Return the amplitudes at all detectors and frequencies, and bounds. Collective.

        A detector without contacts is at rest.
        """
        from pgran.driven.operators import Operators
        from pgran.driven.steady import SteadySolver

        there = found.network.held[self.sites[:, 0]] == FREE
        amplitudes = np.zeros((len(self.omegas), len(there)), complex)
        bounds = np.zeros(amplitudes.shape)
        if not there.any():
            return amplitudes, bounds
        (scaled, unit), (forces, *lengths) = found.network.in_own_unit(), found.left
        unrest = Unrest(scaled, forces / unit, *lengths)
        choices = {"error_tolerance": self.error_tolerance, "whole_field": True}
        with (
            Operators(scaled, group) as operators,
            SteadySolver(operators, self.sites[there], **choices) as solver,
        ):
            for number, omega in enumerate(self.omegas):
                state = solver.solve(1j * omega)
                amplitudes[number, there] = state.displacement
                bounds[number, there] = np.nan_to_num(state.error_bound, nan=np.inf)
                if not np.isfinite(state.error_bound).any():
                    continue
                systems, errors = systems_of(solver, state.field_bound)
                fields, inverse_norm = fields_of(solver, systems), solver.bounds.inverse_norm
                if fields is not None:
                    s = operators.s
                    bounds[number, there] += unrest.missed(s, fields, errors, inverse_norm)
        return amplitudes, bounds

    def collect(self, rows, seconds):
        """Return what becomes of the balls, by the names of `Heat`'s arrays; see `Task`."""
        turned = {name: np.moveaxis(rows[name], 0, -1).copy() for name in self.row.names}
        turned["outcome"] = np.array(OUTCOMES)[turned["outcome"]]
        return turned


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
    """A network as balls at rest under its contact law, which is known: see `ways_to_rest`."""

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
        opened, closed = contact_changes(self.network, network)
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
        if any(contact_changes(self.network, network)):
            return False
        here, there = (
            one.overlap[np.argsort(pair_numbers(one.bond, len(one.held)))]
            for one in (self.network, network)
        )
        return bool(np.abs(here - there).max() <= RETURNED * here.mean())


class Unrest:
    """How near a packing, in its own unit, is to a rest, and what that does to amplitudes.

    Balance leaves forces, and rounds: `pgran manual sensitivity` has the inequalities. `left` (free
    balls,) bounds the forces left, `blurred` (contacts,) what rounds in overlaps, `gap` is the
    narrowest one. The balls of contacts are off by `moved`, `pressed` along normals.
    """

    def __init__(self, network, left, blurred, gap):
        from pgran.driven.counting import least_stiffness

        self.seen, weights = Radii(network, relax=False), network.weights[:: network.components]
        floats, held = int(not network.held[network.bond].any()), network.held.copy()
        held[network.free[:floats]] = AT_REST  # forces add up to nothing: the others balance it
        fixed = dataclasses.replace(with_vectors(network), held=held, push=None)
        least, d = least_stiffness(fixed), network.distance
        reach = 2.1 * np.linalg.norm((weights * left)[floats:]) / least if least else np.inf
        self.moved = self.seen.lengths * reach
        pressed = np.sqrt((least + self._norm(network.force / d)) / network.stiffness) * reach
        self.pressed = pressed + self.moved**2 / d + blurred
        near = np.all(self.pressed <= ASTRAY * network.overlap) and 2 * weights.max() * reach < gap
        self.is_near = near and 2 * self._norm(self._changes(0.0)) <= least

    def missed(self, s, fields, errors, inverse_norm):
        """Return what that does to amplitudes at detectors (nd,), at most; infinite: not known.

        `fields` and `errors` are as in `Radii.derivatives`; |S^-1| is at most `inverse_norm`.
        """
        changes, seen = self._changes(s), self.seen
        eta = self._norm(changes)
        if not self.is_near or not eta * inverse_norm < 1:
            return np.full(len(fields) - 1, np.inf)
        squares = np.sum(np.abs(seen.parted(fields)) ** 2, axis=2)
        norms = np.sqrt(squares @ changes) + np.sqrt(eta) * errors
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
