"""What a warm ball, or a cut bond, does to a signal while its neighbours stay in place."""

import dataclasses
from typing import NamedTuple

import numpy as np

from pgran.errors import InputError
from pgran.experiments.sensitivity import finite
from pgran.experiments.sensitivity.gradient import MISSED, AdjointSweep, fields_of, systems_of
from pgran.experiments.sensitivity.record import OUTCOMES, Heat
from pgran.medium.base import EPSILON
from pgran.run.experiment import Caution
from pgran.store.estimate import counted
from pgran.store.record import ball_names, columns_of

QUARTER = 0.25  # of the amplitude: what the heater of the experiment changed
LARGE_GROWTH = 0.3  # of the mean overlap: beyond it packings rearrange
SEED = 1993  # of the balls that are drawn


def check_solver(lattice, crew):
    """Raise where the solvers that options choose cannot say what a change does."""
    from pgran.driven.linear import is_factored

    if not is_factored():
        raise InputError("-heat_*: needs a factorization (-steady_pc_type cholesky or lu)")
    if not lattice.dissipates and crew.group.size > 1:
        raise InputError(
            "-heat_*: no error bounds are known of an undamped lattice that ranks share; "
            "-ranks_per_lattice 1 gives them"
        )


def with_heard(record):
    """Return a record with the shares of balls whose change is a quarter or more, for certain."""
    before, bound = record.displacement[..., None], record.error_bound[..., None]
    with np.errstate(invalid="ignore"):
        change = np.abs(record.warmed - before) - record.warmed_bound - bound
        # by a quarter of what the amplitude may be at most
        share = np.mean(change >= QUARTER * (np.abs(before) + bound), axis=-1)
    share[record.converged_reason <= 0] = np.nan
    return dataclasses.replace(record, heard=share)


class Heater(NamedTuple):
    """What is done to a warm ball: one of these; see the keywords of `heat`."""

    factor: float | None
    overlap: float | None
    radius: float | None
    kelvin: float | None
    expansion: float
    hertz: float

    @property
    def grows(self):
        """Whether radii grow."""
        return self.radius is not None or self.kelvin is not None

    def balls(self, medium, balls, samples):
        """Return the places among the free balls of those that are warmed, which increase.

        All, unless balls are given, or how many to draw: the same whatever is done to them.
        """
        ways = self.factor, self.overlap, self.radius, self.kelvin
        count = medium.free_balls if any(way is not None for way in ways) else 0
        if balls is not None:
            return np.unique(medium.numbers_of(medium.sites(balls, "-heat_balls")))
        if samples is not None and samples > count:
            raise InputError(f"-heat_samples {samples}: there are only {count} balls to warm")
        return np.sort(np.random.default_rng(SEED).permutation(count)[:samples])

    def growth(self, network):
        """Return by how much the radius of each ball grows if it is warm."""
        if network.radius is None and self.kelvin is not None:
            raise InputError("-heat_kelvin: balls expand by parts of radii, which are not known")
        if self.radius is None:
            growth = self.expansion * self.kelvin * network.radius
        else:
            growth = np.full(len(network.held), self.radius)
        if network.radius is not None and np.any(network.radius + growth <= 0):
            raise InputError("-heat_radius, -heat_kelvin: a ball would have no radius left")
        return growth

    def changes(self, medium, warm):
        """Return what `finite.changes` does of some free balls by their places."""
        contacts = finite.contacts_of(medium, warm)
        if self.factor is not None:
            growth = (self.factor - 1) * medium.springs.elastic.reshape(-1, medium.bonds)
            growth = growth[:, contacts]
        elif self.overlap is not None:
            growth = finite.stiffer_by_overlap(medium, self.overlap, self.hertz)[:, contacts]
        else:  # a contact overlaps by more as the radius of the ball that is warm says
            radii = self.growth(medium)
            by_end = [
                finite.stiffer_by_overlap(medium, radii[end], self.hertz)[:, contacts]
                for end in medium.bond.T
            ]
            is_first = medium.bond[contacts, 0] == medium.ball_numbers[warm][:, None]
            growth = np.where(is_first, *by_end)
        return finite.changes(medium, contacts, growth)


class HeatSweep(AdjointSweep):
    """The amplitudes after changes that leave all other balls in place, frequency by frequency.

    The free balls at the places `warm` are warmed; `relax` as in `heat`.
    """

    def __init__(self, lattice, omegas, detectors, heater, relax, warm, cut, error_tolerance):
        self.heater, self.balls = heater, lattice.ball_numbers[warm]
        # radii have derivatives where the contact law is known, neighbours frozen or not
        self.relaxed = self.differentiated = False
        if heater.grows:
            from pgran.experiments.sensitivity.growth import ways_to_rest

            self.relaxed, self.differentiated = ways_to_rest(lattice, relax)
        groups = {}  # groups[kind][n]: the springs that change n changes
        if len(warm):
            kind = "frozen" if self.relaxed else "warmed"
            groups[kind], self.delta = heater.changes(lattice, warm)
        if cut:
            groups["cut"], _ = finite.cuts(lattice, 1j)
        self.groups = {name: springs for name, springs in groups.items() if len(springs)}
        self.computed = [*self.groups, *["by_radius"] * self.differentiated]
        missing = {"warmed", "frozen", "cut", "by_radius"} - {*self.computed}
        lengths = {"ball": (len(self.balls),), "ball_number": (lattice.free_balls,)}
        sites = lattice.sites(detectors)
        super().__init__(lattice, omegas, sites, error_tolerance, Heat, missing, **lengths)

    def relaxation(self):
        """Return the task that computes the amplitudes of relaxed packings."""
        from pgran.experiments.sensitivity.growth import GrowthTask

        growth = self.heater.growth(self.lattice)[self.balls]
        heard = self.omegas, self.sites, self.choices["error_tolerance"]
        return GrowthTask(self.lattice, self.balls, growth, *heard)

    def prepare(self, operators):
        """See `FrequencySweep`."""
        groups = self.groups.items()
        self.flexibilities = {
            name: finite.Flexibility(operators, springs) for name, springs in groups
        }
        if self.differentiated:
            from pgran.driven.counting import least_stiffness
            from pgran.experiments.sensitivity.radii import Radii, with_vectors

            least = least_stiffness(with_vectors(self.scaled)) if self.relaxed else 0.0
            self.radii = Radii(self.scaled, self.relaxed, least)

    def keep(self, point, solver):
        """See `FrequencySweep`. Collective over a group."""
        from pgran.driven.columns import BlockSolver

        super().keep(point, solver)
        for name in self.computed:
            point[name], point[f"{name}_bound"] = np.nan, np.inf
        if solver.factor is None:
            point["converged_reason"] = min(point["converged_reason"], MISSED)
        if point["converged_reason"] <= 0:
            return
        s, before = solver.operators.s, (point["displacement"], point["error_bound"])
        systems, errors = systems_of(solver, point["field_bound"])
        if self.differentiated:
            fields = fields_of(solver, systems)
            if fields is not None:
                after = self.radii.derivatives(s, fields, errors)
                point["by_radius"], point["by_radius_bound"] = after
        if not self.groups:
            return
        # this rank's rows; what rounds while a spring's stretch is computed is within the bounds
        fields = np.stack([x.solution.getArray(readonly=True) for x in systems], axis=1)
        norms = np.array([x.solution.norm() for x in systems])
        errors = errors + (self.scaled.springs.columns.shape[1] + 2) * EPSILON * norms
        # what is not finite is without a bound
        with BlockSolver(solver) as columns, np.errstate(all="ignore"):
            for name, flexibility in self.flexibilities.items():
                stretched = flexibility.stretched(fields, errors)
                matrices = flexibility.matrices(columns)
                delta = self._changes(name, s, flexibility.groups)
                after = finite.changed_amplitudes(before, stretched, matrices, delta)
                point[name], point[f"{name}_bound"] = after

    def _changes(self, name, s, springs):
        """Return by how much kappa of the springs of groups changes at s."""
        if name == "cut":
            _, delta = finite.cuts(self.scaled, s)
            return delta
        return np.where(springs >= 0, self.scaled.stiffer(self.delta / self.unit, s, springs), 0.0)

    def collect(self, rows, seconds):
        """See `Task`."""
        heater = self.heater
        return Heat(
            factor=np.nan if heater.factor is None else float(heater.factor),
            overlap=np.nan if heater.overlap is None else float(heater.overlap),
            factorizations=int(rows["factorizations"].sum()),
            solve_seconds=seconds,
            omega=self.omegas,
            detector=self.sites,
            ball=self.balls,
            **columns_of(Heat, rows),
            **self._growth(),
        )

    def _growth(self):
        """Return what a record says of balls that grow."""
        heater, network = self.heater, self.lattice
        if not heater.grows:
            return {}
        growth = heater.growth(network)[self.balls]
        facts = {"relaxed": self.relaxed, "growth": growth}
        if heater.kelvin is not None:
            facts |= {"kelvin": heater.kelvin, "expansion": heater.expansion}
        if network.overlap is not None:
            least = np.full(len(network.held), np.inf)
            np.minimum.at(least, network.bond, network.overlap[:, None])
            facts["growth_overlap"] = growth / network.overlap.mean()
            facts["growth_least"] = growth / least[self.balls]
        return facts


def summary(record):
    """Yield in words what heating or cutting does."""
    good = record.converged_reason > 0
    if failed := np.count_nonzero(~good):
        yield Caution(f"{failed} of {len(good)} frequencies of the heater failed")
    if record.growth is not None:
        yield from _of_growth(record)
    for d, ball in enumerate(ball_names(record.detector)):
        for name, what in (("warmed", "warm ball"), ("cut", "cut bond")):
            after = getattr(record, name)
            if after is None or not good.any():
                continue
            before = record.displacement[good, d][:, None]
            with np.errstate(all="ignore"):  # a detector may be at rest
                change = np.abs(after[good, d] - before) / np.abs(before)
            bounded = np.isfinite(getattr(record, f"{name}_bound")[good, d])
            change = change[bounded & np.isfinite(change)]
            text = f"{ball}: one {what} changes its amplitude by "
            if not change.size:
                yield f"{text}what is not known"
                continue
            usual, largest = 100 * np.median(change), 100 * change.max()
            text += f"{usual:.3g} % (median), {largest:.4g} % at most"
            if name == "warmed":
                share = 100 * record.heard[good, d].mean()
                text += f", a quarter or more in {share:.3g} % of all cases"
            yield text


def _of_growth(record):
    """Yield in words by how much balls have grown, and what packings did."""
    if record.lost:
        lost = f"{record.lost} of {len(record.ball)} packings found no rest"
        yield Caution(f"{lost}: their amplitudes are NaN")
    by = f"{np.abs(record.growth).max(initial=0.0):.4g}"
    if record.growth_overlap is not None:
        large, least = np.abs(record.growth_overlap).max(initial=0.0), np.abs(record.growth_least)
        if large > LARGE_GROWTH:
            yield Caution(
                f"radii grow by {large:.3g} of the mean overlap: beyond {LARGE_GROWTH:g} packings "
                "rearrange, and derivatives by radii say little of what happens"
            )
        by += (
            f", {large:.3g} of the mean overlap and, of a ball's own smallest overlap, "
            f"{np.median(least):.3g} (median) to {least.max():.3g}"
        )
    if record.by_radius_bound is not None and np.isinf(record.by_radius_bound).any():
        yield Caution(
            "derivatives by radii have no bounds: it is not certain that the packing is stable"
        )
    rest = "all balls find a new rest" if record.relaxed else "neighbours frozen"
    yield f"radii of warm balls grow by up to {by}; {rest}"
    if record.relaxed and np.any(there := record.outcome != OUTCOMES[-1]):
        outcomes = [f"{np.count_nonzero(record.outcome == x)} {x}" for x in OUTCOMES[:-1]]
        opened, closed = (f"{x[there].mean():.3g}" for x in (record.opened, record.closed))
        yield (
            f"{counted(len(record.ball), 'packing')}: {', '.join(outcomes)}; on average {opened} "
            f"contacts opened, {closed} closed"
        )
