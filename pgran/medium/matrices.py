"""The matrices of a medium, for SciPy and other programs: `pgran.matrices`."""

import os
from collections import namedtuple

import numpy as np

from pgran.arguments import called_right
from pgran.medium import base
from pgran.medium.network_file import load
from pgran.medium.springs import drive_of, quadratic
from pgran.store.record import Result


class Matrices(namedtuple("Matrices", "K, C, M, unknowns")):
    """K, C, M, what the unknowns are, and as attributes f_K and f_C, shape (n,)."""


@called_right
def matrices(medium: base.Medium | Result | str | os.PathLike) -> Matrices:
    """Return stiffness, damping and mass matrix of a medium, or of that in a result or a file.

    `sweep` solves S u = f, S = K + i omega C - omega^2 M, f = f_K + i omega f_C, where u are
    displacements, not mass-weighted ones, and what drives moves by 1; units are the medium's. M has
    masses and moments of inertia, K the pre-stress, C drag and power laws of damping: all is exact
    at any omega. They are real and symmetric; but with a loss angle K is K (1 + i eta), complex and
    not Hermitian, and normal modes are those of `K.real`.

    Returns
    -------
    K, C, M : scipy.sparse.csr_matrix, shape (n, n); f_K, f_C are attributes of the tuple
    unknowns : numpy.recarray, shape (n,)
        `unknowns.ball`, the number of a ball, on a lattice in C order (`np.unravel_index`), and
        `unknowns.component`: x, y, z, rotations rx, ry, rz; u of a scalar.

    Examples
    --------
    >>> K, C, M, unknowns = pgran.matrices(pgran.Lattice.random((6, 5), mass=2.0))
    >>> K.shape, M.diagonal().tolist()[:3], unknowns.component.tolist()[:3]
    ((30, 30), [2.0, 2.0, 2.0], ['u', 'u', 'u'])
    """
    from scipy.sparse import diags  # here: SciPy takes its time

    if isinstance(medium, (str, os.PathLike)):
        medium = load(medium)
    medium = base.medium(getattr(medium, "medium", medium))
    scale, names = 1 / medium.displacements(np.ones(medium.size)), ["u"]
    if medium.components > 1:
        names = [*base.AXES[: medium.axes], *("rx", "ry", "rz")[3 - medium.turns :]]
    ball = np.repeat(medium.ball_numbers, len(names))
    unknowns = np.rec.fromarrays([ball, names * medium.free_balls], names="ball,component")
    K, C, m = quadratic(medium, scale)
    found = Matrices(K, C, diags(m, format="csr"), unknowns)
    found.f_K, found.f_C = (scale * force for force in drive_of(medium))
    return found
