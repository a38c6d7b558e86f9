"""The figure of the homogeneous box: amplitude and phase against frequency (paper: exactpl)."""

import math

import numpy as np

from pgran.draw import captions, marks, scales, style


def figures(result, **_):
    """Yield the amplitude of the box above its phase."""
    box = result.continuum
    (x, y), (lx, ly) = box.point, box.size
    numbers = captions.formulas(
        rf"$x$ = {x:g}, $y$ = {y:g}, $L_x$ = {lx:g}, $L_y$ = {ly:g}, "
        rf"$K_0$ = {box.stiffness:g}, $m$ = {box.mass:g}, beta {box.damping:g}"
    )
    figure = style.stack([amplitude, phase], None, style.PAGE, shared=True, continuum=box)
    figure.caption += f" Here {numbers}." + " Undamped peaks are infinite." * (not box.damping)
    style.above(figure, numbers)
    yield "exactpl", figure


def amplitude(ax, continuum):
    """Amplitude at a point of the homogeneous box relative to the driven wall, against the driving
    frequency, by the exact series; ticks: driven resonances.
    """
    ax.set(yscale="log", ylabel=scales.AMPLITUDE)
    return _curve(ax, continuum, continuum.amplitude)


def phase(ax, continuum):
    r"""Phase at that point, without damping 0 or $\pi$."""
    ax.set_ylabel(scales.PHASE)
    if continuum.damping > 0:
        return _curve(ax, continuum, continuum.phase)
    ax.set_yticks([0, np.pi], ["0", r"$\pi$"])
    ax.set_ylim(-0.2 * np.pi, 1.2 * np.pi)
    steps = np.where(continuum.displacement.real < 0, np.pi, 0.0)
    return _curve(ax, continuum, steps, drawstyle="steps-mid")


def _curve(ax, continuum, values, **line):
    """Draw values against frequency, where there is an amplitude; mark the resonances."""
    unit = math.sqrt(continuum.stiffness / continuum.mass) / continuum.size[0]
    x = continuum.omega / unit
    good = np.isfinite(continuum.amplitude) & (continuum.amplitude > 0)
    ax.set(xlim=scales.limits(x), xlabel=r"driving frequency $\omega L_x/\sqrt{K_0/m}$")
    (curve,) = marks.curves(ax, x, values, good, **line)
    marks.modes(ax, continuum.resonance / unit, "driven resonances")
    return curve
