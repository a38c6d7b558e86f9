"""Numbers in text files: line by line, in columns of a file, and the tables of a result."""

import dataclasses
import math

import numpy as np

from pgran.catalogue import without
from pgran.errors import FileError, InputError
from pgran.store.paths import open_regular

LONGEST_LINE = 2**16  # bytes
LONGEST_FILE = 2**26  # bytes
SEPARATORS = str.maketrans(",;", "  ")
MEASURED = ("omega", "amplitude", "phase")  # omega: what a header may call frequency, too
COLUMN_AXES = "detector_number", "axis", "bound"  # along these a table has columns, not rows
MEDIA = "lattice", "network"  # groups that are of no scene
SPACE_AXES = "balls", "bonds_"  # what arrays along these hold is a picture, no table


def is_number(word):
    """Return whether a word is a number."""
    try:
        float(word)
    except ValueError:
        return False
    return True


class Lines:
    """The lines of a text file one by one, none longer than a bound."""

    def __init__(self, path, stream):
        self.path, self._stream, self.number = path, stream, 0
        self.ended = True  # whether the present line has its end

    def refuse(self, why):
        """Raise a FileError about the present line."""
        raise FileError(f"{self.path}:{max(self.number, 1)}: {why}")

    def next(self):
        """Return the next line without its end, or None after the last one."""
        raw = self._stream.readline(LONGEST_LINE + 1)
        if not raw:
            return None
        self.number += 1
        self.ended = raw.endswith(b"\n")
        try:  # editors may put a mark in front of a file
            line = raw.decode("utf-8-sig" if self.number == 1 else "utf-8")
        except UnicodeDecodeError:
            line = "\0"
        if len(raw) > LONGEST_LINE or "\0" in line:
            packed = raw.startswith(b"\x1f\x8b") and self.number == 1
            self.refuse("is compressed: unpack it first" if packed else "is no line of text")
        return line.rstrip("\r\n")

    def next_content(self):
        """Return the next line that holds more than a comment, without its comment, or None."""
        while (line := self.next()) is not None:
            if content := line.partition("#")[0].strip():
                return content
        return None

    def need(self, what):
        """Return the next line, in which something is expected."""
        line = self.next()
        if line is None or not self.ended:
            self.refuse(f"the file ends here, within its {what}: was it cut?")
        return line

    def last(self, start):
        """Return how many lines begin with a text, and go back to the last of them."""
        before, count = 0, 0
        while (line := self.next()) is not None:
            if line.startswith(start):
                place, number, count = before, self.number - 1, count + 1
            before = self._stream.tell()
        if count:
            self._stream.seek(place)
            self.number = number
        return count


def read_columns(path):
    """Return the numbers in a file of one or two columns, shape (n, 1) or (n, 2).

    A FileError names the line of what is no finite number.
    """
    return _numbers(path, _content(path), (1, 2), "one, or a time and one")


def read_measured(path):
    """Return what was measured at some frequencies, columns by their names.

    Two columns, `omega` (a frequency, in any unit) and `amplitude` relative to the drive, or three,
    `phase` in rad too. A header may name them in another order.
    """
    lines, names, widths = _content(path), MEASURED, (2, 3)
    meaning = "frequency, amplitude and maybe phase"
    if lines and not any(map(is_number, _words(lines[0][1]))):
        place, header = lines.pop(0)
        names = [word.strip("\"'").lower() for word in _words(header)]
        names = [name.replace("frequency", "omega") for name in names]
        widths = (len(names),)
        if sorted(names) not in (sorted(MEASURED), sorted(MEASURED[:2])):
            raise FileError(f"{place}: a header names {meaning}")
    numbers = _numbers(path, lines, widths, f"{meaning}, as the first one")
    columns = dict(zip(names, numbers.T, strict=False))
    for name in MEASURED[:2]:
        for row in np.flatnonzero(columns[name] <= 0)[:1]:
            raise FileError(f"{lines[row][0]}: {name} {columns[name][row]:g} is not > 0")
    return columns


def _content(path):
    """Return the place and the text of each line that is not empty."""
    with open_regular(path, what="a file of numbers", most=LONGEST_FILE) as stream:
        lines = Lines(path, stream)
        return [(f"{path}:{lines.number}", line) for line in iter(lines.next_content, None)]


def _words(line):
    """Return the words of a line, parted by commas, semicolons or blanks."""
    return line.translate(SEPARATORS).split()


def _numbers(path, lines, widths, meaning):
    """Return the numbers of all lines, as many and as finite in each as in the first."""
    rows = []
    for place, line in lines:
        words = _words(line)
        if not all(map(is_number, words)):
            raise FileError(f"{place}: {line[:60]!r} is no number; begin comments with #")
        row = [float(word) for word in words]
        if not all(map(math.isfinite, row)):
            why = "is not finite; fill the gap, or leave its end away"
            raise FileError(f"{place}: {line[:60]!r} {why}")
        if len(row) not in widths or len(row) != len(rows[0] if rows else row):
            raise FileError(f"{place}: numbers: {len(row)}; each line has {meaning}")
        rows.append(row)
    if not rows:
        raise FileError(f"{path}: holds no numbers")
    return np.array(rows)


def tables(result):
    """Return the tables of a result: columns by their names.

    Of each record but the medium's all arrays along the same axes make a table: a row for each
    place along them, first what is there (`omega`, or a number from 0), then the arrays, of each
    detector a column: `amplitude_8_10`, `amplitude_17`. Group and axes name the tables but the
    first, "", of the scene's own record if it has one. A FileError says if there is none.
    """
    scene = str(result.scene)
    groups = [group for group in result.records if group not in MEDIA]
    named = {}
    for group in sorted(groups, key=lambda group: group != scene):  # the scene's own first
        for number, (axes, columns) in enumerate(_tables_of(result.records[group]).items()):
            name = [group] * (group != scene) + [*axes] * (number > 0)
            named["-".join(name) if named else ""] = columns
    if not named:
        raise FileError(f"no table in this result (scene {scene}){without(scene)}")
    return named


def table_of(record, rows=()):
    """Return the table of a record, that with these rows if it has several; see `Record`."""
    found = _tables_of(record)
    if not rows and len(found) == 1:
        (rows,) = found
    if rows not in found:
        calls = " or ".join(f"to_dataframe({', '.join(map(repr, axes))})" for axes in found)
        raise InputError(f"which table of {record.group}? {calls or 'it has no rows'}")
    return found[rows]


def _tables_of(record):
    """Return the tables of a record by the axes of their rows, those of fewer axes first."""
    declared = {
        item.name: item.metadata["axes"]
        for item in dataclasses.fields(record)
        if "axes" in item.metadata
    }
    used = {axis for axes in declared.values() for axis in axes}
    found = {}
    for name, axes in declared.items():
        values, axes = getattr(record, name), axes or (name,)
        in_space = any(axis.startswith(SPACE_AXES) for axis in axes)
        if values is None or name in used or in_space or axes == COLUMN_AXES[:2]:
            continue
        # displacement (omega, detector_number): a row each omega, a column each detector
        rows = tuple(axis for axis in axes if axis not in COLUMN_AXES)
        values = np.moveaxis(values, [axes.index(axis) for axis in rows], range(len(rows)))
        if rows not in found:
            places = [
                getattr(record, axis) if declared.get(axis) == () else np.arange(length)
                for axis, length in zip(rows, values.shape, strict=False)
            ]
            grids = np.meshgrid(*places, indexing="ij")
            found[rows] = dict(zip(rows, map(np.ravel, grids), strict=True))
        if declared[name]:
            aside = [axis for axis in axes if axis not in rows]
            labels = _labels(record, name, aside, values.shape[len(rows) :])
            columns = values.reshape(math.prod(values.shape[: len(rows)]), len(labels)).T
            found[rows] |= dict(zip(labels, columns, strict=True))
    filled = {rows: columns for rows, columns in found.items() if len(columns[rows[0]])}
    return dict(sorted(filled.items(), key=lambda table: len(table[0])))


def numbers_of(record):
    """Return the single numbers of a record by their names, one of each detector.

    These are its plain values but texts, short arrays, and what its tables of one row hold.
    """
    found = {}
    for item, value in record.filled():
        if "along" in item.metadata:
            labels = _labels(record, item.name, item.metadata["along"], value.shape)
            found |= dict(zip(labels, value.tolist(), strict=True))
        elif isinstance(value, int | float):
            found[item.name] = value
    for columns in _tables_of(record).values() if record.group not in MEDIA else ():
        rows = {name: column.tolist() for name, column in columns.items()}
        found |= {name: row[0] for name, row in rows.items() if len(row) == 1}
    return found


def _labels(record, name, axes, shape):
    """Return the names of an array's columns, one for each place along the axes that have them."""
    labels = [name]
    for axis, length in zip(axes, shape, strict=True):
        sites = np.arange(length)[:, None]
        if axis == "detector_number":
            sites = record.detector
        labels = ["_".join(map(str, [label, *site])) for label in labels for site in sites.tolist()]
    return labels
