"""Curves of random lattices, looked at between the frequencies that were computed.

    python tests/campaigns/curves.py [--samples 100] [--frequencies 2000] [--points]

Each sample's curve is resolved to 1e-2 of the amplitude. With --points frequencies are solved for
one by one, and damping goes down to 1e-9: what is looked at then is whether `line_error` knows of
every line that is wrong. At so many random frequencies, at five across every mode narrower than ten
times their distance and where straight lines come nearest to zero the field is solved directly and
refined in extended precision; a bound that then looks false is judged by elimination with 50
digits. tests/test_curve.py has the short ones.
"""

import argparse
import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))

import mpmath
import numpy as np
from reference import exact_amplitudes
from samples import bond_arrays, reference_of, swept

from pgran.experiments.response.record import Curve
from pgran.medium.lattice import Lattice

RESOLVE = 1e-2
LAWS = {
    "uniform": lambda rng, size: rng.uniform(0, 1, size),
    "zeros": lambda rng, size: rng.choice([0.0, 1.0], size, p=[0.15, 0.85]),
    "wide": lambda rng, size: 10 ** rng.uniform(-3, 0, size),
    "constant": lambda rng, size: np.ones(size),
    "weak": lambda rng, size: rng.uniform(0.8, 1, size),
}
COLUMNS = ("solved", "points", "tests", "narrow", "unproven", "straight")
# Bounds of A and of A' exceeded; proven, but above 1e-4, as the bound says; lines that leave the
# curve where it is proven; the same elsewhere, unless `line_error` says so. Unproven lines that it
# calls straight are counted.
FAULTS = ("bounds", "slopes", "inexact", "lines", "unsaid")


class Sample:
    """A lattice of up to 400 balls along 1 to 3 axes, its detectors, and where it is driven."""

    def __init__(self, seed, points=False):
        """Draw it, of at least 20 balls; for points of at least 2, and with less damping."""
        rng = self.rng = np.random.default_rng([29, seed])
        fewest, least = (2, -9) if points else (20, -4)
        axes, balls = rng.integers(1, 4), fewest * (400 / fewest) ** rng.uniform()
        stretch = np.exp(rng.uniform(-0.3, 0.3, axes))
        self.shape = tuple(np.ceil(stretch * balls ** (1 / axes)).astype(int).tolist())
        self.law = list(LAWS)[rng.integers(len(LAWS))]
        bonds = bond_arrays(self.shape, lambda size: LAWS[self.law](rng, size))
        self.lattice = Lattice(bonds, 1.0, 10 ** rng.uniform(least, 0), kmax=1.0)
        self.sites = np.array([rng.integers(self.shape) for _ in range(rng.integers(1, 4))])
        self.places = np.ravel_multi_index(self.sites.T, self.shape)
        self.low, self.high = self.lattice.omega_mx * np.array([0.02, 1.5])
        self.reference = reference_of(self.lattice)
        asked = rng.integers(40, 2000) if points else 40
        self.asked = np.sort(rng.uniform(self.low, self.high, asked))
        self.choices = {"method": "points"}
        if not points:
            self.choices = {"method": "curve", "resolve": RESOLVE, "keep_models": True}

    def frequencies(self, response, count):
        """Return what to test at, `count` at random, and how many lie across narrow modes."""
        ends = response.omega[0], response.omega[-1]
        across = self.reference.across_modes(*ends, 10 * (self.high - self.low) / count)
        known, step = response.displacement, np.diff(response.omega)[:, None]
        place = (-known[:-1] / np.diff(known, axis=0)).real
        nearest = (response.omega[:-1, None] + place * step)[(place > 0) & (place < 1)]
        omega = self.rng.uniform(*ends, count)
        return np.unique(np.concatenate([omega, across, nearest])), len(across)

    def exact(self, omega):
        """Return the detectors' A and A', a hundred frequencies at a time."""
        parts = np.array_split(omega, -(-len(omega) // 100))
        fields = [self.reference.sweep(part) for part in parts]
        return [np.concatenate(field)[:, self.places] for field in zip(*fields, strict=True)]


def surely(sample, omega, found, bound):
    """Return which errors exceed bounds, by elimination with many digits."""
    constants = sample.lattice.stiffness, sample.lattice.mass, sample.lattice.damping
    with mpmath.workdps(50):
        exact = exact_amplitudes(*constants, omega, sample.sites)
        errors = [abs(mpmath.mpmathify(complex(x)) - y) for x, y in zip(found, exact, strict=True)]
    return np.array([e > b for e, b in zip(errors, bound, strict=True)])


def examine(sample, seed, count):
    """Carry out a sample and print its faults; return their numbers and others, as in the table."""
    response = swept(sample.lattice, sample.asked, sample.sites, **sample.choices)
    omega, narrow = sample.frequencies(response, count)
    exact, slope = sample.exact(omega)
    unknown = np.full((2, *exact.shape), [[[np.nan]], [[np.inf]]])
    found = Curve(omega, *unknown, *unknown) if response.models is None else response.at(omega)
    size, proven = np.abs(exact), np.isfinite(found.error_bound)
    lines = [np.interp(omega, response.omega, column) for column in response.displacement.T]
    end = np.maximum(np.searchsorted(response.omega, omega), 1)
    astray = ~(np.abs(np.transpose(lines) - exact) <= RESOLVE * size)
    faults = (
        np.abs(found.displacement - exact) > found.error_bound,
        np.abs(found.derivative - slope) > found.derivative_bound,
        proven & ~(found.error_bound <= 1.0001e-4 * size),
        proven & astray,
        ~proven & astray & (response.line_error[end] <= RESOLVE),
    )
    for n in np.flatnonzero(faults[0].any(axis=1)):
        faults[0][n] = surely(sample, omega[n], found.displacement[n], found.error_bound[n])
    for name, wrong in zip(FAULTS, faults, strict=True):
        for n, d in np.argwhere(wrong)[:3]:
            values = (x[n, d] for x in (exact, *found[1:], response.line_error[end]))
            print(name, seed, d, f"{omega[n]:.17g}", *map("{:.8g}".format, values))
    solved = response.factorizations, len(response.omega)
    unproven = np.count_nonzero(~proven.all(axis=1))
    straight = np.count_nonzero(~response.unresolved & (response.modelled[1:] == 0))
    return *solved, len(omega), narrow, unproven, straight, *map(np.count_nonzero, faults)


def main():
    """Print a line a sample and what they sum up to; exit with 1 if anything was false."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--samples", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--frequencies", type=int, default=2000)
    parser.add_argument("--points", action="store_true")
    given = parser.parse_args()
    total = np.zeros(len(COLUMNS + FAULTS), int)
    print(f"{'sample':30}", *(f"{name:>8}" for name in COLUMNS + FAULTS))
    for seed in range(given.first, given.first + given.samples):
        sample = Sample(seed, given.points)
        numbers = examine(sample, seed, given.frequencies)
        what = f"{seed:4d} {'x'.join(map(str, sample.shape)):>8} {sample.law:>8}"
        print(f"{what} {sample.lattice.damping:.1e}", *(f"{n:8d}" for n in numbers), flush=True)
        total += numbers
    print(f"{f'{given.samples} samples':30}", *(f"{n:8d}" for n in total))
    sys.exit(bool(np.any(total[[-5, -4, -2, -1]])))


if __name__ == "__main__":
    main()
