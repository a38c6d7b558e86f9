"""What fails at one frequency is marked there, and reaches no other one."""

import math

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc
from samples import random_lattice, uniform_lattice

from pgran.errors import InputError
from pgran.files.reading import read_words, resolve
from pgran.parallel.agreement import met_by_all
from pgran.solve.counting import ModeCounter
from pgran.solve.operators import Operators
from pgran.solve.steady import SteadySolver

# m omega^2 = 2 k is an eigenvalue of these lattices exactly, in doubles too.
SINGULAR = [((1,), 0.5, 1.0), ((2,), 1.0, 1.0), ((2, 2), 0.5, 1.0), ((5, 5, 5), 1.5, 3.0)]
SOLVERS = [
    "",
    "-steady_pc_factor_mat_solver_type mumps",
    "-steady_ksp_type preonly -steady_pc_type lu",
    "-steady_pc_type lu -steady_pc_factor_mat_solver_type superlu_dist",
    "-steady_pc_type gamg",
    "-steady_pc_type icc",
    "-steady_pc_type sor",
    "-steady_pc_factor_shift_type positive_definite",
]


@pytest.mark.parametrize("whole_field", [False, True])
@pytest.mark.parametrize("options", SOLVERS)
@pytest.mark.parametrize("case", SINGULAR, ids=str)
def test_a_singular_frequency_spoils_no_other_one(case, options, whole_field, solver_options):
    """Each later frequency has what it has alone, bit for bit; by a direct solver it is good."""
    solver_options(options)
    shape, stiffness, omega = case
    lattice = uniform_lattice(shape, stiffness, damping=0.0)
    sites = np.zeros((0 if whole_field else 1, len(shape)), dtype=int)
    omegas = omega * np.array([1.0, 0.8, 1.0, 1.02, 1.0, 1.03])

    def solved(frequencies):
        with (
            Operators(lattice, MPI.COMM_SELF) as operators,
            SteadySolver(operators, sites, whole_field=whole_field) as solver,
        ):
            states = []
            for frequency in frequencies:
                solver.restart()
                states.append(solver.solve(1j * float(frequency)))
            return states

    together = solved(omegas)
    for state in together:
        (alone,) = solved([state.s.imag])
        good = state.converged_reason > 0
        assert (alone.converged_reason > 0) == good
        if good:
            assert np.array_equal(alone.displacement, state.displacement)
            assert np.array_equal(alone.error_bound, state.error_bound)
            assert alone.field_bound == state.field_bound or not whole_field
        if state.s.imag == omega:
            assert not good
        elif "pc_type" not in options or "lu" in options:
            assert good


@pytest.mark.parametrize("options", SOLVERS[:3])
def test_earlier_frequencies_leave_nothing_behind(options, solver_options):
    """Not in the last digit either: what was factored first decides no permutation."""
    solver_options(options)
    for seed in range(12):
        lattice = random_lattice((6, 1 + seed % 3), seed, damping=0.01 * (seed % 2), law="wide")
        results = []
        for omegas in ((0.3,), (0.001, 0.3), (20.0, 0.3)):
            with (
                Operators(lattice, MPI.COMM_SELF) as operators,
                SteadySolver(operators, [[1, 0]]) as solver,
            ):
                for omega in omegas:
                    solver.restart()
                    state = solver.solve(1j * omega)
            results.append((state.displacement[0], state.error_bound[0]))
        assert len(set(results)) == 1


def test_a_count_at_an_eigenvalue_spoils_no_other_one():
    """A pivot is zero there; the next count is what it is alone."""
    lattice = uniform_lattice((3, 3), 0.5, damping=0.0)
    with Operators(lattice, MPI.COMM_SELF) as operators:
        with ModeCounter(operators.K) as counter:
            alone = counter.below(2.3, 1e-3)
        with ModeCounter(operators.K) as counter:
            assert counter._inertia(2.0, 1e-3) is None
            assert counter.below(2.3, 1e-3) == alone is not None


@pytest.mark.parametrize("options", ["", "-steady_ksp_type preonly"])
def test_an_error_of_petsc_is_the_mark_of_its_point(comm, options, solver_options, caplog):
    """It ends no sweep, is told once, and the next point is solved."""
    solver_options(options)
    lattice = random_lattice((8, 9), 3)
    omegas = np.linspace(0.3, 0.9, 7)
    with Operators(lattice, comm) as operators, SteadySolver(operators, [[3, 3]]) as solver:
        expected = [solver.solve(1j * omega) for omega in omegas]
    with Operators(lattice, comm) as operators, SteadySolver(operators, [[3, 3]]) as solver:
        factor = solver._factor

        def failing():
            if operators.omega in omegas[[2, 3, 5]]:
                raise PETSc.Error(76)  # an error in an outside package
            return factor()

        solver._factor = failing
        solver._prepare, prepare = None, solver._prepare

        def noted(s):
            operators.omega = s.imag
            prepare(s)

        solver._prepare = noted
        found, fields = [], []
        for omega in omegas:
            found.append(solver.solve(1j * omega))
            fields.append(solver.field.getArray().copy())
    for number, (state, right) in enumerate(zip(found, expected, strict=True)):
        if number in (2, 3, 5):
            assert state.converged_reason < 0
            assert np.isnan(state.displacement[0])
            assert np.isnan(fields[number]).all()
            assert state.error_bound[0] == math.inf
        else:
            assert state.converged_reason > 0
            assert abs(state.displacement[0] - right.displacement[0]) <= 1e-10
            assert np.isfinite(fields[number]).all()
    assert len([r for r in caplog.records if "is marked: PETSc" in r.getMessage()]) == 1


def test_an_error_that_one_rank_alone_meets(world):
    """It is known from one that all ranks meet, and then ends the run."""
    assert met_by_all(world)
    apart = world.Dup()  # what one rank has begun here the others never end
    if world.size > 1 and world.rank == 0:
        assert not met_by_all(apart)


def test_what_petsc_would_never_end_is_refused():
    """A shift of pivots by nothing; other thresholds, and no shift, pass."""

    def keys(words):
        return resolve(read_words(["-scene", "response", *words.split()])).solver

    for words in (
        "-steady_pc_type icc -steady_pc_factor_zeropivot 0",
        "-steady_pc_factor_shift_type POSITIVE_DEFINITE -steady_pc_factor_zeropivot 1e-20",
        "-steady_sub_pc_type icc -steady_sub_pc_factor_zeropivot 0",
        "-steady_pc_type asm -steady_sub_pc_factor_zeropivot 0",
    ):
        with pytest.raises(InputError, match="and never end"):
            keys(words)
        assert keys(words.replace(" 0", " 1e-13").replace("1e-20", "1e-13"))
    assert keys(
        "-steady_pc_type icc -steady_pc_factor_shift_type none -steady_pc_factor_zeropivot 0"
    )
    assert keys("-steady_pc_type lu -steady_pc_factor_zeropivot 1e-300")
