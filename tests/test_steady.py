"""The certified steady state: against the dense reference, closed forms and identities."""

import math
import os

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc
from reference import Reference, uniform_field
from samples import bond_arrays, random_lattice, skip_unless_ranks_fit, uniform_lattice

from pgran.physics.lattice import Lattice
from pgran.solve.bounds import smallest_damping_eigenvalue
from pgran.solve.linear import factor_package
from pgran.solve.operators import Operators
from pgran.solve.steady import SteadySolver

DIRECT = "-steady_ksp_type preonly -steady_pc_type lu"
POOR = "-steady_ksp_type gmres -steady_pc_type ilu -steady_ksp_max_it 60"


def solve(lattice, omegas, sites, comm, tolerance=1e-4, **more):
    """The states, and the whole fields on rank 0 of `comm`."""
    skip_unless_ranks_fit(lattice.shape, comm)
    with (
        Operators(lattice, comm) as operators,
        SteadySolver(operators, np.atleast_2d(sites), tolerance, **more) as solver,
    ):
        states, fields = [], []
        for omega in np.atleast_1d(omegas):
            states.append(solver.solve(1j * float(omega)))
            fields.append(operators.field(solver.field))
    return states, fields


def reference_of(lattice):
    return Reference(lattice.stiffness, lattice.mass, lattice.damping)


def assert_certified(states, lattice, sites, tolerance):
    """Every bound holds, and every point is as accurate as asked.

    The reference's own error is 1e-3 of what rounding adds to any bound: it is the same
    conditioning times a roundoff of extended precision (test_reference.py).
    """
    reference = reference_of(lattice)
    for state in states:
        exact = reference.amplitudes(state.s.imag, sites)
        error = np.abs(state.displacement - exact)
        assert state.converged_reason > 0
        assert np.all(error <= state.error_bound)
        assert np.all(error <= tolerance * np.abs(exact))


def random_cases():
    rng = np.random.default_rng(20)
    shapes = [(9,), (1,), (5, 6), (6, 5), (1, 7), (7, 1), (3, 4, 3), (2, 1, 5), (12, 12)]
    for number, shape in enumerate(shapes * 3):
        law = ("uniform", "bimodal", "wide")[(number + number // 9) % 3]
        damping, mass = 10 ** rng.uniform(-6, 0), 10 ** rng.uniform(-1, 1)
        omegas = np.sort(10 ** rng.uniform(-2, 0.3, 8)) / math.sqrt(mass)
        count = rng.integers(1, 4)
        sites = np.stack([rng.integers(0, n, count) for n in shape], axis=1)
        tolerance = 10 ** rng.uniform(-8, -1)
        lattice = random_lattice(shape, number, damping, mass, law)
        yield pytest.param(lattice, omegas, sites, tolerance, id=f"{number}-{law}")


@pytest.mark.parametrize(("lattice", "omegas", "sites", "tolerance"), list(random_cases()))
def test_error_is_within_bound_and_tolerance(comm, lattice, omegas, sites, tolerance):
    """Amplitudes below 1e-17 may miss the tolerance, but must say so; the bound holds anyway."""
    states, _ = solve(lattice, omegas, sites, comm, tolerance)
    reference = reference_of(lattice)
    reached = [state for state in states if state.converged_reason > 0]
    assert_certified(reached, lattice, sites, tolerance)
    for state in states:
        exact = reference.amplitudes(state.s.imag, sites)
        assert np.all(np.abs(state.displacement - exact) <= state.error_bound)
        assert state.converged_reason > 0 or np.abs(exact).min() < 1e-17


def test_evanescent_amplitudes(comm):
    """Far above omega_mx nothing but certified digits is left: 1e-11 of the wall's amplitude."""
    lattice = random_lattice((20, 20), 5)
    omegas = np.linspace(1.25, 1.33, 9)
    states, _ = solve(lattice, omegas, [(8, 10)], comm)
    assert max(abs(state.displacement[0]) for state in states) < 1e-8
    assert min(abs(state.displacement[0]) for state in states) < 1e-11
    assert_certified(states, lattice, [(8, 10)], 1e-4)


@pytest.mark.parametrize("shape", [(30,), (12, 13), (5, 6, 7)])
def test_direct_solver_is_exact(comm, shape, solver_options):
    solver_options(DIRECT)
    lattice = random_lattice(shape, 1)
    sites = [tuple(n // 2 for n in shape)]
    states, _ = solve(lattice, np.linspace(0.05, 1.4, 12), sites, comm)
    assert_certified(states, lattice, sites, 1e-9)


@pytest.mark.parametrize("shape", [(40,), (15, 10), (10, 15), (1, 8), (8, 1), (6, 5, 4)])
def test_uniform_lattice(comm, shape):
    """Fact 1: the closed form, to 1e-12 of the wall's amplitude or of the largest."""
    lattice = uniform_lattice(shape)
    omegas = [0.02, 0.3, 0.71, 1.1, 1.5]
    states, fields = solve(lattice, omegas, [(0,) * len(shape)], comm, 1e-13, whole_field=True)
    for state, field in zip(states, fields, strict=True):
        exact = uniform_field(shape, 0.25, 1.0, 0.003, state.s.imag)
        scale = max(1.0, float(np.abs(exact).max()))
        assert abs(state.displacement[0] - exact[(0,) * len(shape)]) <= 1e-12 * scale
        if field is not None:
            assert np.abs(field - exact).max() <= 1e-12 * scale


def test_whole_field_bound(comm):
    """With `whole_field` the field is right in the 2-norm, and without its bound nothing passes."""
    lattice = random_lattice((11, 10), 2, damping=1e-3)
    reference = reference_of(lattice)
    omegas = [0.05, 0.4, 0.8, 1.2]
    states, fields = solve(lattice, omegas, [(10, 5)], comm, 1e-6, whole_field=True)
    for state, field in zip(states, fields, strict=True):
        assert state.converged_reason > 0
        if field is not None:
            exact = reference.field(state.s.imag)
            error = np.linalg.norm((field - exact).astype(complex))
            assert error <= state.field_bound <= 1e-6 * np.linalg.norm(exact)


def test_smallest_damping_eigenvalue():
    for shape in [(7,), (1,), (4, 6), (3, 1, 2)]:
        C = reference_of(uniform_lattice(shape)).C
        expected = np.linalg.eigvalsh(C.astype(float))[0]
        assert smallest_damping_eigenvalue(shape) == pytest.approx(expected, rel=1e-12)


# Identities (facts 3 and 7)


@pytest.fixture
def identities(comm):
    """Return a lattice, and a generator of its solver and matrices at some frequencies."""
    lattice = random_lattice((9, 8), 4, damping=0.01)

    def solved():
        with (
            Operators(lattice, comm) as operators,
            SteadySolver(operators, [[2, 5]], 1e-12, whole_field=True) as solver,
        ):
            for omega in (0.1, 0.5, 0.9, 1.2):
                solver.solve(1j * omega)
                yield omega, operators, solver

    return lattice, solved


def test_reciprocity(identities):
    """A_d = z^T f with S z = e_d: the drive moved to the detector's place. Nothing is conjugate."""
    lattice, solved = identities
    for omega, operators, solver in solved():
        (adjoint,) = solver.adjoints
        exact = reference_of(lattice).amplitudes(omega, [(2, 5)])[0]
        assert abs(adjoint.solution.tDot(operators.f) - exact) <= 1e-11 * abs(exact)


def stretches(field, wall):
    """By how much each bond is stretched, the driven wall displaced by `wall`."""
    return [np.diff(field, axis=a, prepend=0, append=wall * (a == 0)) for a in range(field.ndim)]


def test_sensitivity(identities, comm):
    """dA_d/dk = -(b^T z)(b^T A) for every bond, the driven wall's displacement 1 in A, 0 in z.

    Those of bonds, dashpots and masses add up to none: A_d keeps its value if all grow alike.
    """
    lattice, solved = identities
    for omega, operators, solver in solved():
        A, z = (comm.bcast(operators.field(x)) for x in (solver.field, solver.adjoints[0].solution))
        slopes = [-q * w for q, w in zip(stretches(z, 0), stretches(A, 1), strict=True)]
        for axis, index in ((0, (9, 5)), (0, (0, 3)), (1, (4, 4)), (1, (2, 0))):
            shifted = []
            for change in (1e-6, -1e-6):
                k = [array.copy() for array in lattice.stiffness]
                k[axis][index] += change
                shifted.append(Reference(k, 1.0, 0.01).amplitudes(omega, [(2, 5)])[0])
            slope = (shifted[0] - shifted[1]) / 2e-6
            assert abs(slopes[axis][index] - slope) <= 1e-7 * abs(slope)
        parts = [np.sum(k * d) for k, d in zip(lattice.stiffness, slopes, strict=True)]
        parts += [1j * omega * 0.01 * np.sum(d) for d in slopes]
        parts.append(omega**2 * np.sum(z * A))
        assert abs(sum(parts)) <= 1e-11 * max(map(abs, parts))


def test_power_balance(identities, comm):
    """Im(A^H f) = omega beta A^H C A; and what the wall puts in is what all dashpots take out.

    The first is S's own: f includes the dashpots of the driven wall, whose loss C counts against a
    wall at rest. In the second the wall moves: its force is that of the driven bonds. Both are
    negative for the conjugate solution.
    """
    lattice, solved = identities
    for omega, operators, solver in solved():
        A, loss = solver.field, omega * lattice.damping
        lost = operators.f.duplicate()
        operators.C.mult(A, lost)
        put_in = operators.f.dot(A).imag  # PETSc: A^H f
        taken = loss * lost.dot(A).real
        lost.destroy()
        assert taken > 0
        assert abs(put_in - taken) <= 1e-11 * operators.f.norm() * A.norm()
        field = comm.bcast(operators.field(A))
        force = np.sum((lattice.stiffness[0][-1] + 1j * loss) * (1 - field[-1]))
        taken = loss * sum(np.sum(np.abs(w) ** 2) for w in stretches(field, 1))
        assert abs(force.imag - taken) <= 1e-11 * taken


def test_scaling(comm):
    """K -> s K, beta -> sqrt(s) beta, omega -> sqrt(s) omega leaves A as it is."""
    s, omegas, sites = 7.3, np.array([0.1, 0.55, 1.1]), [(3, 3)]
    lattice = random_lattice((8, 7), 6)
    scaled = Lattice(
        tuple(s * k for k in lattice.stiffness), lattice.mass, math.sqrt(s) * lattice.damping
    )
    first, _ = solve(lattice, omegas, sites, comm, 1e-10)
    second, _ = solve(scaled, math.sqrt(s) * omegas, sites, comm, 1e-10)
    for a, b in zip(first, second, strict=True):
        # each is right to 1e-10; rounding of the scaled parameters moves A by far less
        assert abs(a.displacement[0] - b.displacement[0]) <= 4e-10 * abs(a.displacement[0])


def test_mirror_symmetry_in_y(comm):
    lattice = random_lattice((8, 7), 6)
    mirrored = Lattice(tuple(k[:, ::-1] for k in lattice.stiffness), lattice.mass, lattice.damping)
    there, _ = solve(lattice, [0.2, 0.7], [(2, 1)], comm, 1e-10)
    here, _ = solve(mirrored, [0.2, 0.7], [(2, 5)], comm, 1e-10)
    for a, b in zip(there, here, strict=True):
        assert abs(a.displacement[0] - b.displacement[0]) <= 2e-10 * abs(a.displacement[0])


# Solvers chosen by options


@pytest.mark.parametrize(
    "options",
    [
        "-steady_ksp_type gmres",
        "-steady_ksp_type preonly",
        "-steady_pc_type lu -steady_pc_factor_mat_solver_type mumps",
        "-steady_pc_type cholesky -steady_pc_factor_mat_solver_type mumps",
        "-steady_pc_type lu -steady_pc_factor_mat_solver_type superlu_dist",
        "-steady_ksp_type preonly -steady_pc_type lu -steady_pc_factor_mat_solver_type mumps",
        "-steady_ksp_type gmres -steady_pc_type bjacobi -steady_ksp_max_it 3000 "
        "-steady_ksp_gmres_restart 200",
    ],
)
def test_other_solvers(comm, options, solver_options):
    """Whatever solves, what it certifies is right."""
    solver_options(options)
    lattice = random_lattice((9, 10), 8)
    states, _ = solve(lattice, np.linspace(0.5, 1.3, 9), [(3, 4), (8, 0)], comm)
    assert_certified(states, lattice, [(3, 4), (8, 0)], 1e-4)


def test_what_factors_by_default(solver_options):
    """PETSc in the ordering of the smaller factor; MUMPS where lattices are large or shared."""
    assert factor_package((20, 20), 1) == "petsc"
    assert factor_package((1000, 1000), 1) == factor_package((20, 20), 2) == "mumps"
    entries = []
    for options in ("", "-steady_pc_factor_mat_ordering_type nd"):
        solver_options(options)
        with (
            Operators(random_lattice((30, 30)), MPI.COMM_SELF) as operators,
            SteadySolver(operators, [[5, 5]]) as solver,
        ):
            solver.solve(1j * 0.6)
            entries.append(solver.factor.getInfo()["nz_used"])
    assert entries[0] < entries[1]


def test_incomplete_factorization_never_passes_wrong_numbers(solver_options):
    """bcgs with ILU(0) fails at some frequencies and must not hide it."""
    solver_options("-steady_ksp_type bcgs -steady_pc_type ilu -steady_ksp_max_it 40")
    lattice = random_lattice((16, 16), 8, damping=1e-3)
    states, _ = solve(lattice, np.linspace(0.05, 1.35, 40), [(3, 4)], MPI.COMM_SELF)
    good = [state for state in states if state.converged_reason > 0]
    assert 0 < len(good) < len(states)
    assert_certified(good, lattice, [(3, 4)], 1e-4)


@pytest.mark.parametrize(
    "options",
    [
        "-steady_ksp_type richardson -steady_pc_type none -steady_ksp_max_it 2",
        "-steady_ksp_type gmres -steady_pc_type none -steady_ksp_max_it 1",
        "-steady_ksp_type bcgs -steady_pc_type none -steady_ksp_max_it 1",
        "-steady_ksp_type preonly -steady_pc_type jacobi",
        "-steady_ksp_type preonly -steady_pc_type none",
    ],
)
@pytest.mark.parametrize("damping", [0.003, 0.0])
def test_hopeless_solvers_are_marked(comm, options, damping, solver_options):
    """Every point is tried, marked, and its bound still holds where it is finite.

    No pass leaves a larger residual than no solution at all.
    """
    solver_options(options)
    lattice = random_lattice((9, 10), 8, damping)
    states, fields = solve(lattice, np.linspace(0.1, 1.0, 10), [(3, 4)], comm)
    reference = reference_of(lattice)
    for state, field in zip(states, fields, strict=True):
        assert state.converged_reason <= 0
        if field is not None:
            S, f = (part.astype(complex) for part in reference.system(state.s.imag))
            missed, largest = np.linalg.norm(f - S @ field.ravel()), np.linalg.norm(S, np.inf)
            assert missed <= (1 + 1e-12) * np.linalg.norm(f)
            expected = missed / (largest * np.linalg.norm(field) + np.linalg.norm(f))
            assert 0.3 * expected < state.backward_error < 1.01 * expected
        error = abs(state.displacement[0] - reference.amplitudes(state.s.imag, [(3, 4)])[0])
        assert not error > state.error_bound[0]


@pytest.mark.parametrize(
    ("options", "lattice", "site", "omegas"),
    [
        (POOR, random_lattice((12, 12), 8), (3, 4), np.linspace(0.1, 1.3, 25)),
        # at first amplitudes beyond all digits
        ("", random_lattice((120,), 8, damping=0.3), (0,), np.linspace(0.6, 0.1, 30)),
    ],
    ids=["poor", "tiny"],
)
def test_no_point_of_a_sweep_suffers_from_a_failed_neighbour(
    options, lattice, site, omegas, solver_options
):
    """After a failure the next frequency starts afresh, though the factors could be reused: it
    gets what it would get alone."""
    solver_options(options)
    choices = {"comm": MPI.COMM_SELF, "refresh_iterations": 1000}
    states, _ = solve(lattice, omegas, [site], **choices)
    failed = [i for i, state in enumerate(states[:-1]) if state.converged_reason <= 0]
    assert any(states[i + 1].converged_reason > 0 for i in failed)
    for i in failed[-5:]:
        alone, _ = solve(lattice, omegas[i + 1], [site], **choices)
        assert alone[0].displacement[0] == states[i + 1].displacement[0]
        assert alone[0].converged_reason == states[i + 1].converged_reason


# Without damping


def test_undamped_lattice(comm):
    """Right to rounding away from resonances, and proven unless ranks share the lattice."""
    lattice = random_lattice((8, 9), 3, damping=0.0)
    reference = reference_of(lattice)
    lowest = math.sqrt(reference.eigenvalues()[0])
    states, _ = solve(lattice, [lowest / 3, lowest / 2, 1.3, 1.6], [(6, 4)], comm)
    for state in states:
        assert state.converged_reason > 0
        exact = reference.amplitudes(state.s.imag, [(6, 4)])[0]
        if comm.size == 1:
            assert abs(state.displacement[0] - exact) <= state.error_bound[0]
        else:
            assert np.isnan(state.error_bound[0])
        # S is definite below the lowest and above the highest mode: well conditioned
        assert abs(state.displacement[0] - exact) <= 1e-10 * abs(exact)


RESONANT_SOLVERS = [
    "",
    "-steady_ksp_type preonly",
    DIRECT,
    "-steady_pc_type lu -steady_pc_factor_mat_solver_type mumps",
]


@pytest.mark.parametrize("options", RESONANT_SOLVERS)
def test_nothing_passes_next_to_an_undamped_resonance(comm, options, solver_options):
    """At the double next to an eigenfrequency no digit of the amplitude can be known.

    A rounding of S, 1e-16, is then as large as its smallest eigenvalue, however small the residual.
    """
    solver_options(options)
    lattice = random_lattice((8, 9), 3, damping=0.0)
    omegas = np.sqrt(reference_of(lattice).eigenvalues()[[0, 5, 40]])
    for sites, whole_field in ((np.array([[6, 4]]), False), (np.empty((0, 2), int), True)):
        states, _ = solve(lattice, omegas, sites, comm, whole_field=whole_field)
        assert [state.s.imag for state in states if state.converged_reason > 0] == []


@pytest.mark.parametrize(
    ("shape", "stiffness"),
    [((1,), 0.125), ((2,), 0.25), ((2, 2), 0.125), ((5, 5), 0.0625)],
    ids=str,
)
@pytest.mark.parametrize("options", RESONANT_SOLVERS)
def test_undamped_resonance_never_passes(comm, shape, stiffness, options, solver_options):
    """omega = 1/2 is an eigenfrequency exactly, in doubles too, and its mode is driven: no answer.

    m omega^2 = K0 (4 - 2 cos(p pi/(n+1)) - 2 cos(q pi/(n+1))) is 2 K0 for p = q = 1, n = 2, and
    4 K0 for p = q = (n+1)/2, n odd; q is odd where n is not 3, 7, ..., so that the wall drives it.
    """
    solver_options(options)
    lattice = uniform_lattice(shape, stiffness, damping=0.0)
    assert np.abs(reference_of(lattice).eigenvalues() - 0.25).min() < 1e-14
    states, _ = solve(lattice, [0.5], [(0,) * len(shape)], comm)
    assert states[0].converged_reason <= 0


def test_singular_stiffness_with_damping(comm):
    """A ball without springs still hangs on its dashpots."""
    lattice = Lattice(bond_arrays((4, 5), np.zeros), damping=0.01)
    sites = [(1, 2)]
    states, _ = solve(lattice, [0.001, 0.01, 0.3], sites, comm)
    assert_certified(states, lattice, sites, 1e-4)


# Reuse


def test_factorization_is_reused_and_the_results_agree(comm):
    lattice = random_lattice((15, 14), 9)
    omegas = np.linspace(0.6, 0.6015, 31)
    results = []
    for refresh in (0, 1000):
        with (
            Operators(lattice, comm) as operators,
            SteadySolver(operators, np.array([[5, 5]]), 1e-6, refresh) as solver,
        ):
            states = [solver.solve(1j * omega) for omega in omegas]
            if comm.size == 1:  # shared factors are so cheap here that reuse need not pay
                assert solver.factorizations < len(omegas)
            results.append(states)
    assert solver.factorizations == 1  # a thousand iterations were allowed
    assert max(state.iterations for state in states) > 0
    for states in results:
        assert_certified(states, lattice, [(5, 5)], 1e-6)


def test_preonly_factors_at_each_frequency(comm, solver_options):
    """Whatever is said of iterations, of which it makes none."""
    solver_options(DIRECT)
    with (
        Operators(random_lattice((6, 7)), comm) as operators,
        SteadySolver(operators, np.array([[2, 2]]), refresh_iterations=1000) as solver,
    ):
        for omega in np.linspace(0.6, 0.61, 7):
            solver.solve(1j * omega)
        assert solver.factorizations == 7


def test_results_after_a_restart_do_not_depend_on_the_past(comm):
    lattice = random_lattice((10, 10), 2)
    with (
        Operators(lattice, comm) as operators,
        SteadySolver(operators, np.array([[4, 5]])) as solver,
    ):
        first = [solver.solve(1j * omega).displacement[0] for omega in (0.5, 0.51, 0.52)]
        for omega in (1.1, 0.2, 0.9):
            solver.solve(1j * omega)
        solver.restart()
        again = [solver.solve(1j * omega).displacement[0] for omega in (0.5, 0.51, 0.52)]
    if comm.size == 1:
        assert again == first
    else:  # MUMPS adds up what other ranks send as it arrives
        assert again == pytest.approx(first, rel=1e-12)


def test_frequencies_in_any_order(comm):
    """The line through the last two frequencies extrapolates backwards and from far away too."""
    lattice = random_lattice((10, 10), 2)
    omegas = [0.9, 0.3, 0.301, 1.3, 0.02, 0.3]
    states, _ = solve(lattice, omegas, [(4, 5)], comm)
    assert_certified(states, lattice, [(4, 5)], 1e-4)


def test_the_line_through_two_solutions_meets_the_third(comm):
    """So close together frequencies need no iteration, where the last solution alone would."""
    with (
        Operators(random_lattice((15, 14), 9), comm) as operators,
        SteadySolver(operators, [[5, 5]], 1e-4, refresh_iterations=1000) as solver,
    ):
        assert [solver.solve(1j * (0.6 + 1e-4 * i)).iterations for i in range(5)] == [0] * 5
        assert solver.factorizations == 1


def test_a_frequency_asked_for_again(comm):
    lattice = random_lattice((10, 10), 2)
    states, _ = solve(lattice, [0.5, 0.5, 0.5, 0.51], [(4, 5)], comm)
    assert_certified(states, lattice, [(4, 5)], 1e-4)


def test_several_detectors_are_each_certified(comm):
    """Also the same ball twice, and corners."""
    lattice = random_lattice((7, 6), 3)
    sites = [(0, 0), (6, 5), (3, 3), (3, 3), (0, 5), (6, 0)]
    states, _ = solve(lattice, [0.2, 0.75, 1.4], sites, comm)
    assert_certified(states, lattice, sites, 1e-4)


def test_a_point_passes_only_if_every_detector_does(comm):
    """Next to the wall the amplitude is known to rounding, at the far end, 1e-30, no digit is."""
    lattice = random_lattice((120,), 4, damping=0.3)
    (state,), _ = solve(lattice, 0.55, [(119,), (1,)], comm)
    assert (state.error_bound <= 1e-4 * np.abs(state.displacement)).tolist() == [True, False]
    assert state.converged_reason <= 0


# Memory


def resident():
    """Memory of this process, bytes."""
    with open("/proc/self/statm") as stream:
        return int(stream.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def test_memory_stays_flat_over_many_solves():
    """A leaked vector a solve would be 16 kB x 10^4 = 160 MB."""
    with (
        Operators(random_lattice((5, 200)), MPI.COMM_SELF) as operators,
        SteadySolver(operators, np.array([[2, 3]]), refresh_iterations=5) as solver,
    ):
        omegas = 0.6 + 1e-5 * np.arange(1000)
        for omega in omegas[:100]:
            solver.solve(1j * omega)
        before = resident()
        for omega in np.tile(omegas, 2):
            solver.solve(1j * omega)
        assert resident() - before < 8e6


def test_memory_stays_flat_over_many_lattices(comm):
    """Leaked matrices and factors of 900 balls, some 300 kB, 150 times would be 45 MB."""
    lattice = random_lattice((30, 30))

    def once():
        with (
            Operators(lattice, comm) as operators,
            SteadySolver(operators, np.array([[2, 3], [4, 5]])) as solver,
        ):
            solver.solve(1j * 0.6)
            operators.field(solver.field)

    for _ in range(40):
        once()
    before = resident()
    for _ in range(150):
        once()
    grown = comm.allreduce(resident() - before, MPI.MAX)
    assert grown < 12e6


def petsc_objects(owner):
    """Yield all PETSc objects that an owner or what it owns refers to."""
    for item in vars(owner).values():
        for held in item if isinstance(item, list) else [item]:
            if isinstance(held, PETSc.Object):
                yield held
            elif type(held).__module__.startswith("pgran."):
                yield from petsc_objects(held)


@pytest.mark.parametrize("damping", [0.003, 0.0])
def test_everything_is_destroyed(comm, damping):
    """No PETSc object outlives its owner."""
    with (
        Operators(random_lattice((6, 5), damping=damping), comm) as operators,
        SteadySolver(operators, np.array([[2, 3]])) as solver,
    ):
        solver.solve(1j * 0.6)
        held = [*petsc_objects(operators), *petsc_objects(solver)]
    assert len(held) > 15
    assert all(item.handle == 0 for item in held)
