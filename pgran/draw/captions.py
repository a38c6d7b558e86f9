"""Captions: what all figures of a result have in common, in words that a paper can use.

A figure's own words are its `caption`, given where it is drawn. Formulas are LaTeX's.
"""

import numpy as np

from pgran.draw import marks, style
from pgran.store.estimate import two_digits

SAMPLES = "bonds", "network"  # figures that show what was computed on
MOST = 6  # detectors that are named
AXES = {1: "chain", 2: "square lattice", 3: "cubic lattice"}
LAWS = {
    "uniform": "uniform on [{kmin}, {kmax}]",
    "constant": "all {kmax}",
    "loguniform": "log-uniform on [{kmin}, {kmax}]",
    "bimodal": "{kmax} with probability {fraction}, else {kmin}",
    "hertz": "by Hertz's law, $k = 3/2\\,c^{{2/3}} F^{{1/3}}$ with $c$ = {hertz}, of exponential "
    "forces of mean {force}",
    "file": "read from {file}",
}


def number(value, digits=2):
    r"""Return a number as LaTeX writes it, `$4.1\times10^{-5}$`; 0.003 stays as it is."""
    size = f"{value:.{digits}g}"
    if "e" not in size:
        return size
    mantissa, exponent = size.split("e")
    return rf"${mantissa}\times10^{{{int(exponent)}}}$"


def complete(figure, results, si, sampled=False):
    """Return a figure's own caption with the sample, and the bound reached, of each result.

    Not collective.

    Parameters
    ----------
    figure : pgran.draw.style.Page
    results : sequence of pgran.store.record.Result
    si : pgran.store.si.SI
        The program's units.
    sampled : bool
        Whether the figure shows the sample itself, of which there is no error.
    """
    samples = dict.fromkeys(sample(result, si) for result in results)
    reached = [] if sampled else dict.fromkeys(bound(result) for result in results)
    marked = any(line.get_gid() == style.UNIT for ax in figure.panels for line in ax.get_lines())
    unit = r"Dotted line: $\omega_{mx}$." if marked else ""
    return " ".join(filter(None, [figure.caption, *samples, *reached, unit]))


def slopes(response):
    """Return the slopes of fitted phases in words, none where none is known. Not collective."""
    errors, said = response.phase_slope_error, []
    for d, name in enumerate(style.ball_names(response.detector)):
        if np.isfinite(response.phase_slope[d]):
            error = "" if errors is None else rf" \pm {two_digits(errors[d])}"
            said.append(rf"${response.phase_slope[d]:.4g}{error}$ at {name}")
    unit = r"rad per $\omega_{mx}$; $v$: phase velocity, $d$: unit of length"
    return f" Slopes: {', '.join(said)}, in {unit}." if said else ""


def sample(result, si):
    """Return what was computed on: size, law and seed of the bonds or the network's file, damping.

    Not collective. Parameters are as above.
    """
    medium = getattr(result, "medium", None)
    if medium is None:
        return ""  # the box says what it is
    lines = str(getattr(result, "options", "")).splitlines()
    told = dict(line.lstrip("-").partition(" ")[::2] for line in lines)
    bonds = {key[6:]: _plain(value) for key, value in told.items() if key.startswith("bonds_")}
    if medium.group == "network":
        count = f"{len(medium.held)} balls, {medium.free_balls} of them free"
        text = f"Sample: network of {count}, and {len(medium.bond)} contacts"
        if "network_file" in told:
            text += f" (file {told['network_file']})"
        text += f", displacements: {medium.displacement}"
        drawn = ""
    else:
        text = f"Sample: {_size(medium.shape)} of mass {number(medium.mass)} between walls"
        text += ", one of which is driven"
        drawn = LAWS.get(bonds.get("law"), "")
        text += drawn and f"; bonds {drawn.format(**bonds)}"
    found = getattr(result, "ensemble", None)
    if found is not None:
        text += f"; {len(found.seed)} samples, seeds {found.seed.min()} to {found.seed.max()}"
    elif drawn and bonds["law"] not in ("file", "constant"):
        text += f"; seed {bonds['seed']}"
    else:
        text += f"; SHA-256 of the bonds {medium.bonds_sha256[:12]}"
    unit = rf"$\omega_{{mx}}$ = {number(medium.omega_mx, 4)}{si.say('Hz', medium.omega_mx)}"
    text += rf"; damping $\beta$ = {number(medium.damping)}; {unit}"
    return f"{text}{_heard(result)}."


def _heard(result):
    """Return where the detectors of a result are."""
    sites = style.heard(result)
    if sites is None:
        return ""
    names = style.ball_names(sites)
    more = f" and {len(names) - MOST} more" if len(names) > MOST else ""
    return f"; heard at {', '.join(names[:MOST])}{more}"


def _plain(text):
    """Return a number of an options file as a caption has it, other texts as they are."""
    try:
        return text if text.isdigit() else number(float(text), 6)
    except ValueError:
        return text


def _size(shape):
    """Return how many balls a lattice has along its axes."""
    count = r" \times ".join(map(str, shape))
    return f"{AXES[len(shape)]} of ${count}$ balls"


def bound(result):
    """Return what is proven of the errors of a result, or how they were estimated.

    Not collective.
    """
    how = "proven" if getattr(getattr(result, "medium", None), "damping", 0.0) else "certified"
    records = [(name, getattr(result, name, None)) for name in BOUNDS]
    said = [BOUNDS[name](record, how) for name, record in records if record is not None]
    return " ".join(dict.fromkeys(said))


def _amplitudes(record, how):
    """Return the largest relative bound of amplitudes that are as accurate as asked."""
    size = np.abs(record.displacement)
    failed = np.isnan(size)
    if hasattr(record, "converged_reason"):
        failed |= (record.converged_reason <= 0)[(...,) + (None,) * (size.ndim - 1)]
    floored = np.isfinite(marks.upper_limits(record))
    good = ~failed & ~floored & (size > 0)
    relative = np.divide(record.error_bound, size, out=np.zeros_like(size), where=good)[good]
    if not good.any() or not np.isfinite(relative).all():
        said = "No bound of the errors is known."
    else:
        said = f"Relative error of every amplitude: at most {number(relative.max())} ({how})."
    if floored.any():
        said += f" {np.count_nonzero(floored)} amplitudes are upper limits, at the floor."
    if failed.any():
        said += (
            f" {np.count_nonzero(failed)} of {size.size} amplitudes missed the accuracy asked for."
        )
    if np.any(getattr(record, "unresolved", False)):
        said += " Where it is marked the curve is not resolved between its points."
    return said


def _derivatives(record, how):
    """Return the bounds of amplitudes, and the largest of the derivatives d ln|A| / d ln k."""
    largest = np.max(record.log_bound[record.converged_reason > 0], initial=0.0)
    if not 0 < largest < np.inf:
        return _amplitudes(record, how)
    found = f"of every derivative $d\\,\\ln|A| / d\\,\\ln k$: at most {number(largest)} ({how})."
    return f"{_amplitudes(record, how)} Error {found}"


def _signals(record, *_):
    """Return the largest error of signals in units of their largest displacement."""
    relative = np.nanmax(record.error.max(axis=0) / np.abs(record.displacement).max(axis=0))
    how = "proven" if record.error_bound is not None else "estimated"
    return f"Error of every signal: at most {number(relative)} of its largest displacement ({how})."


def _modes(record, *_):
    """Return how many modes were found, and whether their count certifies them."""
    said = f"{record.count_found} of {record.count_expected} normal modes"
    if not record.count_certified:
        return f"{said} were found; they are not certified."
    residual = getattr(record, "residual", None)
    if residual is None or not len(residual):
        return f"{said}, certified by their count."
    return f"{said}, certified by their count; residuals at most {number(residual.max())}."


def _projection(record, *_):
    """Return how many modes there are, and how many frequencies failed."""
    good = record.converged_reason > 0
    missed = np.count_nonzero(~good)
    lost = f" {missed} of {len(good)} frequencies missed the accuracy asked for." if missed else ""
    return _modes(record) + lost


def _counts(record, *_):
    """Return how many counts are certain."""
    return f"{np.count_nonzero(record.certified)} of {len(record.omega)} counts are certified."


def _samples(record, *_):
    """Return how many samples are good."""
    lost = f"; {record.left_out} more are left out" if record.left_out else ""
    return f"Each of {np.count_nonzero(record.good)} samples has the accuracy asked for{lost}."


def _study(record, *_):
    """Return what errors are relative to."""
    return f"The reference's own relative error: at most {number(record.reference_bound)}."


BOUNDS = {
    "response": _amplitudes,
    "relaxation": _amplitudes,
    "sensitivity": _derivatives,
    "heat": _amplitudes,
    "pulse": _signals,
    "modes": _modes,
    "projection": _projection,
    "density": _counts,
    "ensemble": _samples,
    "accuracy": _study,
}
