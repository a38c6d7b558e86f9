"""What is proven of damped modes, against 50 digits: random springs and laws of damping.

`python tests/campaigns/damped.py FIRST LAST` tries these seeds, prints what is BROKEN and what was
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
    n, mass = int(rng.integers(1, 11)), 10 ** rng.uniform(-1, 1)
    rows = np.eye(n)[rng.integers(0, n, 3 * n)] - np.eye(n)[rng.integers(0, n, 3 * n)]
    rows[:n] += rng.choice([0, 1], p=[0.1, 0.9]) * np.eye(n) * rng.choice([-1, 1, 0.3], n)
    k = rng.uniform(0.01, 1, 3 * n) if rng.random() < 0.7 else np.ones(3 * n)
    k[-1] *= rng.choice([1, -0.1])  # pre-stress
    d = 10 ** rng.uniform(-3.5, 0) * np.abs(k) ** rng.uniform(-0.5, 2) * (rng.random(3 * n) < 0.8)
    drag, loss = (rng.choice([0, 10 ** rng.uniform(-3, -1)]) for _ in range(2))
    K = (rows.T * (k + (1j * loss * np.abs(k) if loss else 0))) @ rows
    return K, (rows.T * d) @ rows + mass * drag * np.eye(n), mass


def faults(seed, seen):
    """Yield what is false of a case."""
    rng = np.random.default_rng(seed)
    K, C, m = random_springs(rng)
    n = len(K)
    s, vectors = np.linalg.eig(np.block([[0 * C, np.eye(n)], [-K / m, -C / m]]))
    with mp.workdps(50):
        A = mp.zeros(2 * n)
        A[:n, n:], A[n:, :n], A[n:, n:] = mp.eye(n), -mp.matrix(K) / m, -mp.matrix(C) / m
        exact = mp.eig(A, left=False, right=False)
        distance = np.array([[float(abs(z - mp.mpc(near))) for z in exact] for near in s])
    stored = csr_matrix(K), csr_matrix(C), m
    disc, radius = (proof(*stored, s, vectors[:n]) for proof in (certain.discs, certain.radii))
    seen["modes"] += len(s)
    for name, radii in ("disc", disc), ("radius", radius):
        proven = np.isfinite(radii)
        parts = distance.min(axis=1)[proven] / radii[proven]
        seen[f"in a {name}"] += len(parts)
        seen[f"{name}: worst"] = max(seen[f"{name}: worst"], *parts, 0)
    if np.any(parts > 1):
        yield f"BROKEN case {seed}: a mode is {max(parts):.3g} radii away"
    meet = np.abs(s[:, None] - s) <= disc[:, None] + disc
    for discs in np.linalg.matrix_power(meet.astype(float), len(s))[np.isfinite(disc)] > 0:
        inside = np.any(distance[discs] <= disc[discs][:, None], axis=0).sum()
        if inside != discs.sum():
            yield f"BROKEN case {seed}: {inside} modes in {discs.sum()} discs that meet"
    centre = rng.choice(s) * (1 + 0.1 * rng.standard_normal())
    far = np.abs(np.array([complex(z) for z in exact]) - centre)
    ends = np.sort([0, *far, 3 * far.max()])  # the circle lies in the middle of a gap
    gap = np.argmax(np.diff(ends) * rng.random(len(far) + 1))
    circle, below = (centre, ends[gap : gap + 2].mean()), np.abs(s).max() * rng.random(5) * 1.5
    for name, number, right in (
        *(
            ("below", certain.number_below(*stored, R), sum(abs(z) < R for z in exact))
            for R in below
        ),
        ("counted", certain.number_within(*stored, *circle), gap),
        ("within", certain.number_within(*stored, *circle, True), gap),
    ):
        seen[f"{name}: told"] += number is not None
        if number not in (None, right):
            yield f"BROKEN case {seed}: {name} {number} modes, and not {right}"


def main(first, last):
    """Try the seeds; return the number of faults."""
    seen, broken = Counter(), 0
    for seed in range(first, last):
        for fault in faults(seed, seen):
            print(fault, flush=True)
            broken += 1
    print(f"{last - first} cases:", ", ".join(f"{n:.4g} {what}" for what, n in seen.items()))
    return broken


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])) > 0)
