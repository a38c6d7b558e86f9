"""Units in which the numbers of a lattice or a network fit into doubles."""

import logging
import math

import numpy as np

from pgran.errors import InputError

log = logging.getLogger("pgran")

BETA = 0.003  # the paper's beta, of a lattice whose m and omega_mx are 1


def check_size(name, value, positive=False):
    """Raise InputError unless a number is finite, and positive or not negative."""
    if not math.isfinite(value) or value < 0 or (positive and value == 0):
        least = "positive" if positive else "0 or more"
        raise InputError(f"{name}: must be {least} and finite, not {value}")


def check_magnitudes(axes, mass, damping, stiffest, kmax):
    """Raise InputError where mass, damping and stiffness make no vibrations.

    `stiffest` is the largest constant, `kmax` that which sets the unit of frequency.
    """
    check_size("-bonds_kmax", kmax)
    check_size("-lattice_mass", mass, positive=True)
    check_size("-lattice_damping", damping)
    if not math.isfinite(4 * axes * max(kmax, stiffest) / mass):
        raise InputError(
            "-lattice_mass, -bonds_kmax: frequencies are too large to compute with; use other units"
        )


def einstein_frequency(axes, stiffness, mass):
    """Return sqrt(2 d k / m) of a ball on 2 d springs whose other ends rest (paper: omxdef).

    With k = kmax it is the unit of frequency; d is the number of axes.
    """
    return math.sqrt(2 * axes * stiffness / mass)


def check_frequency(lattice, omega):
    """Raise InputError unless the driven lattice's numbers and their squares fit into doubles.

    No entry of S exceeds 4 d (k + omega beta) + m omega^2 up to the frequency.
    """
    omega = float(omega)
    springs = 4 * lattice.axes * (lattice.stiffest + omega * lattice.damping)
    largest = springs + lattice.mass * omega * omega
    if not math.isfinite(largest * largest):
        raise InputError(
            f"the frequency {omega:g} is too large to compute with; use a lower one, or other units"
        )


def warn_above_modes(lattice, world, lowest):
    """Warn on rank 0 where no mode is above the lowest frequency, which is then often in Hz."""
    if world.rank == 0 and lowest > math.sqrt(lattice.stiffness_norm / lattice.mass):
        log.warning(
            "omega = %.6g, the lowest asked for, is above all modes (omega_mx is %.6g); "
            "frequencies are angular, omega = 2 pi f, but for sweeps with -sweep_unit Hz",
            lowest, lattice.omega_mx,
        )  # fmt: skip


def warn_of_damping(network, option):
    """Warn where most modes are overdamped, or where the default damping is of another unit."""
    unit, contacts = network.mass * network.omega_mx, slice(network.bonds)
    with np.errstate(all="ignore"):
        rates = network.constants[contacts] / (network.damping * network.dashpots[contacts])
    # k / (beta omega_mx) of contacts; the median mode has half of it as its quality
    over = ": most modes are overdamped" * bool(np.median(np.abs(rates)) < network.omega_mx)
    if over or (network.damping == BETA and not 0.1 < unit < 10):
        log.warning(
            "the damping %g, in mass times frequency, is %.2g m omega_mx here%s; %s %.3g would be "
            "%g m omega_mx, the default where m and omega_mx are 1",
            network.damping, network.damping / unit, over, option, BETA * unit, BETA,
        )  # fmt: skip
