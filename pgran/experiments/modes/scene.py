"""Scene `modes`: normal modes, or how many lie below each of some frequencies."""

import numpy as np

from pgran.errors import InputError
from pgran.experiments.modes import density, resonances
from pgran.experiments.modes.find import find_modes
from pgran.experiments.modes.levels import spacings
from pgran.experiments.modes.record import exactness
from pgran.experiments.modes.shapes import RESIDUAL
from pgran.run.experiment import Caution, Scene, call, options_of
from pgran.run.options import alternatives, check_ends
from pgran.store.estimate import counted
from pgran.store.si import SI


def check(values, given):
    """Raise where options contradict each other."""
    density.check(values, given)
    check_modes(values, given)
    if values["modes_count"] is not None and values["modes_target"] is None:
        raise InputError("-modes_count: -modes_target must say where")


def check_modes(values, given):
    """Raise where the options that choose modes contradict each other."""
    if values.get("modes_certificate") not in (None, "auto") and not values.get("modes_damped"):
        raise InputError("-modes_certificate belongs to -modes_damped")
    interval, nearest = ("modes_omega_min", "modes_omega_max"), ("modes_target", "modes_count")
    alternatives(interval, nearest, values, given)
    if (values["modes_omega_min"] is None) != (values["modes_omega_max"] is None):
        raise InputError("-modes_omega_min and -modes_omega_max belong together: give both")
    check_ends("modes_omega", values)
    if values["modes_target"] is not None and values["modes_count"] is None:
        raise InputError("-modes_target: -modes_count must say how many modes")


def run(lattice, options, crew):
    """Return the modes, or their numbers; see `pgran.run.experiment.Scene`."""
    if options.modes_density:
        omegas = density.frequencies(options, lattice)
        record = call(density.count_modes, options, crew, lattice, omegas)
    else:
        record = call(find_modes, options, crew, lattice)
    return record and [record]


def summary(result):
    """Yield in words what a run found."""
    if hasattr(result, "density"):
        yield from density.summary(result)
        return
    if hasattr(result, "damped_modes"):
        from pgran.experiments.modes import damped  # here: normal modes need none of it

        yield from damped.summary(result)
        return
    modes, medium, si = result.modes, result.medium, SI.of(result)
    yield f"{counted(len(modes.omega), 'mode')} in {modes.solve_seconds:.2f} s"
    yield certificate(modes)
    if not len(modes.omega):
        return
    yield f"residuals at most {modes.residual.max():.1e} of |K|"
    moving = modes.moving(medium.built)
    if len(moving.omega) < len(modes.omega):
        yield at_rest(len(modes.omega) - len(moving.omega), medium)
    if not len(moving.omega):
        return
    ends = moving.omega[0], moving.omega[-1]
    yield "omega from {:.6g} to {:.6g}".format(*ends) + si.say("Hz", *ends)
    unstable = np.count_nonzero(modes.omega < 0)
    if unstable:
        yield Caution(
            f"UNSTABLE: {counted(unstable, 'mode')} with omega^2 < 0, given as a negative omega; "
            "the network leaves these positions at a rate of |omega|"
        )
    few, many = moving.participation.min(), moving.participation.max()
    low, high = few / medium.free_balls, many / medium.free_balls
    yield f"participation from {few:.3g} to {many:.3g} balls, {low:.2g} to {high:.2g} of all"
    yield from resonances.summary(moving, si)
    yield from spacings([moving.omega], medium.omega_mx)


def at_rest(count, medium):
    """Return in words what modes of omega = 0 are."""
    whole, loose = 0, "balls that no spring connects with a wall"
    if medium.group == "network":
        whole = 0 if np.any(medium.held[medium.bond]) else medium.built.axes
        loose = "balls that are loose or turn freely (-network_rattlers remove holds rattlers)"
    parts = [f"{whole} translations of the whole, which nothing holds"] * (whole > 0)
    parts += [loose] * (count > whole)
    return f"{counted(count, 'mode')} at rest, left out of what follows: {' and '.join(parts)}"


def certificate(record):
    """Return in words whether all modes were found."""
    found, expected = record.count_found, record.count_expected
    if record.count_certified:
        return f"all {expected} modes found, {exactness(record)}"
    if found != expected:
        return Caution(f"NOT ALL MODES: {found} found where there are {expected}")
    return Caution(
        f"NOT CERTIFIED: of {found} modes some have residuals above {RESIDUAL:g} or overlap"
    )


SCENE = Scene((*options_of(find_modes), density.DENSITY), run, summary, check, function=find_modes)
