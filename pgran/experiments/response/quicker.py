"""Whether a sweep would have been quicker by moments, told without them."""

import numpy as np
from mpi4py import MPI

from pgran.driven import ellipse, moment_sweep, recurrence
from pgran.driven.drive import STEADY
from pgran.run.options import options_in
from pgran.run.task import in_time

BOUND = 1e-7  # of the drive's amplitude: what moments prove of a wall, as measured


def by_moments(response, lattice, options):
    """Yield in words where `-sweep_method moments` would have taken a tenth of the time.

    As `driven.moment_sweep` chooses, but with norms of the matrices that take no matrix, which
    make series longer, and with the seconds that a frequency took.
    """
    omega, seconds = response.omega, response.solve_seconds
    if not lattice.dissipates or lattice.losses is not None or not lattice.semidefinite:
        return  # no series is certain there
    if response.field is not None:
        return
    medium, _ = lattice.in_own_unit()
    highest = np.sqrt(medium.stiffness_norm / medium.mass)
    damping = medium.damping_unit * medium.damping_norm / medium.mass
    try:
        relaxation = medium.relaxation_rate or np.inf
        about = ellipse.Ellipse(highest, damping, relaxation, 1j * omega, MPI.COMM_SELF)
    except recurrence.NoSeriesError:
        return
    tolerance = options_in(options).get("error_tolerance", STEADY["error_tolerance"].default)
    tolerance = float(tolerance)
    needed = moment_sweep.needed_moments(about.rates(1j * omega), tolerance)
    needed[needed > moment_sweep.MOST] = np.inf
    # H has K, C, and three diagonals
    parts = 2 * medium.size, 2 * medium.nonzeros + 3 * medium.size, 1
    term = 1e-9 * np.dot(recurrence.NANOSECONDS, parts)
    term += moment_sweep.EVALUATION[0] * len(omega)
    order = np.argsort(needed)
    weak = response.amplitude.min(axis=1)[order] * tolerance < BOUND * medium.drive_size
    solved = np.arange(len(omega))[::-1] + np.cumsum(weak)
    took = moment_sweep.SETUP + needed[order] * term + solved * seconds / len(omega)
    if 10 * took.min() <= seconds:
        yield f"-sweep_method moments would take these frequencies about {in_time(took.min())}"
