"""Options: how one is declared, read and written, and the files and command lines that give them.

Options files have PETSc's syntax (`-key value`, `#` starts a comment) but are read here, before
PETSc starts, so that what is wrong is an error that names the key and the line.
"""

import contextlib
import itertools
import math
import operator
import os
import re
import shlex
import unicodedata
from collections.abc import Callable
from dataclasses import dataclass

from pgran.arguments import meant, nearest, shown
from pgran.errors import FileError, InputError
from pgran.store.paths import open_regular


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
FILES = Kind(
    "files",
    lambda text: (text,) if os.path.exists(text) else LISTED.read(text),
    LISTED.words,
)
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
            from pgran.run.gone import check_gone

            check_gone(f"{self.name} {text}", where)
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
        return InputError(f"{key}{where}: needs {needs}{unit}{_number_meant(text, self.kind)}")

    # What a keyword asks that is one option: see `pgran.run.experiment.Asked`.

    @property
    def options(self):
        """This one."""
        return (self,)

    def of_run(self, options, *others):
        """Return the value that the options of a run say, None if they do not have this one."""
        return getattr(options, self.name, None)


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
    """Keep one of two ways to say the same: the one given, or given by the winning source.

    Without any, `others` have their defaults. The values of the other way become None. A source
    wins that says the whole: the first of `some`, or any of `whole`, by default all of `others`.
    Raises InputError if both are given, and none wins.
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


# What gives options: files, command lines, and PETSC_OPTIONS

LONGEST_FILE = 2**20  # bytes of an options file
# Control characters and surrogates, which stand for bytes that are no UTF-8.
NO_TEXT = re.compile(r"[^\t\n\r -~\u00a0-\ud7ff\ue000-\U0010ffff]")
KEY = re.compile(r"--?[A-Za-z][\w.-]*", re.ASCII)
UNQUOTED, QUOTES = re.compile(r"[^ \t]+"), re.compile(r"['\"\\]")


@dataclass(frozen=True)
class Given:
    """One key as the user gave it, where, and its rank, by which the command line wins.

    Over later files, these over earlier ones, and all over the environment, of rank 0.
    """

    key: str
    text: str
    where: str
    rank: float


def files_first(words):
    """Return the options files that words begin with, and the others; the first has any name."""
    files = [*words[:1], *itertools.takewhile(lambda word: word.endswith(".opts"), words[1:])]
    for path in files:
        check_word(path)
    return files, words[len(files) :]


def read_files(paths):
    """Return what options files give, in order: later ones win."""
    return [item for rank, path in enumerate(paths, 1) for item in read_file(path, rank)]


def read_file(path, rank=1):
    """Return what an options file gives, in order; an error names what is no `-key value`."""
    with open_regular(path, ".opts") as stream:
        content = stream.read(LONGEST_FILE + 1)
    if len(content) > LONGEST_FILE:
        raise FileError(f"{path}: an options file has at most {LONGEST_FILE} bytes")
    if content.startswith(b"\x89HDF"):
        raise FileError(f"{path}: not a text file, as options files are, but a result or a network")
    text = content.decode("utf-8-sig", errors="surrogateescape")  # editors may put a mark in front
    if strange := NO_TEXT.search(text):
        line = 1 + text.count("\n", 0, strange.start())
        raise FileError(f"{path}: not a text file (line {line})")
    items = []
    for number, line in enumerate(text.splitlines(), 1):
        words = UNQUOTED.findall(line.partition("#")[0])
        if not words:
            continue
        where = f" ({path}, line {number})"
        try:
            if QUOTES.search("".join(words)):  # seldom: shlex is slow
                words = shlex.split(line, comments=True)
        except ValueError as error:
            hint = next((hint for word in line.split() if (hint := _word_meant(word))), error)
            raise InputError(f"{line.strip()}{where}: {hint}") from None
        items += read_words(words, where, rank)
    return items


def read_words(words, where="", rank=math.inf):
    """Return what a command line gives: `-key value`, or `-key` alone."""
    items = []
    for word in words:
        check_word(word, where)
        if KEY.fullmatch(word):
            items.append(Given(word.lstrip("-"), "", where, rank))
        elif re.match("--?[A-Za-z]", word):
            key, sign, value = word.partition("=")
            hint = f"write {key} {value}" if sign else "no key has such a name"
            if " " in word:
                hint = "leave out the quotes around a key and its value"
            raise InputError(f"{word}{where}: {hint}")
        elif items and not items[-1].text:
            items[-1] = Given(items[-1].key, word, where, rank)
        else:
            hint = _word_meant(word, items) or "a value without a key (keys look like -key)"
            raise InputError(f"{word}{where}: {hint}")
    return items


def check_word(word, where=""):
    """Raise where a word could not be read again from an options file."""
    if NO_TEXT.search(word) or "".join(word.splitlines()) != word:
        odd = "a line break, a control character, or a byte that is no UTF-8"
        raise InputError(f"{word}{where}: holds {odd}")


def read_environment():
    """Return what PETSC_OPTIONS gives, and keep PETSc from reading it unchecked."""
    if os.environ.pop("PETSC_OPTIONS_YAML", ""):
        raise InputError("PETSC_OPTIONS_YAML: not read; an options file or PETSC_OPTIONS is")
    return read_words(os.environ.pop("PETSC_OPTIONS", "").split(), " (PETSC_OPTIONS)", 0)


# What was meant by what is wrong

# What other programs' files begin a comment with, and what others write instead of a dash.
COMMENTS, DASHES = ("//", "/*", "%", ";", "!"), tuple("\u2010\u2011\u2013\u2014\u2212")


def _number_meant(text, kind):
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


def _word_meant(word, items=()):
    """Return what a word may have been meant to be that is no value, or None."""
    if word.startswith(COMMENTS):
        return "a comment begins with #"
    if word.endswith(".opts"):
        return "options files come first, before all keys"
    if word.startswith(DASHES):
        return "begins with a long dash; keys begin with -"
    if re.fullmatch("[a-z]+(_[a-z]+)+|scene|detectors", word.lower()):
        return f"a value without a key; did you mean -{word.lower()}?"
    if items and items[-1].text in ("=", ":"):
        return f"write -{items[-1].key} {word}"
    if items and re.fullmatch(r"[\d.,e+-]+", word):
        both = f"{items[-1].text.strip(',')},{word.strip(',')}"
        return f"a value without a key; a list has no blanks: -{items[-1].key} {both}"
    return None
