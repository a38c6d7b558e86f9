"""What is false of amplitudes, forces, curves, relaxations and pulses of random cases.

References are those of tests/reference.py and its likes.
"""

import math

import mpmath
import numpy as np
from mpi4py import MPI
from mpmath import mp
from network_samples import NetworkReference, exact_network_force
from reference import exact_amplitudes
from samples import SOLVERS, Naive, listened, option_values, reference_of, relaxed, steady, swept
from sensitivity_samples import missed

from pgran.driven.counting import smallest_damping
from pgran.errors import InputError
from pgran.experiments.pulse.wall import Pulse
from pgran.experiments.response.record import Curve
from pgran.run.petsc import holding


def amplitude_faults(what, values, exact, bounds, good, tolerance, floor, seen):
    """Yield bounds that are broken, and what passes though its error is more than was asked."""
    for value, x, bound in zip(values, exact, bounds, strict=True):
        error = abs(mpmath.mpmathify(complex(value)) - x) if mp.isfinite(x) else mp.inf
        said = (
            f"{what}: |A| {float(abs(x)):.1e}, error {float(error):.1e}, bound {bound:.1e}, "
            f"asked {tolerance:.0e}{', good' if good else ''}"
        )
        if math.isfinite(bound) and not error <= bound:
            yield f"BROKEN {said}"
        if good and not (mp.isfinite(x) and error <= max(tolerance * abs(x), floor)):
            yield f"WRONG {said}"
        seen["amplitudes"] += 1
        seen["bounded"] += math.isfinite(bound)
        seen["good"] += good
        if good and error > 1e-13 * abs(x) > 0:
            seen["errors beyond rounding"] += 1
            seen["bounds within 100 of these"] += bool(bound <= 100 * error)


def response_of(case, omegas, comm=MPI.COMM_SELF):
    """What a case's solver finds, ranks sharing the lattice; a frequency is a unit of its own."""
    asked = {"error_tolerance": case.tolerance, "error_floor": case.floor}
    with holding(option_values(SOLVERS[case.solver])):
        return swept(case.lattice, omegas, case.sites, comm, comm.size, **asked)


def sweep_faults(case, seen, comm=MPI.COMM_SELF, eliminate=exact_amplitudes, stride=1):
    """Compare every so many frequencies of a lattice's sweep with elimination in many digits."""
    lattice = case.lattice
    try:
        found = response_of(case, case.omegas, comm)
    except InputError:  # numbers too far apart for doubles
        seen["refused"] += 1
        return
    for n in range(0, len(case.omegas), stride):
        omega, good = case.omegas[n], bool(found.converged_reason[n] > 0)
        what = f"case {case.seed}, {lattice.shape}, {case.solver}, omega {omega:.17g}"
        with mp.workdps(case.digits):
            constants = lattice.stiffness, lattice.mass, lattice.damping
            exact = eliminate(*constants, omega, case.sites)
            numbers = found.displacement[n], exact, found.error_bound[n]
            yield from amplitude_faults(what, *numbers, good, case.tolerance, case.floor, seen)


def dependence_faults(case, seen):
    """Yield the frequencies that come out otherwise when solved alone, in whatever digit."""
    try:
        together = response_of(case, case.omegas)
    except InputError:
        seen["refused"] += 1
        return
    for n, omega in enumerate(case.omegas):
        alone = response_of(case, case.omegas[n : n + 1])
        good = together.converged_reason[n] > 0
        seen["frequencies"] += 1
        seen["good"] += bool(good)
        same = (alone.converged_reason[0] > 0) == good
        if good:
            same &= np.array_equal(alone.displacement[0], together.displacement[n])
            same &= np.array_equal(alone.error_bound[0], together.error_bound[n])
        if not same:
            yield f"case {case.seed}: omega {omega:.17g} differs alone"


def network_faults(case, seen, comm=MPI.COMM_SELF):
    """Also right of the imaginary axis: amplitudes, the norm of 1 / S, the least damping."""
    network = case.network
    with (
        mp.workdps(50),
        holding(option_values(SOLVERS[case.solver])),
        steady(network, case.sites, comm, case.tolerance) as (operators, solver),
    ):
        reference = NetworkReference(network)
        for s in case.points:
            state = solver.solve(s)
            what = f"case {case.seed}, {network.displacement}, {case.solver}, {s=}"
            singular = np.linalg.svd(reference.weighted(reference.system(s)).astype(complex))[1]
            stable = solver.bounds.stability(s)
            if not stable <= 1.0001 * singular[-1] + 1e-12 * singular[0]:
                yield f"UNSTABLE {what}: |S x| < {stable:.3g} |x|, {singular[-1]}"
            exact, good = reference.amplitudes(s, case.sites), state.converged_reason > 0
            numbers = state.displacement, exact, state.error_bound
            yield from amplitude_faults(what, *numbers, good, case.tolerance, 0.0, seen)
        if network.damping:
            least = smallest_damping(operators.lattice)
            seen["damped"] += 1
            seen["damping certified"] += least > 0
            if least > 0 and not reference.damping_exceeds(least):
                yield f"DAMPING case {case.seed}: an eigenvalue of C lies below {least:.3g}"


def force_faults(case, seen):
    """Yield forces on the driven balls whose errors exceed their bounds."""
    network, choices = case.network, {"derivatives": True}
    with (
        mp.workdps(60),
        steady(network, case.sites, tolerance=case.tolerance, **choices) as (_, solver),
    ):
        for s in case.points:
            state = solver.solve(s)
            seen["forces"] += 1
            if math.isfinite(state.reaction_bound):
                seen["bounded"] += 1
                pull, reaction = map(mpmath.mpmathify, (network.pull(s), state.reaction))
                bound = state.reaction_bound + network.pull_rounding(abs(s))
                error = abs(pull - reaction - exact_network_force(network, s))
                if not error <= bound:
                    yield f"BROKEN case {case.seed}, {s=}: {float(error):.1e} > {bound:.1e}"


def curve_faults(case, seen, comm=MPI.COMM_SELF):
    """Look between the frequencies that were computed: bounds, derivatives, straight lines.

    Frequencies at random, across every mode narrower than ten times their distance, and where lines
    come nearest to zero are refined in extended precision; a bound that then looks false is judged
    by elimination with 50 digits. Where lines are not proven, `line_error` must say what is wrong.
    """
    lattice = case.lattice
    places = np.ravel_multi_index(np.transpose(case.sites), lattice.shape)
    response = swept(lattice, case.omegas, case.sites, comm, **case.choices)
    reference, (low, *_, high) = reference_of(lattice), response.omega
    displacement, step = response.displacement, np.diff(response.omega)[:, None]
    with np.errstate(all="ignore"):  # two that are alike have no zero between them
        zero = (-displacement[:-1] / np.diff(displacement, axis=0)).real
    nearest = (response.omega[:-1, None] + zero * step)[(zero > 0) & (zero < 1)]
    omega = np.random.default_rng([30, case.seed]).uniform(low, high, case.count)
    across = reference.across_modes(low, high, 10 * (high - low) / case.count)
    omega = np.unique(np.concatenate([omega, across, nearest, response.omega[::40]]))
    omega = omega[comm.rank :: comm.size]
    parts = np.array_split(omega, -(-len(omega) // 100))
    fields = zip(*(reference.sweep(part) for part in parts), strict=True)
    exact, slope = (np.concatenate(field)[:, places] for field in fields)
    unknown = np.full((2, *exact.shape), [[[np.nan]], [[np.inf]]])
    found = Curve(omega, *unknown, *unknown) if response.models is None else response.at(omega)
    proven = np.isfinite(found.error_bound)
    lines = [np.interp(omega, response.omega, column) for column in displacement.T]
    end = np.maximum(np.searchsorted(response.omega, omega), 1)
    astray = ~(np.abs(np.transpose(lines) - exact) <= 1e-2 * np.abs(exact))
    broken = np.abs(found.displacement - exact) > found.error_bound
    constants = lattice.stiffness, lattice.mass, lattice.damping
    for n in np.flatnonzero(broken.any(axis=1)):
        with mp.workdps(50):
            right = exact_amplitudes(*constants, omega[n], case.sites)
            broken[n], _ = missed(found.displacement[n], right, found.error_bound[n])
    late = np.zeros_like(broken)
    if response.models is not None:
        here, at = np.isin(omega, response.omega), np.searchsorted(response.omega, omega)
        wrong = np.abs(response.delay[at[here]] + (slope / exact)[here].imag)
        late[here] = wrong > response.delay_bound[at[here]]
    for name, faults in (
        ("bound", broken),
        ("bound of the derivative", np.abs(found.derivative - slope) > found.derivative_bound),
        ("line", proven & astray),
        ("line_error", ~proven & astray & (response.line_error[end] <= 1e-2)),
        ("delay", late),
    ):
        for n, d in np.argwhere(faults)[:3]:
            values = (x[n, d] for x in (exact, *found[1:], response.line_error[end]))
            values = " ".join(map("{:.8g}".format, values))
            yield f"BROKEN {name}, case {case.seed}, {d}, omega {omega[n]:.17g}: {values}"
    accurate = found.error_bound <= 1.0001e-4 * np.abs(exact)
    steep = found.derivative_bound <= 1e-2 * np.abs(slope).max(axis=0)
    seen["points"] += omega.size
    seen["accurate"] += int(accurate.all(axis=1).sum())
    seen["accurate derivatives"] += int(steep.all(axis=1).sum())


def relaxation_faults(case, seen):
    """Compare some steps, the last among them, with elimination from the stored events."""
    run = relaxed(case.lattice, case.sites, steps=case.steps, **case.choices)
    stiffness, done = [k.copy() for k in case.lattice.stiffness], 0
    events = list(zip(run.bond_axis[0], run.bond_index[0], run.stiffness[0], strict=True))
    rng, steps = np.random.default_rng([31, case.seed]), len(events)
    for step in sorted({0, steps, *rng.integers(0, steps + 1, case.count).tolist()}):
        for axis, index, constant in events[done:step]:
            stiffness[axis][tuple(index)] = constant
        done, (values, bounds) = step, (run.displacement[0, step], run.error_bound[0, step])
        what = f"case {case.seed}, {case.lattice.shape}, {case.choices}, step {step}"
        with mp.workdps(50):
            constants = case.lattice.mass, case.lattice.damping, run.omega
            exact = exact_amplitudes(stiffness, *constants, case.sites)
            good = bool(np.isfinite(values).all())
            asked = case.choices.get("error_tolerance", 1e-4), 1e-20
            yield from amplitude_faults(what, values, exact, bounds, good, *asked, seen)


def pulse_faults(case, seen, comm=MPI.COMM_SELF):
    """Compare displacements and velocities, by both methods, with DOP853 on dense matrices."""
    place = tuple(case.sites[0])
    for method in ("laplace", "moments"):
        found = listened(case.lattice, case.sites, comm, method=method, **case.choices)
        naive = Naive(case.lattice, Pulse(case.choices["shape"], 0.6, 8.0), found.time)
        what = f"case {case.seed} {method} {case.choices}"
        for name, right, bound in (
            ("displacement", naive.u, found.error_bound),
            ("velocity", naive.v, found.velocity_bound),
        ):
            error = np.abs(getattr(found, name)[:, 0] - right[:, *place])
            seen["numbers"] += len(error)
            seen["bounded"] += int(np.isfinite(bound[:, 0]).sum())
            if not np.all(error <= bound[:, 0] + 1e-9):
                yield f"BROKEN {what}: {name} by {np.max(error - bound[:, 0]):.1e}"
        if found.failures and method == "laplace":
            yield f"FAILED {what}"
        if not found.error_bound.max() <= 1e-4 * np.abs(naive.u[:, *place]).max():
            yield f"WRONG {what}: bound {found.error_bound.max():.1e}"
