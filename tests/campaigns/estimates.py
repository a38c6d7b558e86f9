"""Estimates and their errors over many repeats, from data of known law, of several sizes.

    python tests/campaigns/estimates.py [REPEATS]

A row a measure: its mean over the truth, how many standard errors of that mean it misses, the
spread of the repeats over the errors they claim; the mean and the deviation of what each misses the
truth by, over its own error, and how many miss by more than 3 of these. What fails: a bias of more
than a fifth of the spread; errors too small by more than a fifth; misses over errors whose mean is
beyond .4, or whose deviation is below .8 or above 1.3.
A measure that samples are too few for is none, and is not judged. tests/test_statistics.py and its
likes have the short ones.
"""

import contextlib
import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))

import numpy as np
from synthetic import BondSums, codas, gaussian_fields, mean_intensity

from pgran.errors import InputError
from pgran.experiments.ensemble import intensity
from pgran.experiments.ensemble.noise import MAXIMA_SPACING, NoisyCurves
from pgran.experiments.likeness.stretching import MOVES
from pgran.experiments.modes import levels
from pgran.experiments.modes.levels import GOE_SPACING_RATIO, POISSON_SPACING_RATIO
from pgran.experiments.relaxation import memory

FIELDS = (1, 100), (1, 300), (1, 1000), *((n, 10) for n in (8, 20, 40, 80, 300))
GAMMA, EDGES = 0.02, np.array([0.3, 1.0])
MEASURES = {
    "<I>": (mean_intensity, 1.0),
    "<I^2>/<I>^2": (intensity.contrast, intensity.GAUSSIAN_CONTRAST),
    "spread in dB": (intensity.spread, intensity.GAUSSIAN_SPREAD),
    "half width": (intensity.half_width, GAMMA),
    "spacing of maxima": (intensity.maxima_spacing, MAXIMA_SPACING * GAMMA),
    "P between .3 and 1": (
        lambda curves: intensity.histogram(curves, EDGES),
        (np.exp(-0.3) - np.exp(-1.0)) / 0.7,
    ),
}


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
        made = NoisyCurves(omega, A if samples > 1 else A[0], incoherent=incoherent)
        for name, (measure, _) in MEASURES.items():
            with contextlib.suppress(InputError):
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


def main(repeats):
    """Print all tables, and return how many measures fail."""
    rng, failures = np.random.default_rng(1), 0
    for samples, widths in FIELDS:  # samples, window in Gamma
        failures += curves(rng, repeats, samples, widths, incoherent=False)
    failures += curves(rng, repeats, 80, 10, incoherent=True)
    failures += spectra(rng, repeats)
    for memories, trajectories in ((21, 1), (100, 1), (10, 10)):
        failures += relaxations(rng, repeats, memories, trajectories)
    for alike in (0.8, 0.9, 0.99):
        failures += stretches(rng, repeats, alike, alike == 0.9)
    print(f"\n{failures} fail")
    return failures


if __name__ == "__main__":
    sys.exit(int(main(int((sys.argv[1:] or ["400"])[0])) > 0))
