"""Tables in text files of other programs: dumps of LAMMPS and LIGGGHTS, CSV with a header.

What a file claims about its size is believed only as far as its lines go.
"""

import dataclasses
import itertools
from dataclasses import dataclass

import numpy as np

from pgran.errors import FileError
from pgran.store.paths import open_regular

LONGEST_LINE = 2**16  # bytes
BLOCK = 2**14  # rows that are turned into numbers at a time


@dataclass(frozen=True, eq=False)
class Box:
    """A box with sides along the axes: its ends, and along which axes it is periodic."""

    low: np.ndarray
    high: np.ndarray
    periodic: np.ndarray


@dataclass(frozen=True, eq=False)
class Table:
    """Named columns of numbers, and where in the file each row is.

    Attributes
    ----------
    path : str
    columns : dict of str: numpy.ndarray
    texts : dict of str: tuple of int and str
        Of each column that holds something else than numbers: the first such row, and the word.
    places : sequence
        Of each row: the number of its line, or what it is in a graph.
    step : int or None
        Of a dump: the time step.
    snapshots : int
        How many the file has; this is the last one.
    box : Box or None
    """

    path: str
    columns: dict
    texts: dict
    places: list
    step: int | None = None
    snapshots: int = 1
    box: Box | None = None

    def refuse(self, row, why):
        """Raise a FileError about a row."""
        place = self.places[row]
        between = ", " if isinstance(place, str) else ":"
        raise FileError(f"{self.path}{between}{place}: {why}")

    def of_rows(self, chosen):
        """Return the table of some rows, chosen by truth, shape (rows,)."""
        columns = {name: values[chosen] for name, values in self.columns.items()}
        places = [self.places[row] for row in np.flatnonzero(chosen)]
        return dataclasses.replace(self, columns=columns, places=places)

    def numbers(self, name):
        """Return a column; refuse it unless all of it is finite numbers."""
        if name in self.texts:
            row, word = self.texts[name]
            self.refuse(row, f"{name} is {word[:40]!r}, no number")
        if name not in self.columns:
            there = ", ".join([*self.columns, *self.texts][:30])
            raise FileError(f"{self.path}: has no column {name}; it has {there}")
        column = self.columns[name]
        wrong = np.flatnonzero(~np.isfinite(column))
        if wrong.size:
            self.refuse(wrong[0], f"{name} is {column[wrong[0]]}, no finite number")
        return column

    def integers(self, name):
        """Return a column of integers; refuse it if it is another."""
        column = self.numbers(name)
        wrong = np.flatnonzero((column != np.rint(column)) | (np.abs(column) >= 2**53))
        if wrong.size:
            self.refuse(wrong[0], f"{name} is {column[wrong[0]]}, no integer")
        return column.astype(np.int64)


class Lines:
    """The lines of a text file one by one, none longer than a bound."""

    def __init__(self, path, stream):
        """Begin before the first line."""
        self.path, self._stream, self.number = path, stream, 0
        self.ended = True  # whether the present line has its end

    def refuse(self, why, number=None):
        """Raise a FileError about a line, the present one unless another is named."""
        raise FileError(f"{self.path}:{number or max(self.number, 1)}: {why}")

    def next(self):
        """Return the next line without its end, or None after the last one."""
        raw = self._stream.readline(LONGEST_LINE + 1)
        if not raw:
            return None
        self.number += 1
        self.ended = raw.endswith(b"\n")
        try:
            line = raw.decode()
        except UnicodeDecodeError:
            line = "\0"
        if len(raw) > LONGEST_LINE or "\0" in line:
            packed = raw.startswith(b"\x1f\x8b") and self.number == 1
            self.refuse("is compressed: unpack it first" if packed else "is no line of text")
        return line.rstrip("\r\n")

    def need(self, what):
        """Return the next line, in which something is expected."""
        line = self.next()
        if line is None or not self.ended:
            self.refuse(f"the file ends here, within its {what}: was it cut?")
        return line

    def last(self, start):
        """Return how many lines begin with a text, and go back to the last of them."""
        found, before, count = None, 0, 0
        while (line := self.next()) is not None:
            if line.startswith(start):
                found, count = (before, self.number - 1), count + 1
            before = self._stream.tell()
        if count:
            self._stream.seek(found[0])
            self.number = found[1]
        return count


def read_table(path):
    """Return the table in a dump, its last snapshot, or in a CSV file with a header.

    Not collective.

    Raises
    ------
    FileError
        If it is no such file, or is cut; the message has the line.
    """
    with open_regular(path) as stream:
        lines = Lines(path, stream)
        first = lines.next()
        while first is not None and not first.strip():
            first = lines.next()
        if first is None:
            raise FileError(f"{path}: is empty")
        if first.startswith("ITEM:"):
            stream.seek(0)
            return _read_dump(Lines(path, stream))
        if first.lstrip().startswith("<"):
            lines.refuse("this looks like XML: a GraphML file ends in .graphml")
        return _read_csv(lines, first.removeprefix("\ufeff"))


def _read_csv(lines, header):
    """Return the table below a header; commas, semicolons or blanks part its words."""
    while header is not None and not header.partition("#")[0].strip():
        header = lines.next()
    mark = next((mark for mark in ",;" if mark in (header or "")), None)

    def split(line):
        return [word.strip().strip('"') for word in line.split(mark)]

    names = split(header or "")
    if header is None or any(is_number(name) or not name for name in names):
        lines.refuse("the first line must name the columns, without #")
    _check_names(lines, names)

    def rows():
        while (line := lines.next()) is not None:
            line = line.partition("#")[0].strip()
            if line:
                yield lines.number, split(line)

    return Table(lines.path, *_collect(lines, names, rows()))


def is_number(word):
    """Return whether a word is a number. Not collective."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def _check_names(lines, names):
    """Refuse a table that names two columns alike, or none."""
    twice = [name for name in names if names.count(name) > 1]
    if twice or not names:
        lines.refuse(f"two columns are called {twice[0]!r}" if twice else "names no columns")


def _read_dump(lines):
    """Return the last snapshot of a dump."""
    snapshots = lines.last("ITEM: TIMESTEP")
    if not snapshots:
        raise FileError(f"{lines.path}: is no dump: it has no line ITEM: TIMESTEP")
    step = count = box = kind = None
    while True:
        line = lines.need("head")
        words = line.split()
        if words[:1] != ["ITEM:"] or len(words) < 2:
            lines.refuse(f"{line[:40]!r} where a line ITEM: ... belongs")
        if kind and words[1 : 1 + len(kind)] == kind:
            names = words[1 + len(kind) :]
            break
        if words[1:3] == ["NUMBER", "OF"]:
            kind, count = words[3:], _natural(lines, "number of rows")
        elif words[1:3] == ["BOX", "BOUNDS"]:
            box = _read_box(lines, words[3:])
        elif words[1] == "TIMESTEP":
            step = _natural(lines, "time step")
        else:
            lines.need("head")  # of a line such as ITEM: TIME
    _check_names(lines, names)

    def rows():
        for _ in range(count):
            line = lines.need(f"{count} rows")
            yield lines.number, line.split()

    columns, texts, places = _collect(lines, names, rows())
    if (line := lines.next()) is not None and line.strip():
        lines.refuse(f"more than the {count} rows that were announced")
    return Table(lines.path, columns, texts, places, step, snapshots, box)


def _natural(lines, what):
    """Return the number in the next line."""
    line = lines.need(what).strip()
    if not (line.isascii() and line.isdigit() and len(line) < 19):
        lines.refuse(f"{line[:40]!r} is no {what}")
    return int(line)


def _read_box(lines, flags):
    """Return the box in the next three lines."""
    if flags[:3] == ["xy", "xz", "yz"] or flags[:2] == ["abc", "origin"]:
        lines.refuse("the box is triclinic; only boxes with sides along x, y, z are read")
    if len(flags) != 3:
        lines.refuse("does not say of three directions whether they are periodic (pp)")
    ends = []
    for _ in range(3):
        words = lines.need("box").split()
        if len(words) != 2 or not all(map(is_number, words)):
            lines.refuse("the two ends of the box were expected")
        ends.append([float(word) for word in words])
        size = ends[-1][1] - ends[-1][0]
        if not 0 <= size < np.inf or (size == 0 and flags[len(ends) - 1] == "pp"):
            lines.refuse("the box must have a positive and finite length")
    low, high = np.array(ends).T
    return Box(low, high, np.array([flag == "pp" for flag in flags]))


def _collect(lines, names, rows):
    """Return columns, columns of other texts, and the lines of rows given as (number, words)."""
    parts, texts, places = {name: [] for name in names}, {}, []
    done = 0
    while block := list(itertools.islice(rows, BLOCK)):
        for number, words in block:
            if len(words) != len(names):
                why = f"{len(words)} words where the columns are {len(names)}"
                lines.refuse(why, number)
        places.append(np.array([number for number, _ in block]))
        for k, name in enumerate(names):
            words = [words[k] for _, words in block]
            try:
                parts[name].append(np.array(words, dtype=float))
            except ValueError:
                row = next(row for row, word in enumerate(words) if not is_number(word))
                texts.setdefault(name, (done + row, words[row]))
        done += len(block)
    if not done:
        lines.refuse("there are no rows")
    columns = {name: np.concatenate(parts[name]) for name in names if name not in texts}
    return columns, texts, np.concatenate(places)
