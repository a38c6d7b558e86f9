"""The paper's figures and numbers beside what result files hold: a table in Markdown.

    python jobs/paper.py results/paper      draws into that folder, and writes results/paper.md

Of the paper the table has words and numbers with their place; what pgran found is read from the
files that a row's function names as its parameters.
"""

import inspect
import logging
import sys
from concurrent.futures import ProcessPoolExecutor
from itertools import chain
from pathlib import Path

import numpy as np
from paper_table import SECTIONS

import pgran
from pgran.draw import pages as figures
from pgran.errors import BAD_FILE, DONE, FileError, PgranError, reason_of

HEAD = "| what | paper | pgran | verdict | from |\n|---|---|---|---|---|"
INTRODUCTION = """\
# The paper, figure by figure

M. Leibig, *A Model for the Propagation of Sound in Granular Materials*, cond-mat/9301032; figures
and equations go by their TeX labels. omega is in units of omega_mx, lengths are in ball spacings d
unless a unit is given. The paper's sample of bonds is not known: where a number depends on it, it
is given over several samples, too, as mean +- standard deviation. `bash jobs/paper.sh` has made
this; the commands of the files are at the end. A verdict is on the paper: right, wrong, unclear, or
how a question of it is answered.
"""
APART = "beads", "loud"  # stand for the results of all packings, which jobs/paper.sh makes apart
# Results whose figures are laid over each other.
TOGETHER = {
    **{name: [f"{name}_*"] for name in APART},
    "expfreq": ["response", "response_after_100"],
    "geometry_response": ["geometry_response_packing", "geometry_response_ordered"],
    "geometry_modes": ["geometry_modes_packing", "geometry_modes_ordered"],
}


def write(folder):
    """Write the table beside a folder of results; return what is missing, a line each."""
    folder, opened, missing = Path(folder), {}, {}
    lines = [INTRODUCTION]
    for section in SECTIONS:
        drawn = [name for name in section.drawn if files_of(folder, name.rpartition("-")[0])]
        images = [f"![{name}]({folder.name}/{name}.png)" for name in drawn]
        lines += [f"## {section.title}\n", *(f"{image}\n" for image in images)]
        rows = [line(row, folder, opened, missing) for row in section.rows]
        lines += ["\n".join([HEAD, *rows, ""])] if rows else []
    made = {name: result.command for name, result in opened.items() if hasattr(result, "command")}
    lines += ["## Commands\n", *(f"- {name}.h5: `{made[name]}`" for name in sorted(made)), ""]
    folder.with_suffix(".md").write_text("\n".join(lines), encoding="utf-8")
    return [said for name, said in missing.items() if name not in APART]


def files_of(folder, name):
    """Return the files of a name in the table, none if one is missing."""
    found = [sorted(folder.glob(f"{each}.h5")) for each in TOGETHER.get(name, [name])]
    return [*chain.from_iterable(found)] if all(found) else []


def line(row, folder, opened, missing):
    """Return a row of the table; note results that cannot be read, by their names."""
    names = list(inspect.signature(row.found).parameters)
    for name in names:
        if name not in opened and name not in missing:
            try:
                opened[name] = read(folder, name)
            except PgranError as error:
                missing[name] = str(error)
    files = [f"{name}.{'txt' if name.startswith('units') else 'h5'}" for name in names]
    files = [f"`bash jobs/paper.sh --{name}`" for name in names if name in APART] or files
    lacking = [file for name, file in zip(names, files, strict=True) if name in missing]
    if lacking:
        found = f"missing: {', '.join(lacking)}"
    else:
        values = row.found(**{name: opened[name] for name in names})
        several = np.iterable(values) and not isinstance(values, str)
        found = row.form.format(*(values if several else [values]))
    cells = [row.what, row.paper, found, row.verdict, ", ".join(files)]
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


def read(folder, name):
    """Return a result, or what `pgran units` has said as texts in SI units by their names."""
    if name in APART and not files_of(folder, name):
        raise FileError("no results of packings of beads")
    if name in APART:
        return [pgran.load(path) for path in files_of(folder, name)]
    if not name.startswith("units"):
        return pgran.load(folder / f"{name}.h5")
    try:
        rows = (folder / f"{name}.txt").read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise FileError(reason_of(error)) from None
    return {row[:37].strip(): row[37:].strip() for row in rows}


def draw(folder, stem, names):
    """Draw figures of a result, or of several over each other, if they are there."""
    sources, modes, over = files_of(folder, stem), folder / "modes.h5", {}
    if stem == "response" and modes.exists():
        over["modes"] = pgran.load(modes).modes.omega
    if sources:
        made = pgran.plot(sources, **over)
        figures.save({name: made[name] for name in names}, folder / f"{stem}.png")


def drawings():
    """Return the results that figures of the table are of, and the names of their figures."""
    found = {}
    for section in SECTIONS:
        for image in section.drawn:
            stem, _, name = image.rpartition("-")
            found.setdefault(stem, []).append(name)
    return found


def main(folder):
    """Draw, write the table, and say in a line each what is missing."""
    with ProcessPoolExecutor(2) as pool:
        drawn = [pool.submit(draw, folder, *each) for each in drawings().items()]
        missing = write(folder)
        for each in drawn:
            each.result()
    for each in missing:
        print(f"paper: {each}", file=sys.stderr)
    print(f"written to {folder.with_suffix('.md')}")
    return BAD_FILE if missing else DONE


if __name__ == "__main__":
    logging.getLogger("pgran").setLevel(logging.ERROR)  # the runs have said the rest
    sys.exit(main(Path(sys.argv[1])))
