"""What a warm ball, or a cut bond, does to a signal: exact amplitudes, one change at a time."""

import dataclasses

import numpy as np

from pgran.driven import drive as driven
from pgran.errors import InputError
from pgran.experiments.sensitivity import finite
from pgran.experiments.sensitivity.adjoint import MISSED, AdjointSweep
from pgran.experiments.sensitivity.record import Heat
from pgran.experiments.sensitivity.warmth import (
    WAYS,
    Warmth,
    check_options,
    relaxes,
    told,
    with_vectors,
)
from pgran.medium.base import medium
from pgran.medium.law import HERTZ
from pgran.medium.rounding import EPSILON
from pgran.run.agreement import agreeing
from pgran.run.experiment import PROGRESS, Caution, in_parallel, option
from pgran.run.frequencies import SWEEP
from pgran.run.options import FLAG, INTEGER, INTEGERS, REAL
from pgran.run.task import carry_out
from pgran.store.record import ball_names, columns_of

QUARTER = 0.25  # of the amplitude: what the heater of the experiment changed


def summary(record):
    """Return in words what heating or cutting does."""
    good = record.converged_reason > 0
    if failed := np.count_nonzero(~good):
        yield Caution(f"{failed} of {len(good)} frequencies of the heater failed")
    yield from told(record)
    for d, ball in enumerate(ball_names(record.detector)):
        for name, what in (("warmed", "warm ball"), ("cut", "cut bond")):
            after = getattr(record, name)
            if after is None or not good.any():
                continue
            before = record.displacement[good, d][:, None]
            with np.errstate(all="ignore"):  # a detector may be at rest
                moved = np.abs(after[good, d] - before) / np.abs(before)
            bounded = np.isfinite(getattr(record, f"{name}_bound")[good, d])
            moved = moved[bounded & np.isfinite(moved)]
            text = f"{ball}: one {what} changes its amplitude by "
            if not moved.size:
                yield f"{text}what is not known"
                continue
            usual, largest = 100 * np.median(moved), 100 * moved.max()
            text += f"{usual:.3g} % (median), {largest:.4g} % at most"
            if name == "warmed":
                share = 100 * record.heard[good, d].mean()
                text += f", a quarter or more in {share:.3g} % of all cases"
            yield text


@in_parallel(
    "heat", shares_lattice=True, lattice=medium, detectors=driven.DETECTORS, omegas=SWEEP,
    balls=lambda balls: balls,  # rows or flat, which the lattice checks
)  # fmt: skip
def heat(
    lattice,
    omegas,
    detectors,
    crew=None,
    *,
    factor=option(
        None, "warm balls one at a time: their bonds become so many times as stiff", kind=REAL,
        low=0,
    ),
    overlap=option(
        None,
        "warm balls one at a time: their contacts overlap by so much more, by Hertz's law "
        "(-bonds_hertz, or a network's forces)", "length", kind=REAL,
    ),
    radius=option(
        None, "warm balls of a network one at a time: their radii grow by so much", "length",
        kind=REAL,
    ),
    kelvin=option(
        None, "warm balls of a network one at a time by so much: their radii expand", "K",
        kind=REAL,
    ),
    expansion=option(9e-6, "relative growth of a radius by heat; by default of glass", "1/K"),
    relax=option(
        None,
        "the packing finds its rest anew around a ball that grows (true, unless the network does "
        "not know its contact law), or neighbours are frozen", kind=FLAG,
    ),
    hertz=HERTZ,
    balls=option(
        None, "balls to warm, 8,10 or of two balls 8,10,3,4; by default all", kind=INTEGERS, low=0,
        high=2**63 - 1,
    ),
    samples=option(
        None, "warm only so many balls, drawn at random", kind=INTEGER, low=1
    ),
    cut=option(False, "cut bonds one at a time, with their dashpots"),
    error_tolerance=driven.STEADY["error_tolerance"],
    progress=PROGRESS,
) -> Heat:  # fmt: skip
    """Return the amplitudes after each ball is warmed, or each bond is cut, one at a time.

    They are exact, however large changes are. Where neighbours stay in place, each unknown at the
    springs that change takes one solve with the factorization of its frequency (see `finite`), and
    tangential springs get stiffer in the same ratio. Where the packing relaxes, its steady states
    are solved anew (see `growth`). Where radii grow and the network knows its contact law, the
    record has derivatives by all radii as well (see `radii`).
    """
    given = factor, overlap, radius, kelvin, balls, samples, relax
    names = *WAYS, "heat_balls", "heat_samples", "heat_relax"
    check_options(dict(zip(names, given, strict=True)))
    warmth = Warmth(factor, overlap, radius, kelvin, expansion, hertz)
    if not (warmth.is_asked or cut):
        raise InputError(
            "heat: give a factor or an overlap, or cut=True, or of a packing radius or kelvin"
        )
    with agreeing(crew.world):
        check_solver(lattice, crew)
        relaxing = warmth.grows and relaxes(lattice, relax)
        warm = warmth.balls(lattice, balls, samples)
        task = HeatSweep(lattice, omegas, detectors, warmth, relaxing, warm, cut, error_tolerance)
        expanding = task.expanding() if relaxing else None
    driven.check_driven(lattice, crew.world, omegas[0])
    if relaxing and crew.world.rank == 0:
        expanding.packing.warn()
    record = carry_out(task, crew, progress)
    if expanding is not None:
        expanded = carry_out(expanding, crew, progress)
        if record is not None:
            record = with_heard(dataclasses.replace(record, **expanded))
    return record


def with_heard(record):
    """Return a record with the shares of balls whose change is a quarter or more, for certain."""
    before, bound = record.displacement[..., None], record.error_bound[..., None]
    with np.errstate(invalid="ignore"):
        moved = np.abs(record.warmed - before) - record.warmed_bound - bound
        # by a quarter of what the amplitude may be at most
        share = np.mean(moved >= QUARTER * (np.abs(before) + bound), axis=-1)
    share[record.converged_reason <= 0] = np.nan
    return dataclasses.replace(record, heard=share)


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


class HeatSweep(AdjointSweep):
    """The amplitudes after changes that leave all other balls in place, frequency by frequency."""

    def __init__(self, lattice, omegas, detectors, warmth, relaxing, warm, cut, error_tolerance):
        sites, free = lattice.sites(detectors), lattice.ball_numbers
        self.warmth, self.relaxing, self.balls = warmth, relaxing, free[warm]
        groups = {}  # groups[kind][n]: the springs that change n changes
        if len(warm):
            groups["frozen" if relaxing else "warmed"], self.delta = warmth.changes(lattice, warm)
        if cut:
            groups["cut"], _ = finite.cuts(lattice, 1j)
        self.groups = {name: springs for name, springs in groups.items() if len(springs)}
        missing = {"warmed", "frozen", "cut", "by_radius"} - self.groups.keys()
        # by all radii where the contact law is known
        self.differentiated = warmth.grows and relaxes(lattice, None)
        missing -= {"by_radius"} if self.differentiated else set()
        lengths = {"ball": (len(self.balls),), "ball_number": (len(free),)}
        super().__init__(lattice, omegas, sites, error_tolerance, Heat, missing, **lengths)

    def expanding(self):
        """Return the task that computes the amplitudes of relaxed packings."""
        from pgran.experiments.sensitivity.growth import ExpansionTask

        growth = self.warmth.growth(self.lattice)[self.balls]
        where = self.lattice, self.omegas, self.sites, self.balls, growth
        return ExpansionTask(*where, self.choices["error_tolerance"])

    def prepare(self, operators):
        """See `FrequencySweep`."""
        from pgran.driven.certify import least_stiffness
        from pgran.experiments.sensitivity.finite import Flexibility
        from pgran.experiments.sensitivity.radii import Radii

        groups = self.groups.items()
        self.flexibilities = {name: Flexibility(operators, springs) for name, springs in groups}
        if self.differentiated:
            least = least_stiffness(with_vectors(self.scaled)) if self.relaxing else 0.0
            self.radii = Radii(self.scaled, self.relaxing, least)

    def keep(self, point, solver):
        """See `FrequencySweep`. Collective over a group."""
        from pgran.driven.columns import Columns

        super().keep(point, solver)
        computed = [*self.groups, *["by_radius"] * self.differentiated]
        for name in computed:
            point[name], point[f"{name}_bound"] = np.nan, np.inf
        if solver.factor is None:
            point["converged_reason"] = min(point["converged_reason"], MISSED)
        if point["converged_reason"] <= 0:
            return
        before = point["displacement"], point["error_bound"]
        systems, errors = self.systems(point, solver)
        if self.differentiated:
            fields = solver.operators.layout.gathered([x.solution for x in systems])
            if fields is not None:  # on the first rank of the group
                fields = fields.reshape(len(systems), -1)
                after = self.radii.derivatives(solver.operators.s, fields, errors)
                point["by_radius"], point["by_radius_bound"] = after
        if not self.groups:
            return
        with Columns(solver) as columns, np.errstate(all="ignore"):  # not finite: without a bound
            fields, errors = self._fields(systems, errors)
            for name, flexibility in self.flexibilities.items():
                stretched = flexibility.stretched(fields, errors)
                matrices = flexibility.matrices(columns)
                if name == "cut":  # the dashpots of a bond, too, so that it depends on s
                    _, delta = finite.cuts(self.scaled, solver.operators.s)
                else:
                    delta = self.delta / self.unit
                    there = flexibility.groups >= 0
                    growth = self.scaled.stiffer(delta, solver.operators.s, flexibility.groups)
                    delta = np.where(there, growth, 0.0)
                after = finite.changed_amplitudes(before, stretched, matrices, delta)
                point[name], point[f"{name}_bound"] = after

    def _fields(self, systems, errors):
        """Return this rank's rows of the field and the adjoints, and bounds of their errors.

        Collective. What rounds while a spring's stretch is computed of them is within the bounds.
        """
        fields = np.stack([x.solution.getArray(readonly=True) for x in systems], axis=1)
        norms = np.array([x.solution.norm() for x in systems])
        return fields, errors + (self.scaled.springs.columns.shape[1] + 2) * EPSILON * norms

    def collect(self, rows, seconds):
        """See `Task`."""
        warmth = self.warmth
        record = Heat(
            factor=np.nan if warmth.factor is None else float(warmth.factor),
            overlap=np.nan if warmth.overlap is None else float(warmth.overlap),
            factorizations=int(rows["factorizations"].sum()),
            solve_seconds=seconds,
            omega=self.omegas,
            detector=self.sites,
            ball=self.balls,
            **columns_of(Heat, rows),
            **self._growth(),
        )
        return record if record.warmed is None else with_heard(record)

    def _growth(self):
        """Return what a record says of balls that grow."""
        if not self.warmth.grows:
            return {}
        growth = self.warmth.growth(self.lattice)[self.balls]
        said = {"relaxed": self.relaxing, "growth": growth}
        if self.warmth.kelvin is not None:
            said |= {"kelvin": self.warmth.kelvin, "expansion": self.warmth.expansion}
        if (overlap := self.lattice.overlap) is not None:
            least = np.full(len(self.lattice.held), np.inf)
            for end in self.lattice.bond.T:
                np.minimum.at(least, end, overlap)
            said["growth_overlap"] = growth / overlap.mean()
            said["growth_least"] = growth / least[self.balls]
        return said
