"""The smallest eigenvalue of the damping matrix of a network, certified by a count."""

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

PARTS = (0.9, 0.5, 0.1, 0.01)  # of the estimate that are tried


def smallest_eigenvalue(network):
    """Return a number that no eigenvalue of C = B^T diag(damped) B is below; 0 if none is certain.

    Not collective. An estimate by inverse iteration is certified by Sylvester's law: a factorization
    of C less a little more than that number has no negative pivot.
    """
    from scipy.sparse import csr_matrix
    from scipy.sparse.linalg import splu

    from pgran.solve.counting import ModeCounter
    from pgran.solve.layout import NetworkLayout

    with NetworkLayout(network, MPI.COMM_SELF) as layout:
        pointer, columns, values = layout.csr(layout.damped)
        C = csr_matrix((values.real, columns, pointer))
        try:
            lu = splu(C.tocsc())
        except RuntimeError:  # singular
            return 0.0
        x = np.random.Generator(np.random.Philox(1)).standard_normal(C.shape[0])
        for _ in range(20):
            x = lu.solve(x)
            size = np.linalg.norm(x)
            if not 0 < size < np.inf:
                return 0.0
            x /= size
        estimate = x @ (C @ x)
        size = (C.shape[0],) * 2
        matrix = PETSc.Mat().createAIJ(size, csr=(pointer, columns, values), comm=MPI.COMM_SELF)
        for flag in (PETSc.Mat.Option.SYMMETRIC, PETSc.Mat.Option.HERMITIAN):
            matrix.setOption(flag, True)
        found = 0.0
        with ModeCounter(matrix) as counter:
            for part in PARTS:
                shift, clearance = part * estimate, 0.05 * part * estimate
                if counter.below(shift, clearance) == 0:
                    # the count is of a matrix nearer to C - shift than a tenth of the clearance
                    found = 0.99 * (shift - clearance)
                    break
        matrix.destroy()
    return found
