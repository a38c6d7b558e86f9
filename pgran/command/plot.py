"""`pgran plot`: the figures of a result, of several of one scene, of one with another laid over."""

import math
import os
from pathlib import Path

from numpy.typing import ArrayLike

from pgran import catalogue
from pgran.arguments import called_right
from pgran.command.export import blaming_edits, result_of
from pgran.command.words import Parser, positive
from pgran.draw import pages as figures
from pgran.errors import DONE, FileError, InputError, log
from pgran.run.numbers import number, numbers
from pgran.store.estimate import counted
from pgran.store.record import Record
from pgran.store.si import FREQUENCIES_IN, LARGEST, SI, SMALLEST

NARROWEST, WIDEST = 60, 400  # mm
LAID_OVER = {"response": "modes", "pulse": "response"}  # and over what


@called_right
def plot(
    result: object,
    output: str | os.PathLike | None = None,
    modes: "ArrayLike | None" = None,
    response: Record | None = None,
    measured: str | os.PathLike | None = None,
    units: tuple | None = None,
    width: float | None = None,
    caption: bool = False,
    measured_unit: str = "absolute",
    measured_scale: float = 1.0,
    labels: list | None = None,
) -> dict:
    """Return the figures of a result by their names, `plot("a.h5")["amplitude"]`; save them too.

    A network, or its file, is drawn by itself. A notebook shows them, without a window.

    Parameters
    ----------
    result : pgran.store.record.Result, a record, pgran.Network, str or path, or a list of these
        What `load` or a function returns, or a file's path. Several of one scene (response, modes,
        relaxation, pulse) are laid over each other, more than six by a scale of colours over the
        option that differs; of heaters in packings each is a point.
    output : str or os.PathLike, optional
        Where to save: `results/a.png` gives `results/a-amplitude.png` and so on; the ending decides
        the format. A missing folder is made.
    modes : array_like, optional
        Angular frequencies of normal modes, marked by ticks on the frequency axes of a response.
    response : pgran.results.Response, optional
        Of the same lattice; its amplitudes are laid over the spectra of a pulse.
    measured : str or os.PathLike, optional
        Text file of columns of numbers, laid over a response: frequency, amplitude relative to the
        drive, and maybe a phase.
    units : tuple of float, optional
        The program's units of length and time in m and s, each may be None: axes are in mm, ms and
        Hz then. By default those that the run was given.
    width : float, optional
        Width of the figures on paper, in mm, 60 to 400 (85 or 170); letters keep their size.
    caption : bool
        Save beside each figure a text, `results/a-amplitude.txt`: what it shows, of which sample,
        how exactly. It is the figure's `caption` in any case.
    measured_unit : {"absolute", "omega_mx", "Hz"}
        What the measured frequencies are given in: angular in the result's unit, parts of omega_mx,
        or Hz, which takes the unit of time.
    measured_scale : float
        What measured amplitudes are multiplied with, such as 1 over the voltage of the drive.
    labels : list of str, optional
        What several results are called, formulas between dollars. By default what tells them apart,
        "beta = 0.003, seed 7".

    Returns
    -------
    dict of str: matplotlib.figure.Figure

    Raises
    ------
    FileError
        If a file cannot be read or holds nothing to draw, results do not belong together, or a
        figure cannot be saved.
    InputError
        If modes or a response are to be laid over several results, the width, a unit or the scale
        is impossible, labels are not one for each of several results (up to six), or a caption
        would replace the data of `measured`.
    PgranError
        If there is no matplotlib.

    Examples
    --------
    >>> places = [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]
    >>> network = pgran.Network([[0, 1], [1, 2]], [1.0, 2.0], [1, 0, 2], position=places)
    >>> list(pgran.plot(network, width=85))
    ['network']
    """
    given = result if isinstance(result, (list, tuple)) else [result]
    results = [result_of(each) for each in given]
    names = [
        Path(each).name if isinstance(each, (str, os.PathLike)) else str(place)
        for place, each in enumerate(given, 1)
    ]
    modes = None if modes is None else numbers("modes", modes)
    width = None if width is None else number("-width", width)
    if len(results) > 1 and not (modes is None and response is None):
        raise InputError("modes and a response are laid over one result only")
    shown, over = (measured, measured_unit, measured_scale), {"modes": modes, "response": response}
    made = _make(results, names, units, shown, width, labels, **over)
    if output is not None:
        _save(made, output, caption, measured)
    return made


def _units_of(results, length=None, time=None):
    """Return the SI units of results, those given here if any; none where results disagree."""
    if length is not None or time is not None:
        units = {SI(length, time)}
    else:
        units = {SI.of(result) for result in results}
    scales = {result.medium.omega_mx for result in results if hasattr(result, "medium")}
    if len(units) > 1 or (units != {SI()} and len(scales) > 1):
        log.warning("the results have different units: axes are in units of each one's omega_mx")
        return SI()
    return units.pop()


def _make(results, names, units, measured, width, labels=None, **over):
    """Return the figures of results whose files have these names. See `plot`."""
    if width is not None and not NARROWEST <= width <= WIDEST:
        raise InputError(f"-width: a figure is {NARROWEST} to {WIDEST} mm wide, not {width:g}")
    several, points = len(results) > 1, results[0].scene in catalogue.POINTS
    curves = 0 if points else len(results)  # in a legend
    if labels is not None and not 1 < len(labels) == curves:
        both = f"{counted(len(labels), 'label')} for {counted(curves, 'result')}"
        raise InputError(f"-label: {both}; of several over each other each has one, in their order")
    if labels is not None and (len(set(labels)) < curves or not all(map(str.strip, labels))):
        raise InputError("-label: each result has a label of its own, which is not empty")
    units = SI() if several and points else _units_of(results, *units or ())
    measured, unit, scale = measured
    if measured is None and (unit, scale) != ("absolute", 1.0):
        raise InputError("-plot_unit, -plot_scale: are about -plot_with, which is missing")
    data = None if measured is None else _measured(results, units, measured, unit, scale)
    if several:
        from pgran.medium.differences import MOST, labels_of

        if labels and len(labels) > MOST:
            raise InputError(f"-label: more than {MOST} results are told apart by their colours")
        names = labels or (names if points or curves > MOST else labels_of(results, names))
        made = figures.compare(results, names, units, width)
    else:
        made = figures.make(results[0], units, width, **over)
    if measured is not None:
        missed = figures.add_measured(made, results, data, Path(measured).name, scale)
        if missed:
            log.warning("%s: %d frequencies are beyond the sweep: not drawn", measured, missed)
    return made


def _measured(results, units, path, unit, scale):
    """Return what was measured, its frequencies in the results' unit, its amplitudes scaled."""
    from pgran.store.text import read_measured

    if unit not in FREQUENCIES_IN:
        raise InputError(f"-plot_unit {unit}: choose {', '.join(FREQUENCIES_IN)}")
    if not (math.isfinite(scale) and scale > 0):
        raise InputError(f"-plot_scale {scale:g}: amplitudes are multiplied with a positive number")
    if not all(hasattr(result, "response") for result in results):
        raise FileError(f"{path}: what was measured is laid over responses only")
    data = read_measured(path)
    angular = units.angular(unit, results[0].medium.omega_mx)
    if angular is None:
        raise InputError("-plot_unit Hz: the result has no unit of time; -units_time says it, in s")
    amplitude = scale * data["amplitude"]
    if not (amplitude.min() > SMALLEST and amplitude.max() < LARGEST):
        size = f"{amplitude.min():.3g} to {amplitude.max():.3g} in all"
        raise InputError(f"{path}: amplitudes of {size} cannot be drawn; -plot_scale scales them")
    return data | {"omega": angular * data["omega"], "amplitude": amplitude}


def _save(made, output, caption, measured):
    """Save figures, with captions beside them if asked for, and return the paths."""
    output = Path(output)
    captions = [output.with_name(f"{output.stem}-{name}.txt") for name in made if caption]
    if measured is not None and os.path.realpath(measured) in map(os.path.realpath, captions):
        raise InputError(f"{measured}: a caption would replace these data; give another name")
    return figures.save(made, output) + figures.save_captions(made, captions)


@blaming_edits
def run(words):
    """Draw the figures of a result, into files beside it, and print their names.

    With another one of the same lattice its modes are marked in a response, or its response is laid
    over the spectra of a pulse. Several of one scene are laid over each other, labelled by the
    options in which they differ, or as you say; more than six by a scale of colours. A network, of
    pgran import, is drawn by itself.
    """
    parser = Parser(
        "plot",
        run.__doc__,
        "pgran plot results/response.h5",
        "pgran plot results/response.h5 results/modes.h5 -o results/both.pdf",
        "pgran plot results/damping_*.h5 -o results/damping.png",
        "pgran plot loose.h5 tight.h5 -label 'P = .02' -label 'P = .1'",
        "pgran plot results/discs.h5",
    )
    add = parser.add_argument
    add("result", metavar="RESULT", nargs="+", help="HDF5 file of pgran run or pgran import")
    add("-o", "--output", metavar="FIGURE", help="file; its ending decides the format (.png)")
    add("-plot_with", metavar="DATA", help="columns over a response: frequency amplitude [phase]")
    units_of = "what these frequencies are given in (absolute: angular)"
    add("-plot_unit", choices=FREQUENCIES_IN, default="absolute", help=units_of)
    scale_of = "what these amplitudes are multiplied with (1)"
    add("-plot_scale", type=positive, metavar="FACTOR", default=1.0, help=scale_of)
    for name, unit in (("length", "m"), ("time", "s")):
        words_of = f"the unit of {name} in {unit}, if not the one that the run was given"
        add(f"-units_{name}", type=positive, metavar=unit.upper(), help=words_of)
    add("-width", type=float, metavar="MM", help="width of the figures on paper (85 or 170)")
    words_of = "what a result is called among several: one for each, in their order"
    add("-label", "--label", action="append", metavar="TEXT", help=words_of)
    add("-caption", action="store_true", help="write a caption beside each figure, FIGURE.txt")
    options = parser.parse_intermixed_args(words)
    paths, over = [Path(each) for each in options.result], {}
    for path in paths:
        if path.suffix in (".png", ".pdf", ".svg"):
            raise InputError(f"plot: {path}: is no result; a figure to write comes after -o")
    if len(set(map(os.path.realpath, paths))) < len(paths):
        raise InputError("plot: the same result is given twice")
    results = [result_of(each) for each in options.result]
    if len({str(result.scene) for result in results}) > 1:
        number, name, record = _pair(*results)
        paths, results = [paths[number]], [results[number]]
        over[name] = record.omega if name == "modes" else record
        if name == "modes" and not record.count_certified:
            log.warning("modes are missing or inaccurate, so not all are marked")
    units = options.units_length, options.units_time
    measured = options.plot_with, options.plot_unit, options.plot_scale
    names = [path.name for path in paths]
    made = _make(results, names, units, measured, options.width, options.label, **over)
    several = "-compared" if len(results) > 1 else ""
    output = options.output or paths[0].with_name(f"{paths[0].stem}{several}.png")
    for path in _save(made, output, options.caption, options.plot_with):
        print(path)
    return DONE


def _pair(*results):
    """Return the number of the one that is drawn, and what is laid over: its name, its record."""
    import numpy as np  # late: `pgran --help` loads nothing

    from pgran.medium.dissipation import FIELDS

    for place, drawn in enumerate(results if len(results) == 2 else ()):
        over = results[1 - place]
        for group, name in LAID_OVER.items():
            if not (hasattr(drawn, group) and hasattr(over, name)):
                continue
            same = ["shape", "mass", "bonds_sha256"]
            if name == "response":  # modes have neither damping nor drive
                same += [*FIELDS, "damped", "dashpot", "tangential_dashpot"]
                same += ["held", "direction", "component"]
            for fact in same:
                values = [getattr(result.medium, fact, None) for result in (drawn, over)]
                if not np.array_equal(*values):
                    raise FileError(f"the {group} and the {name} belong to different lattices")
            return place, name, getattr(over, name)
    pairs = " or ".join(f"{group} and {name}" for group, name in LAID_OVER.items())
    groups = [next(g for g in catalogue.FIGURES if hasattr(result, g)) for result in results]
    raise FileError(
        f"{' and '.join(groups)} are not drawn together, but results of one scene, or {pairs}"
    )
