"""Columns of numbers in a text file."""

import numpy as np

from pgran.errors import FileError
from pgran.files.paths import open_regular

LONGEST_FILE = 2**26  # bytes


def read_columns(path):
    """Return the numbers in a file of one or two columns, shape (n, 1) or (n, 2).

    Not collective. Blanks, commas or semicolons part them; `#` begins a comment.

    Raises
    ------
    FileError
        If the file cannot be read, or holds what is no finite number, with the line it is in.
    """
    with open_regular(path) as stream:
        content = stream.read(LONGEST_FILE + 1)
    if len(content) > LONGEST_FILE:
        raise FileError(f"{path}: a file of numbers has at most {LONGEST_FILE} bytes")
    rows = []
    for number, line in enumerate(content.decode("utf-8-sig", errors="replace").splitlines(), 1):
        words = line.partition("#")[0].replace(",", " ").replace(";", " ").split()
        if not words:
            continue
        place, said = f"{path}:{number}", repr(line.strip()[:60])
        try:
            row = [float(word) for word in words]
        except ValueError:
            raise FileError(f"{place}: {said} is no number; begin comments with #") from None
        if not np.all(np.isfinite(row)):
            raise FileError(f"{place}: {said} is not finite; fill the gap, or leave its end away")
        if len(row) != len(rows[0] if rows else row) or len(row) > 2:
            raise FileError(f"{place}: {len(row)} numbers; each line has one, or a time and one")
        rows.append(row)
    if not rows:
        raise FileError(f"{path}: holds no numbers")
    return np.array(rows)
