"""K, C, S and f on any number of ranks, against the sum over bonds of reference.py."""

import numpy as np
import pytest
from petsc4py import PETSc
from reference import balls
from samples import random_lattice, reference_of

from pgran.driven.operators import Operators
from pgran.medium.bonds import bond_arrays
from pgran.medium.lattice import Lattice

SHAPES = [(7,), (1,), (2,), (5, 6), (6, 1), (1, 6), (1, 1), (2, 3), (4, 3, 5), (1, 4, 3), (5, 1, 2)]
POINTS = (0.3j, 1.1j, 0j, 0.4 + 0j, 0.2 + 0.7j, 0.2 - 0.7j)


@pytest.fixture(params=SHAPES, ids=str)
def shape(request, comm):
    if np.prod(request.param) < comm.size:
        pytest.skip("fewer balls than ranks")
    return request.param


def dense(matrix, operators):
    """A distributed matrix, or a vector, on every rank, in C order of the balls."""
    numbers = operators.layout.readings(balls(operators.shape))[0][:, 0]
    rows = slice(*matrix.getOwnershipRange())
    if isinstance(matrix, PETSc.Vec):
        whole = np.zeros(matrix.getSize(), complex)
        whole[rows] = matrix.getArray()
        return operators.comm.allreduce(whole)[numbers]
    whole = np.zeros(matrix.getSize(), complex)
    for row in range(rows.start, rows.stop):
        columns, values = matrix.getRow(row)
        whole[row, columns] = values
    return operators.comm.allreduce(whole)[np.ix_(numbers, numbers)]


def assert_close(found, expected):
    """Up to the rounding of sums of 2 dim terms."""
    assert np.abs(found - expected).max() <= 1e-15 * max(1.0, np.abs(expected).max())


@pytest.mark.parametrize("damping", [0.02, 0.0])
def test_one_system_for_every_s(comm, shape, damping):
    """S = K + s beta C + s^2 m, symmetric, S(conj s) = conj S(s); the drive alike."""
    lattice, found = random_lattice(shape, 7, damping, mass=1.7), {}
    reference = reference_of(lattice)
    with Operators(lattice, comm) as operators:
        assert_close(dense(operators.K, operators), reference.K)
        assert (operators.C is None) == (damping == 0)
        for s in POINTS:
            operators.combine(s)
            found[s] = S = dense(operators.S, operators)
            expected, drive = reference.system(-1j * s)
            assert_close(S, expected)
            assert_close(dense(operators.f, operators), drive)
            assert np.array_equal(S, S.T)
        assert np.array_equal(found[0.2 + 0.7j].conj(), found[0.2 - 0.7j])
        operators.combine(0.3j)  # nothing of another s is left
        assert np.array_equal(dense(operators.S, operators), found[0.3j])


@pytest.mark.parametrize("s", [-1e-3, -1e-9 + 1j, complex(np.nan, 1.0)])
def test_the_left_half_plane_is_refused(comm, s):
    lattice = random_lattice((5, 4))
    with Operators(lattice, comm) as operators, pytest.raises(ValueError, match="the real part"):
        operators.combine(s)


def test_pattern_and_symmetry_do_not_change(comm):
    """One nonzero pattern for K, C and every S, with bonds of zero stiffness kept in it."""
    entries = 30 + 2 * (5 * 5 + 6 * 4)  # balls, and two for every bond between balls
    with Operators(random_lattice((6, 5), law="bimodal"), comm) as operators:
        for s in (0.2j, 0.9 + 1j):
            operators.combine(s)
            assert operators.S.isSymmetricKnown() == (True, True)
            assert operators.S.isHermitianKnown() == (True, False)
            for matrix in (operators.K, operators.C, operators.S):
                assert matrix.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"] == entries
            operators.set_stiffness(np.full(len(operators.layout.ends), 0.1), np.array([14, 3]))


@pytest.mark.parametrize("law", ["uniform", "wide"])
def test_changed_bonds_leave_nothing_behind(comm, shape, law):
    """One bond after the other, many at once, and all: as assembled anew, bit for bit."""
    lattice, rng = random_lattice(shape, 11, law=law), np.random.default_rng(3)
    constants, count = lattice.constants.copy(), len(lattice.constants)
    some = {0, count - 1, *rng.integers(0, count, 6).tolist()}
    changes = [*([bond] for bond in sorted(some)), range(0, count, 2), range(count), [], [0, 0]]
    with Operators(lattice, comm) as operators:
        for changed in changes:
            changed = np.array(changed, dtype=int)
            constants[changed] = 10.0 ** rng.uniform(-6, 0, len(changed))
            operators.set_stiffness(constants, changed)
            operators.combine(0.1 + 0.6j)
            with Operators(Lattice(bond_arrays(shape, constants)), comm) as anew:
                anew.combine(0.1 + 0.6j)
                for name in ("K", "S", "f"):
                    changed, assembled = (dense(getattr(x, name), x) for x in (operators, anew))
                    assert np.array_equal(changed, assembled)


def test_an_error_on_its_way_destroys_nothing_that_needs_other_ranks(comm):
    with pytest.raises(ZeroDivisionError), Operators(random_lattice((5, 4)), comm) as operators:
        raise ZeroDivisionError
    assert (operators.K.handle == 0) == (comm.size == 1)
    operators.destroy()
    assert operators.K.handle == 0
