"""The figures of a structure factor: maps with the dispersion; speeds, and where waves end."""

from functools import partial

import numpy as np
from matplotlib.colors import LogNorm

from pgran.draw import captions, marks, scales, style

LEAST_SHOWN = 1e-2  # of the largest S: what is less looks the same
WAVE_NUMBER = scales.Quantity("wave number $q$", "(1/length)")
OMEGA = scales.ANY_FREQUENCY._replace(own=r"$\Omega/\omega_{mx}$")


def figures(result, **_):
    """Yield a map of each branch, and a page of speeds and widths."""
    record, medium = result.structure, result.medium
    good = record.converged_reason > 0
    style.check_any(record.structure_factor[good], "frequency that was solved")
    both = {"record": record, "medium": medium}
    maps = [partial(spectra, **both, branch=b) for b in range(len(record.branch))]
    page, _ = style.grid(maps, lambda rows: 2.6, rows=1, narrowest=2.0)
    for ax in page.panels:
        ax.set_ylim(top=max(each.get_ylim()[1] for each in page.panels))
        ax.label_outer()
    drawn, bar = page.panels[0].collections[0], {"label": r"$S(q,\omega)$ / largest"}
    page.colorbar(drawn, ax=list(page.panels), aspect=30, **bar)
    page.caption = style.caption_of(spectra)
    pages = {"structure": page}
    if np.isfinite(record.frequency).any():
        pages["dispersion"] = style.stack([speed, scattering], **both)
    for name, figure in pages.items():
        if record.failures:
            style.note(figure, f"{record.failures} of {len(good)} frequencies failed")
        yield name, figure


def errors(record, _):
    """Return how exact S is."""
    words = record.exactness(captions.number)
    return f"{words[0].upper()}{words[1:]}."


def spectra(ax, record, medium, branch=0):
    r"""Dynamic structure factor $S(q, \omega)$ in units of the largest of each map, and the
    oscillators fitted to it: dots $\Omega(q)$, bars from $\Omega-\Gamma/2$ to $\Omega+\Gamma/2$.
    """
    values = np.where(record.converged_reason > 0, record.structure_factor[:, branch].T, np.nan).T
    values = np.maximum(values / np.nanmax(values), LEAST_SHOWN)  # NaN stays
    omega, look = record.omega / medium.omega_mx, {"norm": LogNorm(LEAST_SHOWN, 1.0)}
    drawn = ax.pcolormesh(_edges(record.q), _edges(omega), values, rasterized=True, **look)
    middle, half = (x[branch] / medium.omega_mx for x in (record.frequency, 0.5 * record.width))
    look = {"fmt": "o", "markersize": 2, "color": "white", "elinewidth": 0.6}
    fitted = np.isfinite(middle)
    ax.errorbar(record.q[fitted], middle[fitted], np.abs(half[fitted]), **look)
    ax.set_title(record.branch[branch])
    seen = np.nanmax(values, axis=1, initial=0.0) > LEAST_SHOWN
    ax.set_ylim(_edges(omega)[0], _edges(omega)[1:][seen].max())
    scales.label(ax.xaxis, WAVE_NUMBER)
    scales.label(ax.yaxis, scales.ANY_FREQUENCY)
    return drawn


def _edges(x):
    """Return the ends of cells around numbers that increase."""
    apart = np.gradient(x) if len(x) > 1 else x
    return np.concatenate([x - 0.5 * apart, [x[-1] + 0.5 * apart[-1]]])


def speed(ax, record, medium):
    r"""Phase velocity $\Omega/q$ of the oscillators against the wave number."""
    scales.label(ax.xaxis, WAVE_NUMBER)
    ax.set_ylabel(r"$\Omega/q$ (length $\sqrt{k/m}$)")
    error = record.frequency_error / record.q
    return marks.points(ax, record.q, record.velocity, error, record.branch, linestyle="-")


def scattering(ax, record, medium):
    r"""$\pi\Gamma/\Omega$ of the oscillators by scattering; vertical lines: where it is 1, dotted,
    and waves end (Ioffe and Regel).
    """
    rates = record.scattering, record.scattering_error
    ratio, error = (np.pi * rate / record.frequency for rate in rates)
    scales.label(ax.xaxis, OMEGA)
    ax.set_ylabel(r"$\pi\Gamma/\Omega$")
    x = record.frequency / medium.omega_mx
    drawn = marks.points(ax, x, ratio, error, record.branch, linestyle="-")
    ax.axhline(1.0, color="black", linewidth=0.6, linestyle=":")
    for curve, limit in zip(drawn, record.ioffe_regel, strict=True):
        ax.axvline(limit / medium.omega_mx, color=curve[0].get_color(), linewidth=0.6)
    return drawn
