"""Options: how one is declared, read and written; those of every run; a run's own, resolved."""

import contextlib
import math
import operator
import re
import shlex
import unicodedata
from collections.abc import Callable
from dataclasses import dataclass
from os.path import exists

from pgran.arguments import meant, nearest, shown
from pgran.errors import InputError


@dataclass(frozen=True)
class Kind:
    """A type of option, how its text is read, and what a text must be in words."""

    name: str
    read: Callable
    words: str


def _only(possible, read):
    """Return what reads a value, and raises ValueError unless it is possible."""

    def checked(text):
        value = read(text)
        if not possible(value):
            raise ValueError
        return value

    return checked


def _several(kind, words):
    read = lambda text: tuple(map(kind.read, text.split(",")))  # noqa: E731
    return Kind(f"{kind.name}s", read, f"{words} with commas between them")


# A key without a value is true.
FLAGS = dict.fromkeys(("", "true", "yes", "1", "on"), True)
FLAGS |= dict.fromkeys(("false", "no", "0", "off"), False)
INTEGER = Kind("integer", _only(lambda value: abs(value) < 2**64, int), "a whole number")
REAL = Kind("real", _only(math.isfinite, float), "a number")
FLAG = Kind("flag", lambda text: FLAGS[text.lower()], "true or false")
TEXT = Kind("text", _only(len, str), "a value")
INTEGERS, REALS = _several(INTEGER, "whole numbers"), _several(REAL, "numbers")
# Names of files that a run reads: what these hold is part of what the run is.
FILE = Kind("file", TEXT.read, "the name of a file")
LISTED = _several(FILE, "names of files")
# Several, or one with a comma in its name.
FILES = Kind("files", lambda text: (text,) if exists(text) else LISTED.read(text), LISTED.words)
# Of a default, or of a tuple of them.
KINDS = {bool: FLAG, int: INTEGER, float: REAL, str: TEXT, (int,): INTEGERS, (float,): REALS}


def text_of(value):
    """Return the text that a value is read from."""
    value = _without_numpy(value)
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


def _hint(text, kind):
    """Return what to say of 20x20, (1, 2), 0,5 or 1e3 where another type of number is needed."""
    plain = unicodedata.normalize("NFKC", text).strip("()[], ")
    if not re.fullmatch(r"[\d\s.,;xe+-]+", plain):
        return ""
    if re.fullmatch(r"\d{20,}", plain):
        return "; this one is too large"
    whole = re.fullmatch(r"\d(\.\d*)?e\+?\d\d?|\d+\.0*", plain) and float(plain)
    whole = f"{whole:.0f}" if whole == round(whole or 0) else ""
    for other in (re.sub(r"[\s,;x]+", ",", plain), plain.replace(",", "."), whole):
        with contextlib.suppress(ValueError, KeyError):
            kind.read(other)
            return meant(other if other != text else "")
    return ""


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
        """Return the value that `text` means; raise an InputError if it is not possible."""
        try:
            value = self.kind.read(text.strip())
        except (ValueError, KeyError):
            raise self._wrong_type(text, where) from None
        if self.choices and value not in self.choices:
            hint = meant(nearest(value, self.choices))
            choices = ", ".join(self.choices)
            raise InputError(f"-{self.name} {text}{where}: choose {choices}{hint}")
        for number in value if isinstance(value, tuple) else (value,):
            if not all(holds(number, bound) for _, holds, bound in self._bounds()):
                raise InputError(f"-{self.name} {text}{where}: {number} is not {self.range()}")
        return value

    def range(self):
        """Return the range in words."""
        return " and ".join(f"{sign} {bound:.3g}" for sign, _, bound in self._bounds())

    def _bounds(self):
        """Return the sign of each bound that there is, what it means, and the bound."""
        above, low = (">", operator.gt, self.above), (">=", operator.ge, self.low)
        bounds = (above, low, ("<=", operator.le, self.high))
        return [(sign, holds, bound) for sign, holds, bound in bounds if bound is not None]

    @property
    def options(self):
        """The options of a keyword that this declares; see `pgran.run.keywords`."""
        return (self,)

    def of_run(self, options, *others):
        """Return the value that the options of a run say, None if they do not have this one."""
        return getattr(options, self.name, None)

    def write(self, value):
        """Return the line of an options file that sets this value."""
        return f"-{self.name} {shlex.quote(text_of(value))}"

    def check(self, value):
        """Return a value given in Python as the command line would read it; raise as it does."""
        try:
            plain = _without_numpy(value)
            text = text_of(plain)
        except Exception:  # whatever an object's own conversion raises
            raise self._wrong_type(shown(value)) from None
        read = self.read(text)
        if read != plain:
            raise self._wrong_type(text)
        return read

    def _wrong_type(self, text, where=""):
        key = f"-{self.name} {text}".rstrip()
        unit = f" (unit: {self.unit})" if self.unit else ""
        needs = f"one of {', '.join(self.choices)}" if self.choices else self.kind.words
        return InputError(f"{key}{where}: needs {needs}{unit}{_hint(text, self.kind)}")


# The options of every run.
RUN = (
    Option(
        "ranks_per_lattice", INTEGER, 0,
        "ranks that share one lattice, the rest share out the work; 0 = automatic", low=0
    ),
    Option(
        "output_file", TEXT, None, "result (default: results/NAME.h5 for NAME.opts)"
    ),
    Option("output_overwrite", FLAG, False, "replace an existing result"),
    Option(
        "output_progress", TEXT, "auto", "auto = a bar on a terminal, lines elsewhere",
        choices=("auto", "bar", "lines", "none"),
    ),
    Option("output_log", TEXT, None, "log file; an existing log is continued"),
    Option("units_length", REAL, None, "unit of length, the spacing of a lattice", "m", above=0),
    Option("units_time", REAL, None, "unit of time: figures and summaries in Hz", "s", above=0),
    Option("dry_run", FLAG, False, "say what the run will need, and stop"),
)  # fmt: skip


def options_in(text):
    """Return {name: text} of what `Options.text` has written, but how a run was carried out."""
    how = ("output_", *(option.name for option in RUN))
    lines = [line.lstrip("-").partition(" ") for line in text.splitlines() if line]
    return {name: value for name, _, value in lines if not name.startswith(how)}


def alternatives(some, others, values, given, whole=None):
    """Let one of two ways to say the same stand: the one given, or given by the winning source.

    Without any, `others` have their defaults. The values of the way that does not stand become
    None. A source wins that says the whole: the first of `some`, or any of `whole`, by default all
    of `others`. Raises InputError if both are given, and none wins.
    """

    def latest(keys):
        return max([(given[key].rank, key) for key in keys if key in given], default=(-1, None))

    (rank, one), (other_rank, other) = latest(some), latest(others)
    stands = latest(some[:1] if other else some)[0] > other_rank
    if one and other and not stands and latest(others if whole is None else whole)[0] <= rank:
        here, there = (f"-{key}{given[key].where or ' (command line)'}" for key in (other, one))
        raise InputError(f"{here}: contradicts {there}; give one of them")
    if one or other or values[some[0]] is not None:
        values.update(dict.fromkeys(others if stands else some))


def check_ends(name, values):
    """Raise unless the lower end of a window lies below its upper end."""
    low, high = (values.get(f"{name}_{end}") for end in ("min", "max"))
    if low is not None and low >= high:
        raise InputError(f"-{name}_min: {low:g} is not below -{name}_max, {high:g}")
