"""What is proven of damped modes, against 50 digits: random springs and laws of damping.

And which SLEPc finds near a target, in eight systems of units, against a dense linearisation of the
naive reference. `python tests/campaigns/damped.py FIRST LAST` tries these seeds, prints what is
BROKEN and what was seen. tests/test_certain.py has closed forms.
"""

import dataclasses
import logging
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import scipy.linalg
from mpmath import mp
from scipy.sparse import csr_matrix

sys.path.insert(0, str(Path(__file__).parents[1]))  # before this script's folder

from law_samples import with_laws
from network_samples import NetworkReference, as_network

import pgran
from pgran.experiments.modes import certain
from pgran.medium import crystals

# powers of ten of the units of stiffness, mass and length
UNITS = [
    (0, 0, 0), (0, -12, 0), (7, -6, -3), (6, -15, -4), (-9, 9, 0), (0, 20, 0), (20, -30, 3),
    (-20, -10, -5),
]  # fmt: skip


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


def random_medium(rng):
    """A lattice, a packing or a random network, with any laws of damping."""
    seed, beta = int(rng.integers(2**31)), 10 ** rng.uniform(-3.5, 0.3)
    kind = rng.choice(["lattice", "packing", "geometric"])
    if kind == "lattice":
        shape = [(60,), (9, 8), (4, 4, 4)][rng.integers(3)]
        law = rng.choice(["uniform", "constant"])
        medium = pgran.Lattice.random(shape, law=law, seed=seed, damping=beta)
        laws = {
            "damping_power": rng.choice([0.0, 0.5, 1.0]),
            "drag": rng.choice([0.0, 10 ** rng.uniform(-3, 0)]),
            "loss": rng.choice([0.0, 10 ** rng.uniform(-3, -1)], p=[0.7, 0.3]),
        }
        return dataclasses.replace(medium, **laws)
    if kind == "packing":
        law = str(rng.choice(["harmonic", "hertz"]))
        size, pressure = int(rng.integers(30, 50)), 10 ** rng.uniform(-3, -1)
        medium = pgran.pack(size, law=law, pressure=pressure, walls="x", seed=seed)
    else:
        medium = crystals.random_geometric(
            60, 2, 6.0, masses=10 ** rng.uniform(-0.5, 0.5, 60), direction=[3.0, 4.0],
            stiffness=lambda u: 0.5 + u / 2, seed=seed,
        )  # fmt: skip
    beta *= np.sqrt(medium.stiffest * medium.mass)
    medium = dataclasses.replace(medium, damping=beta)
    return with_laws(medium, seed) if rng.random() < 0.5 else medium


def in_units(medium, k, m, x):
    """The same medium where the units of stiffness, mass and length are so much smaller."""
    time = np.sqrt(m / k)
    factors = {
        "stiffness": k, "mass": m, "masses": m, "median_mass": m, "kmax": k, "tangential": k,
        "damping": k * time, "damping_reference": k, "drag": 1 / time, "force": k * x,
        "position": x, "distance": x, "radius": x, "box": x,
    }  # fmt: skip
    values = {}
    for item in dataclasses.fields(medium):
        value, factor = getattr(medium, item.name), factors.get(item.name)
        if factor is not None and value is not None:
            tupled = isinstance(value, tuple)
            values[item.name] = tuple(v * factor for v in value) if tupled else value * factor
    return dataclasses.replace(medium, **values)


def search_faults(seed, seen):
    """Yield which modes that SLEPc finds near a target are none, and which are missing unmarked."""
    rng = np.random.default_rng([23, seed])
    medium, count = random_medium(rng), int(rng.integers(2, 8))
    exact = NetworkReference(as_network(medium) if medium.is_grid else medium)
    weight = 1 / np.sqrt(exact.M.astype(float))
    K, C, L = (weight[:, None] * A.astype(float) * weight for A in (exact.K, exact.C, exact.L))
    C = medium.damping * C + np.diag(exact.drag.astype(float))
    if L.any():
        K = K + 1j * L
    A = np.block([[0 * C, np.eye(len(K))], [-K, -C]])
    true, rows, columns = scipy.linalg.eig(A, left=True)
    angle, mx = np.abs(np.sum(rows.conj() * columns, axis=0)), medium.omega_mx
    wrong = 1e-9 * mx + 1e-13 * np.linalg.norm(A) / np.maximum(angle, 1e-300)
    target = rng.choice([0.0, rng.uniform(0, 1.2)]) * mx
    for powers in UNITS:
        k, m, x = (10.0**power for power in powers)
        case = f"BROKEN search {seed}, units 1e{powers}"
        seen["searches"] += 1
        try:
            modes = pgran.find_modes(
                in_units(medium, k, m, x), damped=True, method="eps", certificate="counted",
                targets=[target * np.sqrt(k / m)], count=count,
            )  # fmt: skip
        except pgran.PgranError:
            seen["refused"] += 1
            continue
        seen["marked"] += modes.failures > 0
        found, left = modes.eigenvalue / np.sqrt(k / m), np.arange(len(true))
        apart = []
        for s in found:  # each true one is found once
            far = np.abs(true[left] - s) / wrong[left]
            apart.append(far.min())
            left = np.delete(left, far.argmin())
        seen["search: worst"] = max(seen["search: worst"], *apart)
        if max(apart) > 1 and not modes.failures:
            yield f"{case}: {sum(np.array(apart) > 1)} of {len(found)} are no modes"
        reach = np.abs(found - 1j * target).max()
        above = true[left].imag > (wrong[left] if L.any() else -wrong[left])
        missing = above & (np.abs(true[left] - 1j * target) < reach - wrong[left])
        if (missing.any() or len(found) != count) and not modes.failures:
            yield f"{case}: {missing.sum()} missing of {count}, {len(found)} found"


def main(first, last):
    """Try the seeds; return the number of faults."""
    logging.disable(logging.WARNING)
    seen, broken = Counter(), 0
    for seed in range(first, last):
        for fault in (*faults(seed, seen), *search_faults(seed, seen)):
            print(fault, flush=True)
            broken += 1
    print(f"{last - first} cases:", ", ".join(f"{n:.4g} {what}" for what, n in seen.items()))
    return broken


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])) > 0)
