"""What a dry run foresees, against what the run takes, and against mathematics of its own."""

import contextlib
import math
import os
import re
import time
import tracemalloc
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from petsc4py import PETSc
from samples import random_lattice, run_scene, steady

from pgran import InputError, Network
from pgran.command import forecast, medium
from pgran.command.resolve import SCENES, resolve
from pgran.experiments.modes import dense, scene
from pgran.medium import crystals as makers
from pgran.run import machine
from pgran.run.options import read_file, read_words
from pgran.run.task import Task

OPTIONS = Path(__file__).parents[1] / "options"


def chosen(name, *words):
    """The options of a shipped experiment, some of them changed."""
    given = read_file(OPTIONS / f"{name}.opts") + read_words([*words, "-output_progress", "none"])
    return resolve(given, "a.h5")


def foreseen(world, options):
    """The lines of a forecast, {first word: the rest}."""
    lines = forecast.forecast(SCENES[options.scene], options, world, time.perf_counter())
    return dict(line.split(maxsplit=1) for line in world.bcast(lines))


@pytest.mark.parametrize("shape", [(100,), (10, 1000), (6, 6, 6)])
def test_entries_of_a_factor(shape):
    with steady(random_lattice(shape), [[n // 2 for n in shape]]) as (_, solver):
        solver.solve(0.5j)
        found = solver.factor.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"]
    assert found / 1.7 < medium.dissection(shape) < found * 1.7


@pytest.mark.parametrize(("axes", "kind"), [(2, "scalar"), (3, "scalar"), (3, "vector")])
def test_entries_and_nonzeros_of_a_network(axes, kind):
    """A network of scalars in space is no chain: its factor fills."""
    network = makers.random_geometric(500, axes, displacement=kind)
    with steady(network, [network.free[0]]) as (_, solver):
        solver.solve(0.5j)
        found = solver.factor.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"]
    assert found / 1.3 < network.graph.entries < found * 1.3
    K = network.restoring_forces(np.eye(network.size))
    blocks = K.reshape(len(network.free), network.components, len(network.free), -1)
    met = np.count_nonzero(np.any(blocks, axis=(1, 3)))
    assert network.graph.nonzeros == met * network.components**2
    if axes == 3:
        ball = np.arange(network.size)
        held = np.where(ball > 0, 0, 2)
        chain = Network(np.stack([ball[:-1], ball[1:]], axis=1), np.ones(len(ball) - 1), held)
        needed = [medium.lattice_memory(each, 1) for each in (network, chain)]
        assert needed[0] > 1.5 * needed[1]


class Counting(Task):
    """Units of ten items, each a tenth of a second by a clock of the test's own."""

    items, row = "items", np.dtype([("value", float), ("factorizations", int)])

    def __init__(self, units, clock):
        self.units, self.clock = [range(10 * i, 10 * i + 10) for i in range(units)], clock

    @contextlib.contextmanager
    def open(self, group):
        self.clock.now += 5.0  # is not shared out

        def work(unit):
            rows = np.ones(len(unit), self.row)
            self.clock.now += 0.1 * len(unit)
            return rows

        yield work

    def length(self, unit):
        return len(unit)

    def sample(self, unit):
        return unit[:2]


@pytest.mark.parametrize("units", [1, 10, 1000])
def test_time_is_that_of_the_units_of_one_group(world, monkeypatch, units):
    clock = SimpleNamespace(now=0.0)
    monkeypatch.setattr(forecast.time, "perf_counter", lambda: clock.now)
    delivered = {}
    with forecast.Rehearsal(world, 1) as crew:
        task = Counting(units, clock)
        with task.open(crew.group) as work:
            crew.share(task, work, delivered.__setitem__)
        ((work_of_all, seconds),) = crew.trials
        assert crew.spent < 3.0  # however many there are
    assert seconds == pytest.approx(math.ceil(units / world.size), abs=0.5)
    if world.rank == 0:
        assert work_of_all == f"{10 * units} items, about {10 * units} factorizations"
        assert sorted(delivered) == list(range(units))
        assert all(len(rows) == 10 for rows in delivered.values())


@pytest.mark.parametrize(
    ("name", "words", "work"),
    [
        ("modes", "", "4.. modes"),
        ("packing_modes", "", "686 modes"),
        ("modes_density", "-lattice_shape 16,15", "60 frequencies"),
        ("response", "-sweep_points 60 -output_fields", "60 frequencies, about 60 factorizations"),
        ("relaxation", "-relax_steps 2000", "2001 states, about 3. factorizations"),
        ("projection_three_modes", "-sweep_points 9", ". modes; 9 frequencies, about .*"),
        ("heater_packing", "-heat_samples 2 -sweep_omega .3", "1 frequencies.*; 2 warm balls"),
        ("accuracy_modes", "-lattice_shape 6,6 -accuracy_repeats 1", "1 runs; 3 runs"),
    ],
)
def test_work_and_disk_are_those_of_the_run(world, monkeypatch, name, words, work):
    monkeypatch.chdir(OPTIONS.parent)
    options = chosen(name, *words.split())
    lines = foreseen(world, options)
    assert re.fullmatch(work, lines["work"])
    records = run_scene(options, world)
    if world.rank == 0:
        value, unit = lines["disk"].split()[1:3]
        size = forecast.stored_bytes(records)
        assert float(value) * {"kB": 1e3, "MB": 1e6}[unit] == pytest.approx(size, rel=0.1)


def test_whole_spectra_are_foreseen_by_smaller_ones(world, monkeypatch):
    """Work grows like n^3, and memory that no trial takes is told of."""
    monkeypatch.setattr(scene, "TRIED", 100)
    monkeypatch.setattr(forecast, "most_resident", lambda: 10**6)
    tried, solve = [], dense.DenseSolver.solve

    def noted(self, count):
        tried.append(count)
        return solve(self, count)

    monkeypatch.setattr(dense.DenseSolver, "solve", noted)
    with forecast.Rehearsal(world, 1) as crew:
        scene.find_modes(random_lattice((20, 20)), crew, method="dense")
        scene.find_modes(random_lattice((8, 8)), crew, method="dense")
        some = scene.find_modes(random_lattice((20, 20)), crew, method="dense", interval=(0.2, 0.7))
    if world.rank == 0:
        assert tried == [100, 64, 100]
        assert 100 < len(some.omega) < 300  # as if modes were spread evenly
        assert crew.untried == dense.memory(400)
        (work, long), (_, short), _ = crew.trials
        assert work == "400 modes"
        assert 3 * short < long < 64 * crew.spent
    options = chosen("modes", "-modes_method", "dense")
    assert foreseen(world, options)["memory"].split()[1] in ("6.1", "1")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("-detectors 20,0", "outside"),
        ("-ranks_per_lattice 7", "-ranks_per_lattice 7"),
    ],
)
def test_bad_input_is_met(world, words, message):
    with pytest.raises(InputError, match=message):
        foreseen(world, chosen("response", *words.split()))


@pytest.mark.parametrize(
    ("scene", "words", "key"),
    [
        ("response", "-lattice_shape 1000,1000", "lattice_shape"),
        ("response", "-lattice_shape 400,400", "lattice_shape"),  # its matrices
        ("response", "-sweep_points 200000 -output_fields", "output_fields"),
        ("response", "-sweep_method curve -sweep_resolve 1e-13", "sweep_resolve"),
        ("continuum", "-sweep_points 1000000", "sweep_points"),
        ("pulse", "-pulse_file drive.txt", "pulse_file"),
        ("pulse", "-pulse_time 1e6 -pulse_points 400000", "pulse_time"),
        ("ensemble", "-ensemble_samples 3000000", "ensemble_samples"),
        ("structure", "-structure_count 100000", "structure_count"),
    ],
)
def test_more_than_is_free_is_refused_before_work(call, place, monkeypatch, scene, words, key):
    """The option is named that asks for it, and next to nothing was allocated."""
    for name in ("total_memory", "free_memory"):
        monkeypatch.setattr(machine, name, lambda: 1e8)
    place("drive.txt", "\n".join(f"{1e-3 * n} {math.sin(n / 9)}" for n in range(200)))
    place("b.opts", f"-scene {scene} {words}")
    tracemalloc.start()
    done = call("run", "b.opts")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert (done.returncode, peak < 5e7) == (2, True), peak
    assert f"-{key}: too much: the arrays" in done.stderr


def test_what_does_not_fit_is_not_tried(world, monkeypatch):
    small, large = (random_lattice((n, n)) for n in (20, 300))
    needed = medium.lattice_memory(small, 1)
    assert medium.lattice_memory(small, 1, factored=False) < needed
    assert medium.lattice_memory(large, 4) < 0.5 * medium.lattice_memory(large, 1)
    by_moments = chosen("structure", "-structure_method", "moments")
    assert not medium.is_factored(by_moments, small)
    assert medium.is_factored(chosen("structure"), small)
    assert not medium.is_factored(chosen("structure"), random_lattice((400, 400)))  # by auto
    assert medium.is_factored(chosen("response"), random_lattice((400, 400)))
    monkeypatch.setattr(forecast, "free_memory", lambda: int(1.2 * needed))
    lines = foreseen(world, chosen("response"))
    assert "nothing was tried" in lines["warning"]
    assert "time" not in lines


def test_warnings_of_memory_and_disk(monkeypatch):
    options, memory = chosen("response"), np.array([7e9, 2e9])
    monkeypatch.setattr(forecast, "free_memory", lambda: 1e10)
    monkeypatch.setattr(forecast.shutil, "disk_usage", lambda folder: SimpleNamespace(free=2e6))
    assert forecast.report(options, memory, 9e9, 1000.0, 1e6) == [
        "memory    about 7 GB on rank 0, 2 GB on others; 10 GB free",
        "time      about 17 min on 2 ranks",
        "disk      about 1 MB in a.h5; 2 MB free",
    ]
    memory, disk = forecast.report(options, memory, 2e10, 1000.0, 3e6)[3:]
    assert memory.split()[:3] == ["warning", "20", "GB"]
    assert disk.split()[:3] == ["warning", "3", "MB"]


def test_memory_that_is_free(monkeypatch):
    """The least of what the system has, control groups around this process, and ulimit leave."""
    home, texts = "/sys/fs/cgroup", {"/proc/meminfo": "MemTotal: 99 kB\nMemAvailable: 50 kB\n"}

    def reading(name):
        if name not in texts:
            raise FileNotFoundError(name)
        return SimpleNamespace(read_text=lambda: texts[name])

    monkeypatch.setattr(machine, "Path", reading)
    assert machine.free_memory() == 50 * 1024
    for said, group, limit, used, cache in (
        ("0::/a/job/step", f"{home}/a/job", "max", "current", "inactive_file"),
        ("4:memory:/a/job", f"{home}/memory", "limit_in_bytes", "usage_in_bytes",
         "total_inactive_file"),
    ):  # fmt: skip
        names = [f"{group}/memory.{name}" for name in (limit, used, "stat")]
        told = ["30000\n", "10000\n", f"anon 7\n{cache} 2000\n"]
        texts |= {"/proc/self/cgroup": f"1:cpu:/b\n{said}\n"} | dict(zip(names, told, strict=True))
        assert machine.free_memory() == 22_000  # a cache gives way
        texts[names[0]] = "5000"
        assert machine.free_memory() == 0
        texts[names[0]] = "max\n"
        assert machine.free_memory() == 50 * 1024
    limits, texts["/proc/self/statm"] = {}, "1 0 0 0 0 2 0"
    monkeypatch.setattr(machine.resource, "getrlimit", lambda kind: limits.get(kind, (-1, -1)))
    for kind, taken in ((machine.resource.RLIMIT_AS, 1), (machine.resource.RLIMIT_DATA, 2)):
        limits[kind] = (40_000 - 9_000 * taken, -1)
        assert machine.free_memory() == limits[kind][0] - taken * os.sysconf("SC_PAGE_SIZE")
        with pytest.raises(InputError, match=r"-x: too much: .* GB are free to this process"):
            machine.check_memory("x", 2**21)
        with pytest.raises(InputError, match=r"ulimit -[vd] \d\d: too little memory"):
            machine.check_limits()
    texts.clear()
    assert machine.free_memory() is None
