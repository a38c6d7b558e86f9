"""Scene `sensitivity`: what a signal depends on, bond by bond and ball by ball, and its paths.

And what a warm ball, or a cut bond, does to it: exact amplitudes, one change at a time.
"""

import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from pgran.driven import drive as driven
from pgran.errors import InputError
from pgran.experiments.sensitivity.gradient import GradientSweep
from pgran.experiments.sensitivity.record import Heat, Sensitivity
from pgran.medium.base import Medium, medium
from pgran.medium.bonds import bond_ends
from pgran.medium.law import HERTZ
from pgran.run.agreement import agreeing
from pgran.run.crew import Crew
from pgran.run.experiment import PROGRESS, Caution, Scene, call, in_parallel, option, options_of
from pgran.run.frequencies import SWEEP, check_sweep
from pgran.run.options import FLAG, INTEGER, INTEGERS, REAL
from pgran.run.task import carry_out
from pgran.store.estimate import counted, with_error
from pgran.store.record import ball_names, site_name
from pgran.store.si import SI

WAYS = "heat_factor", "heat_overlap", "heat_radius", "heat_kelvin"


@in_parallel(
    "sensitivity", shares_lattice=True, lattice=medium, detectors=driven.DETECTORS, omegas=SWEEP
)
def sensitivity(
    lattice: Medium,
    omegas: "ArrayLike",
    detectors: "ArrayLike",
    crew: Crew | None = None,
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


@in_parallel(
    "heat", shares_lattice=True, lattice=medium, detectors=driven.DETECTORS, omegas=SWEEP,
    balls=lambda balls: balls,  # rows or flat, which the lattice checks
)  # fmt: skip
def heat(
    lattice: Medium,
    omegas: "ArrayLike",
    detectors: "ArrayLike",
    crew: Crew | None = None,
    *,
    factor: float | None = option(
        None, "warm balls one at a time: their bonds become so many times as stiff", kind=REAL,
        low=0,
    ),
    overlap: float | None = option(
        None,
        "warm balls one at a time: their contacts overlap by so much more, by Hertz's law "
        "(-bonds_hertz, or a network's forces)", "length", kind=REAL,
    ),
    radius: float | None = option(
        None, "warm balls of a network one at a time: their radii grow by so much", "length",
        kind=REAL,
    ),
    kelvin: float | None = option(
        None, "warm balls of a network one at a time by so much: their radii expand", "K",
        kind=REAL,
    ),
    expansion: float = option(
        9e-6, "relative growth of a radius by heat; by default of glass", "1/K"
    ),
    relax: bool | None = option(
        None,
        "the packing finds its rest anew around a ball that grows (true, unless the network does "
        "not know its contact law), or neighbours are frozen", kind=FLAG,
    ),
    hertz: float = HERTZ,
    balls: "ArrayLike | None" = option(
        None, "balls to warm, 8,10 or of two balls 8,10,3,4; by default all", kind=INTEGERS, low=0,
        high=2**63 - 1,
    ),
    samples: int | None = option(
        None, "warm only so many balls, drawn at random", kind=INTEGER, low=1
    ),
    cut: bool = option(False, "cut bonds one at a time, with their dashpots"),
    error_tolerance: float = driven.STEADY["error_tolerance"],
    progress: str = PROGRESS,
) -> Heat:  # fmt: skip
    """Return the amplitudes after each ball is warmed, or each bond is cut, one at a time.

    They are exact, however large changes are. Where neighbours stay in place, each unknown at the
    springs that change takes one solve with the factorization of its frequency: with the rows U of
    these springs, A' = A - y^T Delta (I + U S^-1 U^T Delta)^-1 t (Sherman, Morrison and Woodbury).
    Tangential springs get stiffer in the same ratio. Where the packing relaxes, its steady states
    are solved anew. Where radii grow and the network knows its contact law, the record has
    derivatives by all radii as well.

    Examples
    --------
    >>> lattice = pgran.Lattice.random((6, 5), seed=1)
    >>> found = pgran.heat(lattice, [0.3], [(2, 2)], factor=1.1)
    >>> found.warmed.shape  # frequencies, detectors, warm balls
    (1, 1, 30)
    """
    from pgran.experiments.sensitivity.heat import Heater, HeatSweep, check_solver, with_heard

    given = factor, overlap, radius, kelvin, balls, samples, relax
    names = *WAYS, "heat_balls", "heat_samples", "heat_relax"
    check_heater(dict(zip(names, given, strict=True)))
    if not cut and all(way is None for way in given[: len(WAYS)]):
        raise InputError(
            "heat: give a factor or an overlap, or cut=True, or of a packing radius or kelvin"
        )
    heater = Heater(factor, overlap, radius, kelvin, expansion, hertz)
    with agreeing(crew.world):
        check_solver(lattice, crew)
        warm = heater.balls(lattice, balls, samples)
        task = HeatSweep(lattice, omegas, detectors, heater, relax, warm, cut, error_tolerance)
        relaxation = task.relaxation() if task.relaxed else None
    driven.check_driven(lattice, crew.world, omegas[0])
    if relaxation is not None and crew.world.rank == 0:
        relaxation.packing.warn()
    record = carry_out(task, crew, progress)
    if relaxation is not None:
        grown = carry_out(relaxation, crew, progress)
        record = record and dataclasses.replace(record, **grown)
    return with_heard(record) if record and record.warmed is not None else record


def check(values, given):
    """Raise where options contradict each other."""
    check_sweep(values, given)
    check_heater(values)
    loads = [name for name in WAYS if name != "heat_factor" and values[name] is not None]
    if values["network_file"] is not None and values["bonds_redrawn"] and loads:
        raise InputError(f"-{loads[0]}: a redrawn contact is not as stiff as its force makes it")


def check_heater(values):
    """Raise where options of a heater contradict each other."""
    ways = [name for name in WAYS if values[name] is not None]
    if len(ways) > 1:
        names = ", ".join(f"-{name}" for name in ways)
        raise InputError(f"{names}: a ball is warmed in one of these ways; leave the others out")
    which = [f"-{name}" for name in ("heat_balls", "heat_samples") if values[name] is not None]
    if which and not ways:
        raise InputError(f"{which[0]}: say by how much, with -{' or -'.join(WAYS)}")
    if len(which) > 1:
        raise InputError(f"{' and '.join(which)}: give one, the balls or how many to draw")
    if values["heat_relax"] is not None and not {"heat_radius", "heat_kelvin"} & {*ways}:
        raise InputError("-heat_relax: only for balls that grow, by -heat_radius or -heat_kelvin")


def run(lattice, options, crew):
    """Return the sensitivity, and what heating does if asked for; see `Scene`."""
    records = [call(sensitivity, options, crew, lattice)]
    if options.heat_cut or any(getattr(options, way) is not None for way in WAYS):
        records.append(call(heat, options, crew, lattice))
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
        from pgran.experiments.sensitivity.heat import summary as of_heat

        yield from of_heat(result.heat)


def joins(medium, number):
    """Return in words what a bond joins, by its number."""
    if medium.group == "network":
        return "balls {} and {}".format(*medium.bond[number].tolist())
    shape, numbers = medium.shape, np.arange(medium.free_balls)
    ends = bond_ends(numbers.reshape(shape))[number]  # -1 for a wall
    names = [site_name(np.unravel_index(n, shape)) if n >= 0 else "the wall" for n in ends]
    return " to ".join(names)


OPTIONS = options_of(sensitivity, heat, without=[HERTZ])
SCENE = Scene(OPTIONS, run, summary, check, shares_lattice=True, function=sensitivity)
