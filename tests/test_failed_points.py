"""What fails at one frequency is marked there, and reaches no other one."""

import math

import numpy as np
import pytest
from petsc4py import PETSc
from samples import SOLVERS, random_lattice, solve, steady, uniform_lattice

from pgran.command.resolve import resolve
from pgran.errors import InputError
from pgran.run.agreement import met_by_all
from pgran.run.options import read_words

# m omega^2 = 2 k is an eigenvalue of these lattices exactly, in doubles too.
SINGULAR = [((1,), 0.5, 1.0), ((2, 2), 0.5, 1.0), ((5, 5, 5), 1.5, 3.0)]


@pytest.mark.parametrize("whole_field", [False, True])
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("case", SINGULAR, ids=str)
def test_a_singular_frequency_spoils_no_other_one(case, solver, whole_field, solver_options):
    """Each later frequency has what it has alone, bit for bit; by a direct solver it is good."""
    solver_options(SOLVERS[solver])
    (shape, stiffness, omega), together = case, []
    lattice = uniform_lattice(shape, stiffness, damping=0.0)
    sites = [] if whole_field else (0,) * len(shape)
    with steady(lattice, sites, whole_field=whole_field) as (_, opened):
        for part in (1.0, 0.8, 1.0, 1.02):
            opened.restart()
            together.append(opened.solve(1j * omega * part))
    for state in together:
        (alone,), _ = solve(lattice, state.s.imag, sites, whole_field=whole_field)
        good = state.converged_reason > 0
        assert (alone.converged_reason > 0) == good
        if good:
            assert np.array_equal(alone.displacement, state.displacement)
            assert np.array_equal(alone.error_bound, state.error_bound)
            assert alone.field_bound == state.field_bound or not whole_field
        if state.s.imag == omega:
            assert not good
        elif solver in ("default", "preonly, lu", "mumps"):  # SuperLU_DIST exchanges no pivots
            assert good


@pytest.mark.parametrize("options", ["", "-steady_ksp_type preonly"])
def test_an_error_of_petsc_is_the_mark_of_its_point(
    comm, options, solver_options, caplog, monkeypatch
):
    """It ends no sweep, is told once, and the next point is solved."""
    solver_options(options)
    lattice, bad = random_lattice((8, 9), 3), (2, 3, 5)
    omegas = np.linspace(0.3, 0.9, 7)
    right, _ = solve(lattice, omegas, (3, 3), comm)
    with steady(lattice, (3, 3), comm) as (_, solver):
        factor = solver._factor

        def failing():
            if number in bad:
                raise PETSc.Error(76)  # an error in an outside package
            return factor()

        monkeypatch.setattr(solver, "_factor", failing)
        for number, omega in enumerate(omegas):
            state = solver.solve(1j * omega)
            assert (state.converged_reason > 0) == (number not in bad)
            if number in bad:
                assert np.isnan(state.displacement[0])
                assert np.isnan(solver.field.getArray()).all()
                assert state.error_bound[0] == math.inf
            else:
                assert abs(state.displacement[0] - right[number].displacement[0]) <= 1e-10
    assert len([r for r in caplog.records if "is marked: PETSc" in r.getMessage()]) == 1


def test_an_error_that_one_rank_alone_meets(world):
    """It is known from one that all ranks meet, and then ends the run."""
    assert met_by_all(world)
    apart = world.Dup()  # what one rank has begun here the others never end
    if world.size > 1 and world.rank == 0:
        assert not met_by_all(apart)


ENDLESS = [
    "-steady_pc_type icc -steady_pc_factor_zeropivot 0",
    "-steady_pc_factor_shift_type POSITIVE_DEFINITE -steady_pc_factor_zeropivot 1e-20",
    "-steady_sub_pc_type icc -steady_sub_pc_factor_zeropivot 0",
    "-steady_pc_type asm -steady_sub_pc_factor_zeropivot 0",
]
UNSHIFTED = "-steady_pc_type icc -steady_pc_factor_shift_type none -steady_pc_factor_zeropivot 0"


@pytest.mark.parametrize("words", ENDLESS)
def test_what_petsc_would_never_end_is_refused(words):
    """A shift of pivots by nothing; other thresholds, and no shift, pass."""
    with pytest.raises(InputError, match="may never end"):
        resolve(read_words(["-scene", "response", *words.split()]))
    for good in (f"{words.rsplit(maxsplit=1)[0]} 1e-13", UNSHIFTED):
        resolve(read_words(["-scene", "response", *good.split()]))
