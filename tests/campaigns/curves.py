"""Curves of random lattices, looked at between the frequencies that were computed.

    python tests/campaigns/curves.py [--samples 100]

Each sample's curve is resolved to 1e-2 of the amplitude. At 2000 random frequencies, and at five
across every mode narrower than their distance, the field is solved directly and refined in extended
precision; what then looks false is judged by elimination with 50 digits. No bound may be exceeded,
no line between proven points leave the curve. tests/test_curve.py has the short ones.
"""

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))

import mpmath
import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from mpmath import mp
from reference import exact_amplitudes
from samples import bond_arrays, reference_of, swept

from pgran.physics.lattice import Lattice

FREQUENCIES, ASKED, RESOLVE = 2000, 40, 1e-2
LAWS = {
    "uniform": lambda rng, size: rng.uniform(0, 1, size),
    "zeros": lambda rng, size: rng.choice([0.0, 1.0], size, p=[0.15, 0.85]),
    "wide": lambda rng, size: 10 ** rng.uniform(-3, 0, size),
    "constant": lambda rng, size: np.ones(size),
}
COLUMNS = ("sample", "law", "beta", "solved", "points", "unproven", "tests", "narrow")
FAULTS = ("bounds", "slopes", "inexact", "lines", "unsaid")


@dataclass
class Sample:
    """A lattice, its detectors, and where it is driven."""

    seed: int

    def __post_init__(self):
        """Draw it: 20 to 400 balls along 1 to 3 axes."""
        rng = self.rng = np.random.default_rng([29, self.seed])
        axes, balls = rng.integers(1, 4), 20 * 20 ** rng.uniform()
        stretch = np.exp(rng.uniform(-0.3, 0.3, axes))
        self.shape = tuple(np.ceil(stretch * balls ** (1 / axes)).astype(int).tolist())
        self.law = list(LAWS)[rng.integers(len(LAWS))]
        bonds = bond_arrays(self.shape, lambda size: LAWS[self.law](rng, size))
        self.lattice = Lattice(bonds, 1.0, 10 ** rng.uniform(-4, 0), kmax=1.0)
        self.sites = np.array([rng.integers(self.shape) for _ in range(rng.integers(1, 4))])
        self.places = np.ravel_multi_index(self.sites.T, self.shape)
        self.low, self.high = self.lattice.omega_mx * np.array([0.02, 1.5])
        self.reference = reference_of(self.lattice)

    def frequencies(self):
        """Return what to test at, and how many lie across narrow modes."""
        omega = self.rng.uniform(self.low, self.high, FREQUENCIES)
        poles = self.reference.poles()
        poles = poles[2 * np.abs(poles.imag) < (self.high - self.low) / FREQUENCIES]
        across = (poles.real[:, None] + np.abs(poles.imag)[:, None] * np.linspace(-2, 2, 5)).ravel()
        across = across[(self.low < across) & (across < self.high)]
        return np.sort(np.concatenate([omega, across])), len(across)

    def exact(self, omega):
        """Return the amplitudes and their derivatives, refined in extended precision."""
        r, beta = self.reference, 1j * np.longdouble(self.lattice.damping)
        K, C = (scipy.sparse.csr_matrix(matrix) for matrix in (r.K, r.C))
        K, C, w = K.astype(np.clongdouble), C.astype(np.clongdouble), omega.astype(np.longdouble)
        one, unit, M = np.ones_like(w), scipy.sparse.identity(len(r.K)), r.mass
        Kd, Cd = K.astype(complex).tocsc(), C.astype(complex).tocsc()
        options = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0}
        S = [(Kd + 1j * x * r.damping * Cd - M * x * x * unit).tocsc() for x in omega]
        factors = [
            scipy.sparse.linalg.splu(s, options={"SymmetricMode": True}, **options) for s in S
        ]

        def solve(f):
            x = np.zeros_like(f)
            for _ in range(6):
                missed = (f - K @ x - beta * (C @ x) * w + M * x * w * w).astype(complex)
                for n, factor in enumerate(factors):
                    x[:, n] += factor.solve(np.ascontiguousarray(missed[:, n]))
            return x

        A = solve(np.outer(r.drive_K, one) + beta * np.outer(r.drive_C, w))
        slope = solve(beta * (np.outer(r.drive_C, one) - C @ A) + 2 * M * A * w)
        return A[self.places].T, slope[self.places].T


def surely(sample, omega, found, bound):
    """Return which errors exceed bounds, by elimination with many digits."""
    constants = sample.lattice.stiffness, sample.lattice.mass, sample.lattice.damping
    with mp.workdps(50):
        exact = exact_amplitudes(*constants, omega, sample.sites)
        errors = [abs(mpmath.mpmathify(complex(x)) - y) for x, y in zip(found, exact, strict=True)]
    return np.array([e > b for e, b in zip(errors, bound, strict=True)])


def examine(seed):
    """Carry out a sample; return a line of the table and its faults, and print each of these."""
    sample = Sample(seed)
    asked = np.sort(sample.rng.uniform(sample.low, sample.high, ASKED))
    choices = {"method": "curve", "resolve": RESOLVE, "keep_models": True}
    response = swept(sample.lattice, asked, sample.sites, **choices)
    omega, narrow = sample.frequencies()
    omega = omega[(asked[0] <= omega) & (omega <= asked[-1])]
    exact, slope = sample.exact(omega)
    found, size = response.at(omega), np.abs(exact)
    proven = np.isfinite(found.error_bound).all(axis=1)
    lines = np.array([np.interp(omega, response.omega, d) for d in response.displacement.T]).T
    end = np.maximum(np.searchsorted(response.omega, omega), 1)
    resolved = (response.line_error[end] <= RESOLVE).all(axis=1)
    faults = {
        "bounds": np.abs(found.displacement - exact) > found.error_bound,
        "slopes": np.abs(found.derivative - slope) > found.derivative_bound,
        "inexact": proven[:, None] & ~(found.error_bound <= 1e-4 * size),
        "lines": proven[:, None] & ~(np.abs(lines - exact) <= RESOLVE * size),
        "unsaid": (~proven & resolved)[:, None] & ~(np.abs(lines - exact) <= RESOLVE * size),
    }
    for n in np.flatnonzero(faults["bounds"].any(axis=1)):
        faults["bounds"][n] = surely(sample, omega[n], found.displacement[n], found.error_bound[n])
    values = {
        "bounds": found.displacement,
        "slopes": found.derivative,
        "inexact": found.displacement,
    }
    for name, wrong in faults.items():
        for n, d in np.argwhere(wrong)[:3]:
            value = values.get(name, lines)[n, d]
            true = (slope if name == "slopes" else exact)[n, d]
            print(
                f"{name}: seed {seed}, omega {omega[n]:.17g}, detector {d}: {value:.10g}, truly "
                f"{complex(true):.10g}, bounds {found.error_bound[n, d]:.1e} and "
                f"{found.derivative_bound[n, d]:.1e}, line_error {response.line_error[end[n], d]:.1e}"
            )
    counts = [int(np.count_nonzero(wrong)) for wrong in faults.values()]
    shape = "x".join(map(str, sample.shape))
    how = f"{seed:4d} {shape:>9} {sample.law:>9} {sample.lattice.damping:8.1e}"
    what = (
        response.factorizations,
        len(response.omega),
        np.count_nonzero(~proven),
        len(omega),
        narrow,
    )
    return how, (*what, *counts)


def main():
    """Print a line a sample and what they sum up to; exit with 1 if anything was false."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--samples", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=1e9)
    given, total, started = parser.parse_args(), 0, time.perf_counter()
    print(" ".join(COLUMNS[:3]), " ".join(f"{name:>8}" for name in (*COLUMNS[3:], *FAULTS)))
    for seed in range(given.first, given.first + given.samples):
        how, numbers = examine(seed)
        print(how, " ".join(f"{n:8d}" for n in numbers), flush=True)
        total = total + np.array(numbers)
        if time.perf_counter() - started > given.seconds:
            break
    print(f"{seed + 1 - given.first} samples", " ".join(f"{n:8d}" for n in total))
    sys.exit(int(total[-5] + total[-4] + total[-2] > 0))


if __name__ == "__main__":
    main()
