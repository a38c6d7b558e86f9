"""Columns of numbers in a text file: motions of the wall, and what was measured."""

import numpy as np

from pgran.errors import FileError
from pgran.store.lines import Lines, is_number
from pgran.store.paths import open_regular

LONGEST_FILE = 2**26  # bytes
MEASURED = ("omega", "amplitude", "phase")  # omega: what a header may call frequency, too


def read_columns(path):
    """Return the numbers in a file of one or two columns, shape (n, 1) or (n, 2).

    A FileError names the line of what is no finite number.
    """
    rows = _numbers(path, _lines(path), (1, 2), "one, or a time and one")
    return np.array([row for _, row in rows])


def read_measured(path):
    """Return what was measured at some frequencies, columns by their names.

    Two columns, `omega` (a frequency, in any unit) and `amplitude` relative to the drive, or three,
    `phase` in rad too. A header may name them in another order.
    """
    lines, names, widths = _lines(path), MEASURED, (2, 3)
    if lines and not any(map(is_number, lines[0][1])):
        place, header, _ = lines.pop(0)
        names = [word.strip("\"'").lower().replace("frequency", "omega") for word in header]
        widths = (len(names),)
        if sorted(names) not in (sorted(MEASURED), sorted(MEASURED[:2])):
            raise FileError(f"{place}: a header names frequency, amplitude and maybe phase")
    rows = _numbers(path, lines, widths, "frequency, amplitude and maybe phase, as the first one")
    columns = dict(zip(names, np.transpose([row for _, row in rows]), strict=False))
    for name in MEASURED[:2]:
        if (wrong := np.flatnonzero(columns[name] <= 0)).size:
            raise FileError(f"{rows[wrong[0]][0]}: {name} {columns[name][wrong[0]]:g} is not > 0")
    return columns


def _lines(path):
    """Return of each line that is not empty its place, its words, and itself."""
    with open_regular(path, what="a file of numbers", most=LONGEST_FILE) as stream:
        lines = Lines(path, stream)
        blanks = str.maketrans(",;", "  ")
        return [
            (f"{path}:{lines.number}", line.translate(blanks).split(), repr(line[:60]))
            for line in iter(lines.next_content, None)
        ]


def _numbers(path, lines, widths, meaning):
    """Return of each line its place, and as many finite numbers as the first one has."""
    rows = []
    for place, words, line in lines:
        if not all(map(is_number, words)):
            raise FileError(f"{place}: {line} is no number; begin comments with #")
        row = [float(word) for word in words]
        if not np.all(np.isfinite(row)):
            raise FileError(f"{place}: {line} is not finite; fill the gap, or leave its end away")
        if len(row) != len(rows[0][1] if rows else row) or len(row) not in widths:
            raise FileError(f"{place}: numbers: {len(row)}; each line has {meaning}")
        rows.append((place, row))
    if not rows:
        raise FileError(f"{path}: holds no numbers")
    return rows
