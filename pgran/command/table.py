"""`pgran table`: the numbers of several results beside the options in which they differ."""

import os
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import numpy

from pgran.arguments import called_right, meant, nearest
from pgran.command.export import blaming_edits, result_of
from pgran.command.words import Parser
from pgran.errors import DONE, InputError, needed
from pgran.medium.differences import differences
from pgran.store.paths import whole
from pgran.store.record import Shown
from pgran.store.text import numbers_of

if TYPE_CHECKING:
    import pandas

WIDEST = 3  # options that begin each line


@called_right
def table(results: list) -> "pandas.DataFrame":
    """Return the numbers of several results, a row each: `table(["a.h5", "b.h5"])`.

    Parameters
    ----------
    results : list of pgran.store.record.Result, str or os.PathLike
        What `load` returns, or the paths of their files.

    Returns
    -------
    pandas.DataFrame
        First the options in which the results differ, named in `attrs["options"]`. Then of each
        record the plain values, short arrays, of each detector a column, `phase_velocity_8_10`, and
        what it has of a single frequency, time or mode; those of records other than the scene's
        begin with the name of their group. Last how many numbers failed, and how the run went.

    Raises
    ------
    FileError
        If a file cannot be read.
    PgranError
        If there is no pandas.

    Examples
    --------
    >>> packings = [pgran.pack(40, pressure=p, seed=1) for p in (1e-2, 3e-2)]
    >>> pgran.table(packings).unknowns.tolist()
    [80, 80]
    """
    pandas = needed("a table", "pandas")
    results = [results] if isinstance(results, (str, os.PathLike, Shown)) else results
    read = list(map(result_of, results))
    rows = differences(read)
    options = list(dict.fromkeys(key for row in rows for key in row))
    for result, row in zip(read, rows, strict=True):
        failures = 0
        for group, record in result.records.items():
            own = f"{group}_" * (group != result.scene)
            row |= {own + name: value for name, value in numbers_of(record).items()}
            failures += int(numpy.sum(record.failures))
        told = {name: getattr(result, name, None) for name in ("status", "seconds", "mpi_size")}
        row |= {"failures": failures} | told
    names = [r if isinstance(r, (str, os.PathLike)) else n for n, r in enumerate(results, 1)]
    frame = pandas.DataFrame(rows, index=pandas.Index(map(str, names), name="result"))
    frame.attrs["options"] = options
    return frame


def in_words(frame, everything=False):
    """Return a table for a terminal: few digits, by default of columns in which results differ."""
    options = frame.attrs["options"]
    shown = frame.nunique(dropna=False) > 1
    shown |= everything or not shown.any()
    shown["failures"] |= frame["failures"].any()
    shown[options] = True  # those that differ as texts alone, too
    told = frame.loc[:, shown]
    if 0 < len(options) <= WIDEST:
        told = told.set_index(options, append=told.duplicated(options).any())
    width = shutil.get_terminal_size().columns
    return told.to_string(float_format="{:.4g}".format, line_width=width, sparsify=False)


@blaming_edits
def run(words):
    """Tell the numbers of several results beside the options in which they differ.

    On a terminal columns are left out in which all results agree, and numbers are rounded.
    """
    example = "pgran table results/a.h5 results/b.h5"
    chosen = f"{example} --columns phase_velocity -o results/both.csv"
    parser = Parser("table", run.__doc__, example, chosen)
    add = parser.add_argument
    add("results", metavar="RESULT", nargs="+", help="HDF5 files of pgran run")
    add("-o", "--output", metavar="NAME.csv", help="file of all columns, with all digits, instead")
    add("--columns", metavar="A,B", help="beside the options only those whose names begin so")
    asked = parser.read(words)
    if asked.output and Path(asked.output).suffix != ".csv":
        raise InputError(f"table: -o {asked.output}: the name of a table ends in .csv")
    frame = table(asked.results)
    names = asked.columns.split(",") if asked.columns else list(frame)
    for name in names:
        if not any(column.startswith(name) for column in frame):
            raise InputError(f"--columns {name}: no such column{meant(nearest(name, frame))}")
    names = ("failures", *names, *frame.attrs["options"])
    frame = frame.loc[:, [column.startswith(names) for column in frame]]
    if asked.output:
        with whole(asked.output) as stream:
            stream.write(frame.to_csv().encode())
    print(asked.output or in_words(frame, everything=bool(asked.columns)))
    return DONE
