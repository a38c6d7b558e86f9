"""Tables of other programs: dumps of LAMMPS and LIGGGHTS, CSV with a header, GraphML.

What a file claims about its size is believed only as far as its lines go.
"""

import dataclasses
import itertools
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pgran.errors import FileError, needed
from pgran.store.paths import open_regular
from pgran.store.text import Lines, is_number

BLOCK = 2**14  # rows that are turned into numbers at a time: words take more room
LARGEST_GRAPH = 2**28  # bytes; NetworkX keeps all of a graph as Python objects


class Box(NamedTuple):
    """A box with sides along the axes: its ends, and along which axes it is periodic."""

    low: np.ndarray
    high: np.ndarray
    periodic: np.ndarray


@dataclass(frozen=True, eq=False)
class Table:
    """Named columns of numbers, and the place in the file of each row: a line, or an edge's name.

    `texts` holds of each column with something else than numbers the first such row and its word.
    A dump has a time step, a number of snapshots, of which this is the last, and a box.
    """

    path: str
    columns: dict
    texts: dict
    places: np.ndarray
    step: int | None = None
    snapshots: int = 1
    box: Box | None = None

    def __contains__(self, name):
        return name in self.columns or name in self.texts

    def __str__(self):
        return ", ".join([*self.columns, *self.texts][:30])

    def refuse(self, row, why):
        """Raise a FileError about a row."""
        place = self.places[row]
        between = ", " if isinstance(place, str) else ":"
        raise FileError(f"{self.path}{between}{place}: {why}")

    def refuse_any(self, wrong, why):
        """Raise a FileError about the first row that is wrong, if one is: `why`, or `why(row)`."""
        for row in np.flatnonzero(wrong)[:1]:
            self.refuse(row, why(row) if callable(why) else why)

    def of_rows(self, chosen):
        """Return the table of some rows, chosen by truth, shape (rows,)."""
        columns = {name: values[chosen] for name, values in self.columns.items()}
        return dataclasses.replace(self, columns=columns, places=self.places[chosen])

    def numbers(self, name, positive=False):
        """Return a column; refuse it unless all of it is finite, and maybe positive, numbers."""
        if name in self.texts:
            row, word = self.texts[name]
            self.refuse(row, f"{name} is {word[:40]!r}, no number")
        if name not in self:
            raise FileError(f"{self.path}: has no column {name}; it has {self}")
        column = self.columns[name]
        endless = ~np.isfinite(column)
        self.refuse_any(endless, lambda row: f"{name} is {column[row]}, no finite number")
        if positive:
            self.refuse_any(column <= 0, lambda row: f"{name} must be positive, not {column[row]}")
        return column

    def integers(self, name):
        """Return a column of integers; refuse it if it is another."""
        column = self.numbers(name)
        others = (column != np.rint(column)) | (np.abs(column) >= 2**53)
        self.refuse_any(others, lambda row: f"{name} is {column[row]}, no integer")
        return column.astype(np.int64)

    @cached_property
    def digits(self):
        """How many digits its numbers have: six, which LAMMPS prints, or up to 15."""
        some = {x for column in self.columns.values() for x in column[:BLOCK].tolist() if x % 1 > 0}
        return next((n for n in range(6, 15) if all(float(f"{x:.{n}g}") == x for x in some)), 15)


def read_table(path):
    """Return the table in a dump, its last snapshot, or in a CSV file with a header."""
    with open_regular(path) as stream:
        lines = Lines(path, stream)
        first = lines.next_content()
        if first is None:
            raise FileError(f"{path}: is empty")
        if first.startswith("ITEM:"):
            stream.seek(0)
            return _read_dump(Lines(path, stream))
        if first.startswith("<"):
            lines.refuse("this looks like XML: a GraphML file ends in .graphml")
        return _read_csv(lines, first)


def _read_csv(lines, header):
    """Return the table below a header; commas, semicolons or blanks part its words."""
    mark = next((mark for mark in ",;" if mark in header), None)

    def split(line):
        return [word.strip().strip('"') for word in line.split(mark)]

    names = split(header)
    if any(is_number(name) or not name for name in names):
        lines.refuse("the first line must name the columns, without #")
    return _read_rows(lines, names, map(split, iter(lines.next_content, None)))


def _read_dump(lines):
    """Return the last snapshot of a dump."""
    snapshots = lines.last("ITEM: TIMESTEP")
    if not snapshots:
        raise FileError(f"{lines.path}: is no dump: it has no line ITEM: TIMESTEP")
    # a head in any order, at last the line that repeats the kind and names the columns:
    #   ITEM: NUMBER OF ENTRIES
    #   812
    #   ITEM: BOX BOUNDS pp ff ff         two ends in each of the next three lines
    #   ITEM: ENTRIES c_p[1] c_p[2] ...
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
    rows = (lines.need(f"{count} rows").split() for _ in range(count))
    table = _read_rows(lines, names, rows)
    if (line := lines.next()) is not None and line.strip():
        lines.refuse(f"more than the {count} rows that were announced")
    return dataclasses.replace(table, step=step, snapshots=snapshots, box=box)


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
    for flag in flags:
        words = lines.need("box").split()
        if len(words) != 2 or not all(map(is_number, words)):
            lines.refuse("the two ends of the box were expected")
        low, high = map(float, words)
        if not 0 <= high - low < np.inf or (high == low and flag == "pp"):
            lines.refuse("the box must have a positive and finite length")
        ends.append((low, high))
    return Box(*np.array(ends).T, np.array([flag == "pp" for flag in flags]))


def _read_rows(lines, names, rows):
    """Return the table of rows of lines, given as their words."""
    twice = [name for name in names if names.count(name) > 1]
    if twice or not names:
        lines.refuse(f"two columns are called {twice[0]!r}" if twice else "names no columns")

    def placed():
        for words in rows:
            if len(words) != len(names):
                lines.refuse(f"{len(words)} words where the columns are {len(names)}")
            yield lines.number, words

    table = _table(lines.path, names, placed())
    if table is None:
        lines.refuse("there are no rows")
    return table


def _table(path, names, rows):
    """Return the table of rows given as (place, words), None if there are none."""
    blocks, texts, places, done = {name: [] for name in names}, {}, [], 0
    while block := list(itertools.islice(rows, BLOCK)):
        places.append(np.array([place for place, _ in block]))
        for k, name in enumerate(names):
            words = [words[k] for _, words in block]
            try:
                blocks[name].append(np.array(words, dtype=float))
            except (TypeError, ValueError, OverflowError):
                wrong = (row for row, word in enumerate(words) if not is_number(str(word)))
                row = next(wrong, 0)
                texts.setdefault(name, (done + row, str(words[row])))
        done += len(block)
    if not done:
        return None
    columns = {name: np.concatenate(blocks[name]) for name in names if name not in texts}
    return Table(path, columns, texts, np.concatenate(places))


def read_graph(path):
    """Return the tables of the nodes and of the edges of a GraphML file, and the nodes' names.

    The columns `id` and `id1`, `id2` are the names where these are all integers, else numbers from
    0 in the order of the file.
    """
    open_regular(path, what="a GraphML file", most=LARGEST_GRAPH).close()
    networkx = needed("GraphML, unlike CSV,", "networkx")
    try:
        graph = networkx.read_graphml(path)
        nodes, edges = list(graph.nodes(data=True)), list(graph.edges(data=True))
    except Exception as error:  # whatever a damaged file makes of NetworkX
        why = f"{type(error).__name__}: {error}"
        raise FileError(f"{path}: NetworkX cannot read it: {why}") from None
    names = [str(name) for name, _ in nodes]
    numbered = all(name.isascii() and name.isdigit() and len(name) < 16 for name in names)
    ids = {name: int(name) if numbered else k for k, name in enumerate(names)}
    balls = [(f"node {name}", {**data, "id": ids[str(name)]}) for name, data in nodes]
    pairs = [
        (f"edge {a} - {b}", {**data, "id1": ids[str(a)], "id2": ids[str(b)]})
        for a, b, data in edges
    ]
    tables = []
    for rows, what in ((balls, "nodes"), (pairs, "edges")):
        columns = [*dict.fromkeys(name for _, row in rows for name in row)]
        # NaN where a row lacks a number
        words = ((place, [row.get(name, np.nan) for name in columns]) for place, row in rows)
        table = _table(path, columns, words)
        if table is None:
            raise FileError(f"{path}: has no {what}")
        tables.append(table)
    return *tables, names
