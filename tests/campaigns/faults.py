"""The fault campaign: pgran never hangs, and never loses what is finished.

    bash jobs/faults.sh [PERCENT]
    python -m campaigns.faults PERCENT [plant] [stop] [interrupt]

Each trial disturbs a run, checks what pgran promises of that, and lets the same command go on, with
another number of ranks: no finished unit is lost, and the result is that of a run never stopped,
bit for bit. Each part prints one line, and before it what went wrong; exit code 1 if anything did.
"""

import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import h5py
import numpy as np
from campaigns import inject

from pgran.run.journal import MAGIC, RECORD

RESULT, JOURNAL, PART = "results/a.h5", "results/a.h5.unfinished", "results/.a.h5.part"
OLD = Path(__file__).resolve().parents[1] / "version1.h5"  # a result, to be replaced
SEED, TRIALS = 1993, 120  # of each part
SECONDS = 60.0  # none of these runs takes longer
SECONDS_TO_STOP = 5.0  # after a fault or a signal, the launcher's own second or two included
# Differ between runs; what solvers did counts from a restart.
VOLATILE = {"solve_seconds", "seconds", "created", "command", "mpi_size", "solvers"}
VOLATILE |= {"REFERENCE_LIST", "DIMENSION_LIST"}  # addresses in the file

SCENES = {
    "response": "-scene response -lattice_shape 20,20 -sweep_points 1500",
    "fields": "-scene response -lattice_shape 30,30 -sweep_points 400 -output_fields",
    "modes": "-scene modes -lattice_shape 36,36 -output_fields",
    "projection": "-scene projection -lattice_shape 20,20 -sweep_points 600",
    "window": "-scene relaxation -lattice_shape 20,20 -lattice_damping .01 -relax_steps 15000",
    "krylov": "-scene relaxation -lattice_shape 9,8 -detectors 3,3 -lattice_damping .01 "
    "-relax_steps 1650 -relax_trajectories 3 -relax_method krylov -relax_window 16",
}


class Job:
    """`pgran run a.opts` in a folder of its own, by which all its processes are known."""

    def __init__(self, folder, ranks, *words, program=("-m", "pgran")):
        """Start it in a folder, with further words; without mpirun on one rank."""
        self.folder, self.log = folder, folder / f"{time.monotonic_ns()}.log"
        launcher = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
        command = [*launcher, sys.executable, *program, "run", "a.opts", *words]
        with open(self.log, "w") as log:
            self.process = subprocess.Popen(
                [*command, "-output_progress", "none"], env=dict(os.environ),
                cwd=folder, stdout=log, stderr=log, start_new_session=True,
                # a shell lets what it starts with & ignore Ctrl-C
                preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
            )  # fmt: skip

    def __str__(self):
        """Return all that was printed, and where."""
        return f"in {self.folder}:\n{self.log.read_text(errors='replace')}"

    def members(self, which=b""):
        """Return the ids of launcher and ranks, of which MPICH's are in sessions of their own."""
        found, home = [], str(self.folder.resolve())
        for path in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):  # of a zombie, too
                words = (path / "cmdline").read_bytes().split(b"\0")
                if os.readlink(path / "cwd") == home and which in (b"", *words[:3]):
                    found.append(int(path.name))
        return found

    def wait_for(self, there):
        """Wait until `there()`, or the end of the job; at most as long as a run may take."""
        deadline = time.monotonic() + SECONDS
        while self.process.poll() is None and not there() and time.monotonic() < deadline:
            time.sleep(0.001)

    def kill(self):
        """Kill all processes at once."""
        while members := self.members():
            for pid in members:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
        self.process.wait()

    def end(self):
        """Wait for the end, of all processes; return the exit code, and the seconds it took."""
        began = time.monotonic()
        self.wait_for(lambda: False)
        code, seconds = self.process.poll(), time.monotonic() - began
        while self.members() and time.monotonic() < began + seconds + 2.0:
            time.sleep(0.05)
        left = self.members()
        self.kill()
        assert code is not None, f"it hangs {self}"
        assert not left, f"it leaves processes {self}"
        return code, seconds


def contents(path):
    """Return the bytes of all datasets and attributes that do not differ between runs."""
    found = {}

    def note(name, item):
        for key in item.attrs.keys() - VOLATILE:
            found[f"{name}@{key}"] = np.asarray(item.attrs[key]).tobytes()
        if isinstance(item, h5py.Dataset):
            found[name] = (item.dtype.str, item.shape, item[()].tobytes())

    with h5py.File(path) as file:
        note("", file)
        file.visititems(note)
    return found


def units_kept(folder):
    """Return how many whole units a journal holds, read independently of pgran."""
    if not (folder / JOURNAL).exists():
        return 0
    data, count, end = (folder / JOURNAL).read_bytes(), -1, len(MAGIC)
    assert data[:end] == MAGIC[: len(data)], f"{folder}: an unreadable journal"
    while end + RECORD.size <= len(data):  # the first record is no unit
        size = RECORD.unpack_from(data, end)[2]
        end += RECORD.size + size
        count += end <= len(data)
    return max(0, count)


def make_folder(scene):
    """Return a new folder with the options file of a scene."""
    folder = Path(tempfile.mkdtemp(prefix=scene, dir="."))
    (folder / "a.opts").write_text(SCENES[scene].replace(" -", "\n-"))
    (folder / "results").mkdir()
    return folder


@cache
def reference(scene):
    """Return the contents of a run never stopped, and its seconds from journal to result."""
    job = Job(make_folder(scene), 1)
    job.wait_for((job.folder / JOURNAL).exists)
    code, seconds = job.end()
    assert code == 0, f"a run that nothing disturbs fails {job}"
    return contents(job.folder / RESULT), seconds


def go_on(folder, scene, ranks, *words):
    """Let the same command go on to the end: nothing finished is lost or done again."""
    done, kept = (folder / RESULT).exists() and not words, units_kept(folder)
    job = Job(folder, ranks, *words)
    code, _ = job.end()
    assert code == (4 if done else 0), f"exit code {code} when going on {job}"
    found = re.search(r"going on from there, (\d+) units", str(job))
    assert done or not kept or int(found[1]) >= kept, f"of {kept} units some were lost {job}"
    left = [path.name for path in (folder / "results").iterdir()]
    assert done or left == ["a.h5"], f"left behind: {left} {job}"
    assert contents(folder / RESULT) == reference(scene)[0], f"not as never stopped {job}"


def carry_out(trial, numbers):
    """Carry out trials; print a line, and return how many fail."""
    tally, slowest = Counter(), 0.0
    for number in numbers:
        try:
            what, seconds = trial(number)
        except AssertionError as error:
            print(f"FAILED: {trial.__name__} {number}: {error}", flush=True)
            what, seconds = "failed", 0.0
        tally[what], slowest = tally[what] + 1, max(seconds, slowest)
    said = ", ".join(f"{n} {what}" for what, n in sorted(tally.items()))
    print(f"{trial.__name__}: {said}; the slowest ended in {slowest:.1f} s", flush=True)
    return tally["failed"]


@dataclass(frozen=True)
class Fault:
    """What is planted where, the exit code, what is said, and whether with a traceback.

    It strikes any rank, and the message names it; but only rank 0 writes, and of the result all
    ranks agree.
    """

    place: str
    statement: str
    code: int
    cause: str
    traceback: bool = False


UNIT, WRITTEN = inject.UNIT, inject.RESULT
RAISE, PLANTED = "raise RuntimeError('planted')", "RuntimeError: planted"
MISUSE = "from petsc4py import PETSc; PETSc.Vec().createSeq(3).setType('nonsense')"
NO_ROOM = "import resource as r; r.setrlimit(r.RLIMIT_FSIZE, (ROOM, r.RLIM_INFINITY))"
LOSE = "import os, shutil; shutil.move('results', 'lost'); open('results', 'w').close()"
FAULTS = {
    "exception": Fault(UNIT, RAISE, 1, PLANTED, traceback=True),
    "start": Fault(inject.LATTICE, RAISE, 1, PLANTED, traceback=True),
    "petsc": Fault(UNIT, MISUSE, 1, "Unknown vector type: nonsense"),
    "exit": Fault(UNIT, "import sys; sys.exit(7)", 7, "ended by sys.exit(7)"),
    "memory": Fault(UNIT, "import numpy as n; n.ones(2**47)", 1, "Unable to allocate", True),
    "interrupt": Fault(UNIT, "import os; os.kill(os.getpid(), 2)", 130, "interrupted"),
    "segfault": Fault(UNIT, "import ctypes; ctypes.string_at(0)", 139, "exited on signal 11"),
    "kill": Fault(UNIT, "import os; os.kill(os.getpid(), 9)", 137, "exited on signal 9"),
    "import": Fault(UNIT, "import not_there", 1, "pgran doctor"),
    "journal": Fault(inject.RECORD, NO_ROOM, 4, f"{JOURNAL}: cannot be written"),
    "result": Fault(WRITTEN, NO_ROOM, 4, f"{RESULT}: cannot be written: File too large"),
    "folder": Fault(WRITTEN, LOSE, 4, f"{RESULT}: cannot be written"),
}


def plant(number):
    """Plant a fault on a random rank: no hang, the right code, one message of who and why."""
    rng = np.random.default_rng([SEED, 0, number])
    kind, ranks = list(FAULTS)[number % len(FAULTS)], 2 + number // len(FAULTS) % 3
    fault, scene = FAULTS[kind], str(rng.choice(list(SCENES)))
    rank = 0 if fault.place in (inject.RECORD, WRITTEN) else int(rng.integers(ranks))
    turn = int(rng.integers(1, 3)) if fault.place in (UNIT, inject.RECORD) else 1
    words = ["-output_overwrite"]
    if scene == "response" and rng.random() < 0.5:  # the others wait in a collective call
        words += ["-ranks_per_lattice", str(ranks)]
    folder = make_folder(scene)
    earlier = Path(shutil.copy(OLD, folder / RESULT)).read_bytes()
    statement = fault.statement.replace("ROOM", str(rng.integers(100, 4000)))
    program = inject.words(fault.place, statement, rank, turn)
    job = Job(folder, ranks, *words, program=program)
    job.wait_for((folder / "fault").exists)
    code, seconds = job.end()
    codes, cause, who = [fault.code], fault.cause, f"rank {rank}"
    if fault.place == WRITTEN:
        who = cause
    said = str(job)
    if "YOUR APPLICATION" in said:  # MPICH names no rank, but a signal, perhaps one that it sent
        codes, cause, who = [fault.code - 128, 9, 15], "(signal ", "(signal "
    # but for what the run is, which it says before: response of a ...
    speakers = "^(?:pgran(?!: [a-z]+ of )|mpirun|YOUR APPLICATION).*"
    messages = re.findall(speakers, said, re.MULTILINE)
    assert (folder / "fault").exists(), f"the fault did not happen {job}"
    assert seconds < SECONDS_TO_STOP, f"ends after {seconds:.1f} s {job}"
    assert code in codes, f"exit code {code}, not {codes} {job}"
    assert len(messages) == 1, f"{len(messages)} messages {job}"
    assert who in messages[0], f"does not name {who} {job}"
    assert cause in said, f"does not say {cause!r} {job}"
    assert said.count("Traceback") == fault.traceback, f"tracebacks {job}"
    if kind == "folder":
        (folder / "results").unlink()
        (folder / "lost").rename(folder / "results")
    assert (folder / RESULT).read_bytes() == earlier, f"the earlier result is not whole {job}"
    if words == ["-output_overwrite"]:  # bit for bit with one rank a lattice
        go_on(folder, scene, int(rng.integers(1, 4)), *words)
    return kind, seconds


def stop(number):
    """Kill a run at a random moment, or ask it to stop: SIGUSR1 to mpirun, or SIGTERM to a rank."""
    rng = np.random.default_rng([SEED, 1, number])
    how = ("SIGKILL", "SIGUSR1", "SIGKILL", "SIGTERM")[number % 4]
    scene = str(rng.choice(list(SCENES)))
    folder, ranks, moment = make_folder(scene), int(rng.integers(1, 4)), rng.random()
    job = Job(folder, ranks)
    if how == "SIGKILL" and moment < 0.15:  # while it starts, too
        time.sleep(rng.uniform(0, 1.5))
    elif how == "SIGKILL" and moment < 0.35:  # while the result is written
        job.wait_for((folder / PART).exists)
        time.sleep(rng.uniform(0, 0.02))
    else:
        job.wait_for((folder / JOURNAL).exists)
        time.sleep(rng.uniform(0, reference(scene)[1] / min(ranks, 2)))
    seconds = 0.0
    if how == "SIGKILL":
        job.kill()
    else:  # SIGTERM at mpirun makes it kill the ranks a second later
        whom = job.process.pid if how == "SIGUSR1" else max(job.members(), default=job.process.pid)
        with contextlib.suppress(ProcessLookupError):
            os.kill(whom, signal.Signals[how])
        code, seconds = job.end()
        assert code in (0, 75), f"exit code {code} {job}"
        assert seconds < SECONDS_TO_STOP, f"stops after {seconds:.1f} s {job}"
        assert (code == 0) == (folder / RESULT).exists(), f"exit code {code}, or result? {job}"
        assert "Traceback" not in str(job), f"a traceback {job}"
    when = "after" if (folder / RESULT).exists() else "before"
    went = "with" if units_kept(folder) else "without"
    go_on(folder, scene, int(rng.integers(1, 4)))
    return f"{how} {when} the end, {went} units kept", seconds


def interrupt(number):
    """Send one rank a signal while Python, MPI and PETSc start: soon there is none of them."""
    rng = np.random.default_rng([SEED, 2, number])
    name = ("SIGINT", "SIGINT", "SIGTERM")[number % 3]
    scene, ranks = str(rng.choice(list(SCENES))), int(rng.integers(2, 4))
    job = Job(make_folder(scene), ranks)
    ranks_of = lambda: job.members(b"pgran")  # noqa: E731
    job.wait_for(ranks_of)
    time.sleep(rng.uniform(0, 1.5))
    with contextlib.suppress(ProcessLookupError, ValueError):  # it is done
        os.kill(int(rng.choice(ranks_of())), signal.Signals[name])
    began, unborn = time.monotonic(), lambda: "Fatal Python error: init_import_site" in str(job)
    job.wait_for(unborn)
    if unborn():  # the others may wait for it under MPICH, which Python or pgran cannot mend
        job.kill()
        return f"{name} while Python itself starts", 0.0
    code, seconds = job.end()[0], time.monotonic() - began
    # where Python does not listen yet the signal kills: MPICH names it, or a crash that it caused
    early = {128 + signal.Signals[name], int(signal.Signals[name]), 11}
    assert code in {0, 130 if name == "SIGINT" else 75, *early}, f"exit code {code} {job}"
    # the rest of the start included
    assert code == 0 or seconds < 2 * SECONDS_TO_STOP, f"ends after {seconds:.1f} s {job}"
    if any((job.folder / "results").iterdir()):
        go_on(job.folder, scene, int(rng.integers(1, 4)))
    return f"{name} with exit code {code}", seconds


def campaign(*trials, count):
    """Carry out so many of each of these trials in a new folder; return the exit code."""
    home = tempfile.mkdtemp(prefix="pgran-faults-")
    os.chdir(home)
    failures = sum(carry_out(trial, range(count)) for trial in trials)
    print(f"{failures} failures; the folders are in {home}" if failures else "no failures")
    if not failures:
        shutil.rmtree(home)
    return 1 if failures else 0


if __name__ == "__main__":
    parts = [globals()[name] for name in sys.argv[2:]] or (plant, stop, interrupt)
    sys.exit(campaign(*parts, count=TRIALS * int(sys.argv[1]) // 100))
