"""Random networks of all kinds, against elimination with 50 digits and dense eigenvalues.

    python tests/campaigns/networks.py FIRST LAST [counts]

prints what it finds; with `counts` of how many modes unstable networks have below frequencies.
tests/test_network.py and tests/test_campaigns.py have the short versions.
"""

import dataclasses
import logging
import sys
from collections import Counter
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))

import mpmath
import numpy as np
from mpi4py import MPI
from mpmath import mp
from network_samples import NetworkReference, random_network
from samples import SOLVERS, option_values, steady

from pgran.driven.certify import smallest_damping
from pgran.experiments.modes.density import count_modes
from pgran.experiments.modes.scene import find_modes
from pgran.run.crew import Crew
from pgran.run.petsc import holding

DIGITS = 50
ROUNDING = 1e-13  # of |K|: how well dense eigenvalues are known


def faults(case, seen, comm=MPI.COMM_SELF):
    """Yield what is false of what is said of a network; count what was `seen`."""
    with mp.workdps(DIGITS):
        reference = NetworkReference(case.network)
        with holding(option_values(SOLVERS[case.solver])):
            yield from driven_faults(case, reference, seen, comm)
        if comm.size == 1:
            yield from mode_faults(case, reference, seen)


def driven_faults(case, reference, seen, comm):
    """Bounds that are broken, errors that pass, damping that is less than certified."""
    with steady(case.network, case.sites, comm, case.tolerance) as (operators, solver):
        for s in case.points:
            state = solver.solve(s)
            exact = reference.amplitudes(s, case.sites)
            singular = np.linalg.svd(reference.weighted(reference.system(s)).astype(complex))[1]
            stable = solver.bounds.stability(s)
            if not stable <= 1.0001 * singular[-1] + 1e-12 * singular[0]:
                yield f"UNSTABLE case {case.seed}, {s=}: |S x| < {stable:.3g} |x|, {singular[-1]}"
            for found, x, bound in zip(state.displacement, exact, state.error_bound, strict=True):
                error = abs(mpmath.mpmathify(complex(found)) - x) if mp.isfinite(x) else mp.inf
                good = state.converged_reason > 0
                said = (
                    f"case {case.seed}, {case.network.displacement}, {case.solver}, "
                    f"{s=}: |A| "
                    f"{float(abs(x)):.1e}, error {float(error):.1e}, bound {bound:.1e}, asked "
                    f"{case.tolerance:.0e}{', good' if good else ''}"
                )
                if np.isfinite(bound) and not error <= bound:
                    yield f"BROKEN {said}"
                if good and not error <= case.tolerance * abs(x):
                    yield f"WRONG {said}"
                seen["amplitudes"] += 1
                seen[f"{case.network.displacement} amplitudes"] += 1
                seen[f"{case.network.displacement} good"] += good
                seen["good"] += good
                seen["bounded"] += bool(np.isfinite(bound))
        if case.network.damping:
            least = smallest_damping(operators.lattice)
            seen["damping certified"] += least > 0
            seen["damped"] += 1
            if least > 0 and not reference.damping_exceeds(least):
                yield f"DAMPING case {case.seed}: an eigenvalue of C lies below {least:.3g}"
            if least == 0 and reference.damping_exceeds(1e-9):
                seen["damping missed"] += 1


def mode_faults(case, reference, seen):
    """Modes that are missing or elsewhere, without being said to be."""
    eigenvalues = reference.eigenvalues()
    norm = np.abs(eigenvalues).max()
    with Crew(MPI.COMM_SELF, 1) as crew:
        modes = find_modes(case.network, crew)
    unstable = bool(np.any(eigenvalues < -1e-9 * norm))
    seen["networks"] += 1
    seen["unstable"] += unstable
    seen["modes certified"] += modes.count_certified
    if modes.count_certified and len(modes.omega) != len(eigenvalues):
        yield f"MODES case {case.seed}: {len(modes.omega)} of {len(eigenvalues)}, {unstable=}"
    elif modes.count_certified:
        found = case.network.mass * np.sign(modes.omega) * modes.omega**2
        if not np.allclose(found, eigenvalues, rtol=0, atol=1e-11 * norm):
            yield f"MODES case {case.seed}: elsewhere by {np.abs(found - eigenvalues).max():.1e}"
    else:
        yield f"NOT CERTIFIED case {case.seed}: {len(modes.omega)} of {modes.count_expected}"


def unstable_network(seed):
    """Return a random network with springs of negative constants, over twelve decades."""
    case, rng = random_network(seed), np.random.default_rng([18, seed])
    stiffness = np.abs(case.network.stiffness)
    weak = rng.integers(0, len(stiffness), rng.integers(1, 3))
    stiffness[weak] *= -(10 ** rng.uniform(-12, 0, len(weak)))
    network = dataclasses.replace(case.network, stiffness=stiffness, damping=0.0, kmax=None)
    return dataclasses.replace(case, network=network)


def count_faults(case, seen):
    """Yield certified counts of modes that are wrong; count what was `seen`.

    At 0, at random, and on and next to modes; at every other network not at 0.
    """
    network, rng = case.network, np.random.default_rng([19, case.seed])
    with mp.workdps(DIGITS):
        eigenvalues = NetworkReference(network).eigenvalues()
    norm = np.abs(eigenvalues).max()
    top, rounding = np.sqrt(norm / network.mass), ROUNDING * norm
    if eigenvalues[0] > -10 * rounding:
        return
    near = np.sqrt(np.abs(rng.choice(eigenvalues, 2)) / network.mass)
    near *= 1 + rng.choice([0, 1e-12, -1e-9, 1e-6], 2)
    omegas = np.concatenate([top * 10 ** rng.uniform(-6, 0.1, 3), near])
    omegas = np.unique(np.append(omegas, 0.0))[case.seed % 2 :]
    found = count_modes(network, omegas)
    limits = found.omega - found.margin
    limits *= network.mass * np.abs(limits)
    seen["networks"] += 1
    for omega, limit, count, sure in zip(omegas, limits, found.count, found.certified, strict=True):
        low, high = (np.count_nonzero(eigenvalues < limit + x) for x in (-rounding, rounding))
        seen["counts"] += 1
        seen["certified"] += sure
        seen["moved"] += bool(limit < network.mass * omega**2 - rounding)
        if sure and not low <= count <= high:
            yield f"WRONG case {case.seed}, {omega=:.6g}: {count} modes, not {low} to {high}"
    low, high = (np.count_nonzero(eigenvalues < x) for x in (-1e-5 * norm, rounding))
    if not low <= found.unstable <= high:
        yield f"UNSTABLE case {case.seed}: {found.unstable} modes, not {low} to {high}"


def carry_out(random_case, faults, first, last):
    """Print what is false of random cases, each made from its seed, and what was seen."""
    seen = Counter()
    logging.disable()
    for seed in range(first, last):
        try:
            for fault in faults(random_case(seed), seen):
                print(fault, flush=True)
        except Exception as error:
            print(f"RAISED case {seed}: {type(error).__name__}: {error}", flush=True)
    logging.disable(logging.NOTSET)
    print(f"cases {first} to {last}:", ", ".join(f"{n} {name}" for name, n in seen.items()))


if __name__ == "__main__":
    cases = (unstable_network, count_faults) if "counts" in sys.argv else (random_network, faults)
    carry_out(*cases, *map(int, sys.argv[1:3]))
