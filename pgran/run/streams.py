"""Standard output and standard error, which may be closed, a closed pipe, or a full device.

And how messages look there.
"""

import io
import logging
import os
import sys

from pgran.errors import FileError


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


class Messages(logging.Formatter):
    """How messages look on a terminal: who says it, and whether it warns."""

    def __init__(self, name):
        super().__init__()
        self.name = name

    def format(self, record):
        """Return the line of a message."""
        warns = "warning: " if record.levelno == logging.WARNING else ""
        return f"{self.name}: {warns}{record.getMessage()}"


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


def name_rank(world):
    """Begin all further messages of this process with its rank."""
    logging.getLogger("pgran").handlers[0].setFormatter(Messages(f"pgran (rank {world.rank})"))
