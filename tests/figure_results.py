"""Results to draw, made by hand, and what tests read off the axes."""

from dataclasses import fields
from types import SimpleNamespace

import numpy as np
from samples import bond_arrays

from pgran import results
from pgran.physics.lattice import Lattice
from pgran.physics.spectrum import power_spectrum

UNIT = 2.0  # omega_mx
SLOPE, INTERCEPT = -150.0, 5.0  # of the phases
RNG = np.random.default_rng(8)


def make_lattice(shape=(4, 3), mass=1.0, seed=5):
    """Random bonds whose unit of frequency is `UNIT`."""
    rng, kmax = np.random.default_rng(seed), mass * UNIT**2 / (2 * len(shape))
    stiffness = bond_arrays(shape, lambda size: rng.uniform(0, kmax, size))
    return results.LatticeRecord.of(Lattice(stiffness, mass, 0.1, kmax=kmax))


def result(kind, shape=(6, 5), **values):
    """A result of one record, of which a test says only what a figure shows."""
    zeros = dict.fromkeys([field.name for field in fields(kind)], 0)
    groups = {"lattice": make_lattice(shape), kind.group: kind(**zeros | values)}
    return SimpleNamespace(scene=kind.group, **groups)


def make_response(x=None, shape=(4, 3), detectors=((1, 1),)):
    """A response whose phase is a straight line, frequencies `x` in units of omega_mx."""
    x = np.linspace(0.005, 1.3, 260) if x is None else np.asarray(x, dtype=float)
    steeper = SLOPE * np.arange(1, len(detectors) + 1)
    amplitude, phase = np.outer(10.0 ** (-8 * x), steeper / SLOPE), np.outer(x, steeper) + INTERCEPT
    return result(
        results.Response,
        shape,
        phase_slope=steeper,
        phase_velocity=3 / np.abs(steeper),
        phase_intercept=np.full(len(detectors), INTERCEPT),
        phase_fit_min=0.3,
        phase_fit_max=1.0,
        omega=x * UNIT,
        detector=np.array(detectors),
        displacement=amplitude * np.exp(1j * phase),
        amplitude=amplitude,
        phase=phase,
        error_bound=np.full(amplitude.shape, 1e-3),
        at_floor=np.zeros(amplitude.shape, np.int8),
        converged_reason=np.ones(len(x), int),
    )


def make_continuum(damping=0.003, count=300):
    """A made-up box response, whose frequencies are 3 times those of a unit box."""
    x = np.linspace(0.1, 12, count)
    displacement = 2.0 * np.exp(-1j * (x if damping else np.pi * np.floor(x / 3)))
    box = {"point": (0.47, 0.52), "size": (1 / 3, 1.0), "mass": 1.0, "stiffness": 1.0}
    shown = {"amplitude": np.abs(displacement), "phase": np.unwrap(np.angle(displacement))}
    shown |= {"omega": 3 * x, "displacement": displacement, "damping": damping}
    return result(results.ContinuumResponse, **box, **shown, resonance=np.array([13.2, 29.7]))


def make_modes(shape=(6, 5), omega=None, missing=0, certified=True):
    """Modes of frequencies `omega` in units of omega_mx, their shapes the columns of a matrix."""
    balls = int(np.prod(shape))
    omega = np.linspace(0.05, 1.2, balls) if omega is None else np.asarray(omega, dtype=float)
    vector = np.linalg.qr(RNG.normal(size=(balls, balls)))[0][: len(omega)]
    shown = {"omega": omega * UNIT, "vector": vector.reshape(-1, *shape)}
    count = {"count_expected": len(omega) + missing, "count_certified": certified}
    participation = 1 / np.sum(vector**4, axis=1)
    return result(results.Modes, shape, participation=participation, **shown, **count)


def make_projection(x=None, own=None, missing=0):
    """A projection of Lorentzians on modes of frequencies `own`, in units of omega_mx."""
    x = np.linspace(0.1, 1.1, 401) if x is None else np.asarray(x, dtype=float)
    own = np.linspace(0.05, 1.15, 45) if own is None else np.asarray(own)
    coefficient = 1 / (x[:, None] ** 2 - own**2 + 0.01j)
    return result(
        results.Projection,
        omega=x * UNIT,
        mode_omega=own * UNIT,
        coefficient=coefficient,
        dominant=np.abs(coefficient).argmax(axis=1),
        converged_reason=np.ones(len(x), dtype=int),
        count_expected=len(own) + missing,
        count_certified=not missing,
    )


def make_relaxation(steps=300, trajectories=1):
    """A random walk: its spectrum falls like f^-2."""
    walk = 100 + np.cumsum(RNG.normal(size=(trajectories, steps + 1)), axis=1)
    shown = {"detector": np.array([(1, 2)]), "displacement": (walk * np.exp(0.3j))[:, :, None]}
    bounds = {"error_bound": np.full((*walk.shape, 1), 0.5), "at_floor": np.zeros((*walk.shape, 1))}
    made = result(results.Relaxation, **shown, **bounds)
    if steps > 1000:
        made.spectrum = power_spectrum(walk)
    return made


def make_accuracy(error):
    """Configurations of one solver each, slower and slower."""
    seconds = np.arange(1.0, len(error) + 1)
    times = {"seconds": seconds, "seconds_min": 0.9 * seconds, "seconds_max": 1.1 * seconds}
    errors = {"error_max": np.array(error), "error_bound_max": np.ones(len(error))}
    solver = np.array([f"solver{n}" for n in range(len(error))])
    marked = {"failures": np.where(seconds == 4, 4, 0), "on_front": seconds < 3}
    return result(
        results.Accuracy, solver=solver, reference_bound=1e-14, **times, **errors, **marked
    )


def lines(ax, **wanted):
    """The lines of one panel that have these properties."""
    chosen = ax.get_lines()
    for name, value in wanted.items():
        chosen = [line for line in chosen if getattr(line, f"get_{name}")() == value]
    return chosen


def curves(ax):
    """The lines that are data: not the fits, not the marks."""
    return [line for line in ax.get_lines() if np.ma.isMaskedArray(line.get_ydata(orig=True))]


def gaps(line):
    return list(np.flatnonzero(np.ma.getmaskarray(line.get_ydata(orig=True))))


def marks(ax, marker):
    """Where on the frequency axis there are marks of one kind."""
    return [x for line in lines(ax, marker=marker) for x in line.get_xdata()]


def labels(ax):
    """What a legend of the panel lists."""
    return ax.get_legend_handles_labels()[1]


def note(figure):
    return figure._suptitle.get_text() if figure._suptitle else ""
