"""What is proven of damped modes, against 50 digits: random springs and laws of damping.

`python tests/campaigns/damped.py FIRST LAST` tries these seeds: prints what is BROKEN and what was
seen. tests/test_certain.py has closed forms.
"""

import sys
from collections import Counter

import numpy as np
from mpmath import mp
from scipy.sparse import csr_matrix

from pgran.experiments.modes import certain


def random_springs(rng):
    """K, C and m: a law of damping, drag, loss, springs that rotate, parts that float."""
    n, mass = int(rng.integers(1, 7)), 10 ** rng.uniform(-1, 1)
    rows = np.eye(n)[rng.integers(0, n, 3 * n)] - np.eye(n)[rng.integers(0, n, 3 * n)]
    rows[:n] += rng.choice([0, 1], p=[0.1, 0.9]) * np.eye(n) * rng.choice([-1, 1, 0.3], n)
    k = rng.uniform(0.01, 1, 3 * n) if rng.random() < 0.7 else np.ones(3 * n)
    k[-1] *= rng.choice([1, -0.1])  # pre-stress
    d = 10 ** rng.uniform(-3.5, 0) * np.abs(k) ** rng.uniform(-0.5, 2) * (rng.random(3 * n) < 0.8)
    drag, loss = (rng.choice([0, 10 ** rng.uniform(-3, -1)]) for _ in range(2))
    K = (rows.T * (k + (1j * loss * np.abs(k) if loss else 0))) @ rows
    return K, (rows.T * d) @ rows + mass * drag * np.eye(n), mass


def linearised(K, C, m):
    """The matrix whose eigenvalues are the modes, upper halves of whose eigenvectors are shapes."""
    n = len(K)
    return np.block([[np.zeros((n, n)), np.eye(n)], [-K / m, -C / m]])


def exact_modes(K, C, m):
    """All s in 50 digits, of the matrices as they are stored."""
    with mp.workdps(50):
        n = len(K)
        A, lower = mp.zeros(2 * n), (-mp.matrix(K) / m, -mp.matrix(C) / m)
        A[:n, n:], A[n:, :n], A[n:, n:] = mp.eye(n), *lower
        return mp.eig(A, left=False, right=False)


def faults(seed, seen):
    """Yield what is false of a case."""
    rng = np.random.default_rng(seed)
    K, C, m = random_springs(rng)
    s, vectors = np.linalg.eig(linearised(K, C, m))
    X, exact = vectors[: len(K)], exact_modes(K, C, m)
    with mp.workdps(50):
        distance = np.array([[float(abs(z - mp.mpc(a))) for z in exact] for a in s])
    stored = csr_matrix(K), csr_matrix(C), m
    disc, radius = certain.discs(*stored, s, X), certain.radii(*stored, s, X)
    seen["modes"] += len(s)
    for name, radii in ("disc", disc), ("radius", radius):
        ok = np.isfinite(radii)
        seen[f"{name} proven"] += np.count_nonzero(ok)
        worst = np.max(distance.min(axis=1)[ok] / radii[ok], initial=0)
        seen[f"{name} worst"] = max(seen[f"{name} worst"], worst)
        if name == "radius" and worst > 1:
            yield f"BROKEN case {seed}: a mode {worst} radii away"
    apart = np.abs(s[:, None] - s) <= disc[:, None] + disc
    union = np.linalg.matrix_power(apart.astype(float), len(s)) > 0  # discs that hang together
    for together in union[np.isfinite(disc)]:
        inside = np.any(distance[together] <= disc[together][:, None], axis=0).sum()
        if inside != together.sum():
            yield f"BROKEN case {seed}: {inside} modes in {together.sum()} discs"
    centre = rng.choice(s) * (1 + 0.1 * rng.standard_normal())
    far = np.abs(np.array([complex(z) for z in exact]) - centre)
    ends = np.sort([0, *far, 3 * far.max()])  # the circle lies in the middle of some gap
    gap = np.argmax(np.diff(ends) * rng.random(len(far) + 1))
    circle, R = (centre, ends[gap : gap + 2].mean()), np.abs(s).max() * rng.uniform(0.1, 1.5)
    below = sum(abs(z) < R for z in exact)
    for name, number, right in (
        ("below", certain.number_below(*stored, R), below),
        ("counted", certain.number_within(*stored, *circle), gap),
        ("within", certain.number_within(*stored, *circle, True), gap),
    ):
        seen[f"{name} decided"] += number is not None
        if number not in (None, right):
            yield f"BROKEN case {seed}: {name} {number} modes, and not {right}"


def main(first, last):
    """Try the seeds; return the number of faults."""
    seen, broken = Counter(), 0
    for seed in range(first, last):
        for fault in faults(seed, seen):
            print(fault, flush=True)
            broken += 1
    print(f"{last - first} cases:", ", ".join(f"{n:.3g} {what}" for what, n in seen.items()))
    return broken


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])) > 0)
