"""The figure of the homogeneous box: amplitude and phase against frequency (paper: exactpl)."""

import math

import numpy as np

from pgran.errors import FileError
from pgran.figures import style
from pgran.figures.response import AMPLITUDE, FEW, limits

NEEDS = (
    *("point", "size", "mass", "stiffness", "damping"),
    *("omega", "displacement", "amplitude", "phase", "resonance"),
)
FREQUENCY = r"driving frequency $\omega L_x/\sqrt{K_0/m}$"
RESONANCES = "driven resonances"


def figures(result, modes=None):
    """Yield the name and the figure of the response of the box.

    Parameters
    ----------
    result : types.SimpleNamespace
        With group `continuum`.
    modes
        Not used.

    Raises
    ------
    FileError
        If there is no frequency.
    """
    if not np.size(result.continuum.omega):
        raise FileError("nothing to draw in this result: no frequencies")
    yield "exactpl", draw_response(result.continuum)


def draw_response(continuum):
    """Return the figure of amplitude and phase, resonances as pluses (paper: exactpl).

    Without damping the amplitude is real and its phase 0 or pi. Amplitudes of zero, on a wall at
    rest, are gaps.
    """
    unit = math.sqrt(continuum.stiffness / continuum.mass) / continuum.size[0]
    x, resonance = continuum.omega / unit, continuum.resonance / unit
    undamped = continuum.damping == 0
    good = np.isfinite(continuum.amplitude) & (continuum.amplitude > 0)
    figure = style.new_figure(style.PAGE, 4.4)
    upper, lower = figure.subplots(2, 1, sharex=True)
    upper.set_xlim(limits(x, 0.0, math.inf))
    upper.set_yscale("log")
    dots = len(x) <= FEW
    style.draw_good(upper, x, continuum.amplitude, good, dots, color="black")
    if undamped:
        phase = np.where(continuum.displacement.real < 0, np.pi, 0.0)
        steps = {"drawstyle": "steps-mid"}
        lower.set_yticks([0, np.pi], ["0", r"$\pi$"])
        lower.set_ylim(-0.2 * np.pi, 1.2 * np.pi)
    else:
        phase, steps = continuum.phase, {}
    style.draw_good(lower, x, phase, good, dots, color="black", **steps)
    if not good.any():
        upper.yaxis.set_visible(False)
        lower.yaxis.set_visible(False)

    pluses = [style.mark_modes(ax, resonance) for ax in (upper, lower)]
    style.legend_above(upper, {RESONANCES: pluses[0]} if pluses[0] else {}, columns=1)
    upper.set_title(describe(continuum))
    upper.set_ylabel(AMPLITUDE)
    lower.set_ylabel("phase (rad)")
    lower.set_xlabel(FREQUENCY)
    figure.align_ylabels()
    return figure


def describe(continuum):
    """Return the parameters in words."""
    (x, y), (lx, ly) = continuum.point, continuum.size
    return (
        rf"$x$ = {x:g}, $y$ = {y:g}, $L_x$ = {lx:g}, $L_y$ = {ly:g}, "
        rf"$K_0$ = {continuum.stiffness:g}, $m$ = {continuum.mass:g}, "
        rf"$\beta$ = {continuum.damping:g}"
    )
