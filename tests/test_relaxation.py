"""One bond a step: every amplitude against a dense solve from the stored bonds and events."""

from itertools import product

import numpy as np
import pytest
from campaigns.relaxation import UNIFORM, largest_error, relaxed
from reference import Reference
from samples import (
    drive,
    needs_klu,
    random_lattice,
    reference_of,
    run_scene,
    steady,
    uniform_lattice,
)

from pgran.command.resolve import resolve
from pgran.errors import InputError
from pgran.files.reading import read_words
from pgran.physics.bondlaw import BondLaw
from pgran.physics.changes import Changes, draw_changes
from pgran.physics.lattice import Lattice, bond_arrays, bond_count, bond_places
from pgran.physics.spectrum import power_spectrum
from pgran.solve import windows
from pgran.solve.bounds import smallest_damping_eigenvalue
from pgran.solve.changing import ChangingBonds
from pgran.solve.steady import SteadySolver
from pgran.solve.windows import Windows, march

LAWS = {  # of the constants that bonds get; those they have are random_lattice's
    "uniform": UNIFORM,
    "bimodal": BondLaw("bimodal", kmin=0.0, fraction=0.6),
    "wide": BondLaw("loguniform", kmin=1e-6),
}
HOPELESS = "-steady_ksp_type richardson -steady_ksp_max_it 1 -steady_pc_type none"


@pytest.mark.parametrize(
    ("shape", "beta", "law"),
    [
        ((30,), 1e-4, "uniform"),
        ((6, 5), 0.01, "uniform"),
        ((5, 6), 0.01, "bimodal"),
        ((3, 4, 3), 1.0, "uniform"),
    ],
)
@pytest.mark.parametrize("method", ["window", "direct", "krylov"])
def test_every_amplitude_is_that_of_the_stored_network(method, shape, beta, law):
    """Also where bonds vanish and come back."""
    lattice = random_lattice(shape, 5, beta, law=law)
    sites = [[0] * len(shape), [n // 2 for n in shape]]
    choices = {"law": LAWS[law], "steps": 120, "method": method, "window": 40, "seed": 3}
    relaxation = relaxed(lattice, sites, **choices)
    assert relaxation.failures == 0
    assert law == "uniform" or np.count_nonzero(relaxation.stiffness == 0) > 30
    allowed = 1e-4 if method == "krylov" else 1e-10
    assert largest_error(lattice, relaxation, range(0, 121, 12)) <= allowed


def test_a_window_of_every_length_gives_the_same():
    lattice = random_lattice((4, 5), seed=1, damping=0.01)
    runs = [relaxed(lattice, [1, 2], steps=150, window=window) for window in (1, 7, 64, 150)]
    for run in runs[1:]:
        difference = np.abs(run.displacement - runs[0].displacement)
        assert np.max(difference / np.abs(runs[0].displacement)) < 1e-11
    # One for each window, and one more at the end of the unit.
    assert [run.factorizations for run in runs] == [150 + 1, 22 + 1, 3 + 1, 1 + 1]


# One window and its bounds


def follow(lattice, omega, sites, changes, tolerance=1e-4):
    """The amplitudes of one window, their bounds, and what they are."""
    with (
        steady(lattice, sites, tolerance=tolerance) as (operators, solver),
        Windows(ChangingBonds(lattice, operators, None), solver, 1j * omega) as followed,
    ):
        followed.start()
        after, bound = followed.follow(changes)
    k, exact = [array.copy() for array in lattice.stiffness], np.empty_like(after)
    axes, places = bond_places(lattice.shape, changes.bond)
    for step in range(len(after)):
        k[axes[step]][tuple(places[step])] = changes.stiffness[step]
        exact[step] = Reference(k, lattice.mass, lattice.damping).amplitudes(omega, sites)
    assert np.all(np.abs(after - exact) <= bound)
    assert np.all(bound <= min(tolerance, windows.LONGEST_REACH) * np.abs(exact))
    return after, bound, exact


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(("shape", "beta"), [((24,), 0.1), ((5, 6), 1e-2), ((5, 6), 1e-6)])
def test_every_step_is_within_its_bound(shape, beta, law):
    lattice, reached = random_lattice(shape, seed=5, damping=beta, law=law), 0
    sites = [[0] * len(shape), [n // 2 for n in shape]]
    for seed, omega in product((0, 1), (0.1, 0.6)):
        changes = draw_changes(LAWS[law], shape, seed, 0, 0, 32)
        reached += len(follow(lattice, omega, sites, changes, 1e-2)[0])
    assert reached > 10


@pytest.mark.parametrize("tolerance", [1e-2, 1e-12])
def test_a_window_ends_where_its_bound_exceeds_what_is_allowed(tolerance):
    """The 30th step meets a resonance, where bounds exceed 1e-8; 1e-12 they exceed before."""
    changes, lengths = draw_changes(UNIFORM, (4, 4), 1, 0, 0, 40), []
    for seed in range(4):
        lattice = random_lattice((4, 4), seed=seed, damping=1e-6)
        k = np.concatenate([array.ravel() for array in lattice.stiffness])
        k[changes.bond[:30]] = changes.stiffness[:30]
        omega = float(np.sqrt(Reference(bond_arrays((4, 4), k)).eigenvalues()[7]))
        lengths.append(len(follow(lattice, omega, [[1, 2]], changes, tolerance)[0]))
    assert 0 < sum(lengths) < 4 * (30 if tolerance > 1e-8 else 20)


def test_repeated_bonds_and_the_driven_wall():
    """Only bonds at the driven wall change, each many times in a window."""
    lattice = random_lattice((3, 2), seed=3, damping=0.02)
    last = bond_count((3, 2)) - 3 * 3  # bonds along x come first; the last two are driven
    changes = Changes(np.array([last - 1, last - 2] * 10), np.linspace(0, 0.3, 20))
    after, _, exact = follow(lattice, 0.4, [[0, 1]], changes)
    assert len(after) == 20
    assert np.all(np.abs(after - exact) <= 1e-12 * np.abs(exact))


def spoil_algebra(monkeypatch, size):
    """Let the algebra of windows be wrong by so much, at random."""
    rng = np.random.default_rng(1)

    def spoilt(G, delta):
        T, c = march(G, delta)
        return T * (1 + size * rng.standard_normal(T.shape)), c

    monkeypatch.setattr(windows, "march", spoilt)


def spoil_solves(monkeypatch, size):
    """Let the displacements that bonds make be wrong by so much."""
    factor, rng = SteadySolver.factor.fget, np.random.default_rng(1)

    class Spoilt:
        def __init__(self, solver):
            self.factor = factor(solver)

        def matSolve(self, rhs, found):  # noqa: N802
            self.factor.matSolve(rhs, found)
            block = found.getDenseArray()
            block *= 1 + size * rng.standard_normal(block.shape)

    monkeypatch.setattr(SteadySolver, "factor", property(Spoilt))


@pytest.mark.parametrize("size", [1e-3, 1e-7])
@pytest.mark.parametrize("spoil", [spoil_algebra, spoil_solves])
def test_the_bound_covers_windows_that_went_wrong(spoil, size, monkeypatch):
    """Residuals find the errors of block solves and of the algebra, which are in part corrected."""
    monkeypatch.setattr(windows, "LONGEST_REACH", 10.0)
    lattice = random_lattice((5, 6), seed=5, damping=0.1)
    changes = draw_changes(UNIFORM, (5, 6), 1, 0, 0, 40)
    _, right, _ = follow(lattice, 0.6, [[2, 2]], changes, 10.0)
    spoil(monkeypatch, size)
    after, bound, exact = follow(lattice, 0.6, [[2, 2]], changes, 10.0)
    error = np.abs(after - exact)
    assert len(after) == 40
    assert np.all(bound > right)
    assert np.median(error / np.abs(exact)) < size
    assert np.median(bound / error) < 1000


def test_the_bound_of_a_step_is_reached(monkeypatch):
    """One ball that a step moves onto its resonance, the algebra being wrong by 1e-5: its bonds end
    at walls, so that b is half as long as the bound assumes, |b|^2 = 2."""

    def spoilt(G, delta):
        T, c = march(G, delta)
        return T, c * (1 + 1e-5)

    monkeypatch.setattr(windows, "march", spoilt)
    lattice = uniform_lattice((1, 1), 0.125, damping=0.1, mass=2.0)
    stiffness = tuple(k.copy() for k in lattice.stiffness)
    stiffness[0][0] = 0.25
    changes = Changes(np.array([0]), np.array([0.125]))
    after, bound, exact = follow(Lattice(stiffness, 2.0, 0.1), 0.5, [[0, 0]], changes)
    assert np.all(bound <= 2.1 * np.abs(after - exact))


def test_drift_is_how_far_a_window_ends_from_the_next_start(monkeypatch):
    """The largest such distance: of all windows the first one, which is spoilt."""
    follow, calls = Windows.follow, []

    def spoilt(self, changes):
        after, bound = follow(self, changes)
        calls.append(len(after))
        return after * (1 + 1e-9 * (len(calls) == 1)), bound

    lattice = random_lattice((4, 5), seed=1, damping=0.01)
    choices = {"steps": 60, "trajectories": 2, "window": 20}
    assert relaxed(lattice, [1, 2], **choices).drift < 1e-12
    monkeypatch.setattr(Windows, "follow", spoilt)
    assert relaxed(lattice, [1, 2], **choices).drift == pytest.approx(1e-9, rel=1e-3)


def test_on_a_sharp_resonance_windows_end_early_and_stay_exact():
    lattice = random_lattice((4, 4), seed=8, damping=1e-7)
    omega = float(np.sqrt(reference_of(lattice).eigenvalues()[5]))
    choices = {"omega": omega, "steps": 64, "window": 64, "error_tolerance": 1e-3}
    relaxation = relaxed(lattice, [1, 2], **choices)
    assert relaxation.factorizations > 2
    assert relaxation.failures == 0
    # No method does better than the condition of the system, here on the resonance itself.
    condition = 2.0 / (smallest_damping_eigenvalue((4, 4)) * omega * 1e-7)
    assert largest_error(lattice, relaxation, range(65)) <= np.finfo(float).eps * condition


# What changes


def test_draws_depend_on_seed_trajectory_and_step_only():
    """And bonds are drawn uniformly."""
    whole = draw_changes(UNIFORM, (5, 6), 7, 2, 0, 71_000)
    for first, count in ((0, 1), (1, 999), (333, 40)):
        part = draw_changes(UNIFORM, (5, 6), 7, 2, first, count)
        assert np.array_equal(part.bond, whole.bond[first : first + count])
        assert np.array_equal(part.stiffness, whole.stiffness[first : first + count])
    for seed, trajectory in ((8, 2), (7, 3)):
        other = draw_changes(UNIFORM, (5, 6), seed, trajectory, 0, 71_000)
        assert np.mean(other.bond == whole.bond) < 0.1
    counts = np.bincount(whole.bond, minlength=bond_count((5, 6)))
    assert len(counts) == 71
    assert abs(np.sum((counts - 1000.0) ** 2 / 1000.0) - 70) < 5 * np.sqrt(2 * 70)


def test_bounds_hold_after_many_changes_of_very_different_bonds():
    """What large constants leave behind in K would be more than small ones are."""
    law = BondLaw("loguniform", kmin=1e-9, kmax=1e6)
    lattice = random_lattice((2,), damping=0.01)
    changes = draw_changes(law, (2,), 3, 0, 0, 200)
    with steady(lattice, [[0], [1]]) as (operators, solver):
        changing = ChangingBonds(lattice, operators, None)
        for step in range(200):
            changing.apply(changes[step : step + 1])
            solver.restart()
            state = drive(solver, 0.6)
            exact = Reference(bond_arrays((2,), changing.constants), damping=0.01)
            error = np.abs(state.displacement - exact.amplitudes(0.6, [[0], [1]]))
            assert np.all(error <= state.error_bound)


@pytest.mark.parametrize("mass", [1.0, 2.0**60])
def test_units_change_nothing(mass):
    """Stiffness in another unit, and mass or frequency with it: not a bit of the amplitudes."""
    s, lattice = 2.0**60, random_lattice((5, 6), seed=5, damping=0.01)
    speed = np.sqrt(s / mass)
    other = Lattice(
        tuple(s * k for k in lattice.stiffness), mass, 0.01 * s / speed, s * lattice.kmax
    )
    found = relaxed(lattice, [2, 2], steps=40)
    law = BondLaw("uniform", kmax=0.25 * s)
    scaled = relaxed(other, [2, 2], law=law, omega=0.5 * speed, steps=40)
    assert np.array_equal(scaled.stiffness, s * found.stiffness)
    assert np.array_equal(scaled.displacement, found.displacement)
    assert np.array_equal(scaled.error_bound, found.error_bound)


# Ranks


@pytest.mark.parametrize("method", ["window", "krylov"])
def test_the_same_bit_for_bit_on_any_number_of_ranks(world, method, monkeypatch):
    """Of each trajectory several units, on several ranks; all start alike and part."""
    monkeypatch.setattr("pgran.scenes.relaxation.STEPS_IN_UNIT", 1000)
    lattice = random_lattice((6, 5), seed=6, damping=0.01)
    choices = {"steps": 130, "trajectories": 3, "method": method, "window": 20}
    choices["refresh_iterations"] = 50
    at_a_stretch = relaxed(lattice, [2, 2], **choices)
    monkeypatch.setattr("pgran.scenes.relaxation.STEPS_IN_UNIT", 40)
    alone = relaxed(lattice, [2, 2], **choices)
    assert np.array_equal(alone.displacement[:, :41], at_a_stretch.displacement[:, :41])
    shared = relaxed(lattice, [2, 2], world, **choices)
    assert shared.failures == 0
    assert np.array_equal(alone.displacement, shared.displacement)
    assert np.array_equal(alone.stiffness, shared.stiffness)
    first, second, _ = shared.displacement[:, :, 0]
    assert first[0] == second[0]
    assert np.all(first[30:] != second[30:])
    assert largest_error(lattice, shared, [130], trajectory=1) < 1e-4


def test_a_lattice_that_all_ranks_share(world):
    lattice = random_lattice((6, 7), seed=6, damping=0.01)
    together = relaxed(lattice, [2, 2], world, world.size, steps=60)
    alone = relaxed(lattice, [2, 2], steps=60)
    assert np.max(np.abs(alone.displacement - together.displacement)) < 1e-12


# What is missed or refused


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
    with pytest.raises(InputError, match="needs damping"):
        relaxed(lattice, [1, 1], steps=4)
    relaxation = relaxed(lattice, [1, 1], omega=1.3, steps=20, method="krylov")
    assert relaxation.failures == 0
    assert np.all(relaxation.error_bound <= 1e-4 * relaxation.amplitude)
    assert largest_error(lattice, relaxation, range(21)) <= 1e-4
    solver_options("-steady_pc_type jacobi")
    with pytest.raises(InputError, match="relax_method window"):
        relaxed(random_lattice((4, 4), damping=0.1), [1, 1], steps=4)


def test_the_spectrum_of_a_run(world, caplog):
    """That of |A| at the first detector; with a word where the window lies below the memory."""
    words = "-scene relaxation -lattice_shape 5,4 -detectors 2,2,1,1 -output_progress none"
    for more, said in (
        ("-spectrum_fit_min .01 -relax_steps 800 -relax_trajectories 4", "corner 1/(2 pi 49)"),
        ("-spectrum_fit_min .1 -relax_steps 80 -relax_trajectories 4", None),
        ("-relax_steps 20 -error_tolerance 1e-17", "no spectrum: some steps have no amplitude"),
    ):
        caplog.clear()
        options = resolve(read_words(f"{words} {more}".split()))
        records = run_scene(options, world)
        if world.rank > 0:
            continue
        assert said in caplog.text if said else not caplog.text
        by_group = {record.group: record for record in records}
        assert ("spectrum" in by_group) == ("no spectrum" not in caplog.text)
        if "spectrum" in by_group:
            series = np.abs(by_group["relaxation"].displacement[:, :, 0])
            expected = power_spectrum(series, options.spectrum_fit_min, 0.3)
            assert np.array_equal(by_group["spectrum"].power, expected.power)
            assert by_group["spectrum"].exponent == expected.exponent
