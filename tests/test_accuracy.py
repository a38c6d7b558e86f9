"""Error against run time: true errors, the front, solvers that do not work, solver files."""

import logging
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc
from reference import Reference
from samples import random_lattice
from test_journal import stop_at

from pgran import load
from pgran.errors import FileError, InputError, PgranError, StoppedError
from pgran.files import store
from pgran.files.reading import read_words, resolve
from pgran.parallel.agreement import agree
from pgran.parallel.crew import Crew
from pgran.parallel.journal import Journal
from pgran.physics.accuracy import (
    entries,
    front,
    matched,
    mode_bounds,
    read_modes,
    read_response,
    relative_errors,
)
from pgran.results import Accuracy
from pgran.scenes import accuracy
from pgran.scenes.common import driving_frequencies, make_lattice
from pgran.solve import database
from pgran.solve.database import holding, unused

RESPONSE = "-lattice_shape 9,7 -detectors 3,2,5,5 -sweep_omega .1,.35,.6,.9,1.1"
# Units of two frequencies: the first of each is solved to rounding.
SWEEP = "-lattice_shape 6,5 -detectors 3,2,1,4 -sweep_points 128 -sweep_min .3 -sweep_max .9"
RELAXATION = "-accuracy_of relaxation -lattice_shape 7,6 -detectors 2,3 -relax_steps 40"
MODES = "-accuracy_of modes -lattice_shape 8,7"
SOLVERS = {
    "default": "",
    "direct": "-steady_ksp_type preonly\n-steady_pc_type lu\n",
    "iterative": "-steady_pc_type jacobi\n",
    "krylov": "-relax_method krylov\n-steady_refresh_iterations 30\n",
    "dense": "-normal_eps_type lapack\n-normal_ds_method 2\n",
    "missing": "-steady_pc_factor_mat_solver_type no_such_package\n",
    "poor": "-steady_pc_type jacobi\n-steady_ksp_max_it 3\n",
}


@pytest.fixture
def solver(world, shared_path):
    """Return what gives the path of a solver's file: one of SOLVERS, or of its own text."""

    def write(name, text=None):
        path = shared_path / f"{name}.opts"
        if world.rank == 0:
            path.write_text(SOLVERS[name] if text is None else text)
        world.Barrier()
        return str(path)

    return write


def study(world, text, files, comm=None, tolerances="1e-4", repeats=1):
    """Run a study; return its options, and its result on every rank."""
    comm = comm or world
    words = f"-scene accuracy {text} -accuracy_solvers {','.join(files)} -output_progress none"
    more = f" -accuracy_tolerances {tolerances} -accuracy_repeats {repeats}"
    options = resolve(read_words((words + more).split()))
    records = accuracy.run(options, comm)
    return options, comm.bcast(records and records[1])


# True errors


def test_errors_of_a_sweep_are_the_true_ones(world, solver):
    """Against the dense reference; within the tolerance, and falling with it."""
    tolerances = (1e-2, 1e-5, 1e-8)
    options, found = study(
        world, SWEEP, [solver("iterative"), solver("direct")], tolerances="1e-2,1e-5,1e-8"
    )
    assert found.experiment == "response"
    assert found.values == found.compared == 256
    assert found.reference_bound <= 1e-10
    assert found.solver.tolist() == ["iterative"] * 3 + ["direct"] * 3
    assert found.tolerance.tolist() == [*tolerances, *tolerances]
    assert len(set(found.label)) == 6
    assert np.all(found.failures == 0)
    assert np.all(found.error_max <= found.error_bound_max * (1 + 1e-9) + found.reference_bound)
    assert np.all(found.error_bound_max <= found.tolerance)
    assert np.all(found.error_median <= found.error_max)
    assert found.error_max[0] > 10 * found.error_max[1] > 100 * found.error_max[2]
    assert np.all(np.diff(found.iterations[:3]) > 0)
    # the loosest one once more, against numbers that pgran has no part in
    lattice = make_lattice(options, world)
    exact = Reference(lattice.stiffness)
    asked = accuracy.read_configurations(options)[0]
    task = accuracy.make_study(options, lattice)
    with holding(asked.keys), Crew(world, 1) as crew:
        response = world.bcast(task.solve(crew, **asked.choices))
    omegas = driving_frequencies(options)
    mine = [exact.amplitudes(w, response.detector) for w in omegas[world.rank :: world.size]]
    wrong = np.abs(response.displacement[world.rank :: world.size] - mine) / np.abs(mine)
    error = world.allreduce(float(np.max(wrong)), MPI.MAX)
    assert abs(error - found.error_max[0]) <= 2 * found.reference_bound


def test_errors_of_a_relaxation(world, solver):
    tolerances = "1e-2,1e-6"
    files = [solver("default"), solver("krylov")]
    _, found = study(world, RELAXATION, files, tolerances=tolerances)
    assert found.values == found.compared == 41
    assert np.all(found.failures == 0)
    assert np.all(found.error_max <= found.tolerance)
    assert np.all(found.error_bound_max <= found.tolerance * (1 + 1e-12))
    assert found.error_max[0] <= 2 * found.reference_bound  # windows are exact
    assert found.error_max[2] > found.error_max[3]
    assert np.all(found.iterations == -1)


def test_errors_of_modes(world, solver):
    files = [solver("default"), solver("dense")]
    options, found = study(world, MODES, files, tolerances="1e-13")
    exact = np.sqrt(Reference(make_lattice(options, world).stiffness).eigenvalues())
    assert found.values == found.compared == len(exact)
    assert np.all(found.failures == 0)
    assert np.all(found.error_max <= found.reference_bound)
    assert found.reference_bound < 1e-11


def test_what_is_below_the_reference_is_given_as_its_bound():
    value = np.array([1 + 1j, 2.0, -3j])
    reference = entries(value, [1e-6, 1e-3, 1e-9], True)
    found = entries(value + np.array([1e-8, 1e-2, 0]), 0.0, True)
    wanted = [1e-6 / np.sqrt(2), 5e-3, 1e-9 / 3]
    np.testing.assert_allclose(relative_errors(found, reference), wanted, rtol=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_residuals_bound_the_errors_of_modes(world, seed):
    """Exact modes, spoilt: the frequency of each is within its bound."""
    rng = np.random.default_rng(seed)
    options = resolve(read_words(f"-scene modes -lattice_shape 6,5 -bonds_seed {seed}".split()))
    lattice = make_lattice(options, MPI.COMM_SELF)
    K = Reference(lattice.stiffness).K.astype(float)
    values, vectors = np.linalg.eigh(K)
    for scale in (1e-1, 1e-4, 1e-8):
        spoilt = vectors + scale * rng.normal(size=vectors.shape) / np.sqrt(len(K))
        spoilt /= np.linalg.norm(spoilt, axis=0)
        energy = np.sum(spoilt * (K @ spoilt), axis=0)
        residual = np.linalg.norm(K @ spoilt - energy * spoilt, axis=0)
        residual /= np.abs(K).sum(axis=1).max()
        omega = np.sqrt(energy)
        distance = np.min(np.abs(omega[:, None] - np.sqrt(values)), axis=1)
        assert np.all(distance <= mode_bounds(lattice, omega, residual))


def test_what_is_good():
    """Amplitudes whose reason is positive, modes whose residual is small, and none that miss."""
    ones = np.ones((3, 2))
    response = SimpleNamespace(
        displacement=ones, error_bound=ones, converged_reason=np.array([2, 0, -3])
    )
    assert read_response(response, {})["good"].tolist() == [True, True, False, False, False, False]
    modes = SimpleNamespace(omega=np.ones(2), residual=np.array([1e-13, 1e-9]), count_expected=3)
    found = read_modes(random_lattice((3, 2)), modes, {}, 1e-12)
    assert found["good"].tolist() == [True, False, False]


def test_what_is_asked_of_solvers_and_of_the_reference(world, solver):
    words = f"-accuracy_solvers {solver('default')} -accuracy_tolerances 1e-2,1e-12"
    for text in (RESPONSE, RELAXATION, MODES):
        options = resolve(read_words(f"-scene accuracy {text} {words}".split()))
        loose, tight = accuracy.read_configurations(options)
        task = accuracy.make_study(options, make_lattice(options, world))
        if text == MODES:
            asked = [float(c.keys["normal_eps_tol"]) for c in (loose, tight)]
            assert task.certified == 1e-6
        else:
            asked = [c.choices["error_tolerance"] for c in (loose, tight)]
            assert task.exact["error_tolerance"] == task.certified == pytest.approx(1e-13, abs=0)
        assert asked == [1e-2, 1e-12]


def test_seconds_are_those_of_the_middle_repeat():
    study = accuracy.Study("response", None, None, {}, 1e-3)
    rows = np.zeros(3, accuracy.ROW)
    rows["seconds"] = 9.0, 1.0, 2.0
    one = accuracy.Configuration("a", 1e-4, {}, {})
    found = accuracy.assemble(study, [one], entries([1.0], [0.0], True), rows, 3)
    assert (found.seconds, found.seconds_min, found.seconds_max) == (2.0, 1.0, 9.0)


def test_bounds_of_modes_are_residuals_in_their_unit():
    """omega^2 is wrong by no more than the residual, in units of |K|, over the mass."""
    lattice = random_lattice((7, 8), 3, mass=0.5)
    norm = np.abs(Reference(lattice.stiffness).K).sum(axis=1).max()
    bound = mode_bounds(lattice, np.array([1.0]), np.array([1e-6]))
    assert 1e-6 * norm / 0.5 <= bound[0] <= 1.2e-6 * norm / 0.5


@pytest.mark.parametrize("seed", range(5))
def test_missing_modes_leave_the_others_in_place(seed):
    rng = np.random.default_rng(seed)
    omega = np.sort(rng.uniform(size=40))
    omega[7] = omega[6]  # degenerate
    omega[20] = 0.0
    omega.sort()
    bound = np.full(40, 1e-9)
    kept = rng.uniform(size=40) < 0.8
    found = entries((omega + rng.uniform(-1e-9, 1e-9, 40))[kept], bound[kept], True)
    placed = matched(found, entries(omega, bound, True))
    assert np.count_nonzero(placed["good"]) == np.count_nonzero(kept)
    error = np.abs(placed["value"] - omega)[placed["good"]]
    assert np.all(error <= 2e-9)
    assert not np.any(matched(entries(omega + 0.5e-3, bound, True)[:1], placed)["good"])


# The front


@pytest.mark.parametrize("seed", range(20))
def test_front_by_brute_force(seed):
    rng = np.random.default_rng(seed)
    seconds, error = rng.integers(1, 6, (2, 12)).astype(float)
    failures = rng.integers(0, 2, 12)
    broken = rng.uniform(size=12) < 0.2
    seconds[broken], error[broken], failures[broken] = np.nan, np.nan, 3
    fine = failures == 0

    def beaten(one):
        others = [n for n in range(12) if fine[n]]
        return any(
            seconds[n] <= seconds[one]
            and error[n] <= error[one]
            and (seconds[n], error[n]) != (seconds[one], error[one])
            for n in others
        )

    wanted = [bool(fine[one]) and not beaten(one) for one in range(12)]
    assert front(seconds, error, failures).tolist() == wanted


# Solvers that do not work


def test_a_solver_that_does_not_work_is_a_marked_row(world, solver, caplog):
    """On some ranks or on all: one frequency only, so that other ranks have nothing to do."""
    text = RESPONSE.replace(".1,.35,.6,.9,1.1", ".6")
    files = [solver("missing"), solver("default"), solver("poor")]
    with caplog.at_level(logging.WARNING, logger="pgran"):
        _, found = study(world, text, files, repeats=2)
    lines = [r.getMessage() for r in caplog.records if "does not work" in r.getMessage()]
    assert found.failures[0] == 2
    assert np.isnan([found.seconds[0], found.error_max[0], found.error_bound_max[0]]).all()
    assert not found.on_front[0]
    assert found.failures[1] == 0
    assert found.on_front[1]
    assert found.error_max[1] <= 1e-4
    assert found.failures[2] == 2  # marked by itself
    assert np.isnan(found.error_max[2])
    assert np.isfinite(found.seconds[2])
    if world.rank == 0:
        assert len(lines) == 1
        assert lines[0].startswith("missing does not work: ")
        table = list(accuracy.summary([None, found]))
        assert len({len(line) for line in table[1:5]}) == 1  # aligned
        assert [line[0] for line in table[2:5]] == [" ", "*", " "]
    else:
        assert not lines


@pytest.mark.parametrize("kind", [PgranError, PETSc.Error])
def test_an_error_of_one_rank_is_raised_on_all(world, kind):
    row = np.dtype([("unit", int)])
    delivered = []

    def work(unit):
        if unit == 3:
            raise kind("nonsense\nthe reason" if kind is PgranError else 76)
        return np.full(1, unit, row)

    with accuracy.AgreeingCrew(world, 1) as crew:
        with pytest.raises(PgranError, match="the reason" if kind is PgranError else None):
            crew.share(range(8), work, delivered.append, row)
        crew.share(range(8, 12), work, delivered.append, row)
    if world.rank == 0:
        units = sorted(int(unit) for rows in delivered for unit in rows["unit"])
        assert [unit for unit in units if unit >= 8] == [8, 9, 10, 11]
        assert 3 not in units


def test_agreement(world):
    agree(world, None)
    last = world.size - 1
    with pytest.raises(PgranError, match=r"^two$"):
        agree(world, ValueError("one\ntwo") if world.rank == last else None)


def test_no_reference_no_study(world, solver, solver_options):
    """What the experiment's own keys say holds for the reference as well."""
    solver_options("-steady_pc_type jacobi -steady_ksp_max_it 2")
    with pytest.raises(PgranError, match="no reference to compare with"):
        study(world, f"{RESPONSE} -sweep_omega .6", [solver("direct")])


# Solver files and the option database


@pytest.mark.parametrize(
    ("text", "experiment", "message"),
    [
        ("-steady_pc_type lu\n-lattice_mass 2", "response", "-lattice_mass"),
        ("-steady_pc_type lu\n-log_view", "response", "-log_view"),
        ("-steady_pc_type lu\n-relax_method krylov", "response", "-relax_method"),
        ("\n-relax_method krylv", "relaxation", "did you mean krylov"),
        ("\n-steady_refresh_iterations -1", "response", "is not >= 0"),
        ("\n-steady_", "response", "-steady_"),
        ("\n-steady_pc_type python", "response", "could load code"),
    ],
)
def test_a_wrong_solver_file_is_refused_before_any_work(
    world, solver, monkeypatch, text, experiment, message
):
    monkeypatch.setattr(accuracy, "make_lattice", None)
    wrong = solver("wrong", text)
    with pytest.raises(InputError, match=message) as caught:
        study(world, f"-accuracy_of {experiment}", [solver("default"), wrong])
    assert f"({wrong}, line 2)" in str(caught.value)


def test_a_missing_solver_file_is_refused(world, solver):
    with pytest.raises(FileError, match=r"none\.opts"):
        study(world, RESPONSE, [solver("default"), "none.opts"])


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("", "accuracy_solvers is missing"),
        ("-accuracy_solvers a -accuracy_of modes -sweep_points 3", "sweep_points"),
        ("-accuracy_solvers a -accuracy_of modes -detectors 3,3", "detectors"),
        ("-accuracy_solvers a -relax_steps 3", "relax_steps"),
        ("-accuracy_solvers a -accuracy_of modes -modes_count 3", "modes_target"),
        ("-accuracy_solvers a -accuracy_of modes -ranks_per_lattice 2", "ranks_per_lattice"),
        ("-accuracy_solvers a -error_tolerance 1e-3", "error_tolerance"),
        ("-accuracy_solvers a -accuracy_of relaxation -bonds_law file -bonds_file b", "a law"),
    ],
)
def test_options_that_the_experiment_does_not_use(text, key):
    with pytest.raises(InputError, match=key):
        resolve(read_words(f"-scene accuracy {text}".split()))


def test_solvers_of_one_name_are_told_apart(tmp_path):
    files = [tmp_path / name / "a.opts" for name in "xy"]
    for file in files:
        file.parent.mkdir()
        file.write_text("-steady_refresh_iterations 3\n")
    words = f"-scene accuracy -steady_refresh_iterations 5 -accuracy_solvers {files[0]},{files[1]}"
    options = resolve(read_words(words.split()))
    found = accuracy.read_configurations(options)
    assert {c.solver for c in found} == {str(file) for file in files}
    assert all(c.choices["refresh_iterations"] == 3 for c in found)
    assert resolve(read_words(options.text().split())).text() == options.text()


def test_the_option_database_is_as_before(world, solver, solver_options, caplog):
    solver_options("-steady_ksp_type gmres -steady_ksp_max_it 50")
    before = PETSc.Options().getAll()
    files = [
        solver("other", "-steady_ksp_type bcgs\n-steady_ksp_monitr\n"), solver("missing")
    ]  # fmt: skip
    with caplog.at_level(logging.WARNING, logger="pgran"):
        _, found = study(world, RESPONSE, files, tolerances="1e-2,1e-4", repeats=2)
    assert PETSc.Options().getAll() == before
    lines = [r.getMessage() for r in caplog.records if "not used" in r.getMessage()]
    assert len(lines) == (1 if world.rank == 0 else 0)
    assert all("-steady_ksp_monitr of other" in line for line in lines)
    assert found.failures.tolist() == [0, 0, 10, 10]


def test_keys_hold_for_a_while(solver_options):
    solver_options("-steady_one 1")
    database, values = PETSc.Options(), []

    def use():
        with holding({"steady_one": "2", "steady_two": ""}):
            values.extend([database.getInt("steady_one"), database.getBool("steady_two")])
            raise ValueError("stop")

    with pytest.raises(ValueError, match="stop"):
        use()
    assert values == [2, True]
    assert database.getInt("steady_one") == 1
    assert not database.hasName("steady_two")
    with holding({"steady_two": "3"}):
        assert unused(["steady_one", "steady_two"]) == ["steady_two"]


def test_unused_keys_are_asked_for_in_petsc4py_where_it_can_tell(monkeypatch):
    """From 3.19 on; where nothing can tell, none is called unused."""

    class Options:
        def used(self, key):
            return key == "steady_one"

    monkeypatch.setattr(database.ctypes, "CDLL", lambda path: SimpleNamespace())
    with monkeypatch.context() as newer:
        newer.setattr(database.PETSc, "Options", Options)
        assert unused(["steady_one", "steady_two"]) == ["steady_two"]
    if not hasattr(PETSc.Options, "used"):
        assert unused(["steady_one", "steady_two"]) == []


# Ranks, files


def test_errors_do_not_depend_on_the_number_of_ranks(world, solver):
    files = [solver("iterative"), solver("default")]
    _, together = study(world, RESPONSE, files, tolerances="1e-2,1e-6")
    _, alone = study(world, RESPONSE, files, MPI.COMM_SELF, tolerances="1e-2,1e-6")
    for name in ("error_max", "error_median", "error_bound_max", "iterations", "failures"):
        np.testing.assert_array_equal(getattr(together, name), getattr(alone, name))


def test_a_study_goes_on_where_it_stopped(world, solver, shared_path, monkeypatch):
    """No run is repeated, but for a solver that has changed meanwhile."""
    runs, timed = [], accuracy.timed
    monkeypatch.setattr(accuracy, "timed", lambda *given: runs.append(given[1]) or timed(*given))

    def go(text, writes=0):
        runs.clear()
        files = [solver("default"), solver("other", text)]
        words = f"-scene accuracy {RESPONSE} -accuracy_repeats 3 -output_progress none"
        words += f" -accuracy_tolerances 1e-4 -accuracy_solvers {','.join(files)}"
        options = resolve(read_words(words.split()))
        with Journal(world, shared_path / "a.h5", {}) as journal:
            stop_at(journal, writes, 0)
            return accuracy.run(options, world, journal)

    for text, left in (("-steady_pc_type lu", 3), ("-steady_pc_type cholesky", 6)):
        with pytest.raises(StoppedError):
            go("-steady_pc_type lu", 1 + 3)  # the reference, and three runs
        assert len(runs) == 3
        records = go(text)
        assert len(runs) == left
        if world.rank == 0:
            assert np.all(np.isfinite(records[1].seconds))
            assert np.all(records[1].failures == 0)


def made(labels, error, failures):
    count = len(labels)
    numbers = np.arange(1.0, count + 1)
    return Accuracy(
        experiment="response",
        repeats=5,
        values=7,
        compared=7,
        reference_bound=1e-11,
        label=np.array([f"{name} 1e-4" for name in labels]),
        solver=np.array(labels),
        tolerance=np.full(count, 1e-4),
        seconds=numbers,
        seconds_min=0.9 * numbers,
        seconds_max=1.2 * numbers,
        error_max=np.array(error),
        error_median=np.array(error),
        error_bound_max=np.array(error) * 3,
        iterations=np.arange(count),
        failures=np.array(failures),
        on_front=front(numbers, np.array(error), np.array(failures)),
    )


def test_labels_come_back_from_the_file(tmp_path):
    record = made(["µ-lattice", "b"], [1e-3, 1e-5], [0, 0])
    store.write(tmp_path / "a.h5", {"scene": "accuracy"}, [record])
    found = load(tmp_path / "a.h5").accuracy
    assert found.label.tolist() == record.label.tolist()
    assert found.solver.dtype.kind == "U"
    assert found.on_front.tolist() == [True, True]


def test_the_command(tmp_path, clean_environment):
    (tmp_path / "default.opts").write_text("")
    (tmp_path / "a.opts").write_text(f"-scene accuracy {RESPONSE}\n".replace(" -", "\n-"))
    words = ["-accuracy_solvers", "default.opts", "-accuracy_repeats", "2"]
    done = subprocess.run(
        ["mpirun", "-n", "2", sys.executable, "-m", "pgran", "run", "a.opts", *words],
        cwd=tmp_path, env=clean_environment, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found = load(tmp_path / "results" / "a.h5")
    assert found.slepc_version == "not loaded"
    assert found.accuracy.label.tolist() == [f"default {t:g}" for t in (1e-2, 1e-4, 1e-6, 1e-8)]
    assert any("* default" in line for line in done.stderr.splitlines())
