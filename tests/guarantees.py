"""What is guaranteed of numbers, by name: random cases from seeds, and what is false of them.

`GUARANTEES` has, for each kind of numbers, what makes a case from a seed, and what solves it and
yields its faults: bounds below errors, numbers that are wrong and pass, what ranks or neighbours
change. It counts what was seen. tests/test_guarantees.py tries some cases of each,
tests/campaigns/guarantees.py as many as are asked for. References are those of tests/reference.py
and its likes.
"""

import dataclasses
import math
from collections.abc import Callable

import mpmath
import numpy as np
from mpi4py import MPI
from mpmath import mp
from network_samples import (
    NetworkReference,
    exact_network_force,
    exactly,
    random_network,
    small_network,
    unstable_network,
)
from reference import exact_amplitudes
from samples import (
    SOLVERS,
    Naive,
    listened,
    long_relaxation,
    option_values,
    random_case,
    random_curve,
    random_points,
    random_pulse,
    random_relaxation,
    reference_of,
    relaxed,
    steady,
    swept,
)
from sensitivity_samples import Exact, missed, random_sensitivity

from pgran.driven.certify import smallest_damping
from pgran.errors import InputError
from pgran.experiments.modes.density import count_modes
from pgran.experiments.modes.scene import find_modes
from pgran.experiments.pulse.wall import Pulse
from pgran.experiments.response.record import Curve
from pgran.experiments.sensitivity.heat import heat
from pgran.experiments.sensitivity.scene import sensitivity
from pgran.medium.lattice import Lattice
from pgran.run.crew import Crew
from pgran.run.petsc import holding

ROUNDING = 1e-13  # of |K|: how well dense eigenvalues are known


# Amplitudes


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
        seen["below 1e-100"] += bool(abs(x) < 1e-100)
        if good and error > 1e-13 * abs(x) > 0:
            seen["errors beyond rounding"] += 1
            seen["bounds within 100 of these"] += bool(bound <= 100 * error)


def response_of(case, omegas):
    """What a case's solver finds, on this rank alone; every frequency is a unit of its own."""
    asked = {"error_tolerance": case.tolerance, "error_floor": case.floor}
    with holding(option_values(SOLVERS[case.solver])):
        return swept(case.lattice, omegas, case.sites, **asked)


def sweep_faults(case, seen, eliminate=exact_amplitudes, stride=1):
    """Compare every so many frequencies of a lattice's sweep with elimination in many digits."""
    lattice = case.lattice
    try:
        found = response_of(case, case.omegas)
    except InputError:  # numbers too far apart for doubles
        seen["refused"] += 1
        return
    seen["undamped"] += lattice.damping == 0
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
            seen[f"{network.displacement} good"] += good
        if network.damping:
            least = smallest_damping(operators.lattice)
            seen["damped"] += 1
            seen["damping certified"] += least > 0
            seen["damping missed"] += least == 0 and reference.damping_exceeds(1e-9)
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
    lattice, places = (
        case.lattice,
        np.ravel_multi_index(np.transpose(case.sites), case.lattice.shape),
    )
    response = swept(lattice, case.omegas, case.sites, comm, **case.choices)
    reference, (low, *_, high) = reference_of(lattice), response.omega
    displacement, step = response.displacement, np.diff(response.omega)[:, None]
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
    seen["solved"] += response.factorizations
    seen["across narrow modes"] += len(across)
    seen["accurate"] += int(accurate.all(axis=1).sum())
    seen["accurate derivatives"] += int(steep.all(axis=1).sum())
    unproven = response.modelled[1:] == 0
    seen["unproven lines called straight"] += int(np.sum(unproven & ~response.unresolved))


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
    seen["steps that miss their accuracy"] += run.failures


def pulse_faults(case, seen, comm=MPI.COMM_SELF):
    """Compare displacements and velocities, by both methods, with DOP853 on dense matrices."""
    place = tuple(case.sites[0])
    found, stepped = (
        listened(case.lattice, case.sites, comm, method=method, **case.choices)
        for method in ("laplace", "integrate")
    )
    naive = Naive(case.lattice, Pulse(case.choices["shape"], 0.6, 8.0), found.time)
    for name, right, bound, estimate in (
        ("displacement", naive.u, "error_bound", "error_estimate"),
        ("velocity", naive.v, "velocity_bound", "velocity_estimate"),
    ):
        right, bound = right[:, *place], getattr(found, bound)[:, 0]
        error = np.abs(getattr(found, name)[:, 0] - right)
        estimated = np.abs(getattr(stepped, name)[:, 0] - right)
        seen["numbers"] += len(error)
        seen["bounded"] += int(np.isfinite(bound).sum())
        if not np.all(error <= bound + 1e-9):
            yield f"BROKEN case {case.seed} {case.choices}: {name} by {np.max(error - bound):.1e}"
        if not estimated.max() <= getattr(stepped, estimate).max() + 1e-9:
            yield f"WRONG case {case.seed} {case.choices}: {name}, estimated, {estimated.max():.1e}"
    if found.failures or stepped.failures or stepped.error_bound is not None:
        yield f"FAILED case {case.seed} {case.choices}"
    if not found.error_bound.max() <= 1e-4 * np.abs(naive.u[:, *place]).max():
        yield f"WRONG case {case.seed} {case.choices}: bound {found.error_bound.max():.1e}"


# Derivatives and finite changes


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
    k = abs(exactly(exact.network.stiffness))
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


# Modes


def mode_faults(case, seen):
    """Modes that are missing or elsewhere, without being said to be."""
    with mp.workdps(50):
        eigenvalues = NetworkReference(case.network).eigenvalues()
    norm = np.abs(eigenvalues).max()
    with Crew(MPI.COMM_SELF, 1) as crew:
        modes = find_modes(case.network, crew)
    unstable = bool(np.any(eigenvalues < -1e-9 * norm))
    seen["networks"] += 1
    seen["unstable"] += unstable
    seen["certified"] += modes.count_certified
    if modes.count_certified and len(modes.omega) != len(eigenvalues):
        yield f"MODES case {case.seed}: {len(modes.omega)} of {len(eigenvalues)}, {unstable=}"
    elif modes.count_certified:
        found = case.network.mass * np.sign(modes.omega) * modes.omega**2
        if not np.allclose(found, eigenvalues, rtol=0, atol=1e-11 * norm):
            yield f"MODES case {case.seed}: elsewhere by {np.abs(found - eigenvalues).max():.1e}"
    else:
        yield f"NOT CERTIFIED case {case.seed}: {len(modes.omega)} of {modes.count_expected}"


def count_faults(case, seen):
    """Yield certified counts of modes that are wrong; count what was `seen`.

    At 0, at random, and on and next to modes; at every other network not at 0.
    """
    network, rng = case.network, np.random.default_rng([19, case.seed])
    with mp.workdps(50):
        eigenvalues = NetworkReference(network).eigenvalues()
    norm = np.abs(eigenvalues).max()
    top, rounding = np.sqrt(norm / network.mass), ROUNDING * norm
    if eigenvalues[0] > -10 * rounding:
        return
    near = np.sqrt(np.abs(rng.choice(eigenvalues, 2)) / network.mass)
    near *= 1 + rng.choice([0, 1e-12, -1e-9, 1e-6], 2)
    omegas = np.concatenate([top * 10 ** rng.uniform(-6, 0.1, 3), near])
    omegas = np.unique(np.append(omegas, 0.0))[case.seed % 2 :]
    with Crew(MPI.COMM_SELF, 1) as crew:
        found = count_modes(network, omegas, crew)
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


# All of them


@dataclasses.dataclass(frozen=True)
class Guarantee:
    """A case from a seed, the faults of a case, and what the tests try of it.

    They try `few` seeds, of cases `changed`; `most` tells of what was seen which is at least which
    part of which. `shared` are the seeds of cases that all ranks solve together.
    """

    case: Callable
    faults: Callable
    few: int
    most: tuple = ()
    changed: dict = dataclasses.field(default_factory=dict)
    shared: range = range(0)


def good(part, of="amplitudes"):
    """Return that so large a part is good."""
    return (("good", part, of),)


GUARANTEES = {
    "sweeps": Guarantee(random_case, sweep_faults, 60, good(0.6)),
    "frequencies alone": Guarantee(random_case, dependence_faults, 20, good(0.5, "frequencies")),
    "networks": Guarantee(random_network, network_faults, 24, good(0.5), shared=range(100, 106)),
    "forces": Guarantee(small_network, force_faults, 30, (("bounded", 0.5, "forces"),)),
    "curves": Guarantee(random_curve, curve_faults, 1, (("accurate", 1, "points"),), {"count": 9}),
    "points": Guarantee(random_points, curve_faults, 1, (), {"count": 9}),
    "relaxations": Guarantee(random_relaxation, relaxation_faults, 12, good(0.9)),
    "long relaxations": Guarantee(
        long_relaxation, relaxation_faults, 18, good(1), {"steps": 8, "count": 1}
    ),
    "pulses": Guarantee(random_pulse, pulse_faults, 8, (("bounded", 1, "numbers"),)),
    "derivatives": Guarantee(
        random_sensitivity, sensitivity_faults, 8,
        (*good(0.5, "points"), ("warmed bounded", 0.5, "warmed"), ("cut bounded", 0.5, "cut")),
    ),
    "modes": Guarantee(random_network, mode_faults, 24, (("certified", 1, "networks"),)),
    "counts": Guarantee(unstable_network, count_faults, 15, (("certified", 1, "counts"),)),
}  # fmt: skip


def carry_out(name, seeds, seen, changed=None):
    """Yield what is false of the cases of some seeds, errors among it; count what was `seen`."""
    guarantee = GUARANTEES[name]
    for seed in seeds:
        try:
            case = dataclasses.replace(guarantee.case(seed), **changed or {})
            yield from guarantee.faults(case, seen)
        except Exception as error:
            yield f"RAISED case {seed}: {type(error).__name__}: {error}"
