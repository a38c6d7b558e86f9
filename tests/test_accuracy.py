"""Error against run time: true errors, the front, solvers that do not work, solver files."""

import time

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc
from reference import Reference
from samples import option_values, random_lattice, run_scene
from test_journal import stop_at

from pgran.command.resolve import resolve
from pgran.errors import FileError, InputError, PgranError, StoppedError
from pgran.experiments.accuracy.study import entries, front, matched, mode_bounds, relative_errors
from pgran.experiments.modes.normal import ModeSolver
from pgran.experiments.response.scene import sweep
from pgran.medium.sample import make_lattice
from pgran.run.crew import Crew
from pgran.run.frequencies import driving_frequencies
from pgran.run.journal import Journal
from pgran.run.options import read_words
from pgran.run.petsc import holding

RESPONSE = "-lattice_shape 9,7 -detectors 3,2,5,5 -sweep_omega"
# Units of two frequencies: the first of each is solved to rounding.
SWEEP = "-lattice_shape 6,5 -detectors 3,2,1,4 -sweep_points 128 -sweep_min .3 -sweep_max .9"
RELAXATION = "-accuracy_of relaxation -lattice_shape 7,6 -detectors 2,3 -relax_steps 40"
MODES = "-accuracy_of modes -lattice_shape 8,7 -accuracy_repeats 3"
ITERATIVE, MISSING = "-steady_pc_type jacobi", "-steady_pc_factor_mat_solver_type mkl_cpardiso"


@pytest.fixture
def ask(place):
    """Return what resolves the options of a study by solvers, the text of a file each."""

    def asked(text, tolerances="1e-4", **solvers):
        paths = [place(f"{name}.opts", f"\n{keys}\n") for name, keys in solvers.items()]
        words = f"-scene accuracy -accuracy_repeats 1 {text} -output_progress none"
        words += f" -accuracy_tolerances {tolerances} -accuracy_solvers {','.join(map(str, paths))}"
        return resolve(read_words(words.split()))

    return asked


def study(options, world, journal=None):
    """The comparison, on every rank."""
    records = run_scene(options, world, journal) or []
    return world.bcast(next((r for r in records if r.group == "accuracy"), None))


def test_errors_of_a_sweep_are_the_true_ones(world, ask):
    """Against the dense reference; within the tolerance, and falling with it; on any ranks."""
    direct = "-steady_ksp_type preonly\n-steady_pc_type lu"
    options = ask(SWEEP, "1e-2,1e-5,1e-8", iterative=ITERATIVE, direct=direct)
    found, alone = study(options, world), study(options, MPI.COMM_SELF)
    assert found.values == found.compared == 256
    assert found.reference_bound <= 1e-10
    assert found.solver.tolist() == ["iterative"] * 3 + ["direct"] * 3
    assert found.tolerance.tolist() == [1e-2, 1e-5, 1e-8] * 2
    assert np.all(found.error_max <= found.error_bound_max * (1 + 1e-9) + found.reference_bound)
    assert np.all(found.error_bound_max <= found.tolerance)
    assert found.error_max[0] > 10 * found.error_max[1] > 100 * found.error_max[2]
    for name in ("error_max", "error_median", "error_bound_max", "iterations", "failures"):
        np.testing.assert_array_equal(getattr(found, name), getattr(alone, name))
    # the loosest one once more, against numbers that pgran has no part in
    lattice, omegas = make_lattice(options, world), driving_frequencies(options)
    with holding(option_values(ITERATIVE)), Crew(MPI.COMM_SELF, 1) as crew:
        how = {"method": "points", "error_tolerance": 1e-2}
        response = sweep(lattice, omegas, options.detectors, crew, **how)
    exact = Reference(lattice.stiffness)
    exact = np.array([exact.amplitudes(w, response.detector) for w in omegas])
    error = np.max(np.abs(response.displacement - exact) / np.abs(exact))
    assert abs(error - found.error_max[0]) <= 2 * found.reference_bound


def test_errors_of_a_relaxation(world, ask):
    krylov = "-relax_method krylov\n-steady_refresh_iterations 30"
    found = study(ask(RELAXATION, "1e-2,1e-6", default="", krylov=krylov), world)
    assert found.compared == 41
    assert np.all(found.failures == 0)
    assert np.all(found.error_max <= found.tolerance)
    assert found.error_max[0] <= 2 * found.reference_bound <= 1e-7  # windows are exact
    assert found.error_max[2] > found.error_max[3]


def test_errors_failures_and_times_of_modes(world, ask, monkeypatch, caplog):
    """One run is held up on one rank; at other tolerances modes are bad, or a rank fails alone."""
    solve, asked = ModeSolver.solve, []

    def spoilt(self, *arguments):
        asked.append(PETSc.Options("normal_").getString("eps_tol", ""))
        values, vectors, residuals = solve(self, *arguments)
        if len(asked) == 2:  # after the reference
            time.sleep(0.5)
        if asked[-1] == "1e-13":
            residuals[5] = 2e-12
            return values[1:], vectors[1:], residuals[1:]
        if asked[-1] == "0.001":
            raise PgranError("the reason")
        return values, vectors, residuals

    monkeypatch.setattr(ModeSolver, "solve", spoilt)
    found = study(ask(MODES, "1e-11,1e-13,1e-3", default=""), world)
    assert found.values == found.compared == 56
    assert found.failures.tolist() == [0, 2, 56]
    assert np.isnan(found.error_max).tolist() == [False, False, True]
    assert np.nanmax(found.error_max) <= found.reference_bound < 1e-11
    assert ("default does not work: the reason" in caplog.messages) == (world.rank == 0)
    assert found.seconds[0] < 0.3 < 0.5 <= found.seconds_max[0]  # the median, and the slowest rank


def test_what_is_below_the_reference_is_given_as_its_bound():
    value = np.array([1 + 1j, 2.0])
    reference = entries(value, [1e-6, 1e-3], True)
    found = relative_errors(entries(value + np.array([1e-8, 1e-2]), 0.0, True), reference)
    np.testing.assert_allclose(found, [1e-6 / np.sqrt(2), 5e-3], rtol=1e-6)


@pytest.mark.parametrize("scale", [1e-1, 1e-8])
def test_residuals_bound_the_errors_of_modes(scale):
    """Exact modes, spoilt: the frequency of each is within its bound."""
    lattice = random_lattice((6, 5), 3, mass=0.5)
    K = Reference(lattice.stiffness).K.astype(float)
    values, vectors = np.linalg.eigh(K)
    spoilt = vectors + scale * np.random.default_rng(1).normal(size=K.shape) / np.sqrt(len(K))
    spoilt /= np.linalg.norm(spoilt, axis=0)
    energy, norm = np.sum(spoilt * (K @ spoilt), axis=0), np.abs(K).sum(axis=1).max()
    residual = np.linalg.norm(K @ spoilt - energy * spoilt, axis=0) / norm
    omega = np.sqrt(energy / 0.5)
    bound = mode_bounds(lattice, omega, residual)
    assert np.all(np.min(np.abs(omega[:, None] - np.sqrt(values / 0.5)), axis=1) <= bound)
    assert np.all(bound <= 1.2 * (residual + 1e-14) * norm / 0.5 / omega)


def test_missing_modes_leave_the_others_in_place():
    rng = np.random.default_rng(0)
    omega = np.sort(rng.uniform(size=40))
    omega[7], omega[0] = omega[6], 0.0  # degenerate, and at rest
    kept, bound = rng.uniform(size=40) < 0.8, np.full(40, 1e-9)
    found = entries((omega + rng.uniform(-1e-9, 1e-9, 40))[kept], 1e-9, True)
    placed = matched(found, entries(omega, bound, True))
    assert np.count_nonzero(placed["good"]) == np.count_nonzero(kept)
    assert np.all(np.abs(placed["value"] - omega)[placed["good"]] <= 2e-9)
    assert not np.any(matched(entries(omega + 0.5e-3, bound, True)[:1], placed)["good"])


def test_front_by_brute_force():
    rng = np.random.default_rng(0)
    seconds, error = rng.integers(1, 9, (2, 60)).astype(float)
    failures, error[:2] = rng.integers(0, 2, 60), np.nan
    fine = (failures == 0) & np.isfinite(error)
    for found, s, d, good in zip(
        front(seconds, error, failures), seconds, error, fine, strict=True
    ):
        beaten = (seconds <= s) & (error <= d) & ((seconds < s) | (error < d)) & fine
        assert found == (good and not beaten.any())


def test_solvers_that_do_not_work_are_marked_rows(world, ask, solver_options, caplog):
    """On some ranks or on all: one frequency only, so that other ranks have nothing to do."""
    solver_options("-steady_ksp_type gmres -steady_ksp_max_it 50")
    before = PETSc.Options().getAll()
    poor, idle = f"{ITERATIVE}\n-steady_ksp_max_it 3", "-steady_ksp_gcr_restart 9"
    text = f"{RESPONSE} .6 -accuracy_repeats 2"
    found = study(ask(text, missing=MISSING, default="", poor=poor, idle=idle), world)
    assert PETSc.Options().getAll() == before
    assert found.failures.tolist() == [2, 0, 2, 0]
    assert np.isnan(found.seconds).tolist() == [True, False, False, False]
    assert np.isnan(found.error_max).tolist() == [True, False, True, False]
    assert found.on_front[[1, 3]].any()
    assert not found.on_front[[0, 2]].any()
    for beginning in ("missing does not work: ", "-steady_ksp_gcr_restart of idle was not used"):
        assert sum(m.startswith(beginning) for m in caplog.messages) == (world.rank == 0)


def test_no_reference_no_study(world, ask, solver_options):
    solver_options("-steady_pc_type jacobi -steady_ksp_max_it 2")
    with pytest.raises(PgranError, match="no reference to compare with"):
        study(ask(f"{RESPONSE} .6", default=""), world)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ("-lattice_mass 2", "-lattice_mass"), ("-relax_method krylov", "-relax_method"),
        ("-steady_refresh_iterations -1", "is not >= 0"),
        ("-steady_pc_type python", "could load code"),
    ],
)  # fmt: skip
def test_a_wrong_solver_file_is_refused_before_any_work(world, ask, wrong, message):
    """Before the detectors, too, of which there is none."""
    with pytest.raises(InputError, match=message) as caught:
        study(ask("-lattice_shape 4,3 -detectors 9,9", default="", wrong=wrong), world)
    assert "wrong.opts, line 2)" in str(caught.value)


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("", "accuracy_solvers is missing"), ("-accuracy_solvers none.opts", r"none\.opts"),
        ("-accuracy_solvers a -accuracy_of modes -sweep_points 3", "sweep_points"),
        ("-accuracy_solvers a -accuracy_of modes -modes_count 3", "modes_target"),
        ("-accuracy_solvers a -accuracy_of modes -ranks_per_lattice 2", "ranks_per_lattice"),
        ("-accuracy_solvers a -accuracy_of relaxation -bonds_law file -bonds_file b", "a law"),
    ],
)  # fmt: skip
def test_missing_files_and_options_that_the_experiment_does_not_use(world, text, key):
    with pytest.raises((InputError, FileError), match=key):
        study(resolve(read_words(f"-scene accuracy {text}".split())), world)


def test_a_study_goes_on_where_it_stopped(world, ask, shared_path, monkeypatch):
    """No run is repeated, but for a solver that has changed meanwhile."""
    make, runs = ModeSolver.__init__, []
    monkeypatch.setattr(ModeSolver, "__init__", lambda *given: runs.append(1) or make(*given))

    def go(vectors, writes=0):
        runs.clear()
        options = ask(MODES, "1e-13", default="", other=f"-normal_eps_ncv {vectors}")
        with Journal(world, shared_path / "a.h5", {}) as journal:
            stop_at(journal, writes, 0)
            return study(options, world, journal)

    for vectors, left in ((50, 3), (40, 6)):
        with pytest.raises(StoppedError):
            go(50, 1 + 3)  # the reference, and three runs
        assert np.all(go(vectors).failures == 0)
        assert len(runs) == left
