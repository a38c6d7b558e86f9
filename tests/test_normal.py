"""Normal modes against dense linear algebra, closed forms and identities."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc
from reference import Reference, uniform_frequencies
from samples import bond_arrays, random_lattice, uniform_lattice

from pgran.errors import InputError
from pgran.parallel.crew import Crew
from pgran.physics import modes as physics_modes
from pgran.physics.lattice import Lattice
from pgran.scenes.modes import _united, certificate, find_modes
from pgran.solve import counting, normal
from pgran.solve.operators import Operators

SOLVERS = Path(__file__).parents[1] / "options" / "solvers"
SHAPES = [(30,), (1, 1), (6, 7), (13, 9), (1, 8), (5, 4, 3)]


@pytest.fixture
def crew(world):
    with Crew(world, 1) as crew:
        yield crew


@pytest.fixture
def narrow(monkeypatch):
    """Make small lattices go through many slices."""
    monkeypatch.setattr(counting, "SLICE", 6)


def from_root(modes, world):
    return world.bcast(modes)


def dense(lattice):
    """K, its eigenvalues in ascending order, and a scale."""
    K = Reference(lattice.stiffness).K.astype(float)
    values = np.linalg.eigvalsh(K)
    return K, values, max(values[-1], 1e-300)


def with_islands(shape, seed=0):
    """A lattice where many bonds are zero and some balls touch nothing."""
    rng = np.random.default_rng(seed)
    draw = lambda size: rng.choice([0.0, 0.25], size, p=[0.5, 0.5])  # noqa: E731
    stiffness = bond_arrays(shape, draw)
    for axis, k in enumerate(stiffness):
        for ball in ((1,) * len(shape), tuple(n // 2 for n in shape)):
            k[ball] = 0
            k[tuple(i + (a == axis) for a, i in enumerate(ball))] = 0
    return Lattice(stiffness, 1.0, 0.003, kmax=0.25)


def check(lattice, modes, low=-np.inf, high=np.inf):
    """Assert that `modes` are all those with low <= lambda <= high, by dense linear algebra."""
    K, values, scale = dense(lattice)
    values = values[(values >= low - 1e-13 * scale) & (values <= high + 1e-13 * scale)]
    assert modes.count_expected == len(values) == len(modes.omega)
    assert modes.count_certified
    assert modes.failures == 0
    F = modes.vector.reshape(-1, lattice.balls)
    assert F.dtype == float
    squares = lattice.mass * modes.omega**2
    np.testing.assert_allclose(squares, values, rtol=0, atol=1e-13 * scale)
    residual = np.linalg.norm(K @ F.T - squares * F.T, axis=0)
    assert residual.max(initial=0) <= 1e-12 * scale
    assert np.all(residual <= (modes.residual + 1e-14) * 2 * scale)
    assert np.abs(F @ F.T - np.eye(len(F))).max(initial=0) <= 1e-10
    assert np.all(F[np.arange(len(F)), np.argmax(np.abs(F), axis=1)] > 0)
    np.testing.assert_allclose(modes.participation, 1 / np.sum(F**4, axis=1), rtol=1e-12)


@pytest.mark.parametrize("law", ["uniform", "bimodal", "wide"])
@pytest.mark.parametrize("shape", SHAPES)
def test_all_modes(shape, law, crew, narrow):
    lattice = random_lattice(shape, seed=5, mass=1.7, law=law)
    modes = from_root(find_modes(lattice, crew, shapes=True), crew.world)
    check(lattice, modes)
    K = Reference(lattice.stiffness).K.astype(float)
    squares = lattice.mass * modes.omega**2
    np.testing.assert_allclose(squares.sum(), np.trace(K), rtol=1e-12)
    np.testing.assert_allclose(np.sum(squares**2), np.sum(K**2), rtol=1e-12)


def test_all_modes_of_the_default_slices(crew):
    lattice = random_lattice((20, 20), seed=2)
    check(lattice, from_root(find_modes(lattice, crew, shapes=True), crew.world))


@pytest.mark.parametrize("shape", [(9, 9), (20, 20), (6, 6, 6), (40,), (7, 11)])
def test_uniform_lattice_is_exact(shape, crew, narrow):
    lattice = uniform_lattice(shape, mass=0.8)
    modes = from_root(find_modes(lattice, crew, shapes=True), crew.world)
    np.testing.assert_allclose(modes.omega, uniform_frequencies(shape, 0.25, 0.8), rtol=1e-12)
    check(lattice, modes)


def test_sine_wave_is_the_lowest_mode(crew):
    shape = (12, 8)
    modes = from_root(find_modes(uniform_lattice(shape), crew, shapes=True), crew.world)
    waves = [np.sin(np.pi * np.arange(1, n + 1) / (n + 1)) for n in shape]
    wave = np.multiply.outer(*waves)
    np.testing.assert_allclose(modes.vector[0], wave / np.linalg.norm(wave), atol=1e-12)


@pytest.mark.parametrize("shape", [(8, 8), (20, 20), (5, 5, 5), (25,)])
def test_islands_have_zero_modes(shape, crew, narrow):
    lattice = with_islands(shape)
    modes = from_root(find_modes(lattice, crew, shapes=True), crew.world)
    check(lattice, modes)
    assert np.count_nonzero(modes.omega < 1e-6) >= 2
    loose = from_root(find_modes(lattice, crew, interval=(0, 1e-4), shapes=True), crew.world)
    check(lattice, loose, 0, 1e-8)


def test_lattice_without_springs(crew):
    lattice = Lattice(bond_arrays((3, 4), np.zeros), 1.0, 0.0, kmax=0.25)
    modes = from_root(find_modes(lattice, crew, shapes=True), crew.world)
    assert modes.count_certified
    np.testing.assert_array_equal(modes.omega, 0)


CASES = [
    ("uniform", (14, 11)), ("bimodal", (12, 12)), ("islands", (13, 10)), ("equal", (10, 10)),
    ("uniform", (6, 5, 4)), ("bimodal", (5, 5, 5)), ("islands", (6, 5, 4)), ("equal", (5, 5, 5)),
]  # fmt: skip


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(("kind", "shape"), CASES)
def test_random_intervals_miss_no_mode(kind, shape, seed, crew, narrow):
    """8 intervals each, 128 in all, a quarter of their ends on a mode."""
    if kind == "islands":
        lattice = with_islands(shape, seed)
    elif kind == "equal":
        lattice = uniform_lattice(shape)
    else:
        lattice = random_lattice(shape, seed=seed, law=kind)
    _, values, scale = dense(lattice)
    omegas = np.sqrt(np.maximum(values, 0))
    rng = np.random.default_rng([seed, *shape])
    for _ in range(8):
        ends = np.where(
            rng.uniform(size=2) < 0.25,
            rng.choice(omegas, 2),
            rng.uniform(0, 1.05 * np.sqrt(scale), 2),
        )
        low, high = np.sort(ends)
        modes = from_root(find_modes(lattice, crew, interval=(low, high), shapes=True), crew.world)
        check(lattice, modes, low**2, high**2)


def test_interval_is_one_of_omega(crew):
    lattice = random_lattice((9, 8), mass=2.5)
    modes = from_root(find_modes(lattice, crew, interval=(0.2, 0.4), shapes=True), crew.world)
    assert modes.omega.min() > 0.2
    assert modes.omega.max() < 0.4
    check(lattice, modes, 2.5 * 0.2**2, 2.5 * 0.4**2)


def test_a_search_that_failed_is_repeated_elsewhere(crew, monkeypatch, narrow):
    """Degenerate modes, so that failed searches had deflated some."""
    fields, calls = normal.ModeSolver._fields, []

    def spoilt(self, vectors):
        calls.append(len(vectors))
        return fields(self, vectors[:-1] if len(calls) % 3 else vectors)

    monkeypatch.setattr(normal.ModeSolver, "_fields", spoilt)
    lattice = uniform_lattice((8, 8))
    check(lattice, from_root(find_modes(lattice, crew, shapes=True), crew.world))


@pytest.mark.parametrize("interval", [(0.0, 1e-3), (1.5, 1.6), (5.0, 6.0)])
def test_empty_interval(interval, crew):
    modes = from_root(find_modes(random_lattice((9, 9)), crew, interval=interval), crew.world)
    assert modes.count_expected == len(modes.omega) == 0
    assert modes.count_certified


@pytest.mark.parametrize("count", [1, 7, 40, 1000])
@pytest.mark.parametrize("target", [0.0, 0.43, 0.9, 3.0])
def test_modes_nearest_to_a_target(target, count, crew):
    lattice = random_lattice((10, 13), seed=4)
    modes = from_root(find_modes(lattice, crew, targets=[target], count=count), crew.world)
    omegas = np.sqrt(dense(lattice)[1])
    nearest = omegas[np.argsort(np.abs(omegas - target))[:count]]
    assert modes.count_expected == len(modes.omega) == min(count, 130)
    assert modes.count_certified
    assert modes.vector is None
    np.testing.assert_allclose(modes.omega, np.sort(nearest), rtol=1e-12)


def test_modes_nearest_to_several_targets(crew):
    lattice, targets = random_lattice((10, 13), seed=4), [0.3, 0.31, 0.8]
    modes = from_root(find_modes(lattice, crew, targets=targets, count=9), crew.world)
    omegas = np.sqrt(dense(lattice)[1])
    nearest = {i for t in targets for i in np.argsort(np.abs(omegas - t))[:9]}
    assert modes.count_expected == len(nearest)
    np.testing.assert_allclose(modes.omega, omegas[sorted(nearest)], rtol=1e-12)


def test_intervals_that_overlap_are_joined():
    """Also one that lies within another; each keeps the counts of its ends."""
    around = [{6: 5, 9: 8}, {0: 0, 4: 3}, {1: 1, 2: 2}, {3: 2, 5: 4}]
    assert _united(around) == [{0: 0, 5: 4}, {6: 5, 9: 8}]


@pytest.mark.parametrize("kind", ["uniform", "islands"])
def test_number_of_ranks_does_not_matter(kind, crew, narrow):
    lattice = with_islands((9, 8)) if kind == "islands" else random_lattice((9, 8))
    together = from_root(find_modes(lattice, crew, shapes=True), crew.world)
    with Crew(MPI.COMM_SELF, 1) as single:
        alone = find_modes(lattice, single, shapes=True)
    np.testing.assert_array_equal(together.omega, alone.omega)
    np.testing.assert_array_equal(together.vector, alone.vector)


@pytest.mark.parametrize("name", ["dense", "slicing", "shift_invert", "ciss"])
def test_solver_files(name, crew, solver_options):
    lines = (SOLVERS / f"modes_{name}.opts").read_text().splitlines()
    solver_options(" ".join(line for line in lines if not line.startswith("#")))
    lattice = random_lattice((9, 9), seed=8)
    modes = from_root(find_modes(lattice, crew, shapes=True), crew.world)
    check(lattice, modes)
    part = from_root(find_modes(lattice, crew, interval=(0.3, 0.6), shapes=True), crew.world)
    check(lattice, part, 0.3**2, 0.6**2)


@pytest.mark.parametrize("name", ["slicing", "shift_invert", "ciss"])
@pytest.mark.parametrize("speed", [2.0**33, 2.0**-33])
def test_units_change_nothing(name, speed, crew, solver_options):
    """Stiffness 4^33 = 7e19 times as large or small: other frequencies, the same digits."""
    lines = (SOLVERS / f"modes_{name}.opts").read_text().splitlines()
    solver_options(" ".join(line for line in lines if not line.startswith("#")))
    lattice = random_lattice((6, 5), seed=8)
    scaled = Lattice(tuple(speed**2 * k for k in lattice.stiffness), 1.0)
    modes, others = (
        from_root(find_modes(some, crew, interval=(0.3 * unit, 0.6 * unit)), crew.world)
        for some, unit in ((lattice, 1.0), (scaled, speed))
    )
    assert modes.count_certified
    assert others.count_certified
    np.testing.assert_array_equal(speed * modes.omega, others.omega)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "which",
    [{"interval": (0.0, 1e300)}, {"interval": (1e200, 1e201)}, {"targets": [1e300], "count": 3}],
)
def test_frequencies_too_high_to_compute_with(crew, which):
    with pytest.raises(InputError, match="too large"):
        find_modes(random_lattice((4, 3)), crew, **which)


def test_errors_of_petsc_are_not_hidden():
    """A slepc4py from PyPI raises a SystemError, PETSc's own error being its cause."""
    with pytest.raises(PETSc.Error, match="71"), normal.plain_errors():
        raise SystemError("returned a result with an exception set") from PETSc.Error(71)
    with pytest.raises(SystemError, match="another") as info, normal.plain_errors():
        raise SystemError("another") from ValueError("cause")
    assert isinstance(info.value.__cause__, ValueError)


def test_missing_modes_are_never_certified(crew, monkeypatch, caplog):
    found = normal.ModeSolver._search
    monkeypatch.setattr(normal.ModeSolver, "_search", lambda *arguments: found(*arguments)[:-1])
    lattice = random_lattice((7, 7))
    modes = from_root(find_modes(lattice, crew, interval=(0.3, 0.6)), crew.world)
    assert not modes.count_certified
    assert modes.failures == modes.count_expected - len(modes.omega) > 0
    assert "NOT ALL" in certificate(modes, len(modes.omega))
    said = f"{len(modes.omega)} of {modes.count_expected} modes found for omega^2 m from"
    assert crew.world.allreduce(said in caplog.text, MPI.LOR)
    near = from_root(find_modes(lattice, crew, targets=[0.5], count=4), crew.world)
    assert not near.count_certified
    assert near.failures == near.count_expected - len(near.omega) > 0


def test_a_mode_found_twice_makes_up_for_none_that_is_missing(crew, monkeypatch, narrow):
    """As many modes as were counted, but not slice by slice."""
    find = normal.ModeSolver.solve

    def spoilt(self, low, high, count):
        modes = find(self, low, high, count)
        chosen = np.arange(count)
        if low < 0:  # the lowest slice
            chosen = chosen[1:]
        if high > self.norm:  # the highest
            chosen = np.append(chosen, count - 1)
        return tuple(part[chosen] for part in modes)

    monkeypatch.setattr(normal.ModeSolver, "solve", spoilt)
    modes = from_root(find_modes(random_lattice((7, 7)), crew), crew.world)
    assert len(modes.omega) == modes.count_expected
    assert not modes.count_certified
    assert modes.failures > 0


def test_inaccurate_modes_are_never_certified(crew, monkeypatch):
    stiff = physics_modes.restoring_forces
    monkeypatch.setattr(physics_modes, "restoring_forces", lambda k, f: stiff(k, f) + 1e-9 * f**2)
    modes = from_root(find_modes(random_lattice((7, 7)), crew), crew.world)
    assert len(modes.omega) == modes.count_expected
    assert not modes.count_certified
    assert modes.failures > 0
    assert "NOT CERTIFIED" in certificate(modes, len(modes.omega))


@pytest.fixture
def counter():
    """A counter for a lattice, with its eigenvalues."""
    lattice = random_lattice((8, 9), seed=3)
    with Operators(lattice, MPI.COMM_SELF) as operators:
        for flag in (PETSc.Mat.Option.SYMMETRIC, PETSc.Mat.Option.HERMITIAN):
            operators.K.setOption(flag, True)
        with counting.ModeCounter(operators.K) as counter:
            yield counter, dense(lattice)[1]


def test_counts_equal_dense_ones(counter):
    counter, values = counter
    for shift in np.random.default_rng(0).uniform(-0.1, 1.5, 200):
        count = counter.below(shift, 1e-9)
        assert count == np.count_nonzero(values < shift)


def test_count_at_a_mode_is_refused(counter):
    counter, values = counter
    for value in values:
        for off in (0.0, 0.4e-6, -0.9e-6):
            assert counter.below(value + off, 1e-6) is None


def test_spoilt_factors_are_refused():
    """A tiny pivot: 1e-14 at a ball that the factorization meets before its neighbour."""
    matrix = PETSc.Mat().createDense(
        (2, 2), array=np.array([[0.5, 1], [1, 0.5]]), comm=MPI.COMM_SELF
    )
    sparse = matrix.convert("aij")
    for flag in (PETSc.Mat.Option.SYMMETRIC, PETSc.Mat.Option.HERMITIAN):
        sparse.setOption(flag, True)
    with counting.ModeCounter(sparse) as counter:
        assert counter._inertia(0.3, 1e-12) == 1
        assert counter._inertia(0.5 - 3e-14, 1e-12) is None
    sparse.destroy()
    matrix.destroy()


@pytest.mark.parametrize("wanted", [1, 7, 30])
@pytest.mark.parametrize("omega", [0.0, 0.41, 0.9])
def test_an_interval_around_a_frequency_has_few_more_modes_than_wanted(counter, omega, wanted):
    counter, values = counter
    (low, below), (high, above) = counter.around(omega, 1.0, wanted).items()
    assert wanted <= above - below <= wanted + max(4, wanted // 4)
    assert above - below == np.count_nonzero((values > low) & (values < high))
    nearest = np.sort(np.abs(np.sqrt(values) - omega))[:wanted]
    assert nearest[-1] <= np.sqrt(high) - omega


def test_slices_share_no_mode_and_leave_none(counter, world, narrow):
    counter, values = counter
    slices = counting.cut(counter, counter.interval(0.2, 0.9), world)
    assert len(slices) > 4
    counts = [count for *_, count in slices]
    assert counts == sorted(counts, reverse=True)  # so that ranks end together
    assert all(a[2] + b[2] > 6 for a, b in pairwise(sorted(slices)))
    for low, high, count in slices:
        assert np.count_nonzero((values > low) & (values < high)) == count
        assert count <= 9 + 6
    inside = [low for low, *_ in slices[1:]]
    for shift in inside:
        assert np.abs(values - shift).min() >= 0.9 * counter.clearance
    assert sum(count for *_, count in slices) == np.count_nonzero((values > 0.2) & (values < 0.9))
