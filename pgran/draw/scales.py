"""What axes show, where their ends and ticks are, and the same axes in SI units.

What is drawn stays in units of omega_mx: in SI ticks, labels and numbers in words are in Hz, s, m.
"""

import math
from typing import NamedTuple

import numpy as np
from matplotlib import ticker

from pgran.draw import style
from pgran.store.si import prefix_of


class Quantity(NamedTuple):
    """A quantity with its unit in the program, in SI, and the power of omega_mx in its numbers."""

    name: str
    own: str = ""
    unit: str | None = None
    power: int = 0


AMPLITUDE = r"amplitude $|A|$ (drive = 1)"
PHASE = "phase (rad)"
FREQUENCY = Quantity("driving frequency", r"$\omega/\omega_{mx}$", "Hz", 1)
ANY_FREQUENCY = Quantity("frequency", r"$\omega/\omega_{mx}$", "Hz", 1)
MODE_FREQUENCY = Quantity("mode frequency", r"$\omega_i/\omega_{mx}$", "Hz", 1)
DOMINANT = MODE_FREQUENCY._replace(name="dominant mode")
DENSITY = Quantity("density of modes per ball", r"($1/\omega_{mx}$)", "1/Hz", -1)
TIME = Quantity("time", r"($1/\omega_{mx}$)", "s", -1)
DELAY = Quantity("group delay", r"($1/\omega_{mx}$)", "s", -1)
DISTANCE = Quantity("distance from the driven wall", "(spacings)", "m")
OPENING = Quantity("drive", "(length)", "m")
ATTENUATION = Quantity("attenuation length", "(spacings)", "m")
IN_WORDS = ANY_FREQUENCY._replace(own=r"$\omega_{mx}$")
TIME_IN_WORDS = TIME._replace(own=r"$\omega_{mx}^{-1}$")
SLOPE = Quantity("slope of the phase", r"rad/$\omega_{mx}$", "rad/Hz", -1)
VELOCITY = Quantity("phase velocity", r"$d\,\omega_{mx}$", "m/s", 1)
MODE_SPEED = Quantity(r"$c_i = \omega_i/k_i$", r"(length $\omega_{mx}$)", "m/s", 1)
PLACES = [Quantity(f"${name}$", unit="m") for name in "xyz"]


def unit_of(quantity, medium, largest):
    """Return what numbers up to the `largest` are multiplied with, and their unit.

    That is SI's where these are shown and known, else the program's.
    """
    factor = quantity.unit and style.units().factor(quantity.unit)
    if factor is None:
        return 1.0, quantity.own
    factor *= medium.omega_mx**quantity.power
    shift, unit = prefix_of(factor * largest, quantity.unit)
    return factor * shift, unit


def said(x, medium, quantity, digits=4):
    """Return a number of a quantity with its unit, in words."""
    factor, unit = unit_of(quantity, medium, x)
    return f"{factor * x:.{digits}g} {unit}".rstrip()


def frequency(x, medium, digits=4):
    """Return a frequency in words, which is `x` in units of omega_mx."""
    return said(x, medium, IN_WORDS, digits)


def label(axis, quantity):
    """Name an axis by what it shows, which `finish` finds on it."""
    axis.quantity = quantity
    axis.set_label_text(f"{quantity.name} {quantity.own}".strip())


def limits(x):
    """Return the range of an axis for the points `x`: theirs, and a margin around a handful."""
    few = len(x) <= style.HANDFUL
    margin = 0.05 * (np.ptp(x) or np.max(np.abs(x)) or 1.0) if few else 0.0
    return np.min(x) - margin, np.max(x) + margin


def wide(x):
    """Return whether positive numbers span more than a decade and a half."""
    return 0 < 10**1.5 * np.min(x) < np.max(x)


def frequencies(ax, x, quantity=FREQUENCY, within=(-np.inf, np.inf), aside=0.0, log=False):
    """Make an axis one of the frequencies `x`, in units of omega_mx, which is a dotted line.

    Only those `within` two ends are shown, and `aside` of them that part of the axis, which begins
    at 0 or above unless there are negative ones, of unstable modes. An axis of frequencies gets as
    long as it must be. It is logarithmic if `log`.
    """
    low, high = limits(x)
    low, high = low - aside * (high - low), high + aside * (high - low)
    low = low if np.min(x) < 0 else max(low, np.min(x) / 1.1 if log else 0.0)
    low, high = max(low, within[0]), min(high, within[1])
    if hasattr(ax.xaxis, "quantity"):
        low, high = min(low, ax.get_xlim()[0]), max(high, ax.get_xlim()[1])
    label(ax.xaxis, quantity)
    if log:
        ax.set_xscale("log")
    else:
        ax.xaxis.set_major_locator(round_ticks(ax.figure))
    ax.set_xlim(low, high)
    if low < 1 < high and not any(line.get_gid() == style.UNIT for line in ax.get_lines()):
        dots = {"color": style.MODE, "linewidth": 0.6, "linestyle": (0, (1, 2)), "zorder": 0.5}
        ax.axvline(1.0, gid=style.UNIT, **dots)


def round_ticks(figure):
    """Return what makes ticks, as many whatever the layout is: that depends on them."""
    narrow = figure.get_figwidth() < 1.5 * style.COLUMN
    return ticker.MaxNLocator(6 if narrow else 10, steps=[1, 2, 2.5, 5, 10])


def delays(ax, values):
    """Make the axis of y one of delays, linear unless all but a tenth of them span two decades.

    Then it is linear in a grey band, up to the median size, logarithmic beyond, with few labels.
    """
    label(ax.yaxis, DELAY)
    size = np.abs(values[np.isfinite(values) & (values != 0)])
    if not len(size) or size.max() < 100 * np.quantile(size, 0.1):
        return
    threshold = float(f"{np.median(size):.1g}")
    ax.set_yscale("symlog", linthresh=threshold)
    ticks = symmetric_ticks(threshold, size.max())
    ax.set_yticks(ticks, [_written(tick) for tick in ticks] if len(ticks) == 3 else None)
    ax.axhspan(-threshold, threshold, color="#e4e4e4", zorder=0, label="linear axis")


def symmetric_ticks(threshold, largest):
    """Return 0, a few powers of ten from a threshold, or about that, to the largest, both signs."""
    low, high = math.ceil(math.log10(threshold)), math.floor(math.log10(largest))
    powers = 10.0 ** np.arange(low, high + 1)[:: -max(1, -(-(high - low + 1) // 3))]
    if not len(powers):
        digit = 10.0 ** math.floor(math.log10(threshold))
        powers = [math.ceil(threshold / digit) * digit]
    return [*np.negative(powers), 0.0, *powers]


class Ticks(ticker.Locator):
    """Ticks where `base` has them for the numbers of an axis times `factor`."""

    def __init__(self, base, factor):
        self.base, self.factor = base, factor

    def set_axis(self, axis):
        """Tell both whose ticks they make."""
        super().set_axis(axis)
        self.base.set_axis(axis)

    def __call__(self):
        """Return the ticks of the axis."""
        return self.tick_values(*sorted(self.axis.get_view_interval()))

    def tick_values(self, vmin, vmax):
        """Return the ticks between two ends."""
        ticks = self.base.tick_values(vmin * self.factor, vmax * self.factor)
        return np.asarray(ticks) / self.factor


def finish(figure, medium=None):
    """Give the axes of a figure SI units where these are known; axes of a quantity are alike.

    Logarithmic axes that have hardly any numbers get more than powers of ten.
    """
    shown = {}
    for axis in [axis for ax in figure.axes for axis in (ax.xaxis, ax.yaxis)]:
        quantity = getattr(axis, "quantity", None)
        usual = isinstance(axis.get_major_formatter(), ticker.LogFormatterSciNotation)
        if medium is not None and quantity and unit_of(quantity, medium, 1.0)[1] != quantity.own:
            shown.setdefault(quantity, []).append(axis)
        elif axis.get_scale() == "log" and usual and narrow(axis):
            convert(axis, 1.0)
    for quantity, alike in shown.items():
        largest = max(np.abs(axis.get_view_interval()).max() for axis in alike)
        factor, unit = unit_of(quantity, medium, largest)
        for axis in alike:
            convert(axis, factor)
            if axis.get_label_text():  # else the panel below has the label
                axis.set_label_text(f"{quantity.name} ({unit})")


def narrow(axis):
    """Return whether a logarithmic axis may hold a single power of ten."""
    low, high = sorted(axis.get_view_interval())
    return high < 100 * low


def convert(axis, factor):
    """Put ticks at round numbers of the axis times `factor`, and those numbers beside them."""
    kind, minor = axis.get_scale(), ticker.NullLocator()
    if kind == "log":
        major = ticker.LogLocator(subs=(1, 2, 5) if narrow(axis) else (1,))
        minor = ticker.LogLocator(subs=range(2, 10))
    elif kind == "symlog":
        ends = axis.get_transform().linthresh, np.abs(axis.get_view_interval()).max()
        major = ticker.FixedLocator(symmetric_ticks(*(factor * end for end in ends)))
    else:
        major = round_ticks(axis.figure)
    axis.set_major_locator(Ticks(major, factor))
    axis.set_minor_locator(Ticks(minor, factor))
    axis.set_minor_formatter(ticker.NullFormatter())
    axis.set_major_formatter(ticker.FuncFormatter(lambda x, _: _written(x * factor)))


def _written(number):
    """Return a number as it stands beside a tick."""
    mantissa, _, power = f"{number:.4g}".partition("e")
    power = power and rf" \cdot 10^{{{int(power)}}}"
    return f"${mantissa}{power}$".replace(r"$1 \cdot ", "$")
