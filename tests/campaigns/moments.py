"""Bounds of values from recurrences, against 60 digits: random small media, s and numbers of terms.

    python tests/campaigns/moments.py FIRST LAST

tries these seeds, prints what is BROKEN, and how far bounds are above errors. Besides the values of
both series it tries what their proofs take for granted: the enclosure of the spectrum, the ellipse
about the range of G, and the norms of polynomials of G. tests/test_moments.py has closed forms.
"""

import contextlib
import dataclasses
import logging
import sys
from collections import Counter, defaultdict
from pathlib import Path

import numpy as np
from mpi4py import MPI
from mpmath import mp
from scipy.sparse import csr_matrix

sys.path.insert(0, str(Path(__file__).parents[1]))  # before this script's folder

from law_samples import with_laws
from network_samples import NetworkReference, as_network, eliminated, exactly, random_network
from samples import bond_arrays

import pgran
from pgran.driven.moment_sweep import series_of
from pgran.driven.moments import Chebyshev
from pgran.driven.recurrence import NoSeriesError, Rows
from pgran.errors import InputError
from pgran.medium.lattice import Lattice

SHAPES = (1,), (3,), (14,), (4, 3), (1, 6), (2, 2, 3)
LAWS = "none", "proportional", "alike", "drag", "random"
ANGLES, DEGREES = 24, 60
DENSE = 1e-9  # relative: how exact dense eigenvalues are here


def random_medium(rng):
    """A lattice or a network of any kind, whose constants, masses and damping spread over decades.

    Its damping is none, a function of K, dashpots that are all alike, drag, or follows random laws.
    """
    law, seed = str(rng.choice(LAWS)), int(rng.integers(2**31))
    if rng.random() < 0.4:
        decades, missing = rng.choice([0.1, 1, 5, 12]), rng.choice([0.0, 0.3])
        bonds = bond_arrays(
            SHAPES[rng.integers(len(SHAPES))],
            lambda size: 10 ** -rng.uniform(0, decades, size) * (rng.random(size) >= missing),
        )
        medium = Lattice(bonds, 10 ** rng.uniform(-2, 2), 0.0, kmax=1.0)
    else:
        medium = dataclasses.replace(random_network(seed, balls=7).network, damping=0.0)
        if rng.random() < 0.1:
            masses = medium.masses.copy()
            masses[rng.integers(len(masses))] *= 1e-14
            medium = dataclasses.replace(medium, masses=masses, median_mass=None)
    unit = np.sqrt(medium.stiffest * medium.mass)
    rate = unit / medium.mass
    if law == "proportional":
        powers = {"damping_power": 1.0, "damping": unit * 10 ** rng.uniform(-4, 0)}
        more = {"loss": 10 ** rng.uniform(-4, -0.5), "drag": rate * 10 ** rng.uniform(-4, 0)}
        chosen = {name: value for name, value in more.items() if rng.random() < 0.5}
        if not medium.is_grid and rng.random() < 0.3:  # nearly in proportion
            bent = 10 ** rng.uniform(-16, -3) * rng.random(len(medium.bond))
            chosen["dashpot"] = 1 + bent
        return dataclasses.replace(medium, **powers | chosen)
    if law == "drag":
        few = () if medium.is_grid else len(medium.held)
        drag = rate * 10 ** rng.uniform(-4, 0) * rng.integers(0 if few else 1, 2, few)
        return dataclasses.replace(medium, drag=drag if few else float(drag))
    if law in ("alike", "random"):
        medium = dataclasses.replace(medium, damping=unit * 10 ** rng.uniform(-4, -0.3))
    if law == "random" and medium.is_grid:
        laws = {"damping_power": rng.choice([0, 0.5, 2.0]), "drag": 10 ** rng.uniform(-4, -1)}
        medium = dataclasses.replace(medium, **laws)
    elif law == "random":
        medium = with_laws(medium, seed)
        if rng.random() < 0.7:  # which no recurrence has beside other dashpots
            medium = dataclasses.replace(medium, loss=None)
    return medium


def faults(seed, seen, tightness):
    """Yield what is false of a case."""
    rng = np.random.default_rng([47, seed])
    try:
        medium, _ = random_medium(rng).in_own_unit()
    except InputError as refused:  # a law without any stiffness
        seen[str(refused)] += 1
        return
    size = medium.size
    reference = NetworkReference(as_network(medium) if medium.is_grid else medium)
    patterns = rng.standard_normal((3, size))
    patterns[rng.random(3) < 0.5] = np.eye(size)[rng.integers(size)]
    top = np.sqrt(np.abs(reference.eigenvalues()).max() / medium.mass)
    sigma = 0.0 if rng.random() < 0.4 else 10 ** rng.uniform(-3, -0.3)
    omega = 10 ** rng.uniform(-1, rng.choice([0.3, 6.0], p=[0.9, 0.1]))
    if sigma and rng.random() < 0.1:
        omega = 0.0
    s = complex(top * sigma, top * omega)
    with contextlib.ExitStack() as held:
        try:
            rows = held.enter_context(Rows(medium, MPI.COMM_SELF))
            series = series_of(rows, medium, np.array([s]))
        except NoSeriesError as refused:
            seen[str(refused)] += 1
            return
        if not series.rates[0] > 0:
            seen["without convergence"] += 1
            return
        for said in claims(medium, reference, series, rng):
            yield f"BROKEN case {seed}: {said}"
        if not sigma:
            yield from walls(seed, medium, reference, s, seen, tightness)
        with mp.workdps(60):
            x = eliminated(reference.weighted(reference.system(s)), exactly(patterns[0]))
            if x is None:
                seen["singular"] += 1
                return
            exact = exactly(patterns) @ x
        own = np.array([rows.layout.free_values(each.reshape(medium.shape)) for each in patterns])
        name = "stiffness" if isinstance(series, Chebyshev) else "dashpots"
        name += "" if sigma else ", sigma 0"
        for part, digits in ("tail", rng.uniform(1, 12)), ("rounding", rng.uniform(20, 30)):
            terms = digits * np.log(10) / series.rates[0]
            if terms > 6000:
                seen["long"] += 1
                continue
            count = 2 * max(1, int(terms / 2))
            series.at(s, count)
            judged, receivers = [], csr_matrix(own)
            sizes = np.linalg.norm(patterns, axis=1) * (1 + 1e-12)
            series.read_by(size, MPI.COMM_SELF)
            for way, *heard in ("squared", None, None), ("read", receivers.__matmul__, sizes):
                terms = series.terms(*series.read(own[0], heard[0], count), heard[1])
                found = zip(*series.values(terms), exact, strict=False)
                judged += [(way, *each) for each in found]
            for way, value, bound, right in judged:
                error = float(abs(mp.mpmathify(complex(value)) - right))
                seen["bounds"] += 1
                if not error <= bound:
                    yield f"BROKEN case {seed}, {name}, {way}, {part}: {error:.3g} > {bound:.3g}"
                tightness[f"{name}, {way}, {part}"].append(bound / max(error, 1e-300))


def walls(seed, medium, reference, s, seen, tightness):
    """Yield what is false of a sweep by moments, whose drive is the medium's own."""
    balls = medium.free[:2] if not medium.is_grid else [(0,) * medium.axes]
    numbers, asked = [0] if medium.is_grid else balls, 1e-3 if seed % 2 else 1e-11
    try:
        found = pgran.sweep(medium, [s.imag], balls, method="moments", error_tolerance=asked)
    except InputError as refused:
        seen[str(refused)[:60]] += 1
        return
    if not found.moments:
        return
    with mp.workdps(60):
        exact = reference.amplitudes(s, numbers)
        step = mp.mpf(10) ** -20 * abs(s)
        ends = [reference.amplitudes(mp.mpc(0, s.imag + h), numbers) for h in (-step, step)]
        slopes = [(after - before) / (2 * step) for before, after in zip(*ends, strict=True)]
    for name, values, bounds, right in (
        ("wall", found.displacement[0], found.error_bound[0], exact),
        ("wall, slope", found.derivative[0], found.derivative_bound[0], slopes),
    ):
        for value, bound, each in zip(values, bounds, right, strict=True):
            error = float(abs(mp.mpmathify(complex(value)) - each))
            seen["bounds"] += 1
            if not error <= bound:
                yield f"BROKEN case {seed}, {name}: {error:.3g} > {bound:.3g}"
            tightness[name].append(bound / max(error, 1e-300))


def claims(medium, reference, series, rng):
    """Yield what the proofs assume, and what is false of it."""
    mass = medium.mass
    eigenvalues, vectors = np.linalg.eigh(reference.weighted(reference.K).astype(float))
    if isinstance(series, Chebyshev):
        inside = (series.a * eigenvalues - series.b) / 2
        if np.abs(inside).max() > 1 + DENSE * (series.a * np.abs(eigenvalues).max() + 1):
            yield f"{np.abs(inside).max()} is outside the spectrum"
        return
    C = reference.weighted(medium.damping * reference.C.astype(float)).astype(float) / mass
    C += np.diag(reference.drag.astype(float))
    root = vectors * np.sqrt(np.maximum(eigenvalues, 0) / mass) @ vectors.T
    G = np.block([[0 * root, root], [-root, -C]])
    ellipse, one = series.ellipse, np.eye(len(G))
    for angle in rng.uniform(0, 2 * np.pi, ANGLES):
        turned = np.exp(-1j * angle) * G
        reach = np.linalg.eigvalsh((turned + turned.conj().T) / 2)[-1]
        axes = np.hypot(ellipse.a * np.cos(angle), ellipse.b * np.sin(angle))
        if reach - ellipse.centre * np.cos(angle) > axes + DENSE * ellipse.b:
            yield f"the range leaves the ellipse at {angle}"
    X = (G - ellipse.centre * one) / (1j * ellipse.kappa)
    ways = (one, X), (one, 2 * X)  # polynomials of the first and second kind
    for kind, (before, now) in enumerate(ways):
        for n in range(1, DEGREES):
            most = ellipse.rho0**n * (n + 1 if kind else 1)
            if np.linalg.norm(now, 2) > most * (1 + DENSE):
                yield f"a polynomial of degree {n}, kind {kind + 1}, is too large"
            before, now = now, 2 * X @ now - before


def main(first, last):
    """Try the seeds; return the number of faults."""
    logging.disable(logging.WARNING)
    seen, broken, tightness = Counter(), 0, defaultdict(list)
    for seed in range(first, last):
        for fault in faults(seed, seen, tightness):
            print(fault, flush=True)
            broken += 1
    print(f"{last - first} cases:", ", ".join(f"{n} {what}" for what, n in seen.items()))
    for name, ratios in sorted(tightness.items()):
        print(f"{name}: {len(ratios)}, least {min(ratios):.3g}, median {np.median(ratios):.3g}")
    return broken


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])) > 0)
