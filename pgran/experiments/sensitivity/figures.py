"""The figures of what a signal depends on: derivatives by bonds, and the power through them."""

from functools import partial

import numpy as np

from pgran.draw import balls, bonds, captions, scales, style
from pgran.experiments.sensitivity import maps
from pgran.experiments.sensitivity.maps import Map, few


def figures(result, **_):
    """Yield for each detector the map of the derivatives, the flux, how they are distributed."""
    found, medium = result.sensitivity, result.medium
    chosen = few(found)
    if not len(chosen):
        return
    if medium.has_places:
        yield from maps.pages("sensitivity", derivatives, found, medium, "derivative", _words)
        seen = Map(medium, found.detector[0])
        panels = [partial(flux, record=found, medium=medium, at=n) for n in chosen]
        text = "each wedge the sum of a cell; " * (not seen.clear) + (
            "wedges: power, from the broad end to the point; width: square root; number: largest "
            "at the circle"
        )
        yield "flux", maps.page(seen, found, panels, "power lost at a ball", text)
    figure = style.single(distribution, record=found, medium=medium)
    maps.note_failed(figure, found)
    yield "distribution", figure
    if medium.group == "lattice":
        yield "bonds", bonds.page(medium, found.detector)


def over(results, _):
    """Yield how heaters that grow change a signal, against how much they grow in each result."""
    from pgran.experiments.sensitivity import figures_heat

    yield "growth", figures_heat.growths(results)


def errors(record, how):
    """Return the bounds of amplitudes, and the largest of the derivatives d ln|A| / d ln k."""
    words = captions.amplitudes(record, how)
    largest = np.max(record.log_bound[record.converged_reason > 0], initial=0.0)
    if 0 < largest < np.inf:
        slope = "$d\\,\\ln|A| / d\\,\\ln k$"
        most = captions.number(largest)
        words += f" Error of every derivative {slope}: at most {most} ({how})."
    return words


def derivatives(ax, record, medium, at, d=0):
    """Draw d ln|A| / d ln k of the bonds that are kept (`most`), as `Map.on_bonds` draws numbers.

    The medium has positions; `at` and `d` are the numbers of the frequency and of the detector.
    """
    seen = Map(medium, record.detector[d])
    drawn, unit = seen.on_bonds(ax, record.on_bonds(at, d))
    maps.title(ax, record, medium, at, f"{unit:.3g}", balls.beyond(drawn))
    return drawn


def _words(seen, record, at, d):
    """Return what the map of a detector shows, in words."""
    return seen.words(record.on_bonds(at, d), "|A| grows with k")


def flux(ax, record, medium, at):
    """Draw the mean power through all bonds at one frequency, and where it is lost.

    The loss of a bond counts half at each of its balls, whose colours are in units of the largest
    that is seen. The title says what the broadest wedge is, a number beside the detector what the
    broadest there is.
    """
    seen = Map(medium, record.detector[0])
    lost = 0.5 * seen.summed(record.loss[at])
    power, ends = np.abs(record.flux[at]), seen.network.bond
    largest = power[seen.numbers].max(initial=0.0) or 1.0
    near = power[(ends == seen.detector).any(axis=1)].max(initial=0.0)
    drawn = seen.flow(ax, record.flux[at] / largest, lost / (lost[seen.free].max() or 1.0))
    seen.beside(ax, captions.number(near, 1))
    maps.title(ax, record, medium, at, f"power {captions.number(largest)}", False)
    return drawn


def distribution(ax, record, medium):
    r"""Share of the bonds whose logarithmic derivative $|d\,\ln|A| / d\,\ln k|$ is larger."""
    drawn, total = [], record.flux.shape[1]
    names = style.ball_names(record.detector)
    for n in few(record):
        for d, name in enumerate(names):
            size, share = maps.shares(np.abs(record.log_amplitude[n, d]), total)
            label = scales.frequency(record.omega[n] / medium.omega_mx, medium)
            drawn += ax.plot(size, share, label=label + f", {name}" * (len(names) > 1))
    for curve, shade in zip(drawn, style.colours(len(drawn)), strict=True):
        curve.set_color(shade)
    ax.set(xlabel="change of $|A|$ in % by 1 % of a bond constant")
    ax.set_ylabel("share of bonds with more")
    maps.logarithmic(ax, drawn)
    return drawn
