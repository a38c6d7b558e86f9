"""Amplitudes of a packing in which one ball after the other expands, and all find a new rest."""

import contextlib
import math
from functools import partial

import numpy as np

from pgran.experiments.sensitivity.adjoint import AdjointSweep
from pgran.experiments.sensitivity.growth import Packing
from pgran.experiments.sensitivity.record import OUTCOMES
from pgran.medium.springs import FREE
from pgran.run.agreement import on_root
from pgran.run.task import Task


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
