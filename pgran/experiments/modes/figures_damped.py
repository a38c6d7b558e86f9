"""The figures of damped modes: their widths, their shapes, and the response as their sum."""

from functools import partial

import numpy as np

from pgran.draw import balls, captions, marks, scales, style
from pgran.experiments.modes.figures import ASIDE, pick
from pgran.experiments.modes.shapes import least_frequency
from pgran.medium.springs import drive_of
from pgran.store.estimate import counted

WIDTH = scales.Quantity("width", r"$\Gamma/\omega_{mx}$", "1/s", 1)
LOST = 2e-15  # of |e_d| |f| |x|^2: what rounding takes of a residue
POINTS = 3000  # frequencies of a sum


def figures(result, **_):
    """Yield the widths, shapes if they are stored, and the response that all modes add up to."""
    modes, medium = result.damped_modes, result.medium
    style.check_any(modes.eigenvalue, "modes")
    both = {"modes": modes, "medium": medium}
    made = {"widths": style.single(widths, **both)}
    ringing = np.flatnonzero((modes.omega > 0) & (modes.rigidity > 0))
    if modes.vector is not None and medium.has_places and len(ringing):
        picked = pick(modes.omega[ringing] / medium.omega_mx, modes.participation[ringing])
        panels = [(n, later) for n in ringing[picked][-2:] for later in (False, True)]
        draws = [partial(swing, **both, mode=n, later=later) for n, later in panels]
        made["swings"] = balls.motions(medium, draws, style.caption_of(swing))
    if modes.complete and modes.residue is not None and np.isfinite(modes.residue).all():
        made["residues"] = style.single(residues, **both)
    for name, figure in made.items():
        if modes.failures:
            style.note(figure, modes.exactness())
        yield name, figure


def errors(record, _):
    """Return how sure it is that no mode is missing."""
    return f"{counted(record.count_found, 'damped mode')}: {record.exactness(captions.number)}."


def widths(ax, modes, medium):
    r"""Damped modes $s = -\Gamma/2 + i \omega$.

    Frequencies of overdamped modes are 0, growing modes are drawn apart, those at rest have no
    width.
    """
    x, y = modes.omega / medium.omega_mx, modes.width / medium.omega_mx
    ax.set(yscale="log")
    scales.frequencies(ax, x if x.any() else np.append(x, 1.0), scales.MODE_FREQUENCY, aside=ASIDE)
    scales.label(ax.yaxis, WIDTH)
    look = {"linestyle": "none", "marker": ".", "markeredgewidth": 0, "clip_on": False}
    (points,) = ax.plot(x[y > 0], y[y > 0], color="black", **look)
    if np.any(grow := (y < 0) & (np.abs(modes.eigenvalue) > least_frequency(medium.built))):
        look |= {"marker": "x", "markeredgewidth": 0.8, "color": style.FAILED, "markersize": 4}
        ax.plot(x[grow], -y[grow], label=r"growing: $-\Gamma$", **look)
    return points


def swing(ax, modes, medium, mode, later):
    """Shapes of damped modes: where most moves, and a quarter period later, with its size over that
    before.
    """
    x = medium.built.displacements(modes.vector[mode])
    x = x * np.exp(-0.5j * np.angle(np.sum(x * x)))  # whose real part is the largest
    drawn, _, plane = balls.motion(ax, medium, -x.imag if later else x.real, of=x.real)
    told = scales.frequency(modes.omega[mode] / medium.omega_mx, medium)
    if later:
        told = rf"later: $\times$ {np.linalg.norm(x.imag) / np.linalg.norm(x.real):.2g}"
    style.title(ax, told, plane)
    return drawn


def residues(ax, modes, medium):
    r"""Response as the sum of the residues of all damped modes over $i\omega - s$, where rounding
    leaves it.
    """
    built, highest = medium.built, 1.1 * (modes.omega.max() or medium.omega_mx)
    omegas = np.linspace(0.0, highest, POINTS + 1)[1:]
    names = style.ball_names(modes.detector) if len(modes.detector) > 1 else None
    x, A = omegas / medium.omega_mx, np.abs(modes.response(omegas))
    # |x|^2 of each mode, and what rounding of x takes of the sum
    size = 1 / (2 * built.mass * np.abs(modes.eigenvalue) * modes.rigidity)
    lost = np.sum(size / np.abs(1j * omegas[:, None] - modes.eigenvalue), axis=1)
    lost = LOST * np.linalg.norm(drive_of(built)[0]) * lost[:, None]
    lost = lost * built.reading_norms(modes.detector)
    ax.set(yscale="log", ylabel=scales.AMPLITUDE)
    scales.frequencies(ax, x)
    return marks.curves(ax, x, A, lost < A, names)
