"""Text files line by line; columns of numbers: motions of the wall, what was measured."""

import numpy as np

from pgran.errors import FileError
from pgran.store.paths import open_regular

LONGEST_LINE = 2**16  # bytes
LONGEST_FILE = 2**26  # bytes
MEASURED = ("omega", "amplitude", "phase")  # omega: what a header may call frequency, too


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
