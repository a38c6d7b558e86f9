"""Trials of the fault campaign: jobs that can be watched and killed, and what is checked after."""

import contextlib
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
import zlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import h5py
import numpy as np

from pgran.parallel.journal import MAGIC, RECORD

PGRAN, QUIET = ["-m", "pgran"], ["-output_progress", "none"]
RESULT, JOURNAL, PART = "results/a.h5", "results/a.h5.unfinished", "results/.a.h5.part"
SECONDS_OF_RUN = 60.0  # none of these takes longer
# What differs from run to run.
VOLATILE = {"solve_seconds", "seconds", "created", "command", "mpi_size"}


class Job:
    """pgran in a session of its own, so that all its processes are known."""

    def __init__(self, folder, ranks, *words, program=PGRAN):
        """Start `pgran run a.opts` and further words in a folder; without mpirun on one rank."""
        self.folder, self.log = folder, folder / f"{time.monotonic_ns()}.log"
        launcher = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
        with open(self.log, "w") as log:
            self.process = subprocess.Popen(
                [*launcher, sys.executable, *program, "run", "a.opts", *QUIET, *words],
                cwd=folder, env=dict(os.environ), stdout=log, stderr=log, start_new_session=True,
            )  # fmt: skip

    def members(self):
        """Return the process ids of launcher and ranks."""
        found = []
        for path in Path("/proc").glob("[0-9]*/stat"):
            try:
                state, _, _, session = path.read_text().rpartition(")")[2].split()[:4]
            except OSError:
                continue
            if int(session) == self.process.pid and state != "Z":
                found.append(int(path.parent.name))
        return found

    def ranks(self):
        """Return the process ids of the ranks that are up."""
        return [pid for pid in self.members() if "python" in os.readlink(f"/proc/{pid}/exe")]

    def running(self):
        """Return whether the job has not ended yet."""
        return self.process.poll() is None

    def wait_for(self, there, seconds=SECONDS_OF_RUN):
        """Wait until `there()` or the end of the job; return whether it is so."""
        deadline = time.monotonic() + seconds
        while self.running() and time.monotonic() < deadline:
            if there():
                return True
            time.sleep(0.001)
        return False

    def end(self, seconds=SECONDS_OF_RUN):
        """Wait for the end and return the exit code; None if it hangs, or leaves processes."""
        try:
            code = self.process.wait(seconds)
        except subprocess.TimeoutExpired:
            code = None
        deadline = time.monotonic() + 2.0
        while self.members() and time.monotonic() < deadline:
            time.sleep(0.05)
        if self.members():
            code = None
            self.kill()
        return code

    def kill(self):
        """Kill all processes at once."""
        while alive := self.members():
            for pid in alive:
                with_no_error(os.kill, pid, signal.SIGKILL)
        self.process.wait()

    def said(self):
        """Return all that was printed."""
        return self.log.read_text(errors="replace")


def with_no_error(function, *arguments):
    """Call a function on what may be gone already."""
    with contextlib.suppress(FileNotFoundError, ProcessLookupError):
        function(*arguments)


def differences(path, other):
    """Return the names of datasets and attributes that are not the same bit for bit."""

    def contents(path):
        found = {}
        with h5py.File(path) as file:

            def note(name, item):
                found.update(
                    {f"{name}@{k}": np.asarray(v).tobytes() for k, v in item.attrs.items()
                     if k not in VOLATILE and k not in ("REFERENCE_LIST", "DIMENSION_LIST")}
                )  # fmt: skip
                if isinstance(item, h5py.Dataset):
                    found[name] = (item.dtype.str, item.shape, item[()].tobytes())

            note("", file)
            file.visititems(note)
        return found

    one, two = contents(path), contents(other)
    return [name for name in one | two if one.get(name) != two.get(name)]


def held(journal):
    """Return how many whole units a journal holds, read independently of pgran; -1: unreadable."""
    try:
        data = journal.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        return 0
    if data[: len(MAGIC)] != MAGIC[: len(data)]:
        return -1
    count, start = -1, len(MAGIC)  # the first record is no unit
    while start + RECORD.size <= len(data):
        *_, size, checksum = RECORD.unpack_from(data, start)
        end = start + RECORD.size + size
        head, payload = data[start : start + RECORD.size - 4], data[start + RECORD.size : end]
        if end > len(data) or zlib.crc32(payload, zlib.crc32(head)) != checksum:
            break
        count, start = count + 1, end
    return max(0, count)


def describe(names):
    """Return in words which parts of a result are not as they should be."""
    return names and f"not as never stopped: {', '.join(names)}"


class Campaign:
    """Counts trials and failures; each trial has a folder and random numbers of its own."""

    def __init__(self, root, short):
        """Keep everything below `root`."""
        self.root, self.short, self.failures, self.references = root, short, 0, {}

    def repeats(self, full, short):
        """Return how many trials there are to be."""
        return range(short if self.short else full)

    def folder(self, text):
        """Return a new folder with an options file in it."""
        folder = Path(tempfile.mkdtemp(dir=self.root))
        (folder / "a.opts").write_text(text)
        return folder

    def check(self, job, *findings):
        """Note what went wrong in a trial, a text each; return whether it is nothing."""
        findings = [text for text in findings if text]
        if findings:
            self.failures += 1
            print(f"FAILED in {job.folder}: {'; '.join(findings)}\n{job.said()}", flush=True)
        return not findings

    def map(self, trial, numbers, scenes=()):
        """Return `trial(self, number)` for all numbers, two at a time; make references before."""
        for scene, text in dict(scenes).items():
            if scene not in self.references:
                self.make_reference(scene, text)
        with ThreadPoolExecutor(2) as pool:
            return list(pool.map(lambda number: trial(self, number), numbers))

    def make_reference(self, scene, text):
        """Keep the result of a run never stopped, and the seconds from journal to result."""
        folder = self.folder(text)
        job = Job(folder, 1)
        job.wait_for((folder / JOURNAL).exists)
        begun = time.monotonic()
        self.check(job, job.end() != 0 and "a run that nothing disturbs fails")
        self.references[scene] = folder / RESULT, time.monotonic() - begun

    def finish(self, folder, scene, ranks):
        """Go on with a run to its end; check that nothing was lost and all is as never stopped."""
        result, journal = folder / RESULT, folder / JOURNAL
        there, units = result.exists(), held(journal)
        job = Job(folder, ranks)
        code = job.end()
        found = re.search(r"going on from there, (\d+) units", job.said())
        found = int(found[1]) if found else 0
        left = {path.name for path in (folder / "results").iterdir()} - {result.name}
        self.check(
            job,
            code != (4 if there else 0) and f"exit code {code} when going on",
            not there and found < units and f"of {units} units {found} were found",
            not there and left and f"left behind: {left}",
            result.exists() and describe(differences(result, self.references[scene][0])),
        )
