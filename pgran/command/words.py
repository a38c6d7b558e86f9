"""The words of a command: a parser whose errors are one line, and numbers within their ranges."""

import argparse
import contextlib
import functools
import math
import re
import sys
import textwrap

from pgran.arguments import meant, nearest
from pgran.errors import DONE, InputError
from pgran.run import launch

WIDTH = 80
OPTION = re.compile(r"--?[A-Za-z][\w.-]*", re.ASCII)
# What argparse says, and what it means.
PLAIN = {
    "^argument ": "",
    "invalid int value: '(.*)'": r"\1 is no whole number",
    "invalid _mode_numbers value: '(.*)'": r"\1 is no list of numbers as 0,3,10:20",
    "invalid float value: '(.*)'": r"\1 is no number",
}


class Parser(argparse.ArgumentParser):
    """A parser whose errors are pgran's; its help is usage, what it does, words, examples."""

    def __init__(self, command, does, *examples, more="", **others):
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
        for pattern, plain in PLAIN.items():
            message = re.sub(pattern, plain, message)
        choice = re.search("choice: '(.*)' .choose from (.*)\\)", message)
        near = choice and nearest(choice[1], re.findall("[^', ]+", choice[2]))
        self._refuse(message, near)

    def _refuse(self, message, near):
        """Raise an InputError, with what was meant or where to read on."""
        raise InputError(f"{self.command}: {message}{meant(near, f'; see {self.prog} --help')}")

    def parse_known_args(self, words=None, namespace=None):
        """Return what words say; of options one dash is as good as two."""
        stop = words.index("--") if "--" in words else len(words)
        words = [*map(self._spelled, words[:stop]), *words[stop:]]
        return super().parse_known_args(words, namespace)

    def _spelled(self, word):
        """Return a word, an option as it was declared; raise an InputError if none has its name."""
        name, sign, value = word.partition("=")
        if not OPTION.fullmatch(name):
            return word
        for known in (name, f"-{name}", name[1:]):
            if known in self._option_string_actions:
                return f"{known}{sign}{value}"
        names = {known.lstrip("-"): known for known in self._option_string_actions}
        self._refuse(f"{name}: unknown option", names.get(nearest(name.lstrip("-"), names)))

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


def positive(text, zero=False):
    """Return a positive number, or a `zero` too."""
    with contextlib.suppress(ValueError):
        if 0 < float(text) < math.inf or (zero and float(text) == 0):
            return float(text)
    kind = "finite number of 0 or more" if zero else "positive number"
    raise argparse.ArgumentTypeError(f"{text} is no {kind}")


magnitude = functools.partial(positive, zero=True)
