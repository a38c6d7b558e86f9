"""Figures of transport: amplitudes against depth, lengths, wave numbers, delays, diffusion."""

import numpy as np

from pgran.draw import marks, scales, style

SHOWN = 4  # frequencies, depths or times
CAPTIONS = {
    "profile": "Mean logarithm of the amplitude against the distance from the driven wall, at some "
    "driving frequencies; pale: where lines go through.",
    "length": "Attenuation length against the driving frequency where sound propagates, above the "
    "first mode (dashed): of the typical amplitude $e^{\\langle\\ln|A|\\rangle}$, of the root mean "
    "square, twice the intensity's, and of the coherent $|\\langle A\\rangle|$, twice the "
    "scattering length. Circled: $\\langle\\ln|A|\\rangle$ is not straight, p < .01.",
    "wave_number": "Wave number of the coherent field against the driving frequency.",
    "band_delay": "Mean group delay in bands of frequencies, by their middle, against the "
    "distance. Hollow: it does not grow for certain.",
}
DIFFUSING = (
    "Mean of $u^2 + (v/\\omega)^2$ over samples against time, at some distances from what is "
    "driven; lines: the fit of diffusion between two walls. Bars: standard errors."
)
FALLS = {
    "length": ("typical", 1),
    "intensity_length": ("root mean square", 2),
    "scattering_length": ("coherent", 2),
}


def figures(result, **_):
    """Yield profiles over depth, lengths and wave numbers by frequency, delays; or squares."""
    lattice = result.medium
    if getattr(result, "diffusion", None):
        yield "diffusion", style.single(decay, DIFFUSING, found=result.diffusion, lattice=lattice)
        return
    found, panels = result.transport, [profile, length]
    if found.wave_number is not None and np.isfinite(found.wave_number).any():
        panels.append(wave_number)
    if found.band_delay is not None:  # files before version 5 have none
        panels.append(band_delay)
    figure = style.stack(panels, CAPTIONS, found=found, lattice=lattice)
    figure.caption += " Bars: standard errors over samples."
    yield "transport", figure


def profile(ax, found, lattice):
    """Draw <ln|A|> against depth at a few frequencies; return the curves."""
    chosen = _some(found.omega)
    if found.depth_low is not None:
        ax.axvspan(found.depth_low, found.depth_high, color="#F0F0F0", zorder=0)
    scales.label(ax.xaxis, scales.DISTANCE)
    ax.set_ylabel(r"$\langle\ln|A|\rangle$")
    labels = [scales.frequency(x / lattice.omega_mx, lattice, 3) for x in found.omega[chosen]]
    values, errors = found.ln_amplitude[chosen], found.ln_amplitude_error[chosen]
    return marks.points(ax, found.depth, values, errors, labels)


def length(ax, found, lattice):
    """Draw the lengths of amplitudes by frequency, where they are known; return what was drawn."""
    ax.set_yscale("log")
    scales.label(ax.yaxis, scales.ATTENUATION)
    if found.first_mode is not None:
        look = {"color": "black", "linestyle": "--", "linewidth": 0.6}
        ax.axvline(found.first_mode / lattice.omega_mx, **look)
    drawn = _by_frequency(ax, found, lattice, FALLS)
    if found.straightness is not None:
        refused = found.omega[found.refused] / lattice.omega_mx, found.length[found.refused]
        ax.plot(*refused, "o", markersize=4, color="black", markerfacecolor="none", linewidth=0.6)
    return drawn


def wave_number(ax, found, lattice):
    """Draw the wave number of the coherent field by frequency; return the points."""
    ax.set_ylabel(r"wave number $k$ (rad/spacing)")
    return _by_frequency(ax, found, lattice, {"wave_number": (None, 1)})


def band_delay(ax, found, lattice):
    """Draw the mean delay of each band against depth; return the curves."""
    scales.label(ax.xaxis, scales.DISTANCE)
    scales.label(ax.yaxis, scales.DELAY)
    middles = 0.5 * (found.edge[1:] + found.edge[:-1]) / lattice.omega_mx
    labels = [scales.frequency(middle, lattice, 2) for middle in middles]
    late, error = found.band_delay * lattice.omega_mx, found.band_delay_error * lattice.omega_mx
    drawn = marks.points(ax, found.depth, late, error, labels)
    for points, propagates in zip(drawn, found.propagates, strict=True):
        if not propagates:
            points.lines[0].set_markerfacecolor("none")
    return drawn


def decay(ax, found, lattice):
    """Draw the mean square against time at some depths, and its fit; return the points."""
    chosen, time = _some(found.depth), found.time * lattice.omega_mx
    scales.label(ax.xaxis, scales.TIME)
    ax.set(yscale="log", ylabel=r"$\langle u^2 + (v/\omega)^2\rangle$")
    labels = [f"{depth:g} spacings" for depth in found.depth[chosen]]
    square, error, fit = (
        x[:, chosen] for x in (found.mean_square, found.mean_square_error, found.fit)
    )
    drawn = marks.points(ax, time, square.T, error.T, labels)
    for points, line in zip(drawn, fit.T, strict=True):
        ax.plot(time, line, color=points.lines[0].get_color(), linewidth=0.8)
    return drawn


def _by_frequency(ax, found, lattice, named):
    """Draw numbers of a record as far as it has them, so many times; return the points."""
    x, rows = found.omega / lattice.omega_mx, []
    scales.frequencies(ax, x)
    for name, (words, times) in named.items():
        values, errors = (getattr(found, name + end) for end in ("", "_error"))
        if values is not None and np.isfinite(values).any():
            rows.append((times * values, times * errors, words))
    look = {"markersize": 2, "elinewidth": 0.6}
    return marks.points(ax, x, *zip(*rows, strict=True), **look) if rows else []


def _some(values):
    """Return the numbers of a few values, equally far from each other."""
    return np.unique(np.linspace(0, len(values) - 1, SHOWN + 2).astype(int)[1:-1])
