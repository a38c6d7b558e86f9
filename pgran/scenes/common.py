"""What several scenes make from their options."""

import numpy as np

from pgran.errors import FileError, InputError, PgranError
from pgran.parallel.agreement import on_root
from pgran.parallel.crew import Crew, automatic_ranks
from pgran.physics.accuracy import is_accurate
from pgran.physics.bondlaw import BondLaw
from pgran.physics.lattice import Lattice

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
        stiffness, kmax = on_root(world, lambda: read_bonds(options.bonds_file))
    else:
        law = make_law(options)
        stiffness, kmax = law.draw(options.lattice_shape, options.bonds_seed), law.kmax
    lattice = Lattice(stiffness, options.lattice_mass, options.lattice_damping, kmax)
    if len(set(world.allgather(lattice.bonds_sha256))) > 1:
        raise PgranError("the ranks drew different bonds: do they run the same NumPy?")
    return lattice


def read_bonds(path):
    """Return the bond constants in a file, which make a lattice, and what sets their unit.

    Not collective.

    Returns
    -------
    stiffness : tuple of numpy.ndarray
    kmax : float or None
        As `pgran.files.store.read_stiffness` returns them.

    Raises
    ------
    FileError
        If the file is no good, or no lattice has such bonds.
    """
    from pgran.files.store import read_stiffness

    stiffness, kmax = read_stiffness(path)
    try:
        Lattice(stiffness)
    except InputError as error:
        raise FileError(f"{path}: /lattice/{error}") from None
    return stiffness, kmax


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


def reached_accuracy(record, good):
    """Yield in words how accurate amplitudes are. Not collective.

    Parameters
    ----------
    record : pgran.results.Response or pgran.results.Relaxation
    good : numpy.ndarray of bool, shape (...)
        Which of its states have the accuracy asked for.
    """
    floored = record.at_floor[good] > 0
    bound, amplitude = record.error_bound[good][~floored], record.amplitude[good][~floored]
    if np.isnan(bound).any():
        yield (
            "no error bounds: none is known of an undamped lattice that ranks share "
            "(-ranks_per_lattice 1 gives them)"
        )
    elif bound.size:
        relative = np.divide(bound, amplitude, out=np.zeros_like(bound), where=bound > 0).max()
        total = record.at_floor.size
        which = "every amplitude" if bound.size == total else f"{bound.size} of {total} amplitudes"
        yield f"relative error of {which} at most {relative:.1e} (error_bound)"
    else:
        yield "no amplitude has the relative accuracy asked for"
    if floored.any():
        yield (
            f"{np.count_nonzero(floored)} of {record.at_floor.size} amplitudes are known to "
            "-error_floor of the wall's only, not relative to themselves (at_floor)"
        )


def below_relative_accuracy(error_bound, amplitude, tolerance):
    """Return which amplitudes have a bound, but miss the relative accuracy. Not collective."""
    missed = np.isfinite(error_bound) & ~is_accurate(error_bound, amplitude, tolerance)
    return missed.astype(np.int8)
