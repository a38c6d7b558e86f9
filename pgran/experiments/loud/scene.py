"""Scene `loud`: periodic states where contacts open and close, with errors and stability."""

from typing import TYPE_CHECKING

import numpy as np

from pgran.driven.drive import DETECTORS, STEADY, check_driven
from pgran.errors import InputError
from pgran.experiments.loud.record import Loud
from pgran.experiments.loud.states import LoudStates
from pgran.medium.base import medium
from pgran.run.agreement import agreeing
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
from pgran.run.numbers import numbers
from pgran.run.options import REALS, Option
from pgran.run.task import carry_out
from pgran.store.estimate import counted
from pgran.store.si import SI

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from pgran.medium.base import Medium
    from pgran.run.crew import Crew

AMPLITUDES = Option(
    "loud_amplitudes", REALS, None, "amplitudes of the drive, increasing: 0.1,0.3,1", "-loud_unit",
    above=0,
)  # fmt: skip


def checked_amplitudes(values):
    """Return amplitudes as an array; raise InputError unless they are positive and increase."""
    values = np.atleast_1d(numbers("-loud_amplitudes", values))
    good = values.ndim == 1 and values.size and np.all(np.isfinite(values) & (values > 0))
    if not good or np.any(np.diff(values) <= 0):
        raise InputError("-loud_amplitudes: positive, finite numbers that increase are needed")
    return values


@in_parallel(
    "loud", shares_lattice=True, lattice=medium, detectors=DETECTORS, omegas=SWEEP,
    amplitudes=Asked((AMPLITUDES,), AMPLITUDES.of_run, checked_amplitudes),
)  # fmt: skip
def loud(
    lattice: "Medium",
    omegas: "ArrayLike",
    detectors: "ArrayLike",
    amplitudes: "ArrayLike",
    crew: "Crew | None" = None,
    *,
    unit: str = option(
        "length",
        "what amplitudes are in: length, the medium's; overlap, the mean one of its contacts; "
        "opening, what opens the first contact at each frequency by the linear field",
        choices=("length", "overlap", "opening"),
    ),
    harmonics: int = option(
        5, "harmonics that are balanced, at least; more where the accuracy needs them", low=1,
        high=64,
    ),
    reach: float = option(
        3.0, "balls of a network that are nearer to touching are contacts, too", "mean overlaps",
        low=0,
    ),
    follow: str = option(
        "amplitude",
        "amplitude, a ladder from the linear state on at each frequency; frequency, up and then "
        "down at each amplitude; folds are passed",
        choices=("amplitude", "frequency"),
    ),
    stability: bool = option(True, "Floquet multipliers: whether a motion stays in a state"),
    certificate: bool = option(
        False, "prove that each state exists, and bound the errors of its harmonics"
    ),
    error_tolerance: float = STEADY["error_tolerance"],
    progress: str = PROGRESS,
) -> Loud:  # fmt: skip
    """Solve for periodic states of a medium whose contacts obey their own law, and may open.

    Each contact pushes with F(h - e) while it is closed, h its overlap, e how far it is stretched;
    its dashpot follows its stiffness by `damping_power`. The harmonics of the motion are balanced
    (see `pgran.experiments.loud.balance`); their errors are estimated by a Newton step with twice
    the harmonics and samples. Normals stay as they are at rest, which neglects second harmonics of
    the order of four overlaps over a distance. Where a largest Floquet multiplier exceeds 1 the
    state is unstable: a real motion leaves it.

    Parameters
    ----------
    amplitudes : array_like of float, shape (na,)
        Amplitudes of the drive, increasing; a push is multiplied by them.

    Raises
    ------
    InputError
        If the medium does not know the law and the overlaps of its contacts, has tangential
        springs or loss angles, or nothing damps.

    Examples
    --------
    >>> lattice = pgran.Lattice.random((6, 5), seed=1, law="hertz", damping=0.1)
    >>> found = pgran.loud(lattice, [0.5], [(2, 2)], [0.1, 1.0], unit="opening")
    >>> found.harmonic.shape  # frequencies, amplitudes, detectors, harmonics
    (1, 2, 1, 6)
    """
    with agreeing(crew.world):
        choices = {"unit": unit, "harmonics": harmonics, "reach": reach, "follow": follow}
        wanted = omegas, detectors, amplitudes, choices, stability, certificate, error_tolerance
        task = LoudStates(lattice, *wanted)
    check_driven(lattice, crew.world, omegas[0])
    return carry_out(task, crew, progress)


def check(values, given):
    """Raise where options contradict each other, or one is missing."""
    check_sweep(values, given)
    if values["loud_amplitudes"] is None:
        raise InputError("-loud_amplitudes: of the drive, as 0.1,0.3,1 with -loud_unit overlap")


def summary(result):
    """Yield in words what a run found."""
    record, si = result.loud, SI.of(result)
    states, reached = record.converged_reason.size, record.reached
    yield (
        f"{counted(states, 'state')} with {counted(record.factorizations.sum(), 'factorization')} "
        f"and {counted(record.products.sum(), 'product')} in {record.solve_seconds:.2f} s; "
        f"{counted(len(record.contact), 'contact')}, {counted(record.near, 'near pair')}"
    )
    if record.failures:
        missing = np.count_nonzero(~reached)
        yield Caution(
            f"{record.failures} of {states} states are not as accurate as asked"
            f"{f', {missing} of them were not reached' * bool(missing)} (converged_reason)"
        )
    unstable = record.unstable & reached
    if unstable.any():
        first = record.drive[unstable].min()
        yield Caution(
            f"{np.count_nonzero(unstable)} of {states} states are unstable, from an amplitude of "
            f"{first:.4g}{si.say('m', first)} on: no motion stays in them (multiplier)"
        )
    unknown = reached & ~np.isfinite(record.multiplier)
    if unknown.any():
        yield f"of {np.count_nonzero(unknown)} states it is not known whether they are stable"
    if record.certificate is not None and reached.any():
        yield from _of_proofs(record, si)
    if np.isfinite(record.opening).any():
        low, w = np.nanmin(record.opening), np.nanargmin(record.opening[:, 0])
        yield (
            f"the first contact opens at an amplitude of {low:.4g}{si.say('m', low)}, at omega = "
            f"{record.omega[w]:.6g}{si.say('Hz', record.omega[w])}"
        )
    if reached.any():
        at = np.unravel_index(np.nanargmax(record.change), record.change.shape)
        omega, size = record.omega[at[0]], record.drive[at]
        percent = (100 * x[at] for x in (record.change, record.second, record.clapping))
        yield (
            f"the {'unstable ' * bool(unstable[at])}state at omega = {omega:.6g}"
            f"{si.say('Hz', omega)}, amplitude {size:.4g}{si.say('m', size)}: the fundamental "
            "differs from the linear one by "
            "{:.3g} %, second harmonic {:.3g} %, {:.3g} % of the contacts clap".format(*percent)
        )
    if np.isfinite(record.turning):
        yield (
            f"normals stay as at rest: what they turn by adds second harmonics of the order of "
            f"{4 * record.turning:.1e} of the largest, four overlaps over a distance"
        )


def _of_proofs(record, si):
    """Yield what is proven of the states, and of how many nothing is."""
    if record.proven.any():
        bound = record.certificate_bound[record.proven, :, 1]
        part = np.max(bound / np.abs(record.harmonic[record.proven, :, 1]))
        top = record.drive[record.proven].max()
        count, unstable = np.count_nonzero(record.proven), (record.proven & record.unstable).any()
        yield (
            f"proven: {count} of {record.drive.size} states exist, "
            f"{'unstable ones among them, ' * bool(unstable)}up to an amplitude of {top:.4g}"
            f"{si.say('m', top)}, and no other is near; fundamentals at detectors are known to "
            f"{part:.1e} of them"
        )
    missing = {
        0: "it is not proven that they exist",
        -1: "no proof was tried; it takes -damping_power 0 or 1, and 3000 contacts at most",
    }
    for kind, said in missing.items():
        count = np.count_nonzero((record.certificate == kind) & record.reached)
        if count:
            yield Caution(f"{count} of {record.drive.size} states: {said} (certificate)")


SCENE = Scene(options_of(loud), run_of(loud), summary, check, shares_lattice=True)
