"""`pgran compare`: how alike two response curves or two codas are."""

import os
import shlex
from pathlib import Path

import numpy as np

import pgran
from pgran.command.export import blaming_edits
from pgran.command.plot import plot
from pgran.command.words import Parser, positive
from pgran.errors import DONE, InputError, log
from pgran.run.options import REALS, Option
from pgran.store import file as store
from pgran.store.estimate import with_error
from pgran.store.record import Result, ball_names

WINDOWS = Option("windows", REALS, None, "low,high,low,high ... of angular frequencies or times")
UNITS = "units_length", "units_time"  # of figures, where both agree
ROW = "{:<18} {:<22} {:<22} {:<8} {}"  # of the table
DIGITS = {"correlation": ".4f", "stretch": "+.3g", "stretched": ".4f", "shift": "+.3g"}


@blaming_edits
def run(words):
    """Say how alike two responses or two pulses are in windows of frequency or time.

    It also finds the stretch that makes them most alike: the relative change of all frequencies, or
    of speeds (coda wave interferometry).
    """
    parser = Parser(
        "compare",
        run.__doc__,
        "pgran compare results/response.h5 results/after.h5",
        "pgran compare results/pulse.h5 results/warm.h5 -windows 200,300,300,400",
        "pgran compare results/response.h5 results/after.h5 -o results/likeness.h5",
    )
    add = parser.add_argument
    add("a", metavar="A", help="HDF5 file of pgran run")
    add("b", metavar="B", help="HDF5 file of pgran run, of the same scene")
    kinds = "figure to draw (A-B.png), or result to store instead, if it ends in .h5"
    add("-o", "-output_file", dest="output", metavar="TO", help=kinds)
    add("-output_overwrite", action="store_true", help="replace an existing result")
    add("-windows", type=WINDOWS.read, help=WINDOWS.meaning)
    add("-stretch", type=positive, default=0.02, help="largest stretch that is tried (.02)")
    options = parser.read(words)
    output = options.output or f"{Path(options.a).with_suffix('')}-{Path(options.b).stem}.png"
    stored = Path(output).suffix == ".h5"
    if stored:
        if os.path.realpath(output) in map(os.path.realpath, (options.a, options.b)):
            raise InputError(f"-o {output}: this result is compared; give another name")
        store.check_output(output, options.output_overwrite)
    found = pgran.compare(options.a, options.b, options.windows, options.stretch)
    told = {"scene": found.group, "status": "complete", "pgran_version": pgran.__version__}
    told["command"] = shlex.join(["pgran", "compare", *words])
    first, other = (pgran.load(path).attributes for path in (options.a, options.b))
    told |= {x: first[x] for x in UNITS if x in first and first[x] == other.get(x)}
    if stored:
        store.write(output, told, [found], options.output_overwrite)
    else:
        plot(Result([found], **told), output)
        output = Path(output).with_stem(f"{Path(output).stem}-{found.group}")
    print("\n".join(table(found)))
    log.info("written to %s", output)
    return DONE


def table(found):
    """Yield in words how alike two results are."""
    yield f"A: {found.label_a}; B: {found.label_b}"
    axis = "time" if found.of == "pulse" else "omega"
    shift = "" if found.shift is None else "or a shift of B"
    heads = axis, "correlation", "stretch of B", "then", shift
    balls = ball_names(found.detector)
    for d, n in np.ndindex(found.stretch.shape[1:]):
        yield f"{balls[d]}, {found.signal[n]}"
        yield ROW.format(*heads).rstrip()
        for w, ends in enumerate(zip(found.low, found.high, strict=True)):
            numbers = (_told(found, name, (w, d, n)) for name in DIGITS)
            yield ROW.format("{:.4g} to {:.4g}".format(*ends), *numbers).rstrip()


def _told(found, name, place):
    """Return a number, with its error if it has one; nothing where there is no such number."""
    values, errors = getattr(found, name), getattr(found, f"{name}_error", None)
    if values is None or np.isnan(values[place]):
        return "" if values is None else "unknown"
    if errors is None:
        return f"{values[place]:{DIGITS[name]}}"
    sign = "+" if DIGITS[name].startswith("+") and values[place] > 0 else ""
    return sign + with_error(values[place], errors[place])
