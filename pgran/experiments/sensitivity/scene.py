"""Scene `sensitivity`: what a signal depends on, bond by bond and ball by ball, and its paths."""

from typing import TYPE_CHECKING

import numpy as np

from pgran.driven import drive as driven
from pgran.errors import InputError
from pgran.experiments.sensitivity import heat
from pgran.experiments.sensitivity.gradient import GradientSweep
from pgran.experiments.sensitivity.record import Sensitivity
from pgran.medium.base import medium
from pgran.medium.bonds import bond_ends
from pgran.medium.law import HERTZ
from pgran.run.agreement import agreeing
from pgran.run.experiment import PROGRESS, Caution, Scene, call, in_parallel, option, options_of
from pgran.run.frequencies import SWEEP, check_sweep
from pgran.run.task import carry_out
from pgran.store.estimate import counted, with_error
from pgran.store.record import ball_names, site_name
from pgran.store.si import SI

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from pgran.medium.base import Medium
    from pgran.run.crew import Crew


@in_parallel(
    "sensitivity", shares_lattice=True, lattice=medium, detectors=driven.DETECTORS, omegas=SWEEP
)
def sensitivity(
    lattice: "Medium",
    omegas: "ArrayLike",
    detectors: "ArrayLike",
    crew: "Crew | None" = None,
    *,
    most: int = option(
        0, "keep only the largest derivatives, by so many bonds and balls; 0 = all", low=0
    ),
    error_tolerance: float = driven.STEADY["error_tolerance"],
    progress: str = PROGRESS,
) -> Sensitivity:
    """Differentiate amplitudes by all bond constants, masses and beta, at each frequency.

    With the adjoint S z = e_d of a detector, and how far A and z stretch the bond, t and y,
    dA_d/dk = -y t (adjoint states: R.-E. Plessix, Geophys. J. Int. 167, 495 (2006)). The accuracy
    holds for derivatives by bonds and masses as well, relative to the largest one.

    Examples
    --------
    >>> lattice = pgran.Lattice.random((6, 5), seed=1)
    >>> found = pgran.sensitivity(lattice, [0.3, 0.6], detectors=[(2, 2)])
    >>> found.log_amplitude.shape  # frequencies, detectors, bonds
    (2, 1, 71)
    """
    with agreeing(crew.world):
        task = GradientSweep(lattice, omegas, detectors, most, error_tolerance)
    driven.check_driven(lattice, crew.world, omegas[0])
    return carry_out(task, crew, progress)


def check(values, given):
    """Raise where options contradict each other."""
    check_sweep(values, given)
    heat.check_options(values)
    loads = [name for name in heat.WAYS if name != "heat_factor" and values[name] is not None]
    if values["network_file"] is not None and values["bonds_redrawn"] and loads:
        raise InputError(f"-{loads[0]}: a redrawn contact is not as stiff as its force makes it")


def run(lattice, options, crew):
    """Return the sensitivity, and what heating does if asked for; see `Scene`."""
    records = [call(sensitivity, options, crew, lattice)]
    if options.heat_cut or any(getattr(options, way) is not None for way in heat.WAYS):
        records.append(call(heat.heat, options, crew, lattice))
    return records if records[0] else None


def summary(result):
    """Yield in words what a run found."""
    record, good = result.sensitivity, result.sensitivity.converged_reason > 0
    nw, kept, bonds = len(record.omega), record.by_stiffness.shape[-1], record.flux.shape[-1]
    what = "all" if kept == bonds else f"the largest {kept} of"
    yield (
        f"{counted(nw, 'frequency')} with {counted(record.factorizations, 'factorization')} in "
        f"{record.solve_seconds:.2f} s: derivatives by {what} {bonds} bonds, by masses and beta"
    )
    if record.failures:
        failed = f"{record.failures} of {nw} frequencies"
        yield Caution(f"{failed} failed or missed the accuracy asked for")
    for d, ball in enumerate(ball_names(record.detector) if good.any() else []):
        slopes = record.log_amplitude[good, d]
        at, bond = np.unravel_index(np.argmax(np.abs(slopes)), slopes.shape)
        number = bond if record.bond is None else record.bond[good][at, d, bond]
        omega, error = record.omega[good][at], record.log_bound[good][at, d, bond]
        yield (
            f"{ball}: depends most on bond {number}, {joins(result.medium, number)}, at omega = "
            f"{omega:.6g}{SI.of(result).say('Hz', omega)}: d ln|A| / d ln k = "
            f"{with_error(slopes[at, bond], error)}"
        )
    if getattr(result, "heat", None):
        yield from heat.summary(result.heat)


def joins(medium, number):
    """Return in words what a bond joins, by its number."""
    if medium.group == "network":
        return "balls {} and {}".format(*medium.bond[number].tolist())
    shape, numbers = medium.shape, np.arange(medium.free_balls)
    ends = bond_ends(numbers.reshape(shape))[number]  # -1 for a wall
    names = [site_name(np.unravel_index(n, shape)) if n >= 0 else "the wall" for n in ends]
    return " to ".join(names)


OPTIONS = options_of(sensitivity, heat.heat, without=[HERTZ])
SCENE = Scene(OPTIONS, run, summary, check, shares_lattice=True, function=sensitivity)
