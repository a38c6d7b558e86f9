"""One bond a step: every amplitude against a dense solve from the stored bonds and events."""

import numpy as np
import pytest
from mpi4py import MPI
from network_samples import as_network
from reference import Reference
from samples import UNIFORM, needs_klu, random_lattice, relaxed, run_scene, steady

import pgran
from pgran.command.resolve import resolve
from pgran.driven.steady import SteadySolver
from pgran.experiments.relaxation import windows
from pgran.experiments.relaxation.fluctuations import power_spectrum
from pgran.experiments.relaxation.windows import BondExchange, Windows, march
from pgran.medium.bonds import bond_arrays, bond_count
from pgran.medium.law import BondLaw, draw_changes
from pgran.run.options import read_words

HOPELESS = "-steady_ksp_type richardson -steady_ksp_max_it 1 -steady_pc_type none"


def exact_amplitudes(lattice, omega, sites, places, constants, steps):
    """Yield the amplitudes after some steps, increasing, by dense solves; places: axes, indices."""
    stiffness, done = [k.copy() for k in lattice.stiffness], 0
    changes = list(zip(*places, constants, strict=True))
    for step in steps:
        for axis, index, constant in changes[done:step]:
            stiffness[axis][tuple(index)] = constant
        done = step
        yield Reference(stiffness, lattice.mass, lattice.damping).amplitudes(omega, sites)


def largest_error(lattice, run, steps, trajectory=0):
    """The largest relative error of the amplitudes after some steps."""
    places, stored = (run.bond_axis[trajectory], run.bond_index[trajectory]), run.stiffness
    events = run.omega, run.detector, places, stored[trajectory]
    exact = np.array([*exact_amplitudes(lattice, *events, sorted(steps))])
    wrong = run.displacement[trajectory, sorted(steps)] - exact
    return float(np.max(np.abs(wrong) / np.abs(exact)))


def follow(lattice, omega, sites, changes, tolerance=1e-4):
    """The amplitudes of one window, their bounds, and what they are."""
    with (
        steady(lattice, sites, tolerance=tolerance) as (operators, solver),
        Windows(BondExchange(lattice, operators, None), solver, 1j * omega) as followed,
    ):
        after, bound = followed.follow(solver.solve(1j * omega), changes)
    places, steps = lattice.bond_places(changes.bond), range(1, len(after) + 1)
    known = [*exact_amplitudes(lattice, omega, sites, places, changes.stiffness, steps)]
    exact = np.array(known, dtype=complex).reshape(after.shape)
    assert np.all(np.abs(after - exact) <= bound)
    assert np.all(bound <= min(tolerance, windows.LARGEST_BOUND) * np.abs(exact))
    return after, bound, exact


@pytest.mark.parametrize("tolerance", [1e-2, 1e-12])
def test_a_window_ends_where_its_bound_exceeds_what_is_allowed(tolerance):
    """The 30th step meets a resonance, where bounds exceed 1e-8; 1e-12 they exceed before."""
    changes, reached = draw_changes(UNIFORM, bond_count((4, 4)), 1, 0, 0, 40), 0
    for seed in range(4):
        lattice = random_lattice((4, 4), seed=seed, damping=1e-6)
        k = lattice.constants.copy()
        k[changes.bond[:30]] = changes.stiffness[:30]
        omega = np.sqrt(Reference(bond_arrays((4, 4), k)).eigenvalues()[7])
        reached += len(follow(lattice, omega, [1, 2], changes, tolerance)[0])
    assert 0 < reached < 4 * (30 if tolerance > 1e-8 else 20)


@pytest.mark.parametrize(("spoilt", "size"), [("march", 1e-3), ("invert", 1e-7)])
def test_the_bound_covers_windows_that_went_wrong(spoilt, size, monkeypatch):
    """Residuals find the errors of block solves and of the algebra, which are in part corrected."""
    monkeypatch.setattr(windows, "LARGEST_BOUND", 10.0)
    changes = draw_changes(UNIFORM, bond_count((5, 6)), 1, 0, 0, 40)
    window = random_lattice((5, 6), 5, 0.1), 0.6, [2, 2], changes, 10.0
    _, right, _ = follow(*window)
    rng, invert = np.random.default_rng(1), SteadySolver.invert

    def noise(x):
        return x * (1 + size * rng.standard_normal(x.shape))

    def marched(G, delta):
        T, c = march(G, delta)
        return noise(T), c

    def solved(solver, rhs, found):
        invert(solver, rhs, found)
        found.getDenseArray()[:] = noise(found.getDenseArray())

    if spoilt == "march":
        monkeypatch.setattr(windows, "march", marched)
    else:
        monkeypatch.setattr(SteadySolver, "invert", solved)
    after, bound, exact = follow(*window)
    error = np.abs(after - exact)
    assert len(after) == 40
    assert np.all(bound > right)
    assert np.median(error / np.abs(exact)) < size
    assert np.median(bound / error) < 1000


def test_drift_is_how_far_a_window_ends_from_the_next_start(monkeypatch):
    """The largest such distance: of all windows the first one, which is spoilt."""
    follow, wrong = Windows.follow, iter([1e-9])
    arguments = random_lattice((4, 5), seed=1, damping=0.01), [1, 2]
    choices = {"steps": 60, "trajectories": 2, "window": 20}

    def spoilt(self, state, changes):
        after, bound = follow(self, state, changes)
        return after * (1 + next(wrong, 0.0)), bound

    assert relaxed(*arguments, **choices).drift < 1e-12
    monkeypatch.setattr(Windows, "follow", spoilt)
    assert relaxed(*arguments, **choices).drift == pytest.approx(1e-9, rel=1e-3)


def test_draws_depend_on_seed_trajectory_and_step_only():
    """And bonds are drawn uniformly: chi^2 of 71 bonds is 70 +- sqrt(140)."""
    whole = draw_changes(UNIFORM, bond_count((5, 6)), 7, 2, 0, 71_000)
    part = draw_changes(UNIFORM, bond_count((5, 6)), 7, 2, 333, 40)
    assert np.array_equal(part.bond, whole.bond[333:373])
    assert np.array_equal(part.stiffness, whole.stiffness[333:373])
    for seed, trajectory in ((8, 2), (7, 3)):
        other = draw_changes(UNIFORM, bond_count((5, 6)), seed, trajectory, 0, 71_000)
        assert np.mean(other.bond == whole.bond) < 0.1
    counts = np.bincount(whole.bond, minlength=bond_count((5, 6)))
    assert abs(np.sum((counts - 1000.0) ** 2 / 1000.0) - 70) < 5 * np.sqrt(2 * 70)


@pytest.mark.parametrize("method", ["window", "krylov"])
def test_the_same_bit_for_bit_on_any_number_of_ranks(world, method, monkeypatch):
    """Of each trajectory several units, on several ranks; all start alike and part.

    Within bounds where the ranks share the lattice.
    """
    monkeypatch.setattr("pgran.experiments.relaxation.scene.STEPS_IN_UNIT", 40)
    lattice = random_lattice((6, 5), seed=6, damping=0.01)
    choices = {"steps": 130, "trajectories": 3, "method": method, "window": 20}
    alone, shared = (relaxed(lattice, [2, 2], comm, **choices) for comm in (MPI.COMM_SELF, world))
    assert shared.failures == 0
    assert np.array_equal(alone.displacement, shared.displacement)
    assert np.array_equal(alone.stiffness, shared.stiffness)
    first, second, _ = shared.displacement[:, :, 0]
    assert first[0] == second[0]
    assert np.all(first[30:] != second[30:])
    assert largest_error(lattice, shared, [130], trajectory=1) < 1e-4
    together = relaxed(lattice, [2, 2], world, world.size, **choices)
    errors = np.abs(alone.displacement - together.displacement)
    assert np.all(errors <= alone.error_bound + together.error_bound)
    assert method == "krylov" or errors.max() < 1e-12


@needs_klu
def test_an_inexact_factorization_serves_no_window(solver_options):
    """KLU solves with the conjugate matrix: a KSP makes up for it, block solves cannot."""
    solver_options("-steady_pc_type lu -steady_pc_factor_mat_solver_type klu")
    lattice = random_lattice((5, 4), seed=6, damping=0.1)
    relaxation = relaxed(lattice, [2, 2], steps=30)
    good = np.flatnonzero(~np.isnan(relaxation.displacement[0, :, 0]))
    assert relaxation.factorizations >= 30
    assert largest_error(lattice, relaxation, good) <= 1e-4


@pytest.mark.parametrize(
    ("method", "options", "tolerance"), [("window", "", 1e-17), ("krylov", HOPELESS, 1e-4)]
)
def test_steps_that_miss_their_accuracy_hold_no_number(method, options, tolerance, solver_options):
    solver_options(options)
    lattice = random_lattice((6, 6), seed=4, damping=0.01, law="wide")
    relaxation = relaxed(lattice, [2, 2], steps=9, method=method, error_tolerance=tolerance)
    assert relaxation.failures == 10
    assert np.all(np.isnan(relaxation.displacement))


def test_windows_need_a_factorization_and_damping(solver_options):
    """And without damping, the other methods have bounds."""
    lattice = random_lattice((4, 4), damping=0.0)
    with pytest.raises(pgran.InputError, match="needs damping"):
        relaxed(lattice, [1, 1], steps=4)
    relaxation = relaxed(lattice, [1, 1], omega=1.3, steps=20, method="krylov")
    assert np.all(relaxation.error_bound <= 1e-4 * relaxation.amplitude)
    assert largest_error(lattice, relaxation, range(21)) <= 1e-4
    solver_options("-steady_pc_type jacobi")
    with pytest.raises(pgran.InputError, match="relax_method window"):
        relaxed(random_lattice((4, 4), damping=0.1), [1, 1], steps=4)


def test_the_spectrum_of_a_run(world, caplog):
    """That of |A| at the first detector; with a word where the window lies below the memory."""
    words = "-scene relaxation -lattice_shape 5,4 -detectors 2,2,1,1 -output_progress none"
    for more, said in (
        ("-spectrum_fit_min .01 -relax_steps 800 -relax_trajectories 4", "corner 1/(2 pi 49)"),
        ("-spectrum_fit_min .1 -relax_steps 130 -relax_trajectories 4", ""),
        ("-relax_steps 20 -error_tolerance 1e-17", "no spectrum: some steps have no amplitude"),
    ):
        caplog.clear()
        options = resolve(read_words(f"{words} {more}".split()))
        found = {record.group: record for record in run_scene(options, world) or []}
        if world.rank == 0:
            assert said in caplog.text
            assert bool(said) == bool(caplog.text)
            assert ("spectrum" in found) == ("no spectrum" not in said)
        if "spectrum" in found:
            series = np.abs(found["relaxation"].displacement[:, :, 0])
            expected = power_spectrum(series, options.spectrum_fit_min, 0.3)
            assert np.array_equal(found["spectrum"].power, expected.power)
            assert found["spectrum"].exponent == expected.exponent


@pytest.mark.parametrize("law", [BondLaw("uniform"), None])
def test_a_medium_after_some_steps(law):
    """Its steady state is that of a relaxation there, and its unit of frequency stays."""
    medium, omega = pgran.Lattice.random((4, 5), damping=0.05), 0.6
    medium, detectors = (medium, [(1, 2)]) if law else (as_network(medium), [7])
    steps = pgran.relax(medium, law, omega, detectors, steps=30, seed=4)
    for step in (0, 7, 30):
        later = pgran.redrawn(medium, step, seed=4, law=law)
        found = pgran.sweep(later, [omega], detectors).displacement[0]
        np.testing.assert_allclose(found, steps.displacement[0, step], rtol=1e-6)
        assert later.omega_mx == medium.omega_mx


def test_bonds_that_are_redrawn_in_vain(caplog):
    same = pgran.Lattice.random((3, 3), law="constant")
    assert pgran.redrawn(same, 5) == same
    assert "-bonds_redrawn 5: each bond has its old constant again" in caplog.text
