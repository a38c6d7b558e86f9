"""A log file beside the result: each line with its time, added to what is there.

Rank 0 tells what the run does, the others what goes wrong. All append to the same file, a message
with one call each, so that messages never mix.
"""

import logging
import os
import re
import sys
import tempfile
import time
from pathlib import Path

from pgran.errors import FileError

STAMP = "%Y-%m-%dT%H:%M:%S%z"
OURS = re.compile(rb"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d[+-]\d{4} pgran[ :]")


def check(path, make=True):
    """Raise a FileError unless a log can be appended to `path`. Not collective.

    Its folder is made if `make` says so.
    """
    path = Path(path)
    if path.is_dir():
        raise FileError(f"{path}: is a folder")
    try:
        if path.exists():
            with open(path, "rb+") as stream:
                beginning = stream.read(100)
            if beginning and not OURS.match(beginning):
                raise FileError(f"{path}: exists already and is no log of pgran")
            return
        if make:
            path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=next(p for p in path.parents if p.exists())):
            pass
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error.strerror or error}") from None


class LogFile(logging.Handler):
    """Appends messages to a file; all ranks but 0 are named in their lines. Not collective."""

    def __init__(self, path, rank):
        """Keep the path."""
        super().__init__()
        self.path, self._file = path, None
        self.name_of_rank = f" (rank {rank})" if rank else ""

    def emit(self, record):
        """Append a message, a stamp before each of its lines."""
        stamp = time.strftime(STAMP, time.localtime(record.created))
        level = "" if record.levelno <= logging.INFO else f"{record.levelname.lower()}: "
        lines = record.getMessage().splitlines() or [""]
        text = "".join(f"{stamp} pgran{self.name_of_rank}: {level}{line}\n" for line in lines)
        try:
            if self._file is None:
                self._file = os.open(self.path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
            os.write(self._file, text.encode(errors="replace"))
        except OSError as error:  # the run goes on: the terminal has the message
            print(f"pgran: {self.path}: cannot be written: {error.strerror}", file=sys.stderr)
