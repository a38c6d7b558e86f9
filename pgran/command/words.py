"""The words of a command: a parser whose errors are one line, and numbers within their ranges."""

import argparse
import contextlib
import math
import re
import sys
import textwrap

from pgran.errors import DONE, InputError
from pgran.run import launch

WIDTH = 80


class Parser(argparse.ArgumentParser):
    """A parser whose errors are pgran's; its help is usage, what it does, words, examples."""

    def __init__(self, command, does, *examples, more="", **others):
        """Say what a command does, with command lines as examples; the help ends with `more`."""
        self.command = command
        epilog = "examples:\n" + "".join(f"  {line}\n" for line in examples) if examples else ""
        super().__init__(
            f"pgran {command}",
            description=textwrap.fill(" ".join(does.split()), WIDTH),
            epilog="\n".join(filter(None, [epilog, more])),
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
            **others,
        )

    def error(self, message):
        """Raise an InputError."""
        message = re.sub("^argument ", "", message)
        raise InputError(f"{self.command}: {message}; see {self.prog} --help")

    def read(self, words):
        """Return what words in any order say; on ranks after the first the command ends here."""
        options = self.parse_intermixed_args(words)
        if launch.rank() > 0:
            sys.exit(DONE)
        return options

    def print_help(self, file=None):
        """Print it on one rank."""
        if launch.rank() == 0:
            super().print_help(file)


def magnitude(text):
    """Return a number that is 0 or more."""
    with contextlib.suppress(ValueError):
        if 0 <= float(text) < math.inf:
            return float(text)
    raise argparse.ArgumentTypeError(f"{text} is no finite number of 0 or more")


def positive(text):
    """Return a positive number."""
    with contextlib.suppress(ValueError):
        if 0 < float(text) < math.inf:
            return float(text)
    raise argparse.ArgumentTypeError(f"{text} is no positive number")
