"""Random networks of all kinds, against elimination with 50 digits and dense eigenvalues.

    python tests/campaigns/networks.py FIRST LAST

prints what it finds. tests/test_network.py has the short version.
"""

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

from pgran.parallel.crew import Crew
from pgran.scenes.modes import find_modes
from pgran.solve.certify import smallest_damping
from pgran.solve.database import holding

DIGITS = 50


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


def carry_out(random_case, faults, first, last):
    """Print what is false of random cases, each made from its seed, and what was seen."""
    logging.disable()
    seen = Counter()
    for seed in range(first, last):
        try:
            for fault in faults(random_case(seed), seen):
                print(fault, flush=True)
        except Exception as error:
            print(f"RAISED case {seed}: {type(error).__name__}: {error}", flush=True)
    print(f"cases {first} to {last}:", ", ".join(f"{n} {name}" for name, n in seen.items()))


if __name__ == "__main__":
    carry_out(random_network, faults, *map(int, sys.argv[1:]))
