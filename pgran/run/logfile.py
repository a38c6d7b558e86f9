"""A log file beside the result: each line with its time, added to what is there.

Rank 0 tells what the run does, the others what goes wrong. All append to the same file, a message
with one call each, so that messages do not mix.
"""

import logging
import re
import sys
import time
from pathlib import Path

from pgran.errors import FileError
from pgran.store.paths import try_beside, writing

STAMP = "%Y-%m-%dT%H:%M:%S%z"
OURS = re.compile(rb"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d[+-]\d{4} pgran[ :]")


def check(path, make=True):
    """Raise a FileError unless a log can be appended to `path`; make its folder if asked to."""
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


class LogFile(logging.FileHandler):
    """Appends messages to a file, a stamp before each line; what cannot be written ends no run."""

    def __init__(self, path, rank):
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
