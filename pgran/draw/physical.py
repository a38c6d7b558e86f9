"""Axes in SI units: what is drawn stays, in units of omega_mx; ticks and labels are in Hz, s, m."""

import numpy as np
from matplotlib.ticker import (
    FixedLocator,
    FuncFormatter,
    Locator,
    LogLocator,
    NullFormatter,
    NullLocator,
)

from pgran.draw import style
from pgran.draw.style import ANY_FREQUENCY, NUMBERS
from pgran.store.si import prefix_of

# What an axis shows, by its label: the quantity, its unit, the power of omega_mx that its numbers
# are measured in.
SHOWN = {
    style.FREQUENCY: ("driving frequency", "Hz", 1),
    ANY_FREQUENCY: ("frequency", "Hz", 1),
    style.MODE_FREQUENCY: ("mode frequency", "Hz", 1),
    style.DENSITY: ("density of modes per ball", "1/Hz", -1),
    style.TIME: ("time", "s", -1),
    style.DELAY: ("group delay", "s", -1),
    style.DISTANCE: ("distance from the driven wall", "m", 0),
    style.ATTENUATION: ("attenuation length", "m", 0),
    NUMBERS["velocity"]: ("phase velocity", "m/s", 1),
    NUMBERS["arrival"]: ("arrival of the front", "s", 0),
    NUMBERS["centre"]: ("centre of the envelope", "s", 0),
    NUMBERS["decay"]: ("rate of decay", "1/s", 0),
    **{f"${name}$": (f"${name}$", "m", 0) for name in "xyz"},
}


class Ticks(Locator):
    """Ticks at round numbers of another unit."""

    def __init__(self, base, factor):
        """Put ticks where `base` has them, when the axis is measured in 1 / factor."""
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
        return (
            np.asarray(self.base.tick_values(vmin * self.factor, vmax * self.factor)) / self.factor
        )


def label_axes(figure, medium, si):
    """Give the axes of a figure that show frequencies, times or lengths SI units.

    Not collective.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    medium : pgran.results.LatticeRecord or pgran.results.NetworkRecord
    si : pgran.store.si.SI
        Quantities whose unit is unknown stay as they are.
    """
    found, below = {}, {}
    for ax in reversed(figure.axes):  # an axis without a label shows what the panel below it does
        spec = getattr(ax, "get_subplotspec", lambda: None)()  # colour bars have none
        for name, axis in (("x", ax.xaxis), ("y", ax.yaxis)):
            label = axis.get_label_text()
            if name == "x" and spec is not None:
                column = spec.colspan.start
                label = below[column] = label or below.get(column, "")
            if label in SHOWN and si.factor(SHOWN[label][1]) is not None:
                found.setdefault(label, []).append(axis)
    for label, axes in found.items():
        quantity, unit, power = SHOWN[label]
        factor = si.factor(unit) * medium.omega_mx**power
        largest = max(np.abs(axis.get_view_interval()).max() for axis in axes)
        shift, unit = prefix_of(factor * largest, unit)
        for axis in axes:
            convert(axis, factor * shift)
            if axis.get_label_text():
                axis.set_label_text(f"{quantity} ({unit})")


def convert(axis, factor):
    """Put ticks at round numbers of the axis times `factor`, and those numbers beside them."""
    kind, minor = axis.get_scale(), NullLocator()
    if kind == "log":
        low, high = sorted(axis.get_view_interval())
        narrow = high < 100 * low  # may hold a single power of ten
        major = LogLocator(subs=(1, 2, 5) if narrow else (1,))
        minor = LogLocator(subs=range(2, 10))
    elif kind == "symlog":
        ends = axis.get_transform().linthresh, np.abs(axis.get_view_interval()).max()
        major = FixedLocator(style.symmetric_ticks(*(factor * end for end in ends)))
    else:
        major = style.round_ticks(axis.figure)
    axis.set_major_locator(Ticks(major, factor))
    axis.set_minor_locator(Ticks(minor, factor))
    axis.set_minor_formatter(NullFormatter())
    axis.set_major_formatter(FuncFormatter(lambda x, _: _written(x * factor)))


def _written(number):
    """Return a number as it stands beside a tick."""
    mantissa, _, power = f"{number:.4g}".partition("e")
    return rf"${mantissa} \cdot 10^{{{int(power)}}}$" if power else f"${mantissa}$"
