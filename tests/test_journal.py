"""Runs that stop and go on: what is finished is kept, whatever cuts the run off."""

import contextlib
import fcntl
import os
import signal
import threading
from types import SimpleNamespace

import numpy as np
import pytest
from result_samples import no_room_beyond
from samples import assert_same, random_lattice

from pgran import (
    BondLaw,
    count_modes,
    find_modes,
    heat,
    pack,
    project,
    pulse,
    relax,
    structure,
    sweep,
)
from pgran.errors import FileError, InputError, StoppedError
from pgran.run.crew import Crew
from pgran.run.journal import MAGIC, RECORD, Journal
from pgran.run.launch import SIGNALS

ROW = np.dtype([("unit", np.int64), ("value", float, (3,))])
UNITS = list(range(11))
RUN = {"-scene": "response", "-bonds_seed": "7"}
JOURNAL = r"a\.h5\.unfinished"
OTHER = RUN | {"-bonds_seed": "8"}


def rows_of(unit):
    rows = np.zeros(1 + unit % 3, ROW)
    rows["unit"] = unit
    rows["value"] = np.random.default_rng(unit).random((len(rows), 3))
    return rows


def fill(journal, positions):
    """Write some units on rank 0; return the stage."""
    stage = journal.stage(0, UNITS, ROW)
    if journal.comm.rank == 0:
        for position in positions:
            journal.write(stage, position, rows_of(position))
    journal.comm.Barrier()
    return stage


@contextlib.contextmanager
def ended_by(kind, said):
    """Expect an error at the end of several statements."""
    with pytest.raises(kind, match=said):
        yield


@pytest.fixture
def result(shared_path):
    return shared_path / "a.h5"


@pytest.fixture
def unfinished(result):
    return result.with_name("a.h5.unfinished")


def left_by(world, result, positions):
    """Leave the journal of a run that was stopped, and return its bytes."""
    with ended_by(StoppedError, "the same command"), Journal(world, result, RUN) as journal:
        fill(journal, positions)
        journal.stop("SIGTERM")
    world.Barrier()
    return journal.path.read_bytes()


def kept_of(world, result, content, run=RUN):
    """The positions of the units in the bytes of a journal, none of them other than written."""
    world.Barrier()
    if world.rank == 0:
        result.with_name("a.h5.unfinished").write_bytes(content)
    with Journal(world, result, run) as journal:
        kept = journal.kept(journal.stage(0, UNITS, ROW), ROW)
        assert all(np.array_equal(rows, rows_of(position)) for position, rows in kept.items())
        fill(journal, [3])
    return world.bcast(list(kept))


def test_what_is_left_of_a_journal(world, result, unfinished):
    """Cut off anywhere, by a kill, it keeps all whole records; damage never passes as results."""
    whole, ends, rng = left_by(world, result, UNITS), [len(MAGIC)], np.random.default_rng(5)
    with Journal(world, result, RUN) as journal:
        others = [(1, UNITS, ROW), (0, UNITS[1:], ROW), (0, UNITS, np.dtype(float))]
        assert not any(journal.kept(journal.stage(*other), other[-1]) for other in others)
        journal.medium = "another"
        assert not journal.kept(journal.stage(0, UNITS, ROW), ROW)
    world.Barrier()
    assert not unfinished.exists()  # once the run is complete
    while ends[-1] < len(whole):
        ends.append(ends[-1] + RECORD.size + RECORD.unpack_from(whole, ends[-1])[2])
    for cut in {0, 1, ends[1] - 1, ends[1], *rng.integers(0, len(whole), 60).tolist()}:
        kept = kept_of(world, result, whole[:cut])
        assert len(kept) == sum(end <= cut for end in ends[2:])
    for place in rng.integers(len(MAGIC), len(whole), 40).tolist():
        damaged = bytearray(whole)
        damaged[place] ^= 1 << int(rng.integers(8))
        assert len(kept_of(world, result, damaged)) < len(UNITS)


def test_another_run_is_refused_by_name(world, result, unfinished):
    before = left_by(world, result, [1])
    for identity, said in (
        (OTHER, r"-bonds_seed: .* with 7, and now it is 8.*overwrite"),
        (RUN | {"-relax_seed": "8"}, r"-relax_seed: .*not given"),
        ({"-scene": "response"}, r"-bonds_seed: .*now it is not given"),
    ):
        with pytest.raises(InputError, match=said):
            Journal(world, result, identity)
    world.Barrier()
    assert unfinished.read_bytes() == before
    world.Barrier()
    with (
        ended_by(StoppedError, "the same command"),
        Journal(world, result, OTHER, overwrite=True) as journal,
    ):
        assert not journal.kept(journal.stage(0, UNITS, ROW), ROW)
        fill(journal, [2])
        journal.stop("SIGTERM")
    world.Barrier()
    with Journal(world, result, OTHER) as journal:  # what replaced it goes on as any other does
        kept = journal.kept(journal.stage(0, UNITS, ROW), ROW)
        assert world.bcast(list(kept)) == [2]


def test_a_run_that_finished_nothing_is_no_obstacle(world, result, unfinished):
    """Stopped before its first unit it leaves nothing; killed, a journal of no worth."""
    with ended_by(StoppedError, "before any work"), Journal(world, result, RUN) as journal:
        empty = unfinished.read_bytes()
        world.Barrier()
        journal.stop("SIGTERM")
    world.Barrier()
    assert not unfinished.exists()
    assert kept_of(world, result, empty, OTHER) == []


def test_signals_wait_until_the_journal_listens(world, result):
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        signal.pthread_kill(threading.get_ident(), signal.SIGUSR1)
        with Journal(world, result, RUN) as journal:
            assert journal.stop_asked == "SIGUSR1"
        signal.pthread_kill(threading.get_ident(), signal.SIGTERM)  # too late to do anything
        assert signal.sigpending() == {signal.SIGTERM}
        assert signal.sigtimedwait(SIGNALS, 0).si_signo == signal.SIGTERM
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def test_a_second_run_and_a_foreign_file_are_refused(world, result, unfinished):
    with Journal(world, result, RUN):
        with pytest.raises(FileError, match="another run is writing this result"):
            Journal(world, result, RUN)
        world.Barrier()
    with Journal(world, result, RUN):  # nothing is left of the lock
        world.Barrier()
    if world.rank == 0:
        unfinished.write_bytes(b"my thesis")
    with pytest.raises(FileError, match="no journal of pgran"):
        Journal(world, result, RUN, overwrite=True)
    assert unfinished.read_bytes() == b"my thesis"


@pytest.mark.parametrize("kind", ["pipe", "link", "folder"])
def test_what_is_no_file_is_no_journal(world, result, unfinished, kind):
    """Nor is a pipe waited for, or a link followed."""
    make = {"pipe": os.mkfifo, "link": lambda path: path.symlink_to("a"), "folder": os.mkdir}
    if world.rank == 0:
        make[kind](unfinished)
    with pytest.raises(FileError, match="in the way, and no journal of pgran; move it away"):
        Journal(world, result, RUN)
    assert not result.with_name("a").exists()


def test_a_signal_is_answered_at_once(world, result, capfd):
    """Once, by rank 0: the work at hand may take longer than mpirun waits."""
    world.Barrier()
    with ended_by(StoppedError, "SIGTERM"), Journal(world, result, RUN) as journal:
        for _ in range(2):
            os.kill(os.getpid(), signal.SIGTERM)
        said = capfd.readouterr().err
        assert said.count("SIGTERM: stopping after the work at hand") == (world.rank == 0)
        journal.stop(journal.stop_asked)


def test_a_file_system_without_locks(world, result, monkeypatch, caplog):
    """The run goes on, unguarded, which is said."""

    def fail(file, how):
        raise OSError(38, "Function not implemented")

    monkeypatch.setattr(fcntl, "flock", fail)
    with Journal(world, result, RUN) as journal:
        fill(journal, [1])
    assert ("this file system has no locks (Function not imp" in caplog.text) == (world.rank == 0)


def test_bad_input_that_turns_up_late(world, result, unfinished):
    """Leaves nothing of a new run, and all of one that went on."""
    for before in (False, True):
        with ended_by(InputError, "late"), Journal(world, result, RUN) as journal:
            fill(journal, [2])
            raise InputError("late")
        world.Barrier()
        assert unfinished.exists() == before
        world.Barrier()
        left_by(world, result, [1])


def test_no_room(world, result, monkeypatch):
    """What was kept before stays, and the error says which file; so it does of a failing disk."""

    def fail(number):
        raise OSError(5, "Input/output error")

    with no_room_beyond(0, JOURNAL):
        Journal(world, result, RUN)
    with Journal(world, result, RUN) as journal:
        stage = fill(journal, [0, 1])
        if world.rank == 0:
            with no_room_beyond(os.stat(journal.path).st_size + 40, JOURNAL):
                journal.write(stage, 2, rows_of(2))
            assert list(journal.kept(stage, ROW)) == [0, 1]
            journal.write(stage, 2, rows_of(2))
            kept = journal.kept(stage, ROW)
            assert list(kept) == [0, 1, 2]
            assert np.array_equal(kept[2], rows_of(2))
        monkeypatch.setattr(os, "fsync", fail)
        with pytest.raises(FileError, match=r"a\.h5\.unfinished: .*Input/output error"):
            journal.stop("SIGTERM")


def stop_at(journal, writes, rank):
    """Let a rank get a signal when rank 0 has written so many more units."""
    write = journal.write

    def counted(*arguments):
        nonlocal writes
        write(*arguments)
        writes -= 1
        if writes == 0:
            os.kill(os.getpid(), signal.SIGUSR1)

    if journal.comm.rank == 0 == rank:
        journal.write = counted
    elif journal.comm.rank == rank:
        os.kill(os.getpid(), signal.SIGTERM)


def stopped_again_and_again(world, path, identity, compute):
    """What a run computes with its journal that is stopped after each unit, and goes on."""
    stopped = 0
    while True:
        try:
            with Journal(world, path, identity) as journal:
                stop_at(journal, 1, 0)
                found = compute(journal)
            break
        except StoppedError:
            stopped += 1
    assert stopped > 0
    return found


@pytest.mark.parametrize("whom", [0, -1])
@pytest.mark.parametrize("together", [False, True])
def test_share_stops_within_a_unit_and_goes_on(world, result, whom, together):
    """A signal to any one rank stops all; other groups go on, and no unit is done twice."""
    size = world.size if together else 1
    task, done, delivered = SimpleNamespace(units=UNITS, row=ROW), [], []

    def work(unit):
        done.append(unit)
        return rows_of(unit)

    def deliver(position, rows):
        delivered.append((position, rows.tobytes()))

    with (
        ended_by(StoppedError, r"SIG(USR1|TERM)"),
        Journal(world, result, RUN) as journal,
        Crew(world, size, journal) as crew,
    ):
        stop_at(journal, 2, whom % world.size)  # of three ranks, each has three units at least
        world.Barrier()
        crew.share(task, work, deliver)
    first = world.allreduce(len(done)) // size
    assert first < len(UNITS)
    delivered.clear()
    done.clear()
    with Journal(world, result, RUN) as journal, Crew(world, 1, journal) as crew:
        crew.share(task, work, deliver)
    assert first + world.allreduce(len(done)) == len(UNITS)
    if world.rank == 0:
        assert len(delivered) == len(UNITS)
        assert dict(delivered) == {unit: rows_of(unit).tobytes() for unit in UNITS}


LATTICE, SITES = random_lattice((7, 6), 3), (3, 3, 6, 0)
OMEGAS = np.linspace(0.05, 1.2, 70)
SCENES = {
    "response": lambda crew: sweep(LATTICE, OMEGAS, SITES, crew, method="points", fields=True),
    "response, curve": lambda crew: sweep(LATTICE, OMEGAS, SITES, crew, method="curve"),
    "modes": lambda crew: find_modes(random_lattice((24, 20), 4), crew, shapes=True),
    "modes, counted": lambda crew: count_modes(LATTICE, OMEGAS[::9], crew),
    "modes, estimated": lambda crew: count_modes(
        LATTICE, OMEGAS[::9], crew, method="moments", vectors=4, diffusivity="y"
    ),
    "projection": lambda crew: project(LATTICE, OMEGAS, crew),
    "pulse": lambda crew: pulse(LATTICE, SITES, crew, width=4.0, time=90, method="laplace"),
    "structure": lambda crew: structure(LATTICE, 3, OMEGAS[9:], crew, method="moments"),
    "relaxation": lambda crew: relax(
        LATTICE, BondLaw("uniform"), 0.6, (3, 3), crew, steps=1100, trajectories=2, window=16
    ),
    "heat, growing balls": lambda crew: grow(crew),
}  # fmt: skip


def grow(crew):
    """Two stages: frequencies, and the packings in which one ball after the other has grown."""
    network, omegas = pack(40, pressure=1e-2, walls="x", shape=(2, 1)), np.array([0.2, 0.4])
    return heat(network, omegas, network.free[:1], crew, radius=1e-3, balls=network.free[1:4])


@pytest.mark.parametrize("name", SCENES)
def test_a_run_that_went_on_equals_one_never_stopped(world, result, name):
    """Bit for bit, whole scenes, stopped after each unit."""
    with Crew(world, 1) as crew:
        expected = SCENES[name](crew)

    def compute(journal):
        with Crew(world, 1, journal) as crew:
            return SCENES[name](crew)

    found = stopped_again_and_again(world, result, RUN, compute)
    if world.rank == 0:
        assert_same(found, expected)
