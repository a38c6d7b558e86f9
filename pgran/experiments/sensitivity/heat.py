"""What a warm ball, or a cut bond, does to a signal: exact amplitudes, one change at a time."""

import numpy as np

from pgran.driven import drive as driven
from pgran.errors import InputError
from pgran.experiments.sensitivity import finite
from pgran.experiments.sensitivity.adjoint import MISSED, AdjointSweep
from pgran.experiments.sensitivity.record import Heat
from pgran.medium.base import medium
from pgran.medium.law import HERTZ
from pgran.medium.rounding import EPSILON
from pgran.run.agreement import agreeing
from pgran.run.experiment import Caution
from pgran.run.frequencies import SWEEP
from pgran.run.interface import in_parallel
from pgran.run.keys import with_solver
from pgran.run.keywords import PROGRESS, option
from pgran.run.options import INTEGERS, REAL
from pgran.run.task import carry_out
from pgran.store.fields import ball_names
from pgran.store.record import columns_of

QUARTER = 0.25  # of the amplitude: what the heater of the experiment changed


def check(values):
    """Raise where options contradict each other."""
    ways = [name for name in ("heat_factor", "heat_overlap") if values[name] is not None]
    if len(ways) == 2:
        raise InputError("-heat_factor, -heat_overlap: a ball is warmed in one of these ways")
    if values["heat_balls"] is not None and not ways:
        raise InputError("-heat_balls: by how much? -heat_factor or -heat_overlap says")


def summary(record):
    """Return in words what heating or cutting does."""
    good = record.converged_reason > 0
    if record.failures:
        yield Caution(f"{record.failures} of {len(good)} frequencies of the heater failed")
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
@with_solver
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
    hertz=HERTZ,
    balls=option(
        None, "balls to warm, flat: 8,10 or 8,10,3,4; all unless given", kind=INTEGERS, low=0,
        high=2**63 - 1,
    ),
    cut=option(False, "cut bonds one at a time, dashpots too"),
    error_tolerance=driven.STEADY["error_tolerance"],
    progress=PROGRESS,
) -> Heat:  # fmt: skip
    """Return the amplitudes after each ball is warmed, or each bond is cut, one at a time.

    Not an expansion: see `finite`. Each unknown at the springs that change takes one
    solve with the factorization of its frequency. Tangential springs become as much stiffer.
    """
    check({"heat_factor": factor, "heat_overlap": overlap, "heat_balls": balls})
    if factor is None and overlap is None and not cut:
        raise InputError("heat: give a factor or an overlap, or cut=True")
    with agreeing(crew.world):
        check_solver(lattice, crew)
        law = factor, overlap, hertz
        task = HeatSweep(lattice, omegas, detectors, law, balls, cut, error_tolerance)
    driven.check_driven(lattice, crew.world, omegas[0])
    return carry_out(task, crew, progress)


def check_solver(lattice, crew):
    """Raise where the solvers that options choose cannot say what a change does."""
    from pgran.driven.linear import is_factored

    if not is_factored():
        raise InputError("-heat_*: needs a factorization (-steady_pc_type cholesky or lu)")
    if lattice.damping == 0 and crew.group.size > 1:
        raise InputError(
            "-heat_*: no error bounds are known of an undamped lattice that ranks share; "
            "-ranks_per_lattice 1 gives them"
        )


class HeatSweep(AdjointSweep):
    """The amplitudes after all changes, frequency by frequency; `law`: factor, overlap, hertz."""

    def __init__(self, lattice, omegas, detectors, law, balls, cut, error_tolerance):
        """Find the springs that change."""
        sites, free = lattice.sites(detectors), lattice.ball_numbers
        self.factor, self.overlap, hertz = law
        self.balls, groups = free[:0], {}  # groups[kind][n]: the springs that change n changes
        if self.factor is not None or self.overlap is not None:
            warm = np.arange(len(free))
            if balls is not None:
                warm = np.unique(lattice.numbers_of(lattice.sites(balls, "-heat_balls")))
            if self.overlap is None:
                growth = (self.factor - 1) * lattice.springs.elastic
            else:
                growth = finite.grown_by_overlap(lattice, self.overlap, hertz)
            self.balls, contacts = free[warm], finite.contacts_of(lattice, warm)
            groups["warmed"], self.delta = finite.changes(lattice, contacts, growth)
        if cut:
            groups["cut"], _ = finite.cuts(lattice, 1j)
        self.groups = {name: springs for name, springs in groups.items() if len(springs)}
        missing = {"warmed", "cut"} - self.groups.keys()
        balls = (len(self.balls),)
        super().__init__(lattice, omegas, sites, error_tolerance, Heat, missing, ball=balls)

    def prepare(self, operators):
        """See `FrequencySweep`."""
        from pgran.experiments.sensitivity.flexibility import Flexibility

        groups = self.groups.items()
        self.flexibilities = {name: Flexibility(operators, springs) for name, springs in groups}

    def keep(self, point, solver):
        """See `FrequencySweep`. Collective over a group."""
        from pgran.driven.columns import Columns

        super().keep(point, solver)
        for name in self.groups:
            point[name], point[f"{name}_bound"] = np.nan, np.inf
        if solver.factor is None:
            point["converged_reason"] = min(point["converged_reason"], MISSED)
        if point["converged_reason"] <= 0:
            return
        before = point["displacement"], point["error_bound"]
        with Columns(solver) as columns, np.errstate(all="ignore"):  # not finite: without a bound
            fields, errors = self._fields(point, solver)
            for name, flexibility in self.flexibilities.items():
                stretched = flexibility.stretched(fields, errors)
                matrices = flexibility.matrices(columns)
                if name == "cut":  # the dashpots of a bond, too, so that it depends on s
                    _, delta = finite.cuts(self.scaled, solver.operators.s)
                else:
                    delta = self.delta / self.unit
                after = finite.changed_amplitudes(before, stretched, matrices, delta)
                point[name], point[f"{name}_bound"] = after

    def _fields(self, point, solver):
        """Return this rank's rows of the field and the adjoints, and bounds of their errors.

        Collective. What rounds while a spring's stretch is computed of them is within the bounds.
        """
        systems, errors = self.systems(point, solver)
        fields = np.stack([x.solution.getArray(readonly=True) for x in systems], axis=1)
        norms = np.array([x.solution.norm() for x in systems])
        return fields, errors + (self.scaled.springs.columns.shape[1] + 2) * EPSILON * norms

    def collect(self, rows, seconds):
        """See `Task`."""
        arrays, heard = columns_of(Heat, rows), None
        if "warmed" in arrays:
            before, bound = (arrays[n][..., None] for n in ("displacement", "error_bound"))
            moved = np.abs(arrays["warmed"] - before) - arrays["warmed_bound"] - bound
            # for certain: by a quarter of what the amplitude may be at most
            heard = np.mean(moved >= QUARTER * (np.abs(before) + bound), axis=-1)
            heard[arrays["converged_reason"] <= 0] = np.nan
        return Heat(
            factor=np.nan if self.factor is None else float(self.factor),
            overlap=np.nan if self.overlap is None else float(self.overlap),
            factorizations=int(rows["factorizations"].sum()),
            solve_seconds=seconds,
            omega=self.omegas,
            detector=self.sites,
            ball=self.balls,
            heard=heard,
            **arrays,
        )
