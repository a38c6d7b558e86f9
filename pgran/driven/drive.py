"""What experiments of driven steady states share: options, sweeps over frequencies, summaries."""

import contextlib
import copy
import logging

import numpy as np

from pgran.errors import InputError
from pgran.medium.base import check_frequency, warn_above_modes
from pgran.run.agreement import on_root
from pgran.run.experiment import Asked, Caution
from pgran.run.machine import check_memory
from pgran.run.options import INTEGER, INTEGERS, REAL, REALS, TEXT, Option
from pgran.run.task import Task
from pgran.store.estimate import counted

log = logging.getLogger("pgran")
UNSTABLE = "springs of negative constants (pre-stress) make this network unstable"
TOGETHER = 10**5  # unknowns above which all ranks share each product of a recurrence
FEW = 10**4  # the same where there are fewer recurrences than groups of ranks
LONGEST_UNIT = 16  # frequencies that share factorizations

# What a user may ask of the driven steady states, by the keywords of `SteadySolver`, and of the
# functions that have them.
STEADY = {
    "error_tolerance": Option(
        "error_tolerance", REAL, 1e-4, "relative accuracy asked of each amplitude",
        above=0, high=0.5
    ),
    "error_floor": Option(
        "error_floor", REAL, 1e-20,
        "an amplitude whose error bound is below this part of the wall's amplitude, or of F / kmax "
        "under a force F, is good without relative accuracy",
        low=0
    ),
    "refresh_iterations": Option(
        "steady_refresh_iterations", INTEGER, 0,
        "factor anew after a frequency that took more Krylov iterations; 0 = when it pays", low=0
    ),
}  # fmt: skip


SITES = (
    Option(
        "detectors", INTEGERS, (8, 10), "indices of balls, from 0: 8,10, or of two balls 8,10,3,4",
        low=0, high=2**63 - 1
    ),
    Option(
        "detectors_at", REALS, None,
        "of networks, places instead: x,y or x,y,x,y; the free ball nearest to each is heard",
    ),
    Option(
        "detectors_component", TEXT, "drive",
        "of networks with vectors: which component of a displacement is read",
        choices=("drive", "x", "y", "z")
    ),
)  # fmt: skip


def detectors_of(options, world, medium):
    """Return the balls that the options of a run name, by numbers or places."""
    if options.detectors_at is not None:
        return medium.nearest_free(options.detectors_at)
    return options.detectors


DETECTORS = Asked(SITES, detectors_of)


def steady(*values):
    """Return keywords of `SteadySolver`, values in the order of STEADY."""
    return dict(zip(STEADY, values, strict=True))


def check_driven(lattice, world, lowest, in_time=False):
    """Raise where a drive has no bounded answer; warn where steady states could not last.

    Collective. `lowest` is the lowest driving frequency; `in_time` says that motions in time are
    wanted, which must not grow for ever. Raises InputError if nothing is driven, or balls float, or
    motions would grow.
    """
    lattice.check_driven()
    if in_time and lattice.losses is not None:
        raise InputError(
            "-damping_loss: only for steady states; pulses take -damping_power 1 or -damping_mass"
        )
    warn_above_modes(lattice, world, lowest)
    if not is_unstable(lattice, world):
        return
    if in_time:
        raise InputError(f"-network_file: {UNSTABLE}; after a pulse it would move without bound")
    if world.rank == 0:
        log.warning("%s: steady states are as if it stayed; scene modes says more", UNSTABLE)


def is_unstable(lattice, world):
    """Return whether springs of negative constants make some motions grow. Collective."""
    if lattice.semidefinite:
        return False
    from pgran.driven.counting import is_stable

    return not on_root(world, lambda: is_stable(lattice.in_own_unit()[0]))


class FrequencySweep(Task):
    """Steady states of one lattice, one frequency after the other; a scene says what it keeps.

    Frequencies `omegas` (nw,) are angular and increase, `sites` (nd, dim) are the detectors. `kept`
    are the fields of a row, named like those of `SteadyState` where they hold the same; `choices`
    are keywords of `steady.SteadySolver`; `sigma` is the real part of s = sigma + i omega.
    """

    items = "frequencies"
    key = "sweep_points"  # the option that says how many there are

    def __init__(self, lattice, omegas, sites, kept, choices, sigma=0.0):
        self.lattice, self.sites, self.omegas = lattice, sites, np.asarray(omegas)
        self.row, self.choices = np.dtype([*kept, ("factorizations", np.int64)]), choices
        key = "output_fields" if "field" in self.row.names else self.key
        check_memory(key, len(self.omegas) * self.row.itemsize)
        self.s = sigma + 1j * self.omegas
        self.scaled, self.unit = lattice.in_own_unit()
        check_frequency(self.scaled, self.omegas[-1])
        self.units = ranges(len(self.omegas))

    def part(self, places):
        """Return the same task at some of its frequencies."""
        other = copy.copy(self)
        other.omegas, other.s = self.omegas[places], self.s[places]
        other.units = ranges(len(places))
        return other

    def prepare(self, operators):
        """Make what `keep` needs of the lattice at all frequencies. Collective over a group."""

    def keep(self, point, solver):
        """Put into a row what is wanted besides a `SteadyState`. Collective over a group."""

    def complete(self, points):
        """Put into the rows of a unit what is computed for all of them together."""

    @contextlib.contextmanager
    def open(self, group):
        """See `Task`."""
        from pgran.driven.operators import Operators

        with Operators(self.scaled, group) as operators, self.solver(operators) as solver:
            self.prepare(operators)

            def work(unit):
                solver.restart()
                points = np.zeros(len(unit), self.row)
                for point, s in zip(points, self.s[unit.start : unit.stop], strict=True):
                    before = solver.factorizations
                    self.solve(point, solver, s)
                    point["factorizations"] = solver.factorizations - before
                self.complete(points)
                return points

            yield work

    def solver(self, operators):
        """Return what solves. Collective over a group."""
        from pgran.driven.steady import SteadySolver

        return SteadySolver(operators, self.sites, **self.choices)

    def solve(self, point, solver, s):
        """Solve at an s, and put into a row what is wanted. Collective over a group."""
        state = solver.solve(s)
        for name in set(state._fields) & set(self.row.names):
            point[name] = getattr(state, name)
        self.keep(point, solver)

    def sample(self, unit):
        """See `Task`."""
        return unit[:2]


def ranges(count):
    """Cut a sweep into ranges of frequencies, in the same way for any number of ranks."""
    length = min(LONGEST_UNIT, max(1, count // 64))
    return [range(start, min(start + length, count)) for start in range(0, count, length)]


def work_of(record):
    """Return in words what a sweep took, "12 factorizations in 0.31 s"."""
    words = factored = counted(record.factorizations, "factorization")
    if record.moments:
        words = f"{record.moments} moments of each source"
    if record.moments and record.factorizations:
        missed = np.count_nonzero(np.isfinite(record.backward_error))
        words += f", but {missed} which these miss with {factored},"
    return f"{words} in {record.solve_seconds:.2f} s"


def reached_accuracy(record, good):
    """Yield in words how accurate a record's amplitudes are; `good` says which states are."""
    floored = record.at_floor[good] > 0
    bound, amplitude = record.error_bound[good][~floored], record.amplitude[good][~floored]
    if not np.isfinite(bound).all():
        yield Caution(
            "no error bounds are known where balls float or turn without damping, or of an "
            "undamped lattice that ranks share (-ranks_per_lattice 1 gives them there)"
        )
    elif bound.size:
        relative = np.divide(bound, amplitude, out=np.zeros_like(bound), where=bound > 0).max()
        total = record.at_floor.size
        which = "every amplitude" if bound.size == total else f"{bound.size} of {total} amplitudes"
        yield f"relative error of {which} at most {relative:.1e} (error_bound)"
    else:
        yield Caution("no amplitude has the relative accuracy asked for")
    if floored.any():
        yield Caution(
            f"{np.count_nonzero(floored)} of {record.at_floor.size} amplitudes are tiny: only an "
            "upper limit is known, -error_floor of the drive's amplitude (at_floor)"
        )
