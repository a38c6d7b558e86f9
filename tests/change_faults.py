"""What is false of derivatives, warm balls and cut bonds of random cases."""

import numpy as np
from mpi4py import MPI
from mpmath import mp
from network_samples import exactly
from samples import SOLVERS, option_values
from sensitivity_samples import Exact, missed

from pgran import InputError, Lattice, heat, sensitivity
from pgran.run.crew import Crew
from pgran.run.petsc import holding


def sensitivity_faults(case, seen, comm=MPI.COMM_SELF):
    """Yield what is false of what is said of a case; count what was `seen`."""
    asked = {"error_tolerance": case.tolerance}
    given = case.medium, case.omegas, case.sites
    with holding(option_values(SOLVERS[case.solver])), Crew(comm, comm.size) as crew:
        try:
            found, hot = sensitivity(*given, crew, **asked), None
            hot = heat(*given, crew, cut=True, **case.by, **asked)
        except InputError as error:
            seen[f"refused: {str(error)[:60]}"] += 1
            if "needs a factorization" not in str(error):
                return
    if comm.rank:
        return
    with mp.workdps(60):
        exact = Exact(case.medium)
        numbers = case.sites
        if isinstance(case.medium, Lattice):
            numbers = np.ravel_multi_index(case.sites.T, case.medium.shape)
        numbers = np.ravel(numbers)
        for n, omega in enumerate(case.omegas):
            states = exact.states(1j * omega, numbers)
            for fault in derivative_faults(case, found, n, exact, states, seen):
                yield f"case {case.seed} {case.solver} omega {omega:.6g}: {fault}"
            for fault in heat_faults(case, hot, n, exact, states, numbers, seen) if hot else ():
                yield f"case {case.seed} {case.solver} omega {omega:.6g}: {fault}"


def derivative_faults(case, found, n, exact, states, seen):
    """Bounds that are broken, and what passes though it is less accurate than asked."""
    good = found.converged_reason[n] > 0
    seen["points"] += 1
    seen["good"] += good
    if states is None:
        seen["singular"] += 1
        if good:
            yield "GOOD where S is singular"
        return
    A, z, read = states
    right = exact.derivatives(1j * case.omegas[n], A, z)
    checks = [("displacement", found.displacement[n], read, found.error_bound[n])]
    for name, value in right.items():
        if (got := getattr(found, f"by_{name}", None)) is not None:
            checks.append((f"by_{name}", got[n], value, getattr(found, f"by_{name}_bound")[n]))
    k = exactly(exact.network.stiffness)
    for d, amplitude in enumerate(read):
        if amplitude:
            got = found.log_amplitude[n, d] + 1j * found.log_phase[n, d]
            logs = k * right["stiffness"][d] / amplitude
            checks.append(("logarithms", got, logs, found.log_bound[n, d]))
        elif np.isfinite(found.log_bound[n, d]).any():
            yield f"BROKEN log_bound {found.log_bound[n, d]} of no amplitude"
    for name, got, value, bound in checks:
        wrong, errors = missed(got, value, bound)
        seen[name] += got.size
        seen[f"{name} bounded"] += int(np.isfinite(bound).sum())
        if wrong.any():
            yield f"BROKEN {name} {errors[wrong]} > {bound[wrong]}"
        if not good or name == "logarithms":
            continue
        if not np.all(np.isfinite(got)):
            yield f"GOOD {name} not finite"
        for d, error in enumerate(errors if errors.ndim > 1 else []):
            largest = float(abs(value[d]).max())
            if not np.all(error <= case.tolerance * largest):
                yield f"WRONG {name} {error.max()} of {largest}, asked {case.tolerance}"


def heat_faults(case, hot, n, exact, states, numbers, seen):
    """Bounds that are broken, and what is finite where the frequency failed."""
    s, good = 1j * case.omegas[n], hot.converged_reason[n] > 0
    seen["good heat"] += good
    if not good:
        for name in ("warmed", "cut"):
            if np.any(np.isfinite(getattr(hot, f"{name}_bound")[n])):
                yield f"MARKED {name} has a bound"
        return
    rng = np.random.default_rng(case.seed)
    balls, contacts = np.flatnonzero(exact.network.held == 0), len(exact.ends)
    for name, count in (("warmed", len(balls)), ("cut", contacts)):
        after, bound = getattr(hot, name)[n], getattr(hot, f"{name}_bound")[n]
        for one in rng.choice(count, min(2, count), replace=False):
            if name == "warmed":
                right = exact.warmed(s, numbers, balls[one], **case.by)
            else:
                right = exact.cut(s, numbers, one)
            seen[name] += 1
            if right is None:
                seen[f"{name} singular"] += 1
                if np.isfinite(bound[:, one]).any():
                    yield f"BROKEN {name} {one}: a bound {bound[:, one]} where S is singular"
                continue
            wrong, errors = missed(after[:, one], right, bound[:, one])
            accurate = bound[:, one] <= 1e-6 * abs(right).astype(float)
            seen[f"{name} bounded"] += bool(np.isfinite(bound[:, one]).all())
            seen[f"{name} to 1e-6"] += bool(accurate.all())
            if wrong.any():
                yield f"BROKEN {name} {one} {case.by}: {errors} > {bound[:, one]}, {after[:, one]}"
