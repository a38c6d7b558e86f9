"""The words of a command: a parser whose errors are one line, and numbers within their ranges."""

import argparse
import contextlib
import math

from pgran.errors import InputError


class Parser(argparse.ArgumentParser):
    """A parser whose errors are pgran's."""

    def error(self, message):
        """Raise an InputError."""
        raise InputError(f"{self.prog.removeprefix('pgran ')}: {message}; see {self.prog} --help")


def magnitude(text):
    """Return a number that is 0 or more. Not collective."""
    with contextlib.suppress(ValueError):
        if 0 <= float(text) < math.inf:
            return float(text)
    raise argparse.ArgumentTypeError(f"{text} is not 0 or more and finite")


def positive(text):
    """Return a positive number. Not collective."""
    if magnitude(text) == 0:
        raise argparse.ArgumentTypeError(f"{text} is not positive")
    return float(text)
