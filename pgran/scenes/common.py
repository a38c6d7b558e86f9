"""What several scenes make from their options."""

import numpy as np

from pgran.errors import PgranError, on_root
from pgran.lattice import Lattice
from pgran.sharing import Crew, automatic_ranks
from pgran.stiffness import BondLaw

CLOSE = 1e-10  # relative distance


def make_lattice(options, world):
    """Return the lattice that the options describe, the same on every rank.

    Collective.

    Raises
    ------
    InputError, FileError
        If the options or the bonds file are impossible.
    PgranError
        If the ranks disagree on the bonds.
    """
    if options.bonds_law == "file":
        from pgran.store import read_stiffness

        stiffness, kmax = on_root(world, lambda: read_stiffness(options.bonds_file))
    else:
        law = make_law(options)
        stiffness, kmax = law.draw(options.lattice_shape, options.bonds_seed), law.kmax
    lattice = Lattice(stiffness, options.lattice_mass, options.lattice_damping, kmax)
    if len(set(world.allgather(lattice.bonds_sha256))) > 1:
        raise PgranError("the ranks drew different bonds: do they run the same NumPy?")
    return lattice


def make_law(options):
    """Return the law that the bond constants are drawn from. Not collective."""
    return BondLaw(
        options.bonds_law,
        kmin=options.bonds_kmin,
        kmax=options.bonds_kmax,
        fraction=options.bonds_fraction,
        force=options.bonds_force,
        hertz=options.bonds_hertz,
    )


def make_crew(options, lattice, world, journal=None):
    """Return the ranks in groups as `-ranks_per_lattice` says. Collective."""
    ranks = options.ranks_per_lattice or automatic_ranks(lattice.shape, world.size)
    return Crew(world, ranks, journal)


def driving_frequencies(options):
    """Return the frequencies of the sweep, increasing. Not collective."""
    if options.sweep_omega:
        return np.array(options.sweep_omega)
    return np.linspace(options.sweep_min, options.sweep_max, options.sweep_points)


def phase_of_sign(displacement):
    """Return the phase of amplitudes that are real, as without damping: 0 or pi; NaN where unknown.

    Not collective. Its jumps are changes of sign, to be followed by no unwrapping.
    """
    sign = np.where(displacement.real < 0, np.pi, 0.0)
    return np.where(np.isnan(displacement), np.nan, sign)


def fit_line(x, y):
    """Return slope and intercept of the straight line through some points; y may hold NaN.

    Not collective. NaN where less than three points are known, or where these are too close
    together to tell a slope from rounding.
    """
    known = np.isfinite(y)
    x, y = x[known], y[known]
    if len(x) < 3 or np.ptp(x) < CLOSE * np.abs(x).max():
        return np.nan, np.nan
    middle = x.mean()
    slope, height = np.polyfit(x - middle, y, 1)
    return slope, height - slope * middle


def proven_accuracy(error_bound, amplitude, good):
    """Return in words how accurate amplitudes are proven to be. Not collective.

    Parameters
    ----------
    error_bound, amplitude : numpy.ndarray, shape (..., nd)
    good : numpy.ndarray of bool, shape (...)
        Which have the accuracy asked for.
    """
    bound, amplitude = error_bound[good], amplitude[good]
    if np.isnan(bound).any():
        return (
            "no error bounds: none is known of an undamped lattice that ranks share "
            "(-ranks_per_lattice 1 gives them)"
        )
    if not np.any(good):
        return "no amplitude has the accuracy asked for"
    relative = np.divide(bound, amplitude, out=np.zeros_like(bound), where=bound > 0)
    which = "every amplitude" if np.all(good) else f"{np.sum(good)} of {good.size} amplitudes"
    return f"relative error of {which} at most {relative.max(initial=0.0):.1e}, proven"
