"""Where messages go: the standard streams, which may be closed, a closed pipe, or full; a log file.

The log file stands beside the result, each line with its time, added to what is there. Rank 0 tells
what the run does, the others what goes wrong. All append to the same file, a message with one call
each, so that messages do not mix.
"""

import io
import logging
import os
import re
import sys
import time
from pathlib import Path

from pgran.errors import FileError

STAMP = "%Y-%m-%dT%H:%M:%S%z"
OURS = re.compile(rb"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d[+-]\d{4} pgran[ :]")


class Stream(io.FileIO):
    """A standard stream that breaks once: quietly, but for standard output on a full device."""

    broken = False

    def write(self, data):
        """Write what can be written; once broken, nothing."""
        try:
            return len(data) if self.broken else super().write(data)
        except OSError as error:
            self.broken = True
            if self.fileno() == 1 and not isinstance(error, BrokenPipeError):
                text = f"standard output: cannot be written: {error.strerror}"
                raise FileError(text) from None
            return len(data)


def guard():
    """Let this process use standard streams that break in order."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:  # closed: the next file opened would be in its place
            os.open(os.devnull, os.O_RDWR)
    sys.stdout, sys.stderr = (
        io.TextIOWrapper(
            io.BufferedWriter(Stream(number, "w", closefd=False)),
            encoding=getattr(old, "encoding", "utf-8"),
            errors="backslashreplace",
            line_buffering=number == 2 or os.isatty(number),
        )
        for number, old in ((1, sys.stdout), (2, sys.stderr))
    )


class Messages(logging.Formatter):
    """How messages look on a terminal: who says it, and whether it warns."""

    def __init__(self, name):
        super().__init__()
        self.name = name

    def format(self, record):
        """Return the line of a message."""
        warns = "warning: " if record.levelno == logging.WARNING else ""
        return f"{self.name}: {warns}{record.getMessage()}"


def name_rank(world):
    """Begin all further messages of this process with its rank."""
    logging.getLogger("pgran").handlers[0].setFormatter(Messages(f"pgran (rank {world.rank})"))


class LogFile(logging.FileHandler):
    """Appends messages to a file, a stamp before each line; what cannot be written ends no run."""

    def __init__(self, path, rank):
        from pgran.store.paths import writing

        self.speaker = f"pgran (rank {rank})" if rank else "pgran"
        with writing(path):
            super().__init__(path, encoding="utf-8", errors="replace")

    def format(self, record):
        """Return the lines of a message."""
        stamp = time.strftime(STAMP, time.localtime(record.created))
        level = "" if record.levelno <= logging.INFO else f"{record.levelname.lower()}: "
        lines = record.getMessage().splitlines() or [""]
        return "\n".join(f"{stamp} {self.speaker}: {level}{line}" for line in lines)

    def handleError(self, record):  # noqa: N802
        """Say why a message could not be written; the terminal has it."""
        error = sys.exc_info()[1]
        print(f"pgran: {self.baseFilename}: cannot be written: {error}", file=sys.stderr)


def check_log(path, make=True):
    """Raise a FileError unless a log can be appended to `path`; make its folder if asked to."""
    from pgran.store.paths import try_beside, writing

    path = Path(path)
    with writing(path):
        if path.is_dir():
            raise FileError(f"{path}: is a folder")
        if not path.exists():
            return try_beside(path, make)
        with open(path, "rb+") as stream:
            beginning = stream.read(100)
        if beginning and not OURS.match(beginning):
            raise FileError(f"{path}: exists already and is no log of pgran")
