"""The finished units of a run on disk while it goes on, so that a run that was stopped continues.

A journal stands beside the result it leads to, as `<result>.unfinished`: what the run is, and then
a record for each finished unit, appended as it arrives. Each record carries its checksum, so that
one that was cut off by a kill is noticed and dropped. The journal is the run's lock as well, held
by the kernel for as long as the process lives: a lock that nobody holds cannot be left behind.
"""

import contextlib
import fcntl
import json
import os
import signal
import stat
import struct
import time
import zlib
from pathlib import Path

import numpy as np

from pgran.errors import FileError, InputError, PgranError, StoppedError, is_bad_input, log
from pgran.run.agreement import on_root
from pgran.run.launch import SIGNALS
from pgran.store.paths import writing

MAGIC = b"pgran journal 1\n"
# MAGIC | head | identity | head | rows of a unit | head | rows of a unit ...
RECORD = struct.Struct("<IIQI")  # a head: stage, position, bytes, checksum of both
IDENTITY = (0, 0)  # stage and position of the record that says what the run is
SECONDS_BETWEEN_SYNCS = 1.0  # a kill loses nothing in between, only a power failure does


class Journal(contextlib.AbstractContextManager):
    """Keeps finished units, and says when a signal asks the run to stop; use with `with`.

    Collective. Rank 0 holds the file; every rank takes note of signals. `path` is the result's. An
    earlier journal goes on if its identity, texts by the names that users know, is the same. If it
    is another an InputError names the difference, or it is discarded where `overwrite` says so. A
    `dry` run meets and says the same, and changes nothing.
    """

    medium, is_new = "", True  # checksum of the medium: units of another are none of this run

    def __init__(self, comm, path, identity, overwrite=False, dry=False):
        self._dry = dry
        self.comm, self.path = comm, Path(f"{path}.unfinished")
        self._file, self._kept, self._synced, self._signal = None, {}, time.monotonic(), None
        try:
            on_root(comm, lambda: self._open(identity, overwrite))
        except PgranError:
            if self._file is not None:  # an error that is kept must not keep the lock
                self._file.close()
            raise
        self._handlers = [(number, signal.signal(number, self._note)) for number in SIGNALS]
        self._mask = signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)

    def __exit__(self, kind, error, trace):
        """Close the journal; remove it if the run is complete, or nothing was finished yet.

        So it is if bad input turns up late: the corrected command is another run.
        """
        signal.pthread_sigmask(signal.SIG_SETMASK, self._mask)
        for number, handler in self._handlers:
            signal.signal(number, handler)
        if self._file is not None:
            try:
                with self._file:
                    if self._dry:
                        return
                    if kind is None or not self._kept or (self.is_new and is_bad_input(error)):
                        self.path.unlink(missing_ok=True)
            except OSError as trouble:  # no reason to fail: the result is there, or another error
                log.warning("%s: cannot be removed: %s", self.path, trouble.strerror)

    @property
    def stop_asked(self):
        """The name of the signal that has asked this rank to stop, or None."""
        return self._signal and signal.Signals(self._signal).name

    def stage(self, number, units, row):
        """Return what tells the units of a stage, by its number, from those of another one."""
        return zlib.crc32(f"{number} {units!r} {row!r} {self.medium}".encode()) or 1

    def kept(self, stage, row):
        """Return the finished units of a stage, {position: rows}, on rank 0."""
        return {
            position: np.frombuffer(os.pread(self._file.fileno(), size, start), row)
            for (name, position), (start, size) in sorted(self._kept.items())
            if name == stage
        }

    def write(self, stage, position, rows):
        """Append the rows of a finished unit, on rank 0, or raise a FileError."""
        self._append((stage, position), rows.tobytes())
        if time.monotonic() - self._synced > SECONDS_BETWEEN_SYNCS:
            self._sync()

    def _sync(self):
        """Make sure that what was written is on the disk, on rank 0."""
        with writing(self.path):
            os.fsync(self._file.fileno())
        self._synced = time.monotonic()

    def stop(self, name):
        """Raise StoppedError, all work so far being kept. Collective."""
        on_root(self.comm, self._sync)
        if self.comm.bcast(bool(self._kept)):
            raise StoppedError(f"stopped by {name}; the same command goes on from {self.path}")
        raise StoppedError(f"stopped by {name} before any work was finished")

    def _note(self, number, frame):
        """Take note of a signal, and say so at once on rank 0: mpirun may kill before the end."""
        if self._file is not None and self._signal is None:
            text = "stopping after the work at hand; the same command goes on"
            with contextlib.suppress(OSError):  # past the buffers, which it may have interrupted
                os.write(2, f"pgran: {signal.Signals(number).name}: {text}\n".encode())
        self._signal = number

    def _open(self, identity, overwrite):
        """Open the file, and begin anew where it holds no units of this run."""
        if self._dry and not os.path.lexists(self.path):
            return
        self._file = self._locked()
        earlier = self._scan()
        self.is_new = earlier != identity
        if not self.is_new:
            log.info("%s: going on from there, %d units are finished", self.path, len(self._kept))
            return
        if self._kept:
            if not overwrite:
                key = next(k for k in identity | earlier if earlier.get(k) != identity.get(k))
                was, now = (run.get(key, "not given") for run in (earlier, identity))
                raise InputError(
                    f"{key}: {self.path} holds an unfinished run with {was}, and now it is {now}; "
                    "-output_overwrite begins anew, and another -output_file leaves that one alone"
                )
            log.info("%s: another run, which -output_overwrite discards", self.path)
        if self._dry:
            return
        self._kept.clear()
        with writing(self.path):
            self._file.seek(0)
            self._file.truncate()
            self._file.write(MAGIC)
        self._append(IDENTITY, json.dumps(identity).encode())
        del self._kept[IDENTITY]

    def _locked(self):
        """Return the journal's file, opened and locked."""
        if os.path.lexists(self.path) and not stat.S_ISREG(os.lstat(self.path).st_mode):
            self._refuse()  # a pipe would be waited for, a link followed
        how, mode = (os.O_RDONLY, "rb") if self._dry else (os.O_RDWR | os.O_CREAT, "rb+")
        while True:
            file = os.fdopen(os.open(self.path, how, 0o666), mode, buffering=0)
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                file.close()
                raise FileError(
                    f"{self.path}: another run is writing this result; give another -output_file"
                ) from None
            except OSError as error:
                log.warning("%s: this file system has no locks (%s)", self.path, error.strerror)
                return file
            with contextlib.suppress(FileNotFoundError):  # removed by a run that was just done
                if os.path.samestat(os.fstat(file.fileno()), os.stat(self.path)):
                    return file
            file.close()

    def _scan(self):
        """Find the records; return the identity, or None where there is none. Drop what is torn."""
        file, identity = self._file, None
        size = os.fstat(file.fileno()).st_size
        start = file.read(len(MAGIC))
        if start != MAGIC[: len(start)]:
            self._refuse()
        position = len(MAGIC)
        while position + RECORD.size <= size:
            file.seek(position)
            head = file.read(RECORD.size)
            *place, length, checksum = RECORD.unpack(head)
            content = position + RECORD.size
            # a length that was damaged must not make us read, or allocate, more than there is
            if length > size - content:
                break
            payload = file.read(length)
            if zlib.crc32(payload, zlib.crc32(head[:-4])) != checksum:
                break
            if identity is None:
                identity = json.loads(payload)
            else:
                self._kept[tuple(place)] = content, length
            position = content + length
        if identity is None and size > len(MAGIC) + RECORD.size:
            log.warning("%s: damaged; the run begins anew", self.path)
        elif identity is not None and position < size:
            log.info("%s: its end was cut off; that work is done again", self.path)
            if not self._dry:
                file.truncate(position)
        return identity

    def _refuse(self):
        raise FileError(f"{self.path}: in the way, and no journal of pgran; move it away")

    def _append(self, place, payload):
        """Append a record whole, or leave the file as it was."""
        file = self._file
        start = file.seek(0, os.SEEK_END)
        head = RECORD.pack(*place, len(payload), 0)[:-4]
        record = head + struct.pack("<I", zlib.crc32(payload, zlib.crc32(head))) + payload
        with writing(self.path):
            try:
                if file.write(record) < len(record):
                    raise OSError("no room for a whole record")
            except OSError:
                file.truncate(start)
                raise
        self._kept[place] = start + RECORD.size, len(payload)
