"""Signals in time: by amplitudes along the line of a Laplace transform, or by an integrator."""

import contextlib
import math
from functools import partial

import numpy as np

from pgran.machine import check_memory
from pgran.parallel.agreement import on_root
from pgran.parallel.task import Task, carry_out
from pgran.physics import signal
from pgran.physics.laplace import Limits, Line
from pgran.results import Signals
from pgran.scenes.sweeping import FrequencySweep

WHOLE = 4e8  # amplitudes of all balls are kept, for energies at all times, if that costs no more
FIELDS = 4  # times at which the field is kept
FINE = 0.6  # step times frequency of what is integrated by splines: to about 1e-9
COARSE, FINER = 0.3, 0.1  # tolerance of the first integration, and of each against the one before
LEAST = 1e-13  # tolerance of an integration


class Listening:
    """What is listened to: the lattice, its detectors, the pulse and the times.

    Parameters
    ----------
    lattice : pgran.physics.lattice.Lattice
    detectors : array_like of int
        Ball indices, flat or one row a detector.
    sent : pgran.physics.pulse.Pulse or pgran.physics.pulse.Samples
    time : float
        How long.
    points : int
        At so many equal times.
    tolerance : float
        Asked of displacements, relative to a signal's largest.
    fields : bool
        Whether the field at FIELDS times is wanted.
    """

    def __init__(self, lattice, detectors, sent, time, points, tolerance, fields):
        """Choose how finely powers are integrated."""
        self.lattice, self.sent, self.tolerance, self.fields = lattice, sent, tolerance, fields
        self.sites = lattice.sites(detectors)
        lattice.check_driven()
        self.scaled, self.unit = lattice.in_own_unit()
        self.limits = limits_of(self.scaled)
        self.highest = math.sqrt(self.limits.stiffness / self.scaled.mass)  # of normal modes
        step = time / (points - 1)
        self.finer = math.ceil(2 * step * sent.reach / FINE)
        check_memory("pulse_points", points * (48 * len(self.sites) + 64 * self.finer))
        self.time = np.linspace(0.0, time, points)
        self.fine = np.linspace(0.0, time, self.finer * (points - 1) + 1)
        self.field_time = np.linspace(sent.centre, time, FIELDS + 1)[1:]

    def signals(self, method, found, error, force, energy, power, **more):
        """Return the record.

        Not collective.

        Parameters
        ----------
        method : str
        found, error : tuple of numpy.ndarray, shape (nt, nd)
            Displacement and velocity, and what these may be wrong by.
        force : numpy.ndarray, shape (times of `fine`,)
            Of the wall, in the unit of `scaled`; so are energies.
        energy : numpy.ndarray, shape (nt,), or None
        power : numpy.ndarray, shape (times of `fine`,), or None
            What the dashpots take; without it that is what is left of the work.
        **more
            Other fields of `Signals`.
        """
        displacement, velocity = found
        envelope = signal.envelopes(displacement, velocity)
        moves = self.sent.moves(self.time)[0]
        work = signal.integral(self.fine, force * self.sent.moves(self.fine, 2)[1])[:: self.finer]
        dissipated = None if energy is None else work - energy
        if power is not None:
            dissipated = signal.integral(self.fine, power)[:: self.finer]
        decay, decay_error = signal.codas(self.time, envelope, error[0])
        return Signals(
            shape=self.sent.shape,
            pulse_omega=self.sent.omega,
            pulse_width=self.sent.width,
            method=method,
            tolerance=self.tolerance,
            wall_arrival=float(signal.arrivals(self.time, moves[:, None], 0 * moves[:, None])[0]),
            arrival=signal.arrivals(self.time, displacement, error[0]),
            centre=signal.centres(self.time, envelope),
            decay=decay,
            decay_error=decay_error,
            time=self.time,
            wall=moves,
            detector=self.sites,
            displacement=displacement,
            velocity=velocity,
            envelope=envelope,
            force=self.unit * force[:: self.finer],
            work=self.unit * work,
            energy=None if energy is None else self.unit * energy,
            dissipated=None if dissipated is None else self.unit * dissipated,
            **more,
        )


class PulseLine(FrequencySweep):
    """The amplitudes at the detectors along the line of the inverse Laplace transform.

    Parameters
    ----------
    listening : Listening
    """

    def __init__(self, listening):
        """Choose the points of the line."""
        self.listening = listening
        time, tolerance = listening.time, listening.tolerance
        self.line = Line(listening.sent, time[-1], len(time), listening.limits, tolerance)
        self.fields = listening.fields
        shape, detectors = listening.lattice.shape, len(listening.sites)
        cost = len(self.line.s) * math.prod(shape) * len(listening.fine)
        self.whole = self.fields or cost <= WHOLE
        kept = [
            ("displacement", complex, (detectors,)),
            ("error_bound", float, (detectors,)),
            ("force", complex),
        ]
        if self.whole:
            kept.append(("field", complex, shape))
        # below the floor an amplitude matters no more
        relative = 1e-2 * tolerance / max(self.line.growth, 1.0)
        choices = {"error_tolerance": relative, "error_floor": 1e-20}
        omegas = self.line.s.imag
        super().__init__(listening.lattice, omegas, listening.sites, kept, choices, self.line.sigma)

    def keep(self, point, solver):
        """See `FrequencySweep`: f^T A, and the field, which comes to the first rank of a group."""
        operators, moved = solver.operators, solver.field
        point["force"] = operators.pull(operators.s) - operators.f.tDot(moved)
        if self.whole:
            field = operators.layout.field(moved)
            point["field"] = 0.0 if field is None else field

    def collect(self, rows, seconds):
        """See `Task`; what failed has an infinite bound."""
        line, listening = self.line, self.listening
        bound = np.where(np.isnan(rows["error_bound"]), np.inf, rows["error_bound"])
        found = line.signals(np.nan_to_num(rows["displacement"]), bound)
        displacement, error_bound, velocity, velocity_bound = found
        U = line.transform.reshape(-1, *[1] * len(listening.lattice.shape))
        energy = power = field = None
        if self.whole:
            field = np.nan_to_num(rows["field"])
            times = listening.time, listening.fine
            energy, power = signal.energies(listening.scaled, line, field, *times)
        if self.fields:
            field = listening.scaled.displacements(line.at(listening.field_time, U * field))
        return listening.signals(
            "laplace",
            (displacement, velocity),
            (error_bound, velocity_bound),
            line.inverse(np.nan_to_num(rows["force"]) * line.transform, listening.finer),
            energy,
            power,
            sigma=line.sigma,
            period=line.period,
            solves=len(rows),
            factorizations=int(rows["factorizations"].sum()),
            solve_seconds=seconds,
            error_bound=error_bound,
            velocity_bound=velocity_bound,
            field_time=listening.field_time if self.fields else None,
            field=field if self.fields else None,
        )


class Integration(Task):
    """The signals by PETSc's integrators, at each of some tolerances.

    Parameters
    ----------
    listening : Listening
    tolerances : sequence of (int, float)
        How many coarser integrations there are, and the tolerance.
    """

    items = "times"

    def __init__(self, listening, tolerances):
        """Plan an integration at each tolerance."""
        self.listening = listening
        end = float(listening.time[-1])
        self.units = [(number, tolerance, None, end) for number, tolerance in tolerances]
        times, fine, detectors = len(listening.time), len(listening.fine), len(listening.sites)
        kept = [
            ("displacement", float, (times, detectors)),
            ("velocity", float, (times, detectors)),
            ("force", float, (fine,)),
            ("energy", float, (times,)),
            ("steps", np.int64),
            ("complete", bool),
        ]
        if listening.fields:
            kept.append(("field_time", float, (FIELDS,)))
            kept.append(("field", float, (FIELDS, *listening.lattice.shape)))
        self.row = np.dtype(kept)

    @contextlib.contextmanager
    def open(self, group):
        """See `Task`."""
        from pgran.solve.integrate import Integrator
        from pgran.solve.operators import Operators

        listening = self.listening
        keep_at = listening.field_time if listening.fields else ()
        with (
            Operators(listening.scaled, group) as operators,
            Integrator(operators, listening.sites, listening.sent, listening.highest) as integrator,
        ):

            def work(unit):
                number, tolerance, begin, end = unit
                return self.read(integrator.run(end, tolerance, number, keep_at, begin))

            yield work

    def read(self, history):
        """Return a row: the history at the times that are wanted. Not collective."""
        row, listening = np.zeros(1, self.row), self.listening
        row["steps"], row["complete"] = len(history.time) - 1, history.complete
        if history.complete:

            def at(values, slopes, time=listening.time):
                return signal.interpolated(history.time, values, slopes, time)

            row["displacement"] = at(history.displacement, history.velocity)
            row["velocity"] = at(history.velocity, history.acceleration)
            row["force"] = at(*history.force.T, listening.fine)
            row["energy"] = at(*history.energy.T)
            for number, (time, field) in enumerate(history.fields):
                row["field_time"][0, number] = time
                if field is not None:
                    row["field"][0, number] = listening.scaled.displacements(field.real)
        return row

    def length(self, unit):
        """See `Task`: times."""
        *_, begin, end = unit
        time = self.listening.time
        return np.count_nonzero((time >= (begin or 0.0)) & (time <= end))

    def blank(self, unit):
        """See `Task`."""
        return np.zeros(1, self.row)

    def sample(self, unit):
        """See `Task`: a little after the middle of the pulse, where steps are short."""
        number, tolerance, _, end = unit
        begin = self.listening.sent.centre
        part = max(0.02 * (end - begin), 2 * self.listening.time[1])
        return number, tolerance, begin, begin + part

    def collect(self, rows, seconds):
        """Return the rows, and what they took."""
        return rows, seconds


def integrate(listening, crew, progress):
    """Return the signals by integrations at ever smaller tolerances, until two of them agree.

    Collective. The record comes to rank 0, None to the others. The error of the last one is
    estimated, too large by about a power of ten, by its difference from the one before.

    Parameters
    ----------
    listening : Listening
    crew : pgran.parallel.crew.Crew
    progress : str
        Style of `pgran.parallel.progress.Progress`.
    """
    tolerance = COARSE * listening.tolerance
    tolerances, rows, seconds = [(0, tolerance), (1, FINER * tolerance)], [], 0.0
    while tolerances:
        found = carry_out(Integration(listening, tolerances), crew, progress)
        if found:
            rows, seconds = [*rows, *found[0]][-2:], seconds + found[1]
        smaller = partial(next_tolerance, listening, rows, tolerances[-1])
        tolerances = on_root(crew.world, smaller)
    if crew.world.rank > 0:
        return None
    before, last = rows
    errors = [
        np.maximum.accumulate(np.abs(last[name] - before[name]), axis=0)
        if before["complete"] and last["complete"]
        else np.full_like(last[name], np.inf)
        for name in ("displacement", "velocity")
    ]
    return listening.signals(
        "integrate",
        (last["displacement"], last["velocity"]),
        errors,
        last["force"],
        last["energy"],
        None,
        sigma=0.0,
        period=0.0,
        solves=int(last["steps"]),
        factorizations=0,
        solve_seconds=seconds,
        error_estimate=errors[0],
        velocity_estimate=errors[1],
        field_time=last["field_time"] if listening.fields else None,
        field=last["field"] if listening.fields else None,
    )


def next_tolerance(listening, rows, last):
    """Return at which tolerances to integrate once more, none if that is no use.

    Not collective.

    Parameters
    ----------
    listening : Listening
    rows : list of numpy.void
        What the last two integrations found.
    last : (int, float)
        Number and tolerance of the last one.
    """
    (number, tolerance), (before, last) = last, rows
    largest = np.abs(last["displacement"]).max(axis=0)
    wrong = np.abs(last["displacement"] - before["displacement"]).max(axis=0)
    allowed = listening.tolerance * largest
    if not (before["complete"] and last["complete"]) or np.all(wrong <= allowed):
        return []
    # what is left is the error of `last`: may it serve as the coarser one of the next pair?
    missing = np.min(allowed[wrong > allowed] / (FINER * wrong[wrong > allowed]))
    smaller = tolerance * (FINER if missing > 1 else np.clip(0.5 * missing, 1e-6, FINER))
    return [(number + 1, smaller)] if smaller >= LEAST else []


def limits_of(lattice):
    """Return what bounds the motion of a lattice. Not collective."""
    from pgran.solve.certify import smallest_damping

    (drive, damped), beta = lattice.drive_norms, lattice.damping
    return Limits(
        mass=lattice.mass,
        stability=beta and beta * smallest_damping(lattice),
        stiffness=lattice.largest_eigenvalue,
        damping=beta * lattice.damping_norm,
        drive=1.01 * drive,
        drive_damping=1.01 * beta * damped,
    )
