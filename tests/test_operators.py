"""K, C, S and f on any number of ranks, against the sum over bonds of reference.py."""

import numpy as np
import pytest
from petsc4py import PETSc
from reference import REST, Reference, balls, bonds
from samples import random_lattice, skip_unless_ranks_fit, uniform_lattice

from pgran.physics.lattice import Lattice
from pgran.solve.operators import Operators

SHAPES = [(7,), (1,), (2,), (5, 6), (6, 1), (1, 6), (1, 1), (2, 3), (4, 3, 5), (1, 4, 3), (5, 1, 2)]


@pytest.fixture(params=SHAPES, ids=str)
def shape(request, comm):
    """A shape, left out where PETSc has fewer balls along the axes than ranks to cut them for."""
    skip_unless_ranks_fit(request.param, comm)
    return request.param


def dense(matrix, operators):
    """A distributed matrix, on every rank, in C order of the balls."""
    numbers = operators.numbers(balls(operators.shape))
    whole = np.zeros(matrix.getSize(), complex)
    for row in range(*matrix.getOwnershipRange()):
        columns, values = matrix.getRow(row)
        whole[row, columns] = values
    return operators.comm.allreduce(whole)[np.ix_(numbers, numbers)]


def column(vector, operators):
    """A distributed vector, on every rank, in C order of the balls."""
    whole = np.zeros(vector.getSize(), complex)
    whole[slice(*vector.getOwnershipRange())] = vector.getArray()
    return operators.comm.allreduce(whole)[operators.numbers(balls(operators.shape))]


def assert_close(found, expected):
    """Up to the rounding of sums of 2 dim terms."""
    assert np.abs(found - expected).max() <= 1e-15 * max(1.0, np.abs(expected).max())


def test_operators_equal_the_sum_over_bonds(comm, shape):
    lattice = random_lattice(shape, 7, damping=0.02, mass=1.7)
    reference = Reference(lattice.stiffness, 1.7, 0.02)
    with Operators(lattice, comm) as operators:
        assert_close(dense(operators.K, operators), reference.K)
        assert_close(dense(operators.C, operators), reference.C)
        for omega in (0.3, 1.1):
            operators.combine(omega)
            S, f = reference.system(omega)
            assert_close(dense(operators.S, operators), S)
            assert_close(column(operators.f, operators), f)


def test_combine_forgets_the_frequency_before(comm):
    lattice = random_lattice((5, 4))
    with Operators(lattice, comm) as operators:
        operators.combine(0.7)
        first, drive = dense(operators.S, operators), column(operators.f, operators)
        operators.combine(0.1)
        operators.combine(0.7)
        assert np.array_equal(dense(operators.S, operators), first)
        assert np.array_equal(column(operators.f, operators), drive)


def test_pattern_and_symmetry_do_not_change(comm):
    """One nonzero pattern for K, C and every S, with bonds of zero stiffness kept in it."""
    lattice = random_lattice((6, 5), law="bimodal")
    entries = 30 + 2 * (5 * 5 + 6 * 4)  # balls, and two for every bond between balls
    with Operators(lattice, comm) as operators:
        patterns = []
        for omega in (0.2, 0.9, 1.4):
            operators.combine(omega)
            patterns.append([part.tolist() for part in operators.S.getRowIJ()[:2]])
            S = dense(operators.S, operators)
            assert operators.S.isSymmetricKnown() == (True, True)
            assert operators.S.isHermitianKnown() == (True, False)
            assert np.array_equal(S, S.T)
            assert np.abs(S - S.conj().T).max() > 0  # symmetric, not Hermitian
        assert patterns[0] == patterns[1] == patterns[2]
        for matrix in (operators.K, operators.C, operators.S):
            assert matrix.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"] == entries
        arrays = [k.copy() for k in lattice.stiffness]
        change(operators, arrays, 1, (2, 2), 0.1)
        change(operators, arrays, 0, (6, 0), 0.1)
        operators.combine(0.5)
        assert [part.tolist() for part in operators.S.getRowIJ()[:2]] == patterns[0]
        assert operators.S.isSymmetricKnown() == (True, True)


def test_trace(comm, shape):
    """Fact 8: trace K = 2 sum k, less one count for each wall bond; and K, C positive definite."""
    lattice = random_lattice(shape, 2)
    walls = sum(
        lattice.stiffness[axis][index]
        for axis, index, *ends in bonds(shape)
        if any(isinstance(end, str) for end in ends)
    )
    total = 2 * sum(k.sum() for k in lattice.stiffness) - walls
    with Operators(lattice, comm) as operators:
        diagonal = operators.K.getDiagonal()
        trace = diagonal.sum()
        diagonal.destroy()
        assert trace == pytest.approx(total, rel=1e-13)
        for matrix in (operators.K, operators.C):
            assert np.linalg.eigvalsh(dense(matrix, operators))[0] > 0


def test_largest_frequency(comm):
    """Fact 8: omega^2 <= 8 Kmax/m in two dimensions, 4 dim Kmax/m in general."""
    for shape in [(9,), (6, 6), (4, 4, 4)]:
        with Operators(uniform_lattice(shape, 0.25), comm) as operators:
            largest = np.linalg.eigvalsh(dense(operators.K, operators))[-1]
        assert 0.7 * 4 * len(shape) * 0.25 < largest < 4 * len(shape) * 0.25


def test_undamped_lattice_has_no_damping_matrix(comm):
    lattice = random_lattice((4, 5), damping=0.0)
    reference = Reference(lattice.stiffness, damping=0.0)
    with Operators(lattice, comm) as operators:
        assert operators.C is None
        operators.combine(0.8)
        assert_close(dense(operators.S, operators), reference.system(0.8)[0])
        assert_close(column(operators.f, operators), reference.drive_K)


def some_bonds(shape):
    """Two bonds of every sort: inside, at a wall at rest, at the driven wall; along every axis."""
    sorts = {}
    for axis, index, one, other in bonds(shape):
        sort = (axis, "ball" if isinstance(one, tuple) else one,
                "ball" if isinstance(other, tuple) else other)  # fmt: skip
        sorts.setdefault(sort, []).append((axis, index))
    return [bond for found in sorts.values() for bond in (found[0], found[-1])]


def change(operators, arrays, axis, index, by):
    """Change one bond; bonds are numbered axis after axis, each in C order."""
    table = list(bonds(operators.shape))
    assert len(operators.bond_ends) == len(operators.driven_bonds) == len(table)
    number = next(n for n, (a, i, *_) in enumerate(table) if (a, i) == (axis, index))
    arrays[axis][index] += by
    constants = np.concatenate([k.ravel() for k in arrays])
    operators.change_bonds(np.array([number]), constants)


def test_change_of_many_bonds_at_once(comm, shape):
    """Every second bond; and all replaced, by `set_stiffness`."""
    lattice = random_lattice(shape, 11)
    arrays = [k.copy() for k in lattice.stiffness]
    table = list(bonds(shape))
    changed = np.arange(0, len(table), 2)
    for number in changed:
        axis, index, *_ = table[number]
        arrays[axis][index] = 0.01 * number
    reference = Reference(arrays)
    with Operators(lattice, comm) as operators:
        operators.change_bonds(changed, np.concatenate([k.ravel() for k in arrays]))
        for _ in range(2):
            operators.combine(0.6)
            S, f = reference.system(0.6)
            assert_close(dense(operators.K, operators), reference.K)
            assert_close(dense(operators.S, operators), S)
            assert_close(column(operators.f, operators), f)
            operators.set_stiffness(lattice.stiffness)
            reference = Reference(lattice.stiffness)


def test_change_of_a_bond_equals_new_operators(comm, shape):
    lattice = random_lattice(shape, 11)
    arrays = [k.copy() for k in lattice.stiffness]
    touched = some_bonds(shape)
    with Operators(lattice, comm) as operators:
        for number, (axis, index) in enumerate([*touched, *touched[:2]]):
            by = 0.01 * (number + 1)
            change(operators, arrays, axis, index, by)
            reference = Reference(arrays)
            operators.combine(0.6)
            S, f = reference.system(0.6)
            assert_close(dense(operators.K, operators), reference.K)
            assert_close(dense(operators.S, operators), S)
            assert_close(column(operators.f, operators), f)
        with Operators(Lattice(tuple(arrays)), comm) as anew:
            assert_close(dense(operators.K, operators), dense(anew.K, anew))
    assert {axis for axis, _ in touched} == set(range(len(shape)))
    assert any(REST in ends for *_, one, other in bonds(shape) for ends in [(one, other)])


def test_change_and_back(comm):
    """Adding and taking away a power of two leaves K bit for bit."""
    lattice = Lattice(tuple(np.full(k, 0.25) for k in [(6, 4), (5, 5)]))
    with Operators(lattice, comm) as operators:
        before = dense(operators.K, operators)
        arrays = [k.copy() for k in lattice.stiffness]
        for axis, index in some_bonds((5, 4)):
            change(operators, arrays, axis, index, 0.5)
            assert not np.array_equal(dense(operators.K, operators), before)
            change(operators, arrays, axis, index, -0.5)
            assert np.array_equal(dense(operators.K, operators), before)


def test_an_error_on_its_way_destroys_nothing_that_needs_other_ranks(comm):
    lattice = random_lattice((5, 4))
    with pytest.raises(ZeroDivisionError), Operators(lattice, comm) as operators:
        raise ZeroDivisionError
    assert (operators.K.handle == 0) == (comm.size == 1)
    operators.destroy()
    assert operators.K.handle == 0


def test_field_is_in_natural_order(comm, shape):
    """Ball (i, j, k) holds 100 i + 10 j + k."""
    lattice = random_lattice(shape)
    sites = np.array(balls(shape))
    names = sites @ (10.0 ** np.arange(len(shape))[::-1])
    with Operators(lattice, comm) as operators:
        vector = operators.f.duplicate()
        first, last = vector.getOwnershipRange()
        numbers = operators.numbers(sites)
        assert sorted(numbers) == list(range(operators.balls))
        for number, name in zip(numbers, names, strict=True):
            if first <= number < last:
                vector.setValue(number, name)
        vector.assemble()
        field = operators.field(vector)
        back = operators.vector(names.reshape(shape))
        assert back.equal(vector)
        vector.destroy()
        back.destroy()
    if comm.rank == 0:
        assert field.shape == shape
        for site, name in zip(balls(shape), names, strict=True):
            assert field[site] == name
    else:
        assert field is None
