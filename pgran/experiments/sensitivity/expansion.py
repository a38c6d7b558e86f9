"""Amplitudes of a packing in which one ball after the other expands, and all find a new rest."""

import contextlib
import math
from functools import partial

import numpy as np

from pgran.experiments.sensitivity.growth import LOST, OUTCOMES, Packing
from pgran.medium.springs import FREE
from pgran.run.agreement import on_root
from pgran.run.experiment import Caution
from pgran.run.task import Task
from pgran.store.estimate import counted

LARGE = 0.3  # of the mean overlap: growth beyond which packings rearrange


class ExpansionTask(Task):
    """The steady states of a network after each of some balls has grown, ball after ball.

    `balls` are their numbers, `growth` that of their radii; frequencies and `sites` as in
    `FrequencySweep`.
    """

    items = "warm balls"

    def __init__(self, network, omegas, sites, balls, growth, error_tolerance):
        """Take a ball for a unit."""
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
        network, *facts = on_root(group, lambda: self.packing.grown(ball, growth))
        for name, value in zip(("outcome", "opened", "closed", "balance"), facts, strict=True):
            rows[name] = value
        rows["warmed"], rows["warmed_bound"] = math.nan, math.inf
        if network is not None:
            rows["warmed"], rows["warmed_bound"] = self._amplitudes(network, group)
        return rows

    def _amplitudes(self, network, group):
        """Return the amplitudes at all detectors and frequencies, and bounds. Collective.

        A detector without contacts is at rest.
        """
        from pgran.driven.operators import Operators
        from pgran.driven.steady import SteadySolver

        there = network.held[self.sites[:, 0]] == FREE
        amplitudes = np.zeros((len(self.omegas), len(there)), complex)
        bounds = np.zeros(amplitudes.shape)
        if not there.any():
            return amplitudes, bounds
        sites = self.sites[there]
        with (
            Operators(network.in_own_unit()[0], group) as operators,
            SteadySolver(operators, sites, self.error_tolerance) as solver,
        ):
            for number, omega in enumerate(self.omegas):
                state = solver.solve(1j * omega)
                amplitudes[number, there] = state.displacement
                bounds[number, there] = np.nan_to_num(state.error_bound, nan=np.inf)
        return amplitudes, bounds

    def collect(self, rows, seconds):
        """Return what becomes of the balls, by the names of `Heat`'s arrays; see `Task`."""
        turned = {name: np.moveaxis(rows[name], 0, -1).copy() for name in self.row.names}
        turned["outcome"] = np.array(OUTCOMES)[turned["outcome"]]
        return turned


def told_of_growth(heat):
    """Return in words by how much balls have grown, and what packings did."""
    if heat.growth is None:
        return
    if heat.lost:
        lost = f"{heat.lost} of {len(heat.ball)} packings found no rest"
        yield Caution(f"{lost}: their amplitudes are NaN")
    by = f"{np.abs(heat.growth).max(initial=0.0):.4g}"
    if heat.growth_overlap is not None:
        large, least = np.abs(heat.growth_overlap).max(initial=0.0), np.abs(heat.growth_least)
        if large > LARGE:
            yield Caution(
                f"radii grow by {large:.3g} of the mean overlap: beyond {LARGE:g} packings "
                "rearrange, and derivatives by radii say little of what happens"
            )
        by += (
            f", {large:.3g} of the mean overlap, {np.median(least):.3g} (median) to "
            f"{least.max():.3g} of their own smallest one"
        )
    if heat.by_radius_bound is not None and np.isinf(heat.by_radius_bound).any():
        yield Caution(
            "derivatives by radii without bounds: that the packing is stable is not certain"
        )
    rest = "packings at a new rest" if heat.relaxed else "neighbours frozen"
    yield f"radii of warm balls grow by up to {by}; {rest}"
    if heat.relaxed and np.any(there := heat.outcome != OUTCOMES[LOST]):
        outcomes = [f"{np.count_nonzero(heat.outcome == what)} {what}" for what in OUTCOMES[:LOST]]
        opened, closed = (f"{x[there].mean():.3g}" for x in (heat.opened, heat.closed))
        yield (
            f"{counted(len(heat.ball), 'packing')}: {', '.join(outcomes)}; in the mean {opened} "
            f"contacts opened, {closed} closed"
        )
