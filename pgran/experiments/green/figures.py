"""The figures of Green's functions: their magnitudes, and local densities of states."""

import numpy as np

from pgran.draw import captions, marks, scales, style
from pgran.store.record import site_name

NAMED = 6  # curves in a legend
DENSITY = scales.Quantity("local density of states", r"($1/\omega_{mx}$)", "1/Hz", -1)
CAPTIONS = (
    "Magnitude of the displacement of a ball under a unit force on another, each pair once, "
    "against the driving frequency.",
    "Local density of states of the balls that are pushed; over all frequencies its integral is 1.",
)

errors = captions.amplitudes


def figures(result, **_):
    """Yield magnitudes of pairs and, with damping, local densities of the balls that are pushed."""
    shown = {"record": result.green, "medium": result.medium}
    count = 1 + result.medium.built.dissipates  # undamped densities are lines at the modes
    yield "green", style.stack((magnitude, local_density)[:count], CAPTIONS[:count], **shown)


def magnitude(ax, record, medium):
    """Draw |G| of all pairs, each once, upper limits at the floor; return the curves."""
    d, p = np.transpose(_pairs(record))
    heard, pushed = (map(site_name, sites) for sites in (record.receiver[d], record.source[p]))
    names = [f"{one} from {other}" for one, other in zip(heard, pushed, strict=True)]
    limit, values = marks.upper_limits(record)[:, d, p], record.amplitude[:, d, p]
    ax.set(yscale="log", ylabel="displacement $|G|$ (force = 1)")
    return _curves(ax, record, medium, values, (values > 0) & np.isnan(limit), names, limit)


def local_density(ax, record, medium):
    """Draw the local densities of states of the balls that are pushed; return the curves."""
    values, names = record.local_density * medium.omega_mx, style.ball_names(record.source)
    scales.label(ax.yaxis, DENSITY)
    return _curves(ax, record, medium, values, np.isfinite(values), names)


def _curves(ax, record, medium, values, known, names, limit=None):
    """Draw curves with gaps where frequencies failed, which are marked."""
    x, good = record.omega / medium.omega_mx, record.converged_reason > 0
    scales.frequencies(ax, x)
    names = names if len(names) <= NAMED else None
    drawn = marks.curves(ax, x, values, known & good[:, None], names, limit)
    marks.failed(ax, x[~good])
    return drawn


def _pairs(record):
    """Return the numbers of receivers and sources of all pairs, without mirror images."""
    once = {}
    for d, receiver in enumerate(record.receiver.tolist()):
        for p, source in enumerate(record.source.tolist()):
            once.setdefault(frozenset((tuple(receiver), tuple(source))), (d, p))
    return list(once.values())
