"""The figure of a likeness: correlations, stretches, and how a coda decorrelates, by windows."""

import numpy as np

from pgran.draw import marks, scales, style

SIGNALS = {"ln|A|": r"$\ln|A|$", "A": "$A$", "u": "$u$"}


def figures(result, **_):
    """Yield the panels below each other."""
    found = result.likeness
    panels = [correlation, stretch] + [decorrelation] * (found.of == "pulse")
    page = style.stack(panels, shared=True, fewest=0, found=found)
    page.caption += f" A: {found.label_a}; B: {found.label_b}. Bars: windows, and standard errors."
    yield "likeness", page


def correlation(ax, found):
    """Correlation of A and B in windows; open: under the stretch of the largest; thin line: 0."""
    _points(ax, found, "", found.stretched, 0 * found.stretched, told=False, fillstyle="none")
    return _points(ax, found, "correlation", found.correlation, found.correlation_error)


def stretch(ax, found):
    """Stretch of the largest correlation, a relative change of frequencies, where one is known."""
    return _points(ax, found, r"stretch $\epsilon$", found.stretch, found.stretch_error)


def decorrelation(ax, found):
    """Minus the logarithm of the correlation, where it is positive, against time."""
    positive = np.where(found.correlation > 0, found.correlation, np.nan)
    errors = found.correlation_error / positive
    return _points(ax, found, r"$-\ln$ correlation", -np.log(positive), errors)


def _points(ax, found, label, values, errors, told=True, **look):
    """Draw values with their errors in windows, a colour and a mark each ball and signal."""
    pulse = found.of == "pulse"
    known = found.omega_mx > 0  # NaN: not
    unit = (found.omega_mx if known else 1.0) ** (1 if pulse else -1)
    low, high = found.low * unit, found.high * unit
    shown = scales.TIME if pulse else scales.FREQUENCY
    scales.label(ax.xaxis, shown if known else shown._replace(own=""))
    ax.set(xlim=(low.min(), high.max()), ylabel=label)
    ax.axhline(0, color="black", linewidth=0.4)
    balls, signals = style.ball_names(found.detector), [SIGNALS[str(x)] for x in found.signal]
    names = [[ball] * (len(balls) > 1) + [x] * (not pulse) for ball in balls for x in signals]
    names = [", ".join(each) * told or None for each in names]
    rows = [each.reshape(len(low), -1).T for each in (values, errors)]
    look |= {"xerr": 0.5 * (high - low), "elinewidth": 0.6}
    return marks.points(ax, 0.5 * (low + high), *rows, names, "osv^D" if pulse else "os", **look)
