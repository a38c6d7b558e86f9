"""Estimates and their errors over many repeats, from data of known law, of several sizes.

    python tests/campaigns/estimates.py [REPEATS]

A row a measure: its mean over the truth, how many standard errors of that mean it misses, the
spread of the repeats over the errors they claim; the mean and the deviation of what each misses the
truth by, over its own error, and how many miss by more than 3 of these. What fails: a bias of more
than a fifth of the spread; errors too small by more than a fifth; misses over errors whose mean is
beyond .4, or whose deviation is below .8 or above 1.3.
A measure that samples are too few for is none, and is not judged. tests/test_statistics.py and its
likes have the short ones.

The last tables are of ensembles of lattices, 60 at most of each size, drawn from one pool without a
sample twice. Their numbers are biased as any that are not linear in the samples; the truth is the
same estimate of the whole pool, so that a bias counts as a miss. What fails is a root mean square
of z, the misses over their errors, below .9 or above 1.15 by more than twice its noise were there
one number an ensemble, and a number that is never told. How often it is told is said.
"""

import contextlib
import dataclasses
import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))

import numpy as np
from synthetic import BondSums, codas, gaussian_fields, mean_intensity

import pgran
from pgran.experiments.ensemble import statistics as noise
from pgran.experiments.ensemble.statistics import NoisyCurves
from pgran.experiments.likeness.compare import MOVES
from pgran.experiments.modes import levels
from pgran.experiments.modes.levels import GOE_SPACING_RATIO, POISSON_SPACING_RATIO
from pgran.experiments.relaxation import fluctuations as memory
from pgran.store.estimate import MOST

SAMPLES, WIDTHS = (8, 20, 40, 80, 300), 10  # of Gaussian fields, and their window in Gamma
GAMMA, EDGES = 0.02, np.array([0.3, 1.0])
MEASURES = {
    "<I>": (mean_intensity, 1.0),
    "<I^2>/<I>^2": (noise.contrast, noise.GAUSSIAN_CONTRAST),
    "spread in dB": (noise.spread, noise.GAUSSIAN_SPREAD),
    "half width": (noise.half_width, GAMMA),
    "spacing of maxima": (noise.maxima_spacing, noise.MAXIMA_SPACING * GAMMA),
    "P between .3 and 1": (
        lambda curves: noise.histogram(curves, EDGES),
        (np.exp(-0.3) - np.exp(-1.0)) / 0.7,
    ),
}

ENSEMBLES = 60  # at most, of lattices
DRAWN = {"response": ("seed", "good", "displacement", "sample_delay")}
DRAWN["pulse"] = "seed", "good", "arrival", "square"
LENGTHS = "wave_number", "rate", "length", "intensity_length", "scattering_length"
SPREADING = "diffusivity", "absorption", "length", "free_path"


def judge(title, found, truths):
    """Print a table and return how many measures fail; `found` has a list a measure."""
    print(f"\n{title}\n{'':24s} mean/truth  missed by  spread/claim  misses/errors  beyond 3")
    failures = 0
    for name, estimates in found.items():
        if not estimates:
            print(f"{name:24s} withheld")
            continue
        value, error = (
            np.array([np.ravel(getattr(e, part))[0] for e in estimates])
            for part in ("value", "error")
        )
        spread, claim = value.std(ddof=1), np.sqrt(np.mean(error**2))
        bias, ratio = value.mean() - truths[name], spread / claim
        misses, noise = (value - truths[name]) / error, 1 / np.sqrt(len(value))
        middle, deviation = misses.mean(), misses.std(ddof=1)
        failed = (
            abs(bias) > (0.2 + 3 * noise) * spread
            or ratio > 1.2 + 2 * noise
            or abs(middle) > 0.4 + 3 * noise
            or not 0.8 - 3 * noise < deviation < 1.3 + 3 * noise
        )
        failures += int(failed)
        print(
            f"{name:24s} {value.mean() / truths[name]:9.4f}  {bias / spread / noise:9.2f}  "
            f"{ratio:11.3f}  {middle:6.2f} +-{deviation:5.2f}  {np.mean(np.abs(misses) > 3):9.3f}"
            f"{'  FAILS' if failed else ''}"
        )
    return failures


def curves(rng, repeats, samples, widths, incoherent=False):
    """Judge the measures of Gaussian fields in a window of so many Gamma."""
    found = {name: [] for name in MEASURES}
    for _ in range(repeats):
        omega, A, _ = gaussian_fields(rng, samples, 5 * widths + 1, GAMMA, GAMMA / 5)
        made = NoisyCurves(omega, A, incoherent=incoherent)
        for name, (measure, _) in MEASURES.items():
            with contextlib.suppress(pgran.InputError):
                found[name].append(measure(made))
    title = f"{samples} Gaussian fields, window of {widths} Gamma, coherent part off: {incoherent}"
    return judge(title, found, {name: truth for name, (_, truth) in MEASURES.items()})


def spectra(rng, repeats):
    """Judge spacing ratios."""
    found = {"GOE": [], "Poisson": []}
    for _ in range(repeats):
        matrix = rng.standard_normal((300, 300))
        found["GOE"].append(levels.spacing_ratio(np.linalg.eigvalsh(matrix + matrix.T)[75:225]))
        found["Poisson"].append(levels.spacing_ratio(np.sort(rng.random(152))))
    truths = {"GOE": GOE_SPACING_RATIO, "Poisson": POISSON_SPACING_RATIO}
    return judge("spacing ratios of 150 levels", found, truths)


def relaxations(rng, repeats, memories, trajectories):
    """Judge the memory of sums over products of bonds."""
    made = BondSums(60, {1: 0.5, 2: 0.6, 3: 0.8})
    found = {"C(M/2)/C(0)": [], "kbar": [], "B with Delta B": []}
    for _ in range(repeats):
        rows = [made.series(rng, memories * made.bonds) for _ in range(trajectories)]
        run = memory.Series(rows, made.bonds)
        found["C(M/2)/C(0)"].append(memory.autocorrelation(run, [made.bonds // 2]))
        found["kbar"].append(memory.mean_order(run))
        found["B with Delta B"].append(memory.increment_correlation(run))
    C = made.covariance([0, made.bonds // 2])
    truths = dict(zip(found, [C[1] / C[0], made.order, 0.0], strict=True))
    truths["B with Delta B"] = -np.sqrt(made.order / (2 * made.bonds))
    return judge(f"{trajectories} trajectories of {memories} M steps", found, truths)


def stretches(rng, repeats, alike, complex_ones):
    """Judge the stretch of codas, and their correlation under it."""
    pairs = [codas(rng, alike, 0.003, complex_ones) for _ in range(repeats)]
    move = MOVES["pulse"]["stretch"]
    found = {"stretch": [pair.best(move, 0.02)[0] for pair in pairs]}
    found["correlation"] = [pair.correlation(move, 0.003) for pair in pairs]
    truths = {"stretch": 0.003, "correlation": alike}
    return judge(f"codas, correlation {alike}, complex: {complex_ones}", found, truths)


def drawn(pool, some):
    """Return some samples of a pool, whose squares are of one sample a part, as an ensemble."""
    own = {name: getattr(pool, name)[some] for name in DRAWN[pool.of]}
    if pool.of == "pulse":
        parts = np.array_split(own["square"], min(len(own["seed"]), MOST))
        own["square"] = np.array([part.mean(axis=0) for part in parts])
    return dataclasses.replace(pool, **own)


def misses(lattice, pool, size, names):
    """Print a table of ensembles of a size, and return how many of their numbers fail."""
    starts = range(0, len(pool.seed) - size + 1, size)
    parts = [slice(None), *(slice(n, n + size) for n in starts)][: ENSEMBLES + 1]
    truth, *found = (pgran.transport(lattice, drawn(pool, part)) for part in parts)
    print(f"\n{len(found)} ensembles of {size}\n{'':24s} told  rms z  mean z  beyond 3")
    failures = 0
    for name in names:
        value, error = (
            np.array([getattr(each, name + end) for each in found]) for end in ("", "_error")
        )
        z = (value - getattr(truth, name)) / error
        told, z = np.mean(np.isfinite(value)), z[np.isfinite(z)]
        rms, mean, beyond = (np.mean(x) if len(z) else np.nan for x in (z**2, z, np.abs(z) > 3))
        rms, noise = np.sqrt(rms), 1 / np.sqrt(2 * max(min(len(z), len(found)), 1))
        failed = not 0.9 - 2 * noise < rms < 1.15 + 2 * noise
        failures += int(failed)
        print(f"{name:24s} {told:4.2f}  {rms:5.2f}  {mean:6.2f}  {beyond:8.3f}{'  FAILS' * failed}")
    return failures


def transports(repeats, kmin, damping, names):
    """Judge wave numbers and lengths of responses."""
    box = {"shape": (14, 8), "law": "uniform", "kmin": kmin, "damping": damping}
    heard = {"omegas": np.linspace(0.15, 0.9, 16), "detectors": [(i, 4) for i in range(1, 14)]}
    pool = pgran.ensemble("response", repeats * 40, lattice=box, keep="curves", **heard)
    print(f"\nresponses of lattices, kmin {kmin}, damping {damping}")
    return sum(misses(pgran.Lattice.random(**box), pool, size, names) for size in (16, 40))


def diffusions(repeats):
    """Judge the constants of energy that diffuses, of pulses."""
    box = {"shape": (16, 4), "law": "uniform", "kmin": 0.1, "damping": 0.008, "free": "y-,y+"}
    sent = {"omega": 0.8, "width": 8.0, "time": 240.0, "points": 121, "error_tolerance": 1e-2}
    sent |= {"detectors": [(i, 2) for i in range(3, 14)], "keep": "curves", "lattice": box}
    # an ensemble keeps the squares of parts of its samples: of so few each is one
    made = [pgran.ensemble("pulse", 16, seed=16 * n, **sent) for n in range(repeats)]
    own = {name: np.concatenate([getattr(e, name) for e in made]) for name in DRAWN["pulse"]}
    print("\npulses in lattices")
    pool, lattice = dataclasses.replace(made[0], **own), pgran.Lattice.random(**box)
    return sum(misses(lattice, pool, size, SPREADING) for size in (16, 32))


def main(repeats):
    """Print all tables, and return how many measures fail."""
    rng, failures = np.random.default_rng(1), 0
    for samples in SAMPLES:
        failures += curves(rng, repeats, samples, WIDTHS, incoherent=False)
    failures += curves(rng, repeats, 80, WIDTHS, incoherent=True)
    failures += spectra(rng, repeats)
    for memories, trajectories in ((21, 1), (100, 1), (10, 10)):
        failures += relaxations(rng, repeats, memories, trajectories)
    for alike in (0.8, 0.9, 0.99):
        failures += stretches(rng, repeats, alike, alike == 0.9)
    ensembles = min(repeats, ENSEMBLES)
    failures += transports(ensembles, 0.1, 0.01, LENGTHS)
    # of these, the paper's, few strong samples rule <|A|^2>, and rms z of its length is 1.1 to 1.6
    failures += transports(ensembles, 0.0, 0.003, ("wave_number", "rate", "length"))
    failures += diffusions(ensembles)
    print(f"\n{failures} fail")
    return failures


if __name__ == "__main__":
    sys.exit(int(main(int((sys.argv[1:] or ["400"])[0])) > 0))
