"""What a warm ball, or a cut bond, does to a signal: exact amplitudes, one change at a time."""

import numpy as np

from pgran.driven import drive as driven
from pgran.errors import InputError
from pgran.experiments.sensitivity import warm as warming
from pgran.experiments.sensitivity.adjoint import MISSED, AdjointSweep
from pgran.experiments.sensitivity.finite import changed_amplitudes
from pgran.experiments.sensitivity.record import Heat
from pgran.medium.base import medium
from pgran.medium.law import HERTZ
from pgran.medium.rounding import EPSILON
from pgran.run.agreement import agreeing
from pgran.run.experiment import Caution
from pgran.run.frequencies import checked_frequencies
from pgran.run.interface import in_parallel
from pgran.run.keys import with_solver
from pgran.run.keywords import PROGRESS, option
from pgran.run.options import INTEGERS, REAL
from pgran.run.task import carry_out
from pgran.store.fields import ball_names

QUARTER = 0.25  # of the amplitude: what the heater of the experiment changed


def check(values):
    """Raise where options contradict each other. Not collective."""
    if values["heat_factor"] is not None and values["heat_overlap"] is not None:
        raise InputError("-heat_factor, -heat_overlap: a ball is warmed in one of these ways")
    warm = values["heat_factor"] is not None or values["heat_overlap"] is not None
    if values["heat_balls"] is not None and not warm:
        raise InputError("-heat_balls: by how much? -heat_factor or -heat_overlap says")


def is_wanted(options):
    """Return whether the options of a run warm balls or cut bonds."""
    return options.heat_cut or (options.heat_factor, options.heat_overlap) != (None, None)


def summary(found):
    """Return in words what heating or cutting does. Not collective."""
    good = found.converged_reason > 0
    if found.failures:
        yield Caution(f"{found.failures} of {len(good)} frequencies of the heater failed")
    for d, ball in enumerate(ball_names(found.detector)):
        for name, what in (("warmed", "warm ball"), ("cut", "cut bond")):
            changed = getattr(found, name)
            if changed is None or not good.any():
                continue
            known = np.isfinite(getattr(found, f"{name}_bound")[good, d])
            before, after = found.displacement[good, d][:, None], changed[good, d]
            with np.errstate(all="ignore"):  # a detector may be at rest
                moved = np.abs(after - before) / np.abs(before)
            known &= np.isfinite(moved)
            text = f"{ball}: one {what} changes its amplitude by "
            if not known.any():
                yield f"{text}what is not known"
                continue
            usual, most = 100 * np.median(moved[known]), 100 * moved[known].max()
            text += f"{usual:.3g} % (median), {most:.4g} % at most"
            if name == "warmed":
                share = 100 * found.heard[good, d].mean()
                text += f", a quarter or more in {share:.3g} % of all cases"
            yield text


@in_parallel(
    "heat", shares_lattice=True, lattice=medium, omegas=checked_frequencies,
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
):  # fmt: skip
    """Return the amplitudes after each ball is warmed, or each bond is cut, one at a time.

    Collective. Not an expansion: see `finite`. Each unknown at the springs that change takes one
    solve with the factorization of its frequency. Tangential springs become as much stiffer.

    Returns
    -------
    pgran.results.Heat or None
        With a crew of the caller's None on all ranks but rank 0.

    Raises
    ------
    InputError
        If a value is impossible.
    """
    values = {"heat_factor": factor, "heat_overlap": overlap, "heat_balls": balls}
    check(values)
    if factor is None and overlap is None and not cut:
        raise InputError("heat: give a factor or an overlap, or cut=True")
    with agreeing(crew.world):
        check_solver(lattice, crew)
        task = HeatSweep(
            lattice, omegas, detectors, (factor, overlap, hertz), balls, cut, error_tolerance
        )
    driven.check_driven(lattice, crew.world, omegas[0])
    return carry_out(task, crew, progress)


def check_solver(lattice, crew):
    """Raise where the solvers that options choose cannot say what a change does. Not collective."""
    from pgran.driven.linear import is_factored

    if not is_factored():
        raise InputError("-heat_*: needs a factorization (-steady_pc_type cholesky or lu)")
    if lattice.damping == 0 and crew.group.size > 1:
        raise InputError(
            "-heat_*: no error bounds are known of an undamped lattice that ranks share; "
            "-ranks_per_lattice 1 gives them"
        )


class HeatSweep(AdjointSweep):
    """The amplitudes after all changes, frequency by frequency.

    Parameters are those of `heat`.
    """

    def __init__(self, lattice, omegas, detectors, law, balls, cut, error_tolerance):
        """Find the springs that change."""
        sites, free = lattice.sites(detectors), lattice.ball_numbers
        self.factor, self.overlap, hertz = law
        self.balls, self.groups = free[:0], {}  # the springs of each change, kind by kind
        if self.factor is not None or self.overlap is not None:
            chosen = np.arange(len(free))
            if balls is not None:
                chosen = np.unique(lattice.numbers_of(lattice.sites(balls, "-heat_balls")))
            if self.overlap is None:
                growth = (self.factor - 1) * lattice.springs.elastic
            else:
                growth = warming.grown_by_overlap(lattice, self.overlap, hertz)
            contacts, self.balls = warming.contacts_of(lattice, chosen), free[chosen]
            groups, self.delta = warming.changes(lattice, contacts, growth)
            self.groups["warmed"] = np.where(self.delta != 0, groups, -1)
        if cut:
            groups, delta = warming.cuts(lattice, 1j)  # what is zero is so for any other s
            self.groups["cut"] = np.where(delta != 0, groups, -1)
        self.groups = {name: groups for name, groups in self.groups.items() if len(groups)}
        kept = []
        for name, groups in self.groups.items():
            kept.append((name, complex, (len(sites), len(groups))))
            kept.append((f"{name}_bound", float, (len(sites), len(groups))))
        super().__init__(lattice, omegas, sites, kept, error_tolerance)

    def prepare(self, operators):
        """See `FrequencySweep`."""
        from pgran.experiments.sensitivity.flexibility import Flexibility

        self.flexibilities = {
            name: Flexibility(operators, groups) for name, groups in self.groups.items()
        }

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
        with Columns(solver) as columns, np.errstate(all="ignore"):  # not finite: without a bound
            known = self._fields(point, solver)
            for name in self.groups:
                point[name], point[f"{name}_bound"] = self._after(point, columns, *known, name)

    def _fields(self, point, solver):
        """Return this rank's rows of the field and the adjoints, and bounds of their errors.

        Collective. What rounds while a spring's stretch is computed of them is within the bounds.
        """
        systems, errors = self.systems(point, solver)
        fields = np.stack([x.solution.getArray(readonly=True) for x in systems], axis=1)
        norms = np.array([x.solution.norm() for x in systems])
        return fields, errors + (self.scaled.springs.columns.shape[1] + 2) * EPSILON * norms

    def _after(self, point, columns, fields, errors, kind):
        """Return the amplitudes after changes of groups of springs, and their bounds."""
        operators, springs = columns.operators, self.scaled.springs
        groups, flexibility = self.groups[kind], self.flexibilities[kind]
        if kind == "cut":
            delta = warming.cuts(self.scaled, operators.s)[1]
        else:
            delta = self.delta / self.unit
        there = groups >= 0
        longer = operators.stretch(fields, np.maximum(flexibility.springs, 0)).T
        longer[0] += springs.drive[flexibility.springs]
        longer = np.where(there, longer[:, flexibility.place], 0.0)
        sizes = np.linalg.norm(np.where(there, springs.lengths[groups], 0.0), axis=1)
        wrong = 1.01 * errors[:, None] * sizes
        wrong += 4 * EPSILON * np.linalg.norm(longer, axis=2)
        before = point["displacement"], point["error_bound"]
        stretched = longer[0], wrong[0], longer[1:], wrong[1:]
        matrices = flexibility.matrices(columns)
        return changed_amplitudes(before, stretched, matrices, np.where(there, delta, 0.0))

    def collect(self, rows, seconds):
        """See `Task`."""
        found = {name: rows[name].copy() for name in rows.dtype.names}
        heard = None
        if "warmed" in self.groups:
            before, known = (found[n][..., None] for n in ("displacement", "error_bound"))
            moved = np.abs(found["warmed"] - before) - found["warmed_bound"] - known
            heard = np.mean(moved >= QUARTER * (np.abs(before) + known), axis=-1)
            heard[found["converged_reason"] <= 0] = np.nan
        del found["field_bound"]
        return Heat(
            factor=np.nan if self.factor is None else float(self.factor),
            overlap=np.nan if self.overlap is None else float(self.overlap),
            factorizations=int(found.pop("factorizations").sum()),
            solve_seconds=seconds,
            omega=self.omegas,
            detector=self.sites,
            ball=self.balls,
            heard=heard,
            **found,
        )
