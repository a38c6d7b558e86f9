"""The certified steady state: against the dense reference, closed forms and identities."""

import math
import os

import numpy as np
import pytest
from reference import uniform_field
from samples import bond_arrays, random_lattice, reference_of, solve, steady, uniform_lattice

from pgran.physics.lattice import Lattice
from pgran.solve.bounds import smallest_damping_eigenvalue

LU = "-steady_ksp_type preonly -steady_pc_type lu"
MUMPS = "-steady_pc_factor_mat_solver_type mumps"
POOR = "-steady_ksp_type gmres -steady_pc_type ilu -steady_ksp_max_it 60"
SOLVERS = [
    f"{LU} {MUMPS}",
    f"-steady_pc_type cholesky {MUMPS}",
    "-steady_pc_type lu -steady_pc_factor_mat_solver_type superlu_dist",
    "-steady_ksp_type gmres -steady_pc_type bjacobi -steady_ksp_max_it 3000",
]


def assert_certified(states, lattice, sites, tolerance, tiny=0.0):
    """Every bound holds, and every point is as accurate as asked, or marked where it may be tiny.

    The reference's own error is 1e-3 of what rounding adds to any bound: it is the same
    conditioning times a roundoff of extended precision (test_reference.py).
    """
    reference = reference_of(lattice)
    for state in states:
        exact = reference.amplitudes(state.s.imag, sites)
        error = np.abs(state.displacement - exact)
        assert np.all(error <= state.error_bound)
        if state.converged_reason > 0:
            assert np.all(error <= tolerance * np.abs(exact))
        else:
            assert np.abs(exact).min() < tiny


def cases():
    """Lattices of all shapes and laws, frequencies in any order, and solvers."""
    rng, laws = np.random.default_rng(20), ("uniform", "bimodal", "wide")
    shapes = [(9,), (5, 6), (6, 5), (1, 7), (7, 1), (3, 4, 3), (2, 1, 5), (12, 12)]
    for number, shape in enumerate(shapes):
        damping, mass = 10 ** rng.uniform(-6, 0), 10 ** rng.uniform(-1, 1)
        omegas = 10 ** rng.uniform(-2, 0.3, 6) / math.sqrt(mass)
        last = tuple(n - 1 for n in shape)
        sites = [(0,) * len(shape), last, last, tuple(n // 2 for n in shape)]
        lattice = random_lattice(shape, number, damping, mass, laws[number % 3])
        yield pytest.param(lattice, omegas, sites, 10 ** rng.uniform(-8, -1), "", id=str(shape))
    lattice, sites = random_lattice((9, 10), 8), [(3, 4), (8, 0)]
    for options in SOLVERS:
        omegas = [0.5, 0.55, 0.9, 1.3]
        yield pytest.param(lattice, omegas, sites, 1e-4, options, id=options)
    # the line through the last two frequencies extrapolates backwards and from far away too
    again = [0.9, 0.3, 0.301, 1.3, 0.02, 0.3, 0.3]
    yield pytest.param(lattice, again, sites, 1e-4, "", id="again")
    # far above omega_mx, 1e-11 of the wall's amplitude is left
    far = [1.25, 1.29, 1.33]
    yield pytest.param(random_lattice((20, 20), 5), far, [(8, 10)], 1e-4, "", id="evanescent")
    # a ball without springs still hangs on its dashpots
    lattice = Lattice(bond_arrays((4, 5), np.zeros), damping=0.01)
    yield pytest.param(lattice, [0.001, 0.01, 0.3], [(1, 2)], 1e-4, "", id="no springs")


@pytest.mark.parametrize(("lattice", "omegas", "sites", "tolerance", "options"), list(cases()))
def test_what_is_certified_is_right(
    comm, lattice, omegas, sites, tolerance, options, solver_options
):
    """Only amplitudes below 1e-17 may miss the tolerance, but must say so."""
    solver_options(options)
    states, _ = solve(lattice, omegas, sites, comm, tolerance)
    assert_certified(states, lattice, sites, tolerance, tiny=1e-17)


@pytest.mark.parametrize("shape", [(40,), (15, 10), (1, 8), (8, 1), (6, 5, 4)])
def test_uniform_lattice(comm, shape):
    """The closed form, within the bound of the whole field."""
    states, fields = solve(
        uniform_lattice(shape), [0.02, 0.71, 1.1, 1.5], [], comm, 1e-9, whole_field=True
    )
    for state, field in zip(states, fields, strict=True):
        assert state.converged_reason > 0
        if field is not None:
            exact = uniform_field(shape, 0.25, 1.0, 0.003, state.s.imag)
            assert np.abs(field - exact).max() <= 1e-12 * max(1.0, np.abs(exact).max())
            error = np.linalg.norm((field - exact).astype(complex))
            assert error <= state.field_bound <= 1e-9 * np.linalg.norm(field)


@pytest.mark.parametrize("shape", [(7,), (1,), (4, 6), (3, 1, 2)])
def test_smallest_damping_eigenvalue(shape):
    expected = np.linalg.eigvalsh(reference_of(uniform_lattice(shape)).C.astype(float))[0]
    assert smallest_damping_eigenvalue(shape) == pytest.approx(expected, rel=1e-12)


def stretches(field, wall):
    """By how much each bond is stretched, the driven wall displaced by `wall`."""
    return [np.diff(field, axis=a, prepend=0, append=wall * (a == 0)) for a in range(field.ndim)]


@pytest.mark.parametrize("omega", [0.1, 0.5, 1.2])
def test_identities(comm, omega):
    """Reciprocity: A_d = z^T f with S z = e_d, the drive moved to the detector's place.
    Sensitivity: dA_d/dk = -(b^T z)(b^T A) for every bond, the driven wall's displacement 1 in A, 0
    in z; those of bonds, dashpots and masses add up to none, as A_d keeps its value if all grow
    alike.
    Power: what the wall puts in is what all dashpots take out.
    """
    lattice = random_lattice((9, 8), 4, damping=0.01)
    with steady(lattice, (2, 5), comm, 1e-12, whole_field=True) as (operators, solver):
        (exact,) = solver.solve(1j * omega).displacement
        vectors = solver.field, solver.adjoints[0].solution, operators.f
        A, z, f = (comm.bcast(operators.field(x)) for x in vectors)
    assert abs(np.sum(z * f) - exact) <= 1e-11 * abs(exact)
    slopes = [-q * w for q, w in zip(stretches(z, 0), stretches(A, 1), strict=True)]
    parts = [np.sum(k * d) for k, d in zip(lattice.stiffness, slopes, strict=True)]
    parts += [1j * omega * lattice.damping * np.sum(d) for d in slopes]
    parts.append(omega**2 * np.sum(z * A))
    assert abs(sum(parts)) <= 1e-11 * max(map(abs, parts))
    loss = omega * lattice.damping
    force = np.sum((lattice.stiffness[0][-1] + 1j * loss) * (1 - A[-1]))
    taken = loss * sum(np.sum(np.abs(w) ** 2) for w in stretches(A, 1))
    assert abs(force.imag - taken) <= 1e-11 * taken


HOPELESS = [
    "-steady_ksp_type richardson -steady_pc_type none -steady_ksp_max_it 2",
    "-steady_ksp_type bcgs -steady_pc_type none -steady_ksp_max_it 1",
    "-steady_ksp_type preonly -steady_pc_type jacobi",
]


@pytest.mark.parametrize("options", HOPELESS)
@pytest.mark.parametrize("damping", [0.003, 0.0])
def test_hopeless_solvers_are_marked(comm, options, damping, solver_options):
    """Every point is tried, marked, and its bound still holds where it is finite.

    No pass leaves a larger residual than no solution at all.
    """
    solver_options(options)
    lattice = random_lattice((9, 10), 8, damping)
    states, fields = solve(lattice, [0.1, 0.4, 0.7, 1.0], [(3, 4)], comm)
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
def test_after_a_failure_the_next_frequency_starts_afresh(
    options, lattice, site, omegas, solver_options
):
    """Though the factors could be reused, it gets what it would get alone."""
    solver_options(options)
    states, _ = solve(lattice, omegas, [site], refresh_iterations=1000)
    assert_certified(states, lattice, [site], 1e-4, tiny=math.inf)
    failed = [i for i, state in enumerate(states[:-1]) if state.converged_reason <= 0]
    assert any(states[i + 1].converged_reason > 0 for i in failed)
    for i in failed[-5:]:
        (alone,), _ = solve(lattice, omegas[i + 1], [site], refresh_iterations=1000)
        assert alone.displacement[0] == states[i + 1].displacement[0]
        assert alone.converged_reason == states[i + 1].converged_reason


def test_a_point_passes_only_if_every_detector_does(comm):
    """Next to the wall the amplitude is known to rounding, at the far end, 1e-30, no digit is."""
    lattice = random_lattice((120,), 4, damping=0.3)
    (state,), _ = solve(lattice, 0.55, [(119,), (1,)], comm)
    assert (state.error_bound <= 1e-4 * np.abs(state.displacement)).tolist() == [True, False]
    assert state.converged_reason <= 0


def test_undamped_lattice(comm):
    """Right to rounding away from resonances, and proven unless ranks share the lattice."""
    lattice = random_lattice((8, 9), 3, damping=0.0)
    reference = reference_of(lattice)
    lowest = math.sqrt(reference.eigenvalues()[0])
    states, _ = solve(lattice, [lowest / 3, lowest / 2, 1.3, 1.6], [(6, 4)], comm)
    for state in states:
        assert state.converged_reason > 0
        (exact,) = reference.amplitudes(state.s.imag, [(6, 4)])
        error = abs(state.displacement[0] - exact)
        assert error <= state.error_bound[0] if comm.size == 1 else np.isnan(state.error_bound[0])
        # S is definite below the lowest and above the highest mode: well conditioned
        assert error <= 1e-10 * abs(exact)


@pytest.mark.parametrize("options", ["", "-steady_ksp_type preonly", LU, f"{LU} {MUMPS}"])
def test_nothing_passes_on_an_undamped_resonance(comm, options, solver_options):
    """At the double next to an eigenfrequency no digit of the amplitude can be known.

    A rounding of S, 1e-16, is then as large as its smallest eigenvalue, however small the residual.
    In uniform lattices omega = 1/2 is an eigenfrequency exactly, in doubles too, and the wall
    drives its mode: m omega^2 = K0 (4 - 2 cos(p pi/(n+1)) - 2 cos(q pi/(n+1))) is 4 K0 for
    p = q = (n+1)/2, n odd; q is odd where n is not 3, 7, ...
    """
    solver_options(options)
    uneven = random_lattice((8, 9), 3, damping=0.0)
    resonant = np.sqrt(reference_of(uneven).eigenvalues()[[0, 5, 40]])
    uniform = uniform_lattice((5, 5), 0.0625, damping=0.0)
    for lattice, omegas in ((uneven, resonant), (uniform, 0.5)):
        for sites, whole_field in (([0, 0], False), ([], True)):
            states, _ = solve(lattice, omegas, sites, comm, whole_field=whole_field)
            assert [state.s.imag for state in states if state.converged_reason > 0] == []


def resident():
    """Memory of this process, bytes."""
    with open("/proc/self/statm") as stream:
        return int(stream.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.parametrize("damping", [0.003, 0.0])
def test_memory_stays_flat(damping):
    """Leaked by each solve a vector of 1000 balls would be 2 MB, a matrix by each solver 2 MB."""
    lattice, before = random_lattice((5, 200), damping=damping), 0
    for count in range(25):
        if count == 5:
            before = resident()
        solve(lattice, np.linspace(0.6, 0.6002, 5), [(2, 3), (4, 5)], refresh_iterations=5)
    assert resident() - before < 1e6
