"""Damped modes near a target, by SLEPc's PEP (option prefix `damped_`) on S(target)^-1."""

import contextlib

import numpy as np
from mpi4py import MPI

from pgran.driven.operators import SAME, Operators
from pgran.errors import PgranError
from pgran.experiments.modes.normal import SLEPc, invert
from pgran.run.petsc import PETSc, plain_errors

SPARE, SPACE = 4, 3  # modes that are searched for beyond those wanted; vectors for each
MORE = 1, 2, 4, 8, 16  # times as many are searched for until enough are found
BESIDE = 1e-3, 1e-6  # from zero, as modes at rest make S(0) singular, and from other targets


def nearest(medium, target, count):
    """Return s and x, columns, of modes nearest to a target, `count` above the real axis and more.

    The medium is in its own unit and time. Raises PgranError if there is none.
    """
    aside = BESIDE[bool(target)]
    with Operators(medium, MPI.COMM_SELF) as operators:
        for more in MORE:  # mirrored ones take places, and small spaces may not converge
            wanted = min(more * (count + SPARE), medium.size)
            s, x = search(operators, target + aside * 1j, wanted)
            # beyond the farthest one others may be
            here = np.abs(s - target) <= np.abs(s - target - aside * 1j).max(initial=0.0) - aside
            enough = np.count_nonzero(here & (s.imag >= 0)) >= count + SPARE // 2
            if enough or wanted == medium.size:
                break
        s, x = (s[here], x[here]) if enough else (s, x)
        if not np.any(s.imag >= 0):
            raise PgranError(
                "SLEPc's PEP has found no damped mode: many at rest, of rattlers, may hide others "
                "(-network_rattlers remove); else -modes_target or -damped_pep_* choose otherwise"
            )
        return s, operators.layout.fields(x).reshape(len(s), -1).T


@plain_errors()
def search(operators, target, count):
    """Return s and x, a row each as PETSc numbers unknowns, of modes nearest to a target."""
    K, lattice = operators.K, operators.lattice
    M, x, pep = K.duplicate(), K.createVecRight(), SLEPc.PEP().create(PETSc.COMM_SELF)
    M.setDiagonal(operators.M)
    C = M.duplicate() if operators.C is None else operators.C.copy()
    C.scale(operators.damping)
    with contextlib.ExitStack() as held:
        for thing in (M, C, x, pep):
            held.callback(thing.destroy)
        for matrix in (K, C, M):  # complex symmetric, not Hermitian
            matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            matrix.setOption(PETSc.Mat.Option.HERMITIAN, False)
        pep.setOptionsPrefix("damped_")
        pep.setOperators([K, C, M])
        pep.setType("toar")
        pep.setTarget(target)
        pep.setWhichEigenpairs(SLEPc.PEP.Which.TARGET_MAGNITUDE)
        pep.setDimensions(count, min(SPACE * count, 2 * lattice.size))
        pep.setTolerances(1e-13, 200)
        invert(pep.getST(), lattice)
        pep.getST().setTransform(True)
        pep.getST().setMatStructure(SAME)
        pep.setFromOptions()
        x.setArray(np.random.Generator(np.random.Philox(0)).standard_normal(lattice.size))
        pep.setInitialSpace([x])
        pep.solve()
        s, rows = np.empty(min(pep.getConverged(), 2 * count), complex), []
        for number in range(len(s)):
            s[number] = pep.getEigenpair(number, x)
            rows.append(x.getArray(readonly=True).copy())
        return s, np.reshape(rows, (len(s), lattice.size))
