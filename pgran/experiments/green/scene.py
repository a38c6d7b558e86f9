"""Scene `green`: how far a unit force on one ball moves another, and local densities of states."""

import time

import numpy as np
from numpy.typing import ArrayLike

from pgran.driven.amplitudes import below_relative_accuracy, is_accurate
from pgran.driven.drive import STEADY, reached_accuracy, work_of
from pgran.driven.sweeps import METHOD, PatternSweep, carry_out_sweep
from pgran.experiments.green.record import Green
from pgran.medium.base import ALONG, EPSILON, Medium, medium, warn_above_modes
from pgran.run.agreement import agreeing, on_root
from pgran.run.crew import Crew
from pgran.run.experiment import (
    PROGRESS,
    Asked,
    Caution,
    Scene,
    in_parallel,
    option,
    options_of,
    run_of,
)
from pgran.run.frequencies import SWEEP, check_sweep
from pgran.run.machine import check_memory
from pgran.run.options import INTEGERS, Option
from pgran.store.estimate import counted
from pgran.store.record import ball_names, columns_of, row_of

GOOD, MISSED = 1, 0  # reasons of frequencies
BYTES = 200  # of an unknown under each pattern, while a frequency is solved
BALLS = {"kind": INTEGERS, "low": 0, "high": 2**63 - 1}
SOURCES = Option(
    "green_sources", default=(8, 10), meaning="balls that are pushed, indices from 0", **BALLS
)


@in_parallel(
    "green", shares_lattice=True, lattice=medium, omegas=SWEEP,
    sources=Asked((SOURCES,), SOURCES.of_run),
    receivers=lambda balls: balls,  # rows or flat, which the lattice checks
    direction=lambda direction: direction,  # in words or components, as `along` has it
)  # fmt: skip
def green(
    lattice: Medium,
    omegas: "ArrayLike",
    sources: "ArrayLike",
    receivers: "ArrayLike | None" = option(
        None, "balls that are heard; by default those pushed", **BALLS
    ),
    crew: Crew | None = None,
    *,
    direction: "str | ArrayLike" = option(
        "drive", f"of networks with vectors: how balls are pushed and heard: {ALONG}"
    ),
    method: str = METHOD,
    error_tolerance: float = STEADY["error_tolerance"],
    error_floor: float = STEADY["error_floor"],
    progress: str = PROGRESS,
) -> Green:
    """Solve for the displacements of balls under a unit force on one of them.

    The matrix G = e_d^T S^-1 e_p of all pairs is symmetric. Its diagonal gives local densities of
    states, -(2 omega m / pi) Im G_pp, whose integrals over all frequencies are 1, and the power
    that the force puts in, -omega Im G_pp / 2 (E. N. Economou, Green's Functions in Quantum
    Physics). Nothing else is driven.

    Parameters
    ----------
    direction : str or array_like of float, shape (axes,)
        Of networks with vectors: of all forces and displacements; `drive`, `x`, `y`, `z`, or
        components.

    Examples
    --------
    >>> lattice = pgran.Lattice.random((6, 5), seed=1)
    >>> found = pgran.green(lattice, [0.3], sources=[(2, 2), (4, 1)])
    >>> bool(abs(found.green[0, 0, 1] / found.green[0, 1, 0] - 1) < 1e-12)
    True
    """
    started = time.perf_counter()
    with agreeing(crew.world):
        receivers = sources if receivers is None else receivers
        choices = {"error_tolerance": error_tolerance, "error_floor": error_floor}
        task = GreenSweep(lattice, omegas, sources, receivers, direction, choices)
    warn_above_modes(lattice, crew.world, omegas[0])
    rows, moments = carry_out_sweep(task, method, crew, progress)
    seconds = time.perf_counter() - started
    return on_root(crew.world, lambda: task.record(rows, moments, seconds), keep=True)


class GreenSweep(PatternSweep):
    """Green's functions at each frequency, in the lattice's own unit."""

    by = "-green_method"

    def __init__(self, lattice, omegas, sources, receivers, direction, choices):
        sources = lattice.sites(sources, "green_sources")
        self.balls = lattice.sites(receivers, "green_receivers")
        own, heard = len(sources), len(self.balls)
        row = row_of(Green, receiver_number=(heard,), source_number=(own,))
        row += [("own", complex, (own,)), ("own_bound", float, (own,))]
        check_memory("green_sources", BYTES * lattice.size * (own + heard))
        super().__init__(lattice, omegas, sources, row, choices)
        self.direction = lattice.along(direction, "green_direction")
        self.sources, self.receivers = self._forces(sources), self._forces(self.balls)
        if not np.array_equal(self.sites, self.balls):  # what is pushed is heard, too
            self.receivers = np.concatenate([self.receivers, self.sources])

    def _forces(self, sites):
        """Return unit forces on balls as patterns of mass-weighted unknowns, (n, unknowns)."""
        unknowns, _ = self.scaled.readings(sites)
        force = np.zeros((len(sites), self.scaled.size))
        force[np.arange(len(sites))[:, None], unknowns] = self.direction
        fields = self.scaled.displacements(force.reshape(-1, *self.scaled.shape))
        return fields.reshape(force.shape)

    def keep(self, point, solver):
        """See `PatternSweep`."""
        heard = len(self.balls)
        values, bounds = solver.products(self.receivers, self.sources)
        point["green"], point["error_bound"] = values[:heard], bounds[:heard]
        for name, found in (("own", values), ("own_bound", bounds)):
            point[name] = np.diagonal(found[-len(self.sources) :])
        good = is_accurate(bounds, values, solver.tolerance)
        good |= bounds <= self.choices["error_floor"] / abs(self.scaled.kmax)
        point["converged_reason"] = GOOD if np.all(good) else MISSED

    def record(self, rows, moments, seconds):
        """Return the record of the rows."""
        columns, scaled = columns_of(Green, rows), self.scaled
        G, bound = columns["green"], columns["error_bound"]
        at_floor = below_relative_accuracy(bound, G, self.choices["error_tolerance"])
        at_floor[columns["converged_reason"] <= 0] = 0
        G /= self.unit
        bound /= self.unit
        ratio = np.broadcast_to(scaled.inertia_ratio, scaled.free_balls)
        mass = scaled.mass / ratio[scaled.numbers_of(self.sites)]
        factor = 2 / np.pi * self.omegas[:, None] * mass
        density = -factor * rows["own"].imag
        return Green(
            **columns,
            factorizations=int(rows["factorizations"].sum()),
            solve_seconds=seconds,
            moments=moments,
            omega=self.omegas,
            direction=self.direction,
            source=self.sites,
            receiver=self.balls,
            mass=self.unit * mass,
            at_floor=at_floor,
            local_density=density,
            local_density_bound=factor * rows["own_bound"] + 8 * EPSILON * np.abs(density),
        )


def summary(result):
    """Yield in words what a run found."""
    record, good = result.green, result.green.converged_reason > 0
    nw, omega, density = len(record.omega), record.omega, record.local_density
    pairs = counted(record.green[0].size, "pair")
    yield f"{counted(nw, 'frequency')} with {work_of(record)}: {pairs} of balls"
    if record.failures:
        failed = f"{record.failures} of {nw} frequencies"
        yield Caution(f"{failed} failed or missed the accuracy asked for")
    yield from reached_accuracy(record, good)
    # without damping densities are lines at the modes
    whole = nw > 1 and good.all() and result.medium.built.dissipates
    for p, ball in enumerate(ball_names(record.source) if whole else []):
        integral = np.diff(omega) @ (density[1:, p] + density[:-1, p]) / 2
        yield (
            f"{ball}: its local density of states, joined by straight lines, integrates to "
            f"{integral:.4g} from {omega[0]:.6g} to {omega[-1]:.6g}; over all frequencies to 1"
        )


SCENE = Scene(options_of(green), run_of(green), summary, check_sweep, shares_lattice=True)
