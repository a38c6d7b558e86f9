"""Signals by amplitudes along the line of the inverse Laplace transform."""

import math

import numpy as np

from pgran.driven.accurate import Limits
from pgran.driven.sweep import FrequencySweep
from pgran.experiments.pulse import signal
from pgran.experiments.pulse.laplace import Line
from pgran.medium.rounding import EPSILON

WHOLE = 4e8  # amplitudes of all balls are kept, for energies at all times, if that costs no more


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
        limits = limits_of(listening.scaled)
        readings = listening.scaled.reading_norms(listening.sites)
        self.line = Line(listening.sent, time[-1], len(time), limits, tolerance, readings)
        self.fields = listening.fields
        shape, detectors = listening.lattice.shape, len(listening.sites)
        cost = len(self.line.s) * math.prod(shape) * len(listening.fine)
        self.whole = self.fields or cost <= WHOLE
        kept = [
            ("displacement", complex, (detectors,)),
            ("error_bound", float, (detectors,)),
            ("force", complex),
            ("force_error", float),
            ("reaction", complex),
            ("reaction_bound", float),
        ]
        if self.whole:
            kept.append(("field", complex, shape))
        # below the floor an amplitude matters no more
        relative = 1e-2 * tolerance / max(self.line.growth, 1.0)
        choices = {"error_tolerance": relative, "error_floor": 1e-20, "derivatives": True}
        omegas = self.line.s.imag
        super().__init__(listening.lattice, omegas, listening.sites, kept, choices, self.line.sigma)

    def keep(self, point, solver):
        """See `FrequencySweep`: f^T A, and the field, which comes to the first rank of a group."""
        operators, moved = solver.operators, solver.field
        reaction = operators.f.tDot(moved)
        point["force"] = self.scaled.pull(operators.s) - reaction
        missed = abs(reaction - point["reaction"]) + point["reaction_bound"]
        point["force_error"] = missed + self.scaled.pull_rounding(abs(operators.s))
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
        taken, field = self._work(rows["force"], rows["force_error"]), None
        if self.whole:
            field = np.nan_to_num(rows["field"])
            times = listening.time, listening.fine
            energy, power = signal.energies(listening.scaled, line, field, *times)
            dissipated, rough = listening.integral(power)
            work, wrong = taken["work"]
            # all three are computed apart from each other
            wrong = wrong + rough + np.maximum.accumulate(np.abs(work - energy - dissipated))
            taken |= {"energy": (energy, wrong), "dissipated": (dissipated, wrong)}
        if self.fields:
            field = listening.scaled.displacements(line.at(listening.field_time, U * field))
        return listening.signals(
            "laplace",
            (displacement, velocity),
            (error_bound, velocity_bound),
            taken,
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

    def _work(self, force, error):
        """Return force and work of the wall, each with an estimate of its error. Not collective."""
        line, listening = self.line, self.listening
        force, error = np.nan_to_num(force), np.where(np.isnan(error), np.inf, error)
        wrong = line.summed(error + EPSILON * np.abs(force)) * np.exp(line.sigma * listening.fine)
        force = line.inverse(force * line.transform, listening.finer, listening.before)
        work, rough = listening.integral(force * listening.speed)
        with np.errstate(invalid="ignore"):  # a wall at rest does no work, whatever its force is
            power = np.nan_to_num(wrong * np.abs(listening.speed), posinf=np.inf)
        added = np.cumsum(power) * (listening.time[1] / listening.finer)
        return {
            "force": (listening.coarse(force), listening.coarse(wrong)),
            "work": (work, rough + listening.coarse(added)),
        }


def limits_of(lattice):
    """Return what bounds the motion of a lattice. Not collective."""
    from pgran.driven.certify import smallest_damping

    (drive, damped), beta = lattice.drive_norms, lattice.damping
    return Limits(
        mass=lattice.mass,
        stability=beta and beta * smallest_damping(lattice),
        stiffness=lattice.stiffness_norm,
        damping=beta * lattice.damping_norm,
        drive=1.01 * drive,
        drive_damping=1.01 * beta * damped,
    )
