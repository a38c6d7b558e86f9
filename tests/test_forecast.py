"""The forecast of a dry run against what runs take, and against its own mathematics."""

import re
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc
from samples import random_lattice

from pgran.command import forecast, needs, trials
from pgran.command.costs import FILLED, Costs, dissection
from pgran.errors import InputError
from pgran.files.options import SCENES
from pgran.files.reading import read_file, read_words, resolve
from pgran.scenes import response
from pgran.scenes.common import make_lattice
from pgran.solve.counting import ModeCounter
from pgran.solve.linear import factor_package
from pgran.solve.operators import Operators
from pgran.solve.steady import SteadySolver

PROJECT = Path(forecast.__file__).parents[2]
UNITS = {"kB": 1e3, "MB": 1e6, "GB": 1e9}


def foreseen(world, name, *words):
    """The lines of the forecast of a shipped experiment, {first word: the rest}."""
    given = read_file(PROJECT / "options" / f"{name}.opts") + read_words(words)
    lines = forecast.forecast(resolve(given, "a.h5"), world, time.perf_counter())
    lines = world.bcast(lines)
    return dict(line.split(maxsplit=1) for line in lines)


# Nested dissection


@pytest.mark.parametrize(
    "shape",
    [(100,), (20_000,), (20, 20), (100, 100), (10, 1000), (6, 6, 6), (14, 14, 14), (4, 30, 30)],
)
def test_entries_of_petscs_factor(shape):
    lattice = random_lattice(shape)
    with (
        Operators(lattice, MPI.COMM_SELF) as operators,
        SteadySolver(operators, [[n // 2 for n in shape]]) as solver,
    ):
        solver.solve(0.5j)
        found = solver.factor.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"]
    assert found / 1.7 < dissection(shape)[0] < found * 1.7


@pytest.mark.parametrize(
    ("shape", "entries", "operations"), [((2**18,), 2, 2), ((2**9,) * 3, 2**4, 2**6)]
)
def test_growth_of_dissection(shape, entries, operations):
    """Twice as long: entries like n in a chain and n^(4/3) in a cube, operations like n, n^2."""
    small, large = dissection(shape), dissection([2 * n for n in shape])
    assert large[0] / small[0] == pytest.approx(entries, rel=0.05)
    assert large[1] / small[1] == pytest.approx(operations, rel=0.05)


def test_dissection_of_a_square():
    """The leading terms of A. George, SIAM J. Numer. Anal. 10 (1973)."""
    sides = 2**12 - 1, 2**13 - 1
    small, large = (np.array(dissection((n, n))) for n in sides)
    entries = (large[0] / sides[1] ** 2 - small[0] / sides[0] ** 2) / FILLED
    assert entries == pytest.approx(31 / 4, rel=0.01)
    assert large[1] / sides[1] ** 3 == pytest.approx(2 * 829 / 84, rel=0.05)


def test_dissection_sees_the_lattice_not_its_axes():
    assert dissection((7, 300)) == pytest.approx(dissection((300, 7)), rel=0.1)
    assert dissection((300, 1)) == dissection((300,))


# Trials


@pytest.mark.parametrize("shape", [(50,), (20, 20), (3, 500), (5, 6, 7), (1, 1)])
def test_small_lattices_are_tried_themselves(shape):
    assert trials.trial_shape(shape) == shape


@pytest.mark.parametrize("shape", [(10**7,), (500, 500), (3, 10_000), (40, 40, 40), (2, 900, 900)])
def test_large_lattices_are_cut_down(shape):
    small = trials.trial_shape(shape)
    assert all(n <= m for n, m in zip(small, shape, strict=True))
    assert 0.5 < np.prod(small) / trials.LARGEST[len(shape)] < 1.3


def test_detectors_keep_their_distance_from_the_driven_wall():
    sites = np.array([[480, 250], [8, 499]])
    assert trials.trial_sites(sites, (500, 500), (40, 40)).tolist() == [[20, 20], [0, 39]]
    assert np.array_equal(trials.trial_sites(sites, (500, 500), (500, 500)), sites)


@pytest.mark.parametrize("shape", [(1000, 1000), (40, 40)])
def test_a_trial_factors_as_the_large_lattice_would(world, shape):
    """The key that it takes for this is given back."""
    before, package = PETSc.Options().getAll(), factor_package(shape, world.size)
    with trials.steady_solver(random_lattice((6, 5)), shape, world, [[2, 2]]) as (_, solver):
        units = range(5)
        trial = trials.try_steady(world, (6, 5), solver, 0.5, units, lambda unit: (1, 1))
        assert solver._krylov.pc.getFactorSolverType() == package == trial.costs.package
    assert PETSc.Options().getAll() == before


def test_points_are_shared_out_in_units():
    """The first point of a rank takes longer; 10 units on 4 groups are 3 for one of them."""
    costs = Costs((20, 20), "petsc")
    trial = trials.Trial(costs, 0.2, 0.1, 1.0, 2.0)
    for groups, points in ((1, 100), (2, 50), (4, 30), (20, 10)):
        _, seconds = needs._scaled(trial, (20, 20), 100, 10, groups, 1)
        assert seconds == pytest.approx(0.2 + 0.1 * (points - 1))
    _, alone = needs._scaled(trial, (200, 200), 100, 10, 1, 1)
    _, shared = needs._scaled(trial, (200, 200), 100, 10, 1, 4)
    assert 2 < alone / shared < 4


def test_memory_of_a_lattice_that_ranks_share():
    costs = Costs((300, 300), "mumps")
    assert 16 * costs.entries < costs.factor_bytes < min(40 * costs.entries, costs.bytes(2))
    assert costs.bytes(2, 4) < 0.5 * costs.bytes(2)
    assert costs.bytes(2, 1, 96) - costs.bytes(2) == pytest.approx(96 * 16 * 300 * 300)


def test_work_on_the_lattice_itself_is_not_scaled():
    costs = Costs((20, 20), "petsc")
    trial = trials.Trial(costs, 0.2, 0.1, 1.0, 2.0)
    assert trial.scaled(costs) == (0.2, 0.1)
    first, later = trial.scaled(Costs((200, 200), "petsc"))
    assert first > 0.2
    assert 100 < later / 0.1 < 1000  # between n and n^(3/2)


# Forecasts


@pytest.mark.parametrize("damping", [0.003, 0.03])
def test_factorizations_are_foreseen(world, monkeypatch, damping):
    """Once the trial has taken all units, it has counted what the run will need."""
    monkeypatch.setattr(trials, "SECONDS", np.inf)
    words = f"-lattice_damping {damping} -sweep_min .5 -sweep_max .6 -sweep_points 101".split()
    given = read_file(PROJECT / "options" / "response.opts") + read_words(words)
    records = response.run(resolve([*given, *read_words(["-output_progress", "none"])]), world)
    needed = records[1].factorizations if world.rank == 0 else None
    assert f"about {world.bcast(needed)} fact" in foreseen(world, "response", *words)["work"]


def test_modes_are_foreseen(world):
    assert "400 modes" in foreseen(world, "modes")["work"]
    text = "-lattice_shape 60,60 -modes_omega_min 0 -modes_omega_max .5"
    some = foreseen(world, "modes", *text.split())["work"]
    modes, slices = map(int, re.match(r"about (\d+) modes in about (\d+) slices", some).groups())
    given = read_file(PROJECT / "options" / "modes.opts") + read_words(text.split())
    with Operators(make_lattice(resolve(given), world), MPI.COMM_SELF) as operators:
        for flag in (PETSc.Mat.Option.SYMMETRIC, PETSc.Mat.Option.HERMITIAN):
            operators.K.setOption(flag, True)
        with ModeCounter(operators.K) as counter:
            below = counter.interval(0.0, 0.25).values()
    assert 0.8 < modes / (max(below) - min(below)) < 1.25
    assert 40 < modes / slices < 100  # about sixty to a slice


def test_without_a_factorization_time_is_not_foreseen(world):
    words = "-lattice_shape 200,200 -steady_pc_type none -steady_ksp_max_it 5"
    database = PETSc.Options("steady_")
    for key, text in (("pc_type", "none"), ("ksp_max_it", "5")):
        database.setValue(key, text)
    try:
        lines = foreseen(world, "response", *words.split())
    finally:
        for key in ("pc_type", "ksp_max_it"):
            database.delValue(key)
    assert "not known" in lines["time"]
    assert "beside the preconditioner" in lines["memory"]
    assert "factor" not in lines["unknowns"]


def test_scenes():
    """All but studies, which take as long as their experiment, many times."""
    assert set(needs.SCENES) == set(SCENES) - {"accuracy"}


def test_a_scene_without_forecast(world, monkeypatch):
    monkeypatch.setattr(forecast, "SCENES", {})
    options = resolve(read_words(["-scene", "response"]), "a.h5")
    lines = forecast.forecast(options, world, time.perf_counter())
    assert lines == (["no forecast for scene response"] if world.rank == 0 else [])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("-detectors 20,0", "outside"),
        ("-bonds_law loguniform", "bonds_kmin"),
        ("-ranks_per_lattice 7", "-ranks_per_lattice 7"),
    ],
)
def test_bad_input_is_met(world, words, message):
    with pytest.raises(InputError, match=message):
        foreseen(world, "response", *words.split())


def test_too_little_memory_and_disk(monkeypatch):
    options = resolve(read_words(["-scene", "response"]), "a.h5")
    found = needs.Needs((20, 20), 0.0, "work", 1e6)
    enough = forecast.report(found, options, 2, 3e9, 3e9, 6e9, 0.5)
    monkeypatch.setattr(forecast, "free_bytes", lambda: 5e9)
    short = forecast.report(found, options, 2, 3e9, 3e9, 6e9, 0.5)
    assert not any(line.startswith("WARNING") for line in enough)
    assert [line for line in short if line.startswith("WARNING")] == [
        "WARNING   6 GB of memory on 2 ranks are more than is free here"
    ]
    monkeypatch.setattr(forecast.shutil, "disk_usage", lambda folder: SimpleNamespace(free=1e5))
    assert "WARNING   1 MB are more than is free on the disk" in forecast.report(
        found, options, 1, 3e6, 3e6, 3e6, 0.5
    )


def test_what_ranks_need_together(world, monkeypatch):
    """Rank 0 holds the result twice, and what it gathers; each other rank what it has not sent."""
    found = needs.Needs((20, 20), 0.0, "work", 1e11, 2e11, 1000.0, gathered=3e11, sent=0.5e11)
    monkeypatch.setattr(forecast, "SCENES", {"response": lambda *given: found})
    options = resolve(read_words(["-scene", "response"]), "a.h5")
    root, other, few = 7e11, 2.5e11, 0.1e11  # `few`: what programs take
    enough = root + (world.size - 1) * other
    for free, warns in ((enough - few, True), (enough + world.size * few, False)):
        monkeypatch.setattr(forecast, "free_bytes", lambda free=free: free)
        lines = world.bcast(forecast.forecast(options, world, time.perf_counter()))
        words = dict(line.split(maxsplit=1) for line in lines)
        assert any("memory" in line for line in lines if line.startswith("WARNING")) == warns
        memory = "700 GB" if world.size == 1 else "700 GB on rank 0, 250 GB on each other rank"
        assert words["memory"].startswith(f"about {memory}; ")
        assert words["time"].startswith("about 17 min on ")
        assert words["disk"].startswith("about 100 GB in a.h5; ")


def test_memory_that_is_free(monkeypatch):
    """What the system has, or less in a container with a limit of its own."""
    texts = {
        "/proc/meminfo": "MemTotal: 99 kB\nMemAvailable: 50 kB\n",
        "/sys/fs/cgroup/memory.max": "30000\n",
        "/sys/fs/cgroup/memory.current": "10000\n",
    }
    monkeypatch.setattr(
        forecast, "Path", lambda name: SimpleNamespace(read_text=lambda: texts[name])
    )
    assert forecast.free_bytes() == 20_000
    texts["/sys/fs/cgroup/memory.max"] = "max\n"
    assert forecast.free_bytes() == 50 * 1024
    del texts["/proc/meminfo"]
    assert forecast.free_bytes() is None


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="no /proc")
def test_memory_that_is_taken():
    said = re.search(r"VmRSS:\s+(\d+) kB", Path("/proc/self/status").read_text())[1]
    assert forecast.resident_bytes() == pytest.approx(1024 * int(said), rel=0.05)


def test_words():
    assert forecast.size(85_123_456) == "85 MB"
    assert forecast.size(1.26e9) == "1.3 GB"
    assert forecast.size(12) == "12 bytes"
    assert forecast.span(0.234) == "0.23 s"
    assert forecast.span(3700) == "62 min"
    assert forecast.span(260_000) == "3 days"


# Against runs

MEMORY = """
import atexit, re
def tell():
    with open("/proc/self/status") as status:
        print("PEAK " + re.search(r"VmHWM:\\s+(\\d+) kB", status.read())[1])
atexit.register(tell)
from pgran.__main__ import console
console()
"""


def number(pattern, text):
    value, unit = re.search(pattern, text).groups()
    return float(value) * UNITS[unit]


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="no /proc")
@pytest.mark.parametrize(
    ("name", "ranks"),
    [
        ("continuum_damped", 1),
        ("modes", 1),
        ("projection_three_modes", 1),
        ("relaxation", 1),
        ("response_damping_large", 2),
    ],
)
def test_memory_and_disk_are_as_foreseen(clean_environment, tmp_path, name, ranks):
    """Of the shipped experiments that take about a second; and a dry run makes no file."""

    def start(*words):
        done = subprocess.run(
            ["mpirun", "-n", str(ranks), sys.executable, "-c", MEMORY, "run",
             str(PROJECT / "options" / f"{name}.opts"), "-output_file", "new/a.h5", *words],
            cwd=tmp_path, env=clean_environment, capture_output=True, text=True, timeout=60,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return done.stdout

    said = start("-dry_run", "-output_log", "new/a.log")
    assert list(tmp_path.iterdir()) == []
    done = start("-output_progress", "none")
    peak = max(float(kilobytes) for kilobytes in re.findall(r"PEAK (\d+)", done)) * 1024
    size = (tmp_path / "new" / "a.h5").stat().st_size
    assert 0.5 < number(r"memory +about ([\d.]+) (\w+)", said) / peak < 2
    assert 0.7 < number(r"disk +about ([\d.]+) (\w+)", said) / size < 1.4


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        ("-bonds_law file -bonds_file none.h5", 4, "none.h5"),
        ("-output_file mine.h5", 4, "exists and is no result"),
        ("-output_file mine.h5/a.h5", 4, "cannot be written"),
    ],
)
def test_files_are_checked(clean_environment, tmp_path, words, code, message):
    (tmp_path / "mine.h5").write_text("mine")
    (tmp_path / "a.opts").write_text("-scene response\n")
    done = subprocess.run(
        [sys.executable, "-m", "pgran", "run", "a.opts", *words.split(), "-dry_run"],
        cwd=tmp_path, env=clean_environment, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == code
    assert message in done.stderr
    assert "Traceback" not in done.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.opts", "mine.h5"]
