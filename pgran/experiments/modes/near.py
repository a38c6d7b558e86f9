"""Damped modes near a target, by SLEPc's PEP (option prefix `damped_`) on S(target)^-1."""

import contextlib

import numpy as np
from mpi4py import MPI

from pgran.driven.operators import SAME, Operators
from pgran.errors import PgranError
from pgran.experiments.modes.normal import SLEPc, invert
from pgran.run.petsc import PETSc, plain_errors

SPARE, SPACE = 4, 3  # modes that are searched for beyond those wanted; vectors for each
BESIDE = 1e-3  # omega_mx from a target: modes at rest would make S(0) singular


def nearest(medium, target, count):
    """Return s and x, columns, of modes nearest to a target, `count` above the real axis and more.

    Raises PgranError if there is none.
    """
    wanted = count + SPARE
    target += BESIDE * 1j * medium.omega_mx
    with Operators(medium, MPI.COMM_SELF) as operators:
        s, x = search(operators, target, wanted)
        # of what is mirrored below the axis some may take their places
        while len(s) >= wanted and np.count_nonzero(s.imag >= 0) < wanted < medium.size:
            wanted *= 2
            s, x = search(operators, target, wanted)
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
