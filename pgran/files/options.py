"""Options: how one is declared, read and written; those of every run; a run's own, resolved."""

import difflib
import math
import shlex
from collections.abc import Callable
from dataclasses import dataclass

from pgran.errors import InputError
from pgran.files.solver_keys import is_solver_key


@dataclass(frozen=True)
class Kind:
    """A type of option, and how its text is read."""

    name: str
    read: Callable


def _flag(text):
    """Read a flag; a key without a value is true."""
    words = {"": True, "true": True, "yes": True, "1": True, "on": True}
    words |= {"false": False, "no": False, "0": False, "off": False}
    return words[text.lower()]


def _text(text):
    if not text:
        raise ValueError
    return text


def _integer(text):
    value = int(text)
    if abs(value) >= 2**64:
        raise ValueError
    return value


def _real(text):
    value = float(text)
    if not math.isfinite(value):
        raise ValueError
    return value


def _several(read):
    return lambda text: tuple(read(part) for part in text.split(","))


INTEGER = Kind("integer", _integer)
REAL = Kind("real", _real)
INTEGERS = Kind("integers", _several(_integer))
REALS = Kind("reals", _several(_real))
FLAG = Kind("flag", _flag)
TEXT = Kind("text", _text)
TEXTS = Kind("texts", _several(_text))


def text_of(value):
    """Return the text that a value is read from. Not collective."""
    if isinstance(value, tuple):
        return ",".join(map(text_of, value))
    if isinstance(value, bool):
        return str(value).lower()
    return value if isinstance(value, str) else repr(value)


def _without_numpy(value):
    """Return NumPy's numbers and arrays, and lists, as Python's own numbers and tuples."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    return tuple(map(_without_numpy, value)) if isinstance(value, (list, tuple)) else value


@dataclass(frozen=True)
class Option:
    """One option: `-name`, and what its value may be.

    `low` and `high` bound every number of a value, `above` from below excluding itself. A default
    of None means that the option need not be given and that nothing stands in for it.
    """

    name: str
    kind: Kind
    default: object
    meaning: str
    unit: str = ""
    low: float | None = None
    above: float | None = None
    high: float | None = None
    choices: tuple = ()

    def read(self, text, where=""):
        """Return the value that `text` means.

        Raises
        ------
        InputError
            If it is of the wrong type or out of range.
        """
        try:
            value = self.kind.read(text.strip())
        except (ValueError, KeyError):
            raise self._wrong_type(text, where) from None
        numbers = value if isinstance(value, tuple) else (value,)
        if self.choices and value not in self.choices:
            near = nearest(value, self.choices)
            raise InputError(
                f"-{self.name} {text}{where}: choose {', '.join(self.choices)}"
                + (f"; did you mean {near}?" if near else "")
            )
        for number in numbers:
            if (
                (self.low is not None and number < self.low)
                or (self.above is not None and number <= self.above)
                or (self.high is not None and number > self.high)
            ):
                raise InputError(f"-{self.name} {text}{where}: {number} is not {self.range()}")
        return value

    def range(self):
        """Return the range in words."""
        words = []
        if self.above is not None:
            words.append(f"> {self.above:g}")
        if self.low is not None:
            words.append(f">= {self.low:g}")
        if self.high is not None:
            words.append(f"<= {self.high:g}")
        return " and ".join(words)

    def write(self, value):
        """Return the line of an options file that sets this value."""
        return f"-{self.name} {shlex.quote(text_of(value))}"

    def check(self, value):
        """Return a value given in Python as the command line would read it; raise as it does."""
        plain = _without_numpy(value)
        text = text_of(plain)
        read = self.read(text)
        if read != plain:
            raise self._wrong_type(text)
        return read

    def describe(self):
        """Return what there is to know of the option, over several lines."""
        default = "" if self.default is None else f"default {text_of(self.default)}"
        facts = "; ".join(filter(None, [self.kind.name, self.unit, self.range(), default]))
        choices = f"    choices: {', '.join(self.choices)}\n" if self.choices else ""
        return f"-{self.name}\n    {self.meaning}\n    ({facts})\n{choices}"

    def _wrong_type(self, text, where=""):
        return InputError(
            f"-{self.name} {text}{where}: needs a value of the type `{self.kind.name}`"
        )


def nearest(word, words):
    """Return the word most like `word`, or None. Not collective."""
    return next(iter(difflib.get_close_matches(word, words, n=1, cutoff=0.5)), None)


# The options of every run.
RUN = (
    Option(
        "ranks_per_lattice", INTEGER, 0,
        "ranks that share one lattice, the rest share out the work; 0 = automatic", low=0
    ),
    Option(
        "output_file", TEXT, None, "result (default: results/<name of the options file>.h5)"
    ),
    Option("output_overwrite", FLAG, False, "replace an existing result"),
    Option(
        "output_progress", TEXT, "auto", "auto = a bar on a terminal, lines elsewhere",
        choices=("auto", "bar", "lines", "none"),
    ),
    Option("output_log", TEXT, None, "log file; a log that is there already goes on"),
    Option("dry_run", FLAG, False, "say what the run will need, and stop"),
)  # fmt: skip


class Options:
    """The resolved options of a run: every physics option by name, and the solver keys given.

    `options.lattice_shape` is the value of `-lattice_shape`. `solver` holds what goes to PETSc.
    """

    def __init__(self, scene, declared, values, solver):
        """Keep the values of the options that a scene declares."""
        self.scene, self._declared, self._values, self.solver = scene, declared, values, solver

    def __getattr__(self, name):
        """Return the value of an option of this scene."""
        try:
            return self.__dict__["_values"][name]
        except KeyError:
            raise AttributeError(f"scene {self.scene} has no option -{name}") from None

    def text(self):
        """Return a complete options file that reproduces the run.

        Not collective. Without those that were meant for this run alone: to replace a result, and
        to say only what the run will need.
        """
        lines = [f"-scene {self.scene}"]
        for option in self._declared:
            value = self._values[option.name]
            if value is not None and option.name not in ("output_overwrite", "dry_run"):
                lines.append(option.write(value))
        for key, text in self.solver.items():
            lines.append(f"-{key} {shlex.quote(text)}" if text else f"-{key}")
        return "\n".join(lines) + "\n"

    def identity(self):
        """Return what decides the run's numbers, {option: text}; how it is carried out does not."""
        found = {"scene": self.scene}
        for option in self._declared:
            value = self._values[option.name]
            if value is not None and option not in RUN:
                found[option.name] = text_of(value)
        return found | {k: text for k, text in self.solver.items() if is_solver_key(k)}
