"""One bond a step: every amplitude against a dense solve from the stored bonds and events.

python tests/test_relaxation.py 100000     long runs, checked at random steps
"""

import sys

import numpy as np
import pytest
from mpi4py import MPI
from reference import Reference
from samples import needs_klu, random_lattice, uniform_lattice

from pgran.errors import InputError
from pgran.files.reading import read_words, resolve
from pgran.parallel.crew import Crew
from pgran.physics.bondlaw import BondLaw
from pgran.physics.changes import Changes, draw_changes
from pgran.physics.lattice import Lattice, bond_arrays, bond_count, bond_places
from pgran.physics.spectrum import power_spectrum
from pgran.scenes import relaxation as relaxation_scene
from pgran.scenes.relaxation import relax
from pgran.solve.bounds import smallest_damping_eigenvalue
from pgran.solve.changing import ChangingBonds
from pgran.solve.deformation import Deformation, march
from pgran.solve.operators import Operators
from pgran.solve.steady import SteadySolver
from pgran.solve.windows import Windows, window_length

UNIFORM = BondLaw("uniform")


def events(relaxation, trajectory=0):
    """Yield axis, index and new constant of each stored step."""
    yield from zip(
        relaxation.bond_axis[trajectory],
        relaxation.bond_index[trajectory],
        relaxation.stiffness[trajectory],
        strict=True,
    )


def largest_error(lattice, relaxation, steps, trajectory=0):
    """Return the largest relative error of the amplitudes after some steps, from the events."""
    stiffness = [k.copy() for k in lattice.stiffness]
    done, worst = 0, 0.0
    stored = list(events(relaxation, trajectory))
    for step in sorted(steps):
        for axis, index, value in stored[done:step]:
            stiffness[axis][tuple(index)] = value
        done = step
        exact = Reference(stiffness, lattice.mass, lattice.damping).amplitudes(
            relaxation.omega, relaxation.detector
        )
        found = relaxation.displacement[trajectory, step]
        worst = max(worst, np.max(np.abs(found - exact) / np.abs(exact)))
    return float(worst)


def solve(lattice, sites, crew_of=MPI.COMM_SELF, law=UNIFORM, omega=0.5, **choices):
    """Relax a lattice; the result on every rank."""
    with Crew(crew_of, crew_of.size if choices.pop("together", False) else 1) as crew:
        found = relax(lattice, law, omega, sites, crew, **choices)
    return crew_of.bcast(found)


@pytest.mark.parametrize("beta", [1e-4, 0.01, 1.0])
@pytest.mark.parametrize("shape", [(30,), (6, 5), (3, 4, 3)])
@pytest.mark.parametrize("method", ["window", "direct", "krylov"])
def test_every_amplitude_is_that_of_the_stored_network(method, shape, beta):
    lattice = random_lattice(shape, seed=5, damping=beta)
    sites = [[0] * len(shape), [n // 2 for n in shape]]
    relaxation = solve(lattice, sites, steps=300, method=method, window=40, seed=3)
    assert relaxation.failures == 0
    steps = np.linspace(0, 300, 16).astype(int)
    allowed = 1e-4 if method == "krylov" else 1e-10
    assert largest_error(lattice, relaxation, steps) <= allowed


@pytest.mark.parametrize("method", ["window", "krylov"])
def test_bonds_that_vanish_and_come_back(method):
    law = BondLaw("bimodal", kmin=0.0, kmax=0.25, fraction=0.6)
    lattice = random_lattice((5, 6), seed=2, damping=0.01, law="bimodal")
    relaxation = solve(lattice, [2, 3], law=law, steps=400, method=method)
    assert np.count_nonzero(relaxation.stiffness == 0) > 100
    allowed = 1e-4 if method == "krylov" else 1e-10
    assert largest_error(lattice, relaxation, range(0, 401, 25)) <= allowed


def test_a_window_of_every_length_gives_the_same():
    lattice = random_lattice((4, 5), seed=1, damping=0.01)
    runs = [solve(lattice, [1, 2], steps=150, window=window) for window in (1, 7, 64, 150)]
    for run in runs[1:]:
        difference = np.abs(run.displacement - runs[0].displacement)
        assert np.max(difference / np.abs(runs[0].displacement)) < 1e-11
    # One for each window, and one more at the end of the unit.
    assert [run.factorizations for run in runs] == [150 + 1, 22 + 1, 3 + 1, 1 + 1]


def test_repeated_bonds_and_the_driven_wall():
    """Only bonds at the driven wall change, each many times in a window."""
    lattice = random_lattice((3, 2), seed=3, damping=0.02)
    last = bond_count((3, 2)) - 3 * 3  # bonds along x come first; the last two are driven
    changes = Changes(np.array([last - 1, last - 2] * 10), np.linspace(0, 0.3, 20))
    after, bound, exact = follow(lattice, 0.4, [[0, 1]], changes)
    assert len(after) == 20
    assert np.all(np.abs(after - exact) <= bound)
    assert np.all(np.abs(after - exact) <= 1e-12 * np.abs(exact))


def test_marching_is_elimination():
    """Columns of T make S^-1 b once the bonds before have changed, a vanishing pivot included."""
    rng = np.random.default_rng(4)
    S = rng.standard_normal((9, 9)) + 1j * rng.standard_normal((9, 9))
    S += S.T
    B, delta = rng.standard_normal((9, 5)), rng.standard_normal(5)
    delta[2] = 0.0
    Y = np.linalg.solve(S, B)
    T, c = march(B.T @ Y, delta)
    for t in range(5):
        v = np.linalg.solve(S, B[:, t])
        assert np.abs(Y @ T[:, t] - v).max() <= 1e-12 * np.abs(v).max()
        assert c[t] == pytest.approx(delta[t] / (1 + delta[t] * B[:, t] @ v), rel=1e-12)
        S = S + delta[t] * np.multiply.outer(B[:, t], B[:, t])
    T, c = march(np.array([[0.5, 0.1], [0.1, 0.7]], dtype=complex), np.array([-2.0, 1.0]))
    assert not np.isfinite(c[0])


def follow(lattice, omega, sites, changes, tolerance=1e-4):
    """Return the amplitudes of one window, their bounds, and what they are."""
    with (
        Operators(lattice, MPI.COMM_SELF) as operators,
        SteadySolver(operators, sites, tolerance) as solver,
        Windows(ChangingBonds(lattice, operators, None), solver, 1j * omega) as windows,
    ):
        windows.start()
        after, bound = windows.follow(changes)
    k, exact = [array.copy() for array in lattice.stiffness], np.empty_like(after)
    axes, places = bond_places(lattice.shape, changes.bond)
    for step in range(len(after)):
        k[axes[step]][tuple(places[step])] = changes.stiffness[step]
        exact[step] = Reference(k, lattice.mass, lattice.damping).amplitudes(omega, sites)
    return after, bound, exact


@pytest.mark.parametrize("tolerance", [1e-2, 1e-8])
@pytest.mark.parametrize("law", ["uniform", "bimodal", "wide"])
@pytest.mark.parametrize(("shape", "beta"), [((24,), 0.1), ((5, 6), 1e-2), ((5, 6), 1e-6)])
def test_every_step_is_within_its_bound(shape, beta, law, tolerance):
    lattice = random_lattice(shape, seed=5, damping=beta, law=law)
    draw = {
        "uniform": UNIFORM,
        "bimodal": BondLaw("bimodal", fraction=0.6),
        "wide": BondLaw("loguniform", kmin=1e-6),
    }[law]
    sites = [[0] * len(shape), [n // 2 for n in shape]]
    reached = 0
    for seed in range(3):
        changes = draw_changes(draw, shape, seed, 0, 0, 48)
        for omega in (0.1, 0.6):
            after, bound, exact = follow(lattice, omega, sites, changes, tolerance)
            assert np.all(np.abs(after - exact) <= bound)
            assert np.all(bound <= min(tolerance, 1e-8) * np.abs(exact))
            reached += len(after)
    assert reached > 20


@pytest.mark.parametrize("tolerance", [1e-2, 1e-12])
def test_a_window_ends_where_its_bound_exceeds_what_is_allowed(tolerance):
    """The 30th step meets a resonance, where bounds exceed 1e-8; 1e-12 they exceed before."""
    changes, lengths = draw_changes(UNIFORM, (4, 4), 1, 0, 0, 40), []
    for seed in range(4):
        lattice = random_lattice((4, 4), seed=seed, damping=1e-6)
        k = np.concatenate([array.ravel() for array in lattice.stiffness])
        k[changes.bond[:30]] = changes.stiffness[:30]
        omega = float(np.sqrt(Reference(bond_arrays((4, 4), k)).eigenvalues()[7]))
        after, bound, exact = follow(lattice, omega, [[1, 2]], changes, tolerance)
        assert np.all(np.abs(after - exact) <= bound)
        assert np.all(bound <= min(tolerance, 1e-8) * np.abs(exact))
        lengths.append(len(after))
    assert 0 < sum(lengths) < 4 * (30 if tolerance > 1e-8 else 20)


@pytest.mark.parametrize("s", [1e20, 1e-20])
def test_units_change_nothing(s):
    lattice = random_lattice((5, 6), seed=5, damping=1e-2)
    stiffness = tuple(s * k for k in lattice.stiffness)
    changes = draw_changes(UNIFORM, (5, 6), 1, 0, 0, 40)
    scaled = Changes(changes.bond, s * changes.stiffness)
    expected, bound, _ = follow(lattice, 0.6, [[2, 2]], changes)
    for mass, speed in ((1.0, np.sqrt(s)), (s, 1.0)):
        other = type(lattice)(stiffness, mass, s / speed * 1e-2)
        found, other_bound, _ = follow(other, 0.6 * speed, [[2, 2]], scaled)
        assert np.abs(found / expected - 1).max() <= 1e-12
        assert np.all((other_bound / bound > 0.1) & (other_bound / bound < 10))


def test_the_bound_covers_a_march_that_went_wrong(monkeypatch):
    """With errors of 1e-7 in the algebra amplitudes are corrected, and the bound still holds."""
    lattice = random_lattice((5, 6), seed=5, damping=1e-2)
    changes = draw_changes(UNIFORM, (5, 6), 1, 0, 0, 40)
    right = follow(lattice, 0.6, [[2, 2]], changes)
    rng = np.random.default_rng(1)

    def spoilt(G, delta):
        T, c = march(G, delta)
        return T * (1 + 1e-7 * rng.standard_normal(T.shape)), c

    monkeypatch.setattr("pgran.solve.windows.march", spoilt)
    after, bound, exact = follow(lattice, 0.6, [[2, 2]], changes)
    assert len(after) == 40
    assert np.all(np.abs(after - exact) <= bound)
    assert np.all(bound > right[1])
    assert np.abs(after / exact - 1).max() < 1e-10


def test_the_bound_covers_block_solves_that_went_wrong(monkeypatch):
    """Errors of 1e-10 in the displacements that bonds make are found in their residuals."""
    factor, rng = SteadySolver.factor.fget, np.random.default_rng(1)

    class Spoilt:
        def __init__(self, solver):
            self.factor = factor(solver)

        def matSolve(self, rhs, found):  # noqa: N802
            self.factor.matSolve(rhs, found)
            block = found.getDenseArray()
            block *= 1 + 1e-10 * rng.standard_normal(block.shape)

    monkeypatch.setattr(SteadySolver, "factor", property(Spoilt))
    lattice = random_lattice((5, 6), seed=5, damping=0.1)
    changes = draw_changes(UNIFORM, (5, 6), 1, 0, 0, 40)
    after, bound, exact = follow(lattice, 0.6, [[2, 2]], changes)
    error = np.abs(after - exact)
    assert len(after) == 40
    assert np.all(error <= bound)
    assert np.median(error / np.abs(exact)) > 1e-12
    assert np.median(bound / error) < 1e3


@pytest.mark.parametrize("spoilt", ["solves", "algebra"])
def test_residuals_after_each_step_are_no_larger_than_said(spoilt):
    """Those of x0 + Y gamma, where the solutions Y or the algebra are wrong by 1e-3."""
    lattice, rng = random_lattice((3, 4), seed=5, damping=0.05), np.random.default_rng(1)
    S, f = Reference(lattice.stiffness, damping=0.05).system(0.6)
    bonds = np.array([2, 11, 13, 20, 26, 30])  # the third ends at the driven wall
    B, k = np.zeros((12, 6)), [array.copy() for array in lattice.stiffness]
    axes, places = bond_places((3, 4), bonds)
    for column, (axis, place) in enumerate(zip(axes, places, strict=True)):
        for step, sign in ((-1, -1.0), (0, 1.0)):
            ball = place + step * (np.arange(2) == axis)
            if np.all((ball >= 0) & (ball < (3, 4))):
                B[np.ravel_multi_index(ball, (3, 4)), column] = sign
    driven = (axes == 0) & (places[:, 0] == 3)
    Y, x0 = (np.linalg.solve(S.astype(complex), b.astype(complex)) for b in (B, f))
    if spoilt == "solves":
        Y *= 1 + 1e-3 * rng.standard_normal(Y.shape)
    G, delta = B.T @ Y, rng.uniform(0.05, 0.2, 6)
    T, c = march(G, delta)
    if spoilt == "algebra":
        c *= 1 + 1e-3 * rng.standard_normal(6)
    missed = np.linalg.norm((B - S @ Y).astype(complex), axis=0)
    moved = Deformation.of(T, c, G, delta, B.T @ x0, driven)
    said = moved.residual(np.linalg.norm((f - S @ x0).astype(complex)), missed)
    for step in range(6):
        k[axes[step]][tuple(places[step])] += delta[step]
        S, f = Reference(k, damping=0.05).system(0.6)
        true = np.linalg.norm((f - S @ (x0 + Y @ moved.coefficients[:, step])).astype(complex))
        assert true <= said[step] <= 10 * true
    assert driven.tolist() == [False, False, True, False, False, False]


def test_the_bound_of_a_step_is_reached(monkeypatch):
    """One ball that a step moves onto its resonance, the algebra being wrong by 1e-5: its bonds end
    at walls, so that b is half as long as the bound assumes, |b|^2 = 2."""

    def spoilt(G, delta):
        T, c = march(G, delta)
        return T, c * (1 + 1e-5)

    monkeypatch.setattr("pgran.solve.windows.march", spoilt)
    lattice = uniform_lattice((1, 1), 0.125, damping=0.1, mass=2.0)
    stiffness = tuple(k.copy() for k in lattice.stiffness)
    stiffness[0][0] = 0.25
    changes = Changes(np.array([0]), np.array([0.125]))
    after, bound, exact = follow(Lattice(stiffness, 2.0, 0.1), 0.5, [[0, 0]], changes)
    error = np.abs(after - exact)
    assert np.all(error <= bound)
    assert np.all(bound <= 2.1 * error)


def test_residuals_of_block_solves_are_no_larger_than_said(comm):
    lattice = random_lattice((6, 5), seed=5, damping=0.02)
    S, _ = Reference(lattice.stiffness, damping=0.02).system(0.6)
    with (
        Operators(lattice, comm) as operators,
        SteadySolver(operators, [[2, 2]]) as solver,
        Windows(ChangingBonds(lattice, operators, None), solver, 0.6j) as windows,
    ):
        windows.start()
        ends, flexibility = operators.ends[:30], windows._flexibility(np.arange(30))
        G, sizes, residuals = flexibility.G, flexibility.norms, flexibility.residuals
        places = operators.numbers(list(np.ndindex(6, 5)))
        B = np.zeros((30, 30))
        for column, (below, above) in enumerate(ends):
            B[above, column] += above >= 0
            B[below, column] -= below >= 0
        Y = np.concatenate(comm.allgather(windows._found.getDenseArray()[:, :30]))[places]
        B = B[places]
    missed = np.sqrt(np.sum(np.abs(B - S @ Y) ** 2, axis=0))
    assert np.all(missed <= residuals)
    assert np.median(residuals / missed) < 200
    assert np.all(np.linalg.norm(Y, axis=0) <= sizes)
    assert np.all(sizes <= 1.02 * np.linalg.norm(Y, axis=0))
    assert np.abs(G - Y.T @ B).max() <= 1e-12 * np.abs(G).max()


@pytest.mark.parametrize("trajectories", [1, 2])
def test_drift_is_how_far_a_window_ends_from_the_next_start(monkeypatch, trajectories):
    """The largest such distance: of all windows the first one, which is spoilt."""
    follow, calls = Windows.follow, []

    def spoilt(self, changes):
        after, bound = follow(self, changes)
        calls.append(len(after))
        return after * (1 + 1e-9 * (len(calls) == 1)), bound

    lattice = random_lattice((4, 5), seed=1, damping=0.01)
    choices = {"steps": 60, "trajectories": trajectories, "window": 20}
    assert solve(lattice, [1, 2], **choices).drift < 1e-12
    monkeypatch.setattr(Windows, "follow", spoilt)
    assert solve(lattice, [1, 2], **choices).drift == pytest.approx(1e-9, rel=1e-3)


def test_on_a_sharp_resonance_windows_end_early_and_stay_exact():
    lattice = random_lattice((4, 4), seed=8, damping=1e-7)
    omega = float(np.sqrt(Reference(lattice.stiffness).eigenvalues()[5]))
    choices = {"omega": omega, "steps": 64, "window": 64, "error_tolerance": 1e-3}
    relaxation = solve(lattice, [1, 2], **choices)
    assert relaxation.factorizations > 2
    assert relaxation.failures == 0
    # No method does better than the condition of the system, here on the resonance itself.
    condition = 2.0 / (smallest_damping_eigenvalue((4, 4)) * omega * 1e-7)
    assert largest_error(lattice, relaxation, range(65)) <= np.finfo(float).eps * condition


def test_draws_depend_on_seed_trajectory_and_step_only():
    whole = draw_changes(UNIFORM, (5, 6), 7, 2, 0, 1000)
    for first, count in ((0, 1), (1, 999), (333, 40), (997, 3)):
        part = draw_changes(UNIFORM, (5, 6), 7, 2, first, count)
        assert np.array_equal(part.bond, whole.bond[first : first + count])
        assert np.array_equal(part.stiffness, whole.stiffness[first : first + count])
    for seed, trajectory in ((8, 2), (7, 3)):
        other = draw_changes(UNIFORM, (5, 6), seed, trajectory, 0, 1000)
        assert np.mean(other.bond == whole.bond) < 0.1


def test_bonds_are_drawn_uniformly():
    changes = draw_changes(UNIFORM, (5, 6), 1, 0, 0, 71_000)
    counts = np.bincount(changes.bond, minlength=bond_count((5, 6)))
    assert len(counts) == 71
    chi_square = np.sum((counts - 1000.0) ** 2 / 1000.0)
    assert abs(chi_square - 70) < 5 * np.sqrt(2 * 70)


def test_differences_count_repeated_bonds():
    lattice = random_lattice((3, 3), seed=1)
    with Operators(lattice, MPI.COMM_SELF) as operators:
        changing = ChangingBonds(lattice, operators, None)
        changes = draw_changes(UNIFORM, (3, 3), 1, 0, 0, 200)
        moved = changing.differences(changes)
        bonds = changing.constants.copy()
        for bond, value, difference in zip(changes.bond, changes.stiffness, moved, strict=True):
            assert difference == value - bonds[bond]
            bonds[bond] = value


def test_changed_operators_equal_rebuilt_ones(world):
    lattice = random_lattice((5, 4), seed=4, damping=0.01)

    def draw(trajectory, first, count):
        return draw_changes(UNIFORM, (5, 4), 3, trajectory, first, count)

    with Operators(lattice, world) as operators:
        changing = ChangingBonds(lattice, operators, draw)
        for trajectory, step in ((0, 60), (1, 10), (1, 40), (1, 5)):
            changing.move_to(trajectory, step)
            changing.apply(draw(trajectory, step, 30))
            stiffness = bond_arrays((5, 4), changing.constants)
            fresh = type(lattice)(stiffness, damping=0.01)
            with Operators(fresh, world) as rebuilt:
                difference = rebuilt.K.copy()
                difference.axpy(-1.0, operators.K)
                assert difference.norm() < 1e-14
                difference.destroy()
                operators.f_stiffness.axpy(-1.0, rebuilt.f_stiffness)
                assert operators.f_stiffness.norm() < 1e-14


@pytest.mark.parametrize("method", ["window", "krylov"])
def test_the_same_bit_for_bit_on_any_number_of_ranks(world, method, monkeypatch):
    """Of each trajectory several units, on several ranks."""
    monkeypatch.setattr("pgran.scenes.relaxation.STEPS_IN_UNIT", 1000)
    lattice = random_lattice((6, 5), seed=6, damping=0.01)
    choices = {
        "steps": 130,
        "trajectories": 3,
        "method": method,
        "window": 20,
        "refresh_iterations": 50,
    }
    at_a_stretch = solve(lattice, [2, 2], **choices)
    monkeypatch.setattr("pgran.scenes.relaxation.STEPS_IN_UNIT", 40)
    alone = solve(lattice, [2, 2], **choices)
    assert np.array_equal(alone.displacement[:, :41], at_a_stretch.displacement[:, :41])
    shared = solve(lattice, [2, 2], world, **choices)
    assert not np.isnan(alone.displacement).any()
    assert not np.isnan(shared.displacement).any()
    assert np.max(np.abs(alone.displacement - shared.displacement)) == 0
    assert np.array_equal(alone.stiffness, shared.stiffness)


def test_few_changes_are_extended_by_ones_that_change_nothing(world):
    lattice = random_lattice((5, 4), seed=6, damping=0.01)
    changes = draw_changes(UNIFORM, (5, 4), 1, 0, 0, 3)
    more = changes.extended(7)
    assert len(more) == 7
    assert len(changes.extended(2)) == 3
    with Operators(lattice, world) as operators:
        changing = ChangingBonds(lattice, operators, None)
        assert np.array_equal(changing.differences(more)[:3], changing.differences(changes))
        assert not changing.differences(more)[3:].any()


def test_a_lattice_that_all_ranks_share(world):
    lattice = random_lattice((6, 7), seed=6, damping=0.01)
    alone = solve(lattice, [2, 2], steps=100)
    together = solve(lattice, [2, 2], world, steps=100, together=True)
    assert np.max(np.abs(alone.displacement - together.displacement)) < 1e-12


@needs_klu
def test_an_inexact_factorization_serves_no_window(solver_options):
    """KLU solves with the conjugate matrix: a KSP makes up for it, block solves cannot."""
    solver_options("-steady_pc_type lu -steady_pc_factor_mat_solver_type klu")
    lattice = random_lattice((5, 4), seed=6, damping=0.1)
    relaxation = solve(lattice, [2, 2], steps=30)
    good = np.flatnonzero(~np.isnan(relaxation.displacement[0, :, 0]))
    assert relaxation.factorizations >= 30
    assert largest_error(lattice, relaxation, good) <= 1e-4


def test_what_misses_the_tolerance_is_marked_within_windows_too():
    lattice = random_lattice((6, 6), seed=4, damping=0.01, law="wide")
    relaxation = solve(lattice, [2, 2], steps=100, error_tolerance=1e-17)
    assert relaxation.failures == 101


def test_bounds_hold_after_many_changes_of_very_different_bonds():
    """What large constants leave behind in K would be more than small ones are."""
    law = BondLaw("loguniform", kmin=1e-9, kmax=1e6)
    lattice = random_lattice((2,), damping=0.01)

    def draw(trajectory, first, count):
        return draw_changes(law, (2,), 3, trajectory, first, count)

    with (
        Operators(lattice, MPI.COMM_SELF) as operators,
        SteadySolver(operators, [[0], [1]]) as solver,
    ):
        changing = ChangingBonds(lattice, operators, draw)
        for step in range(200):
            changing.apply(draw(0, step, 1))
            solver.restart()
            state = solver.solve(0.6j)
            exact = Reference(bond_arrays((2,), changing.constants), damping=0.01)
            error = np.abs(state.displacement - exact.amplitudes(0.6, [[0], [1]]))
            assert np.all(error <= state.error_bound)


def test_the_spectrum_of_a_run(world, caplog):
    """That of |A| at the first detector; with a word where the window lies below the memory."""
    words = "-scene relaxation -lattice_shape 5,4 -detectors 2,2,1,1 -output_progress none"
    words += " -relax_trajectories 4 -spectrum_fit_min"
    for fit, steps, warns in ((0.01, 800, True), (0.1, 80, False)):
        caplog.clear()
        options = resolve(read_words(f"{words} {fit} -relax_steps {steps}".split()))
        records = relaxation_scene.run(options, world)
        if world.rank == 0:
            _, relaxation, spectrum = records
            expected = power_spectrum(np.abs(relaxation.displacement[:, :, 0]), fit, 0.3)
            assert np.array_equal(spectrum.power, expected.power)
            assert spectrum.exponent == expected.exponent
            assert ("corner 1/(2 pi 49)" in caplog.text) == warns


def test_no_spectrum_of_a_series_with_gaps(world, caplog):
    words = "-scene relaxation -lattice_shape 5,4 -detectors 2,2 -output_progress none"
    words += " -relax_steps 200 -spectrum_fit_min .1 -error_tolerance 1e-17"
    records = relaxation_scene.run(resolve(read_words(words.split())), world)
    if world.rank == 0:
        assert len(records) == 2
        assert "no spectrum: some steps have no amplitude" in caplog.text


def test_trajectories_start_alike_and_part():
    lattice = random_lattice((5, 5), seed=6, damping=0.01)
    relaxation = solve(lattice, [2, 2], steps=60, trajectories=2)
    assert relaxation.displacement.shape == (2, 61, 1)
    assert relaxation.displacement[0, 0] == relaxation.displacement[1, 0]
    assert np.all(relaxation.displacement[0, 30:] != relaxation.displacement[1, 30:])
    for trajectory in (0, 1):
        assert largest_error(lattice, relaxation, [60], trajectory) < 1e-10


def test_windows_need_a_factorization(solver_options):
    solver_options("-steady_pc_type jacobi")
    lattice = random_lattice((4, 4), damping=0.1)
    with pytest.raises(InputError, match="relax_method window"):
        solve(lattice, [1, 1], steps=4)


def test_windows_need_damping():
    """And without, the other methods have bounds."""
    lattice = random_lattice((4, 4), damping=0.0)
    with pytest.raises(InputError, match="needs damping"):
        solve(lattice, [1, 1], steps=4)
    relaxation = solve(lattice, [1, 1], omega=1.3, steps=20, method="krylov")
    assert relaxation.failures == 0
    assert np.all(relaxation.error_bound <= 1e-4 * relaxation.amplitude)
    assert largest_error(lattice, relaxation, range(21)) <= 1e-4


def test_steps_that_miss_their_accuracy_hold_no_number(solver_options):
    solver_options("-steady_ksp_type richardson -steady_ksp_max_it 1 -steady_pc_type none")
    lattice = random_lattice((4, 4), damping=0.01)
    relaxation = solve(lattice, [1, 1], steps=5, method="krylov")
    assert relaxation.failures == 6
    assert np.all(np.isnan(relaxation.displacement))


def test_the_window_depends_on_the_size_alone():
    assert window_length(400) < window_length(40_000)


def campaign(steps):
    """Print the largest errors at 200 random steps of long runs."""
    zeros = BondLaw("bimodal", kmin=0.0, fraction=0.7)
    print("largest relative error at 200 random steps, drift, steps that miss their accuracy")
    for shape, sites in (((30,), [[14]]), ((7, 6), [[3, 2]]), ((4, 3, 4), [[1, 1, 2]])):
        for beta in (1e-4, 1e-2, 1.0):
            for name, law in (("uniform", UNIFORM), ("bonds of 0", zeros)):
                lattice = Lattice(law.draw(shape, 5), damping=beta, kmax=0.25)
                run = solve(lattice, sites, law=law, omega=0.6, steps=steps)
                good = np.flatnonzero(np.isfinite(run.displacement[0, :, 0]))
                chosen = np.random.default_rng(1).choice(good, 200, replace=False)
                error = largest_error(lattice, run, chosen)
                print(
                    f"{' x '.join(map(str, shape)):10} beta {beta:<6g} {name:10} {error:.1e} "
                    f"{run.drift:.1e} {run.failures:6}",
                    flush=True,
                )


if __name__ == "__main__":
    campaign(int(sys.argv[1]))
