"""The figures of Green's functions: their magnitudes, and local densities of states."""

import numpy as np

from pgran.draw import captions, marks, scales, style
from pgran.store.record import site_name

DENSITY = scales.DENSITY._replace(name="local density of states")

errors = captions.amplitudes


def figures(result, **_):
    """Yield magnitudes of pairs and, with damping, local densities of the balls that are pushed."""
    shown = {"record": result.green, "medium": result.medium}
    # undamped densities are lines at the modes
    panels = [magnitude, local_density][: 1 + result.medium.built.dissipates]
    yield "green", style.stack(panels, **shown)


def magnitude(ax, record, medium):
    """Magnitude of the displacement of a ball under a unit force on another, each pair once,
    against the driving frequency.
    """
    once = {}  # the numbers of receiver and source of each pair, without mirror images
    for d, receiver in enumerate(record.receiver.tolist()):
        for p, source in enumerate(record.source.tolist()):
            once.setdefault(frozenset((tuple(receiver), tuple(source))), (d, p))
    d, p = np.transpose(list(once.values()))
    heard, pushed = (map(site_name, sites) for sites in (record.receiver[d], record.source[p]))
    names = [f"{one} from {other}" for one, other in zip(heard, pushed, strict=True)]
    limit, values = marks.upper_limits(record)[:, d, p], record.amplitude[:, d, p]
    ax.set(yscale="log", ylabel="displacement $|G|$ (force = 1)")
    good = (values > 0) & np.isnan(limit)
    return marks.over_frequency(ax, record, medium, values, good, names, limit)


def local_density(ax, record, medium):
    """Local density of states of the balls that are pushed; over all frequencies its integral
    is 1.
    """
    values, names = record.local_density * medium.omega_mx, style.ball_names(record.source)
    scales.label(ax.yaxis, DENSITY)
    return marks.over_frequency(ax, record, medium, values, np.isfinite(values), names)
