"""The fault campaign: pgran never hangs, and never loses what is finished.

    bash jobs/faults.sh [--short]

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
import zlib
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from threading import Lock

import h5py
import numpy as np
from campaigns import inject

from pgran.parallel.journal import MAGIC, RECORD

RESULT, JOURNAL, PART = "results/a.h5", "results/a.h5.unfinished", "results/.a.h5.part"
OLD = Path(__file__).resolve().parents[1] / "version1.h5"  # a result, to be replaced
SEED = 1993
SECONDS = 60.0  # none of these runs takes longer
SECONDS_TO_STOP = 5.0  # after a fault or a signal, the launcher's own second or two included
VOLATILE = {"solve_seconds", "seconds", "created", "command", "mpi_size"}  # differ between runs
VOLATILE |= {"REFERENCE_LIST", "DIMENSION_LIST"}  # addresses in the file

BONDS = "-lattice_shape 20,20 -bonds_seed 7\n"
RELAX = f"-scene relaxation\n{BONDS}-lattice_damping .01\n"
SCENES = {
    "response": f"-scene response\n{BONDS}-sweep_points 1500\n",
    "fields": "-scene response\n-lattice_shape 30,30\n-sweep_points 400\n-output_fields\n",
    "modes": "-scene modes\n-lattice_shape 36,36\n-output_fields\n",
    "projection": f"-scene projection\n{BONDS}-sweep_points 600\n",
    "window": f"{RELAX}-relax_steps 15000\n",
    "krylov": f"{RELAX}-relax_steps 2000\n-relax_method krylov\n-relax_window 16\n",
    "trajectories": f"{RELAX}-relax_steps 4000\n-relax_trajectories 3\n",
}
# Smaller ones: what happens at a fault does not depend on the size.
SMALL = {
    "small response": "-scene response\n-lattice_shape 9,8\n-detectors 3,3\n-sweep_points 64\n",
    "small modes": "-scene modes\n-lattice_shape 30,30\n",
    "small projection": "-scene projection\n-lattice_shape 9,8\n-sweep_points 64\n",
    "small window": "-scene relaxation\n-lattice_shape 9,8\n-detectors 3,3\n-relax_steps 9000\n",
}


class Job:
    """`pgran run a.opts` in a session of its own, so that all its processes are known."""

    def __init__(self, folder, ranks, *words, program=("-m", "pgran")):
        """Start it in a folder, with further words; without mpirun on one rank."""
        self.folder, self.log = folder, folder / f"{time.monotonic_ns()}.log"
        launcher = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
        command = [*launcher, sys.executable, *program, "run", "a.opts", *words]
        with open(self.log, "w") as log:
            self.process = subprocess.Popen(
                [*command, "-output_progress", "none"], env=dict(os.environ),
                cwd=folder, stdout=log, stderr=log, start_new_session=True,
            )  # fmt: skip

    def __str__(self):
        """Return all that was printed, and where."""
        return f"in {self.folder}:\n{self.log.read_text(errors='replace')}"

    def members(self):
        """Return the process ids of launcher and ranks."""
        found = []
        for path in Path("/proc").glob("[0-9]*/stat"):
            with contextlib.suppress(OSError):
                state, _, _, session = path.read_text().rpartition(")")[2].split()[:4]
                if int(session) == self.process.pid and state != "Z":
                    found.append(int(path.parent.name))
        return found

    def wait_for(self, there):
        """Wait until `there()`, or the end of the job; at most as long as a run may take."""
        deadline = time.monotonic() + SECONDS
        while self.process.poll() is None and not there() and time.monotonic() < deadline:
            time.sleep(0.001)

    def signal(self, number, pids):
        """Signal processes that may be gone."""
        for pid in pids:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, number)

    def kill(self):
        """Kill all processes at once."""
        while members := self.members():
            self.signal(signal.SIGKILL, members)
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


def differences(path, other):
    """Return the names of datasets and attributes that are not the same bit for bit."""

    def contents(path):
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

    one, two = contents(path), contents(other)
    return [name for name in one | two if one.get(name) != two.get(name)]


def units_kept(journal):
    """Return how many whole units a journal holds, read independently of pgran."""
    try:
        data = journal.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        return 0
    assert data[: len(MAGIC)] == MAGIC[: len(data)], f"{journal}: unreadable"
    count, start = -1, len(MAGIC)  # the first record is no unit
    while start + RECORD.size <= len(data):
        *_, size, checksum = RECORD.unpack_from(data, start)
        end = start + RECORD.size + size
        head, payload = data[start : start + RECORD.size - 4], data[start + RECORD.size : end]
        if end > len(data) or zlib.crc32(payload, zlib.crc32(head)) != checksum:
            break
        count, start = count + 1, end
    return max(0, count)


class Campaign:
    """Makes folders and references below a folder, and carries out trials."""

    def __init__(self, root):
        """Begin without references."""
        self.root, self.references, self._lock = root, {}, Lock()

    def folder(self, scene):
        """Return a new folder with the options file of a scene."""
        folder = Path(tempfile.mkdtemp(dir=self.root))
        (folder / "a.opts").write_text((SCENES | SMALL)[scene])
        (folder / "results").mkdir()
        return folder

    def reference(self, scene):
        """Return the result of a run never stopped, and the seconds from journal to result."""
        with self._lock:
            if scene not in self.references:
                job = Job(self.folder(scene), 1)
                job.wait_for((job.folder / JOURNAL).exists)
                code, seconds = job.end()
                assert code == 0, f"a run that nothing disturbs fails {job}"
                self.references[scene] = job.folder / RESULT, seconds
            return self.references[scene]

    def compare(self, folder, scene):
        """Check that a result is that of a run never stopped."""
        wrong = differences(folder / RESULT, self.reference(scene)[0])
        assert not wrong, f"{folder / RESULT}: not as never stopped: {', '.join(wrong)}"

    def go_on(self, folder, scene, ranks, *words):
        """Let the same command go on to the end: nothing finished is lost or done again."""
        done, kept = (folder / RESULT).exists() and not words, units_kept(folder / JOURNAL)
        job = Job(folder, ranks, *words)
        code, _ = job.end()
        assert code == (4 if done else 0), f"exit code {code} when going on {job}"
        found = re.search(r"going on from there, (\d+) units", str(job))
        assert done or not kept or int(found[1]) >= kept, f"of {kept} units some were lost {job}"
        left = [path.name for path in (folder / "results").iterdir()]
        assert done or left == ["a.h5"], f"left behind: {left} {job}"
        self.compare(folder, scene)

    def carry_out(self, trial, numbers):
        """Carry out trials, two at a time; print a line, and return how many fail."""

        def carry(number):
            try:
                return trial(self, number)
            except AssertionError as error:
                print(f"FAILED: {trial.__name__} {number}: {error}", flush=True)
                return "failed", 0.0

        with ThreadPoolExecutor(2) as pool:
            outcomes, seconds = zip(*pool.map(carry, numbers), strict=True)
        tally = ", ".join(f"{n} {what}" for what, n in sorted(Counter(outcomes).items()))
        print(f"{trial.__name__}: {tally}; the slowest ended in {max(seconds):.1f} s", flush=True)
        return outcomes.count("failed")


@dataclass(frozen=True)
class Fault:
    """What is planted where, the exit code, and what is said.

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
    "recursion": Fault(UNIT, "f = lambda: f(); f()", 1, "RecursionError", traceback=True),
    "interrupt": Fault(UNIT, "import os; os.kill(os.getpid(), 2)", 130, "interrupted"),
    "segfault": Fault(UNIT, "import ctypes; ctypes.string_at(0)", 139, "exited on signal 11"),
    "kill": Fault(UNIT, "import os; os.kill(os.getpid(), 9)", 137, "exited on signal 9"),
    "abort": Fault(UNIT, "import os; os.abort()", 134, "exited on signal 6"),
    "vanish": Fault(UNIT, "import os; os._exit(0)", 1, "exiting improperly"),
    "import": Fault(UNIT, "import not_there", 1, "pgran doctor"),
    "journal": Fault(inject.RECORD, NO_ROOM, 4, f"{JOURNAL}: cannot be written"),
    "result": Fault(WRITTEN, NO_ROOM, 4, f"{RESULT}: cannot be written: File too large"),
    "folder": Fault(WRITTEN, LOSE, 4, f"{RESULT}: cannot be written"),
    "writing": Fault(WRITTEN, RAISE, 1, PLANTED, traceback=True),
}
CRASHES = ("segfault", "kill", "abort")  # mpirun speaks for the rank


@cache
def is_mpich():
    """Return whether `mpirun` is MPICH's."""
    return "HYDRA" in subprocess.run(["mpirun", "--version"], capture_output=True, text=True).stdout


def plant(campaign, number):
    """Plant a fault on a random rank: no hang, the right code, one message of who and why."""
    rng = np.random.default_rng([SEED, 0, number])
    kind, ranks = list(FAULTS)[number % len(FAULTS)], 2 + number // len(FAULTS) % 3
    if kind == "vanish" and is_mpich():
        return "vanish not tried: for MPICH's mpirun that is no fault", 0.0
    fault, scene = FAULTS[kind], str(rng.choice(list(SMALL)))
    rank = 0 if fault.place in (inject.RECORD, WRITTEN) else int(rng.integers(ranks))
    turn = int(rng.integers(1, 3)) if fault.place in (UNIT, inject.RECORD) else 1
    words = ["-output_overwrite"]
    if scene == "small response" and rng.random() < 0.5:  # the others wait in a collective call
        words += ["-ranks_per_lattice", str(ranks)]
    folder = campaign.folder(scene)
    earlier = Path(shutil.copy(OLD, folder / RESULT)).read_bytes()
    statement = fault.statement.replace("ROOM", str(rng.integers(100, 4000)))
    program = inject.words(fault.place, statement, rank, turn)
    job = Job(folder, ranks, *words, program=program)
    job.wait_for((folder / "fault").exists)
    code, seconds = job.end()
    codes, cause, who = [fault.code], fault.cause, f"rank {rank}"
    if fault.place == WRITTEN and fault.code == 4:
        who = cause
    if (
        kind in CRASHES and is_mpich()
    ):  # it names no rank, but a signal, perhaps one that it sent itself
        codes, cause, who = [fault.code - 128, 9, 15], "(signal ", "(signal "
    said = str(job)
    speakers = ("pgran", "mpirun", "YOUR APPLICATION")
    messages = [line for line in said.splitlines() if line.startswith(speakers)]
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
        campaign.go_on(folder, scene, int(rng.integers(1, 4)), *words)
    return kind, seconds


def stop(campaign, number):
    """Kill a run at a random moment, or ask it to stop: SIGUSR1 to mpirun, or SIGTERM to a rank."""
    rng = np.random.default_rng([SEED, 1, number])
    how = ("SIGKILL", "SIGUSR1", "SIGKILL", "SIGTERM")[number % 4]
    scene = str(rng.choice(list(SCENES)))
    folder, ranks, moment = campaign.folder(scene), int(rng.integers(1, 4)), rng.random()
    job = Job(folder, ranks)
    if how == "SIGKILL" and moment < 0.15:  # while it starts, too
        time.sleep(rng.uniform(0, 1.5))
    elif how == "SIGKILL" and moment < 0.35:  # while the result is written
        job.wait_for((folder / PART).exists)
        time.sleep(rng.uniform(0, 0.02))
    else:
        job.wait_for((folder / JOURNAL).exists)
        time.sleep(rng.uniform(0, campaign.reference(scene)[1] / min(ranks, 2)))
    seconds = 0.0
    if how == "SIGKILL":
        job.kill()
    else:  # SIGTERM at mpirun makes it kill the ranks a second later
        whom = job.process.pid if how == "SIGUSR1" else max(job.members(), default=0)
        job.signal(signal.Signals[how], [whom] if whom else [])
        code, seconds = job.end()
        assert code in (0, 75), f"exit code {code} {job}"
        assert seconds < SECONDS_TO_STOP, f"stops after {seconds:.1f} s {job}"
        assert (code == 0) == (folder / RESULT).exists(), f"exit code {code}, or result? {job}"
        assert "Traceback" not in str(job), f"a traceback {job}"
    when = {
        "while the result was written": (folder / PART).exists(),
        "with finished units": units_kept(folder / JOURNAL) > 0,
        "after the result": (folder / RESULT).exists(),
        "before any unit": True,
    }
    campaign.go_on(folder, scene, int(rng.integers(1, 4)))
    return f"{how} {next(text for text, so in when.items() if so)}", seconds


def main():
    """Carry out all trials, or some; return the exit code."""
    short = "--short" in sys.argv
    root = Path(tempfile.mkdtemp(prefix="pgran-faults-"))
    campaign = Campaign(root)
    failures = campaign.carry_out(plant, range(len(FAULTS) * (1 if short else 15)))
    failures += campaign.carry_out(stop, range(16 if short else 200))
    print(f"{failures} failures; the folders are in {root}" if failures else "no failures")
    if not failures:
        shutil.rmtree(root)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
