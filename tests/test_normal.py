"""Normal modes against dense linear algebra, closed forms and identities."""

from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc
from reference import Reference, uniform_frequencies
from samples import islands, random_lattice, uniform_lattice

from pgran.driven.counting import ModeCounter
from pgran.driven.operators import Operators
from pgran.errors import InputError
from pgran.experiments.modes import normal, slices
from pgran.experiments.modes.scene import certificate, find_modes
from pgran.medium.lattice import Lattice
from pgran.run.crew import Crew

SOLVERS = Path(__file__).parents[1] / "options" / "solvers"
EQUAL, LOOSE = uniform_lattice((5, 5, 5), mass=0.8), islands((9, 8), 5)


@pytest.fixture
def crew(world):
    with Crew(world, 1) as crew:
        yield crew


@pytest.fixture
def narrow(monkeypatch):
    """Make small lattices go through many slices."""
    monkeypatch.setattr(slices, "SLICE", 6)


def modes_of(lattice, crew, **which):
    """The modes and their shapes, on every rank."""
    return crew.world.bcast(find_modes(lattice, crew, **{"shapes": True} | which))


def check(lattice, modes, interval=(0.0, np.inf)):
    """Assert that `modes` are all those of an interval of omega, by dense linear algebra."""
    K = Reference(lattice.stiffness).K.astype(float)
    values = np.linalg.eigvalsh(K)
    scale = values[-1]
    low, high = (lattice.mass * omega**2 for omega in interval)
    values = values[(values >= low - 1e-13 * scale) & (values <= high + 1e-13 * scale)]
    assert modes.count_expected == len(values) == len(modes.omega)
    assert modes.count_certified
    F = modes.vector.reshape(-1, lattice.size)
    assert F.dtype == float
    squares = lattice.mass * modes.omega**2
    np.testing.assert_allclose(squares, values, rtol=0, atol=1e-13 * scale)
    residual = np.linalg.norm(K @ F.T - squares * F.T, axis=0)
    assert residual.max(initial=0) <= 1e-12 * scale
    assert np.all(residual <= (modes.residual + 1e-14) * 2 * scale)
    assert np.abs(F @ F.T - np.eye(len(F))).max(initial=0) <= 1e-10
    assert np.all(F[np.arange(len(F)), np.argmax(np.abs(F), axis=1)] > 0)
    np.testing.assert_allclose(modes.participation, 1 / np.sum(F**4, axis=1), rtol=1e-12)


@pytest.mark.parametrize(
    "lattice",
    [
        random_lattice((30,), 5, mass=1.7), random_lattice((1, 1), 5, mass=1.7),
        random_lattice((6, 7), 5, law="bimodal"), random_lattice((13, 9), 5, law="wide"),
        EQUAL, LOOSE,
    ],
    ids=lambda lattice: "x".join(map(str, lattice.shape)),
)  # fmt: skip
def test_all_modes(lattice, crew, narrow):
    """On any ranks; the closed form for equal bonds, zero modes of loose balls."""
    modes = modes_of(lattice, crew)
    check(lattice, modes)
    with Crew(MPI.COMM_SELF, 1) as single:
        alone = find_modes(lattice, single, shapes=True)
    np.testing.assert_array_equal(modes.omega, alone.omega)
    np.testing.assert_array_equal(modes.vector, alone.vector)
    if lattice is EQUAL:
        exact = uniform_frequencies(lattice.shape, 0.25, lattice.mass)
        np.testing.assert_allclose(modes.omega, exact, rtol=1e-12)
    if lattice is LOOSE:
        assert np.count_nonzero(modes.omega < 1e-6) >= 2
        check(lattice, modes_of(lattice, crew, interval=(0, 1e-4)), (0, 1e-4))


@pytest.mark.parametrize("lattice", [uniform_lattice((9, 9), mass=0.8), islands((5, 4, 4), 1)])
def test_random_intervals_miss_no_mode(lattice, crew, narrow):
    """Some intervals are empty, some begin and end on a mode."""
    omegas = np.sqrt(np.maximum(Reference(lattice.stiffness).eigenvalues(), 0) / lattice.mass)
    rng = np.random.default_rng([1, *lattice.shape])
    ends = rng.uniform(0, 1.05 * omegas[-1], (9, 2))
    ends[::4] = rng.choice(omegas, (3, 2))
    for interval in [*np.sort(ends).tolist(), (0.0, 1e-3), (5.0, 6.0)]:
        check(lattice, modes_of(lattice, crew, interval=interval), interval)


@pytest.mark.parametrize(
    ("targets", "count"),
    [([0.0], 7), ([0.43], 1), ([0.9], 40), ([3.0], 1000), ([0.3, 0.31, 0.8, 0.05, 0.305], 9)],
)
def test_modes_nearest_to_targets(targets, count, crew):
    lattice = random_lattice((10, 13), seed=4)  # of more modes than a slice has
    modes = modes_of(lattice, crew, targets=targets, count=count, shapes=False)
    omegas = np.sqrt(Reference(lattice.stiffness).eigenvalues())
    nearest = {i for t in targets for i in np.argsort(np.abs(omegas - t))[:count]}
    assert modes.count_expected == len(nearest)
    assert modes.count_certified
    assert modes.vector is None
    np.testing.assert_allclose(modes.omega, omegas[sorted(nearest)], rtol=1e-12)


@pytest.mark.parametrize("name", ["dense", "slicing", "shift_invert", "ciss"])
def test_solver_files(name, crew, solver_options):
    """Units change nothing: stiffness 4^33 = 7e19 times as large or small, the same digits."""
    lines = (SOLVERS / f"modes_{name}.opts").read_text().splitlines()
    solver_options(" ".join(line for line in lines if not line.startswith("#")))
    lattice = random_lattice((6, 5), seed=8)
    check(lattice, modes_of(lattice, crew))
    part = modes_of(lattice, crew, interval=(0.3, 0.6))
    check(lattice, part, (0.3, 0.6))
    for unit in (2.0**33, 2.0**-33):
        scaled = Lattice(tuple(unit**2 * k for k in lattice.stiffness), 1.0)
        others = modes_of(scaled, crew, interval=(0.3 * unit, 0.6 * unit))
        assert others.count_certified
        np.testing.assert_array_equal(unit * part.omega, others.omega)


@pytest.mark.filterwarnings("error")
def test_frequencies_too_high_to_compute_with(crew):
    for which in ({"interval": (0.0, 1e300)}, {"targets": [1e300], "count": 3}):
        with pytest.raises(InputError, match="too large"):
            find_modes(random_lattice((4, 3)), crew, **which)


def test_errors_of_petsc_are_not_hidden():
    """A slepc4py from PyPI raises a SystemError, PETSc's own error being its cause."""
    with pytest.raises(PETSc.Error, match="71"), normal.plain_errors():
        raise SystemError("returned a result with an exception set") from PETSc.Error(71)
    with pytest.raises(SystemError, match="another"), normal.plain_errors():
        raise SystemError("another") from ValueError("cause")


def test_a_search_that_failed_is_repeated_elsewhere(crew, monkeypatch, narrow):
    """Degenerate modes, so that failed searches had deflated some."""
    search, calls = normal.ModeSolver._search, []

    def spoilt(*arguments):
        calls.append(1)
        found = search(*arguments)
        return found[:-1] if len(calls) % 3 else found

    monkeypatch.setattr(normal.ModeSolver, "_search", spoilt)
    lattice = uniform_lattice((8, 8))
    check(lattice, modes_of(lattice, crew))


@pytest.mark.parametrize("fault", ["missing", "twice", "inaccurate"])
def test_wrong_modes_are_never_certified(fault, crew, monkeypatch, caplog, narrow):
    """One found twice makes up for none that is missing in another slice."""
    solve, search = normal.ModeSolver.solve, normal.ModeSolver._search

    def spoilt(self, low, high, count, search):
        values, vectors, residuals = solve(self, low, high, count, search)
        chosen = np.arange(len(values))
        if fault == "inaccurate":
            residuals = residuals + 2e-12
        elif fault == "twice" and low < 0:  # the lowest slice
            chosen = chosen[1:]
        elif fault == "twice" and high > self.norm:  # the highest
            chosen = np.append(chosen, count - 1)
        return values[chosen], vectors[chosen], residuals[chosen]

    monkeypatch.setattr(normal.ModeSolver, "solve", spoilt)
    if fault == "missing":
        monkeypatch.setattr(normal.ModeSolver, "_search", lambda *given: search(*given)[:-1])
    modes = modes_of(random_lattice((7, 7)), crew)
    assert not modes.count_certified
    assert modes.failures > 0
    assert (len(modes.omega) < modes.count_expected) == (fault == "missing")
    assert {"missing": "NOT ALL"}.get(fault, "NOT CERTIFIED") in certificate(modes)
    warned = crew.world.allreduce("modes found for omega^2 m from" in caplog.text, MPI.LOR)
    assert warned or fault != "missing"


def test_counts_equal_dense_ones_but_next_to_a_mode():
    """With spoilt factors, too: at 2, between 1 and 3, the first pivot of two balls is tiny."""
    lattice = random_lattice((8, 9), seed=3)
    values = Reference(lattice.stiffness).eigenvalues()
    with (
        Operators(lattice, MPI.COMM_SELF) as operators,
        ModeCounter(operators.K, lattice) as counter,
    ):
        for shift in np.random.default_rng(0).uniform(-0.1, 1.5, 100):
            assert counter.below(shift, 1e-9) == np.count_nonzero(values < shift)
        for value in values:
            for off in (0.0, 0.4e-6, -0.9e-6):
                assert counter.below(value + off, 1e-6) is None
    pair = uniform_lattice((2,), 1.0)
    with Operators(pair, MPI.COMM_SELF) as operators, ModeCounter(operators.K, pair) as counter:
        assert counter.below(1.8, 1e-11) == 1
        assert counter.below(2.0, 1e-11) is None
