"""Signals by the inverse Laplace transform, and what bounds its error.

On the line s = sigma + i omega the displacement of a ball is A(s) U(s), U(s) the transform of the
wall's motion. Taken at omega_k = 2 pi k / P only, the inverse transform

    e^(sigma t) (1 / P) sum over all k of A(s_k) U(s_k) e^(i omega_k t) = sum over n of
    u(t + n P) e^(-sigma n P)

has the later turns in it, damped; what is wrong with A grows by e^(sigma t). Every part of the
error is bounded:

- each amplitude's own bound, times |U| e^(sigma t);
- frequencies left out: |A| <= |S^-1| |f|, and U is known;
- later turns: with E the energy, dE/dt <= |u'| |f|, and so |u'|_2 <= (1/m) int |f|, never more;
  earlier ones, and frequencies above the pulse's highest, are below 1e-16 of what the wall does.
"""

import math
from functools import partial

import numpy as np

from pgran.driven.amplitudes import Limits
from pgran.driven.drive import FrequencySweep
from pgran.medium.base import EPSILON

SIGMA_TIME = 16.0  # sigma times the time wanted
SHORTEST_PERIOD = 1.2  # the period, in units of the time wanted
LEFT_OUT_SHARE = 1e-9  # of the tolerance: what frequencies left out may add up to
LATER_SHARE = 1e-4  # of the tolerance: what later turns may
NUMBERS_AT_ONCE = 300_000  # numbers of a Fourier transform that are kept at once
LARGEST_COST = 4e8  # at which amplitudes of all balls are kept, for energies at all times


class PulseLine(FrequencySweep):
    """The amplitudes at the detectors of a Recording along the line, and its Signals."""

    key = "pulse_time"

    def __init__(self, recording):
        self.recording, lattice = recording, recording.lattice
        tolerance = recording.tolerance
        self.line = line_of(recording)
        cost = len(self.line.s) * math.prod(lattice.shape) * len(recording.fine)
        self.keeps_energies = cost <= LARGEST_COST
        self.whole = recording.fields or self.keeps_energies
        row = [
            ("displacement", complex, (len(recording.sites),)),
            ("error_bound", float, (len(recording.sites),)),
            ("force", complex),
            ("force_error", float),
            ("reaction", complex),
            ("reaction_bound", float),
        ]
        if self.whole:
            row.append(("field", complex, lattice.shape))
        # below the floor an amplitude matters no more
        relative = 1e-2 * tolerance / max(self.line.growth, 1.0)
        steady = {"error_tolerance": relative, "error_floor": 1e-20, "derivatives": True}
        omegas = self.line.s.imag
        super().__init__(lattice, omegas, recording.sites, row, steady, self.line.sigma)

    def keep(self, point, solver):
        """See `FrequencySweep`: f^T A, and the field, which comes to the first rank of a group."""
        operators, moved = solver.operators, solver.field
        reaction = operators.f.tDot(moved)
        missed = abs(reaction - point["reaction"]) + point["reaction_bound"]
        if self.scaled.push is None:
            point["force"] = self.scaled.pull(operators.s) - reaction
            point["force_error"] = missed + self.scaled.pull_rounding(abs(operators.s))
        else:  # the velocity of what is pushed
            point["force"], point["force_error"] = operators.s * reaction, abs(operators.s) * missed
        if self.whole:
            field = operators.layout.field(moved)
            point["field"] = 0.0 if field is None else field

    def collect(self, rows, seconds):
        """See `Task`; what failed has an infinite bound."""
        line, recording = self.line, self.recording
        bound = np.where(np.isnan(rows["error_bound"]), np.inf, rows["error_bound"])
        found, at_times = line.signals(np.nan_to_num(rows["displacement"]), bound), {}
        force, error = np.nan_to_num(rows["force"]), rows["force_error"]
        found |= work_of(recording, line, force, np.where(np.isnan(error), np.inf, error))
        if self.whole:
            field = np.nan_to_num(rows["field"])
            field = line.transform.reshape(-1, *[1] * (field.ndim - 1)) * field
            energy, power = self._energies(field)
            dissipated, rough = recording.integral(power)
            work, error = found["work"]
            # all three are computed apart from each other
            error = error + rough + np.maximum.accumulate(np.abs(work - energy - dissipated))
            found |= {"energy": (energy, error), "dissipated": (dissipated, error)}
            if recording.fields:
                moved = np.concatenate([*line.at(recording.field_time, field)])
                moved = recording.scaled.displacements(moved)
                at_times = {"field_time": recording.field_time, "field": moved}
        return recording.record(
            "laplace",
            found,
            sigma=float(line.sigma),
            period=float(line.period),
            solves=len(rows),
            factorizations=int(rows["factorizations"].sum()),
            solve_seconds=seconds,
            **at_times,
        )

    def _energies(self, field):
        """Return the energy of springs and balls at the times, and the dashpots' power at `fine`.

        Both are sums of squares: m v^2 / 2, k (b^T u)^2 / 2, beta (b^T v)^2, and what drag takes.
        """
        lattice, line, time, fine = self.scaled, self.line, self.recording.time, self.recording.fine
        s, flat = line.s[:, None], field.reshape(len(line.s), -1)

        def squares(transforms, weights, time):
            return np.concatenate([part**2 @ weights for part in line.at(time, transforms)])

        energy = squares(s * flat, np.full(flat.shape[1], 0.5 * lattice.mass), time)
        power = np.zeros_like(fine)
        for longer, k, damped in lattice.stretched(field, line.transform):
            energy += squares(longer, 0.5 * k, time)
            if lattice.damping:
                power += squares(s * longer, lattice.damping * damped, fine)
        if lattice.drags is not None:
            power += squares(s * flat, lattice.mass * lattice.drags, fine)
        return energy, power


def work_of(recording, line, force, error, more=0.0):
    """Return force and work of the wall, each with an estimate of its error.

    From the force on the line and its error, `more` of which there is at the times. Of a push its
    velocity is in the place of the force; see `Recording.taken`.
    """
    more = np.interp(recording.fine, recording.time, more + 0 * recording.time)
    error = (
        line.summed(error + EPSILON * np.abs(force)) * np.exp(line.sigma * recording.fine) + more
    )
    force = line.inverse(force * line.transform, recording.finer, recording.before)
    work, rough = recording.integral(force * recording.taken)
    with np.errstate(invalid="ignore"):  # a wall at rest does no work, whatever its force is
        power = np.nan_to_num(error * np.abs(recording.taken), posinf=np.inf)
    added = np.cumsum(power) * (recording.time[1] / recording.finer)
    return {
        "force": (recording.coarse(force), recording.coarse(error)),
        "work": (work, rough + recording.coarse(added)),
    }


def line_of(recording):
    """Return the line on which a recording's amplitudes are solved for."""
    limits, sent, time = limits_of(recording.scaled), recording.sent, recording.time[-1]
    readings = recording.scaled.reading_norms(recording.sites)
    tolerance = recording.tolerance * recording.scaled.drive_size
    speed, largest = partial(largest_speed, limits, sent), partial(largest_amplitudes, limits)
    # P so long that u(t + P) e^(-sigma P) is small, |u(t)| being t |u'| at most,
    least = LATER_SHARE * tolerance / readings.max(initial=1.0)
    later = 3 * time * float(speed(3 * time)) / least
    # and that the pulse before this one's time 0 is no part of the turn before either
    earlier = max(SHORTEST_PERIOD, 1.0 - sent.begin / time)
    turn = max(earlier, min(3.0, math.log(max(later, 1.0)) / SIGMA_TIME))
    line = SIGMA_TIME, turn, largest, speed
    return Line(sent, recording.time, *line, tolerance, readings)


class Line:
    """Where on the line amplitudes are computed: `s` and `transform`, U(s), of shape (ns,).

    Signals are wanted at equal times from 0 to T, to a `tolerance` in units of the wall's motion.
    sigma T is `damped`, the period at least `turn` T; |A(s)| is at most `largest(s)`, a velocity
    |u'|_2 at most `speed(t)` up to any t. `readings` are |e_d| of each detector, 1 unless its mass
    is not the unit. An error of every A(s) is `growth` times larger in a displacement, at most;
    what frequencies left out add up to, without e^(sigma t), is `left_out`, and `left_out_speed` in
    a velocity.
    """

    def __init__(self, pulse, time, damped, turn, largest, speed, tolerance, readings):
        self.pulse, self.time, self.speed, end = pulse, time, speed, float(time[-1])
        self.sigma = damped / end
        self.readings = np.asarray(readings)
        step = end / (len(time) - 1)
        self.times = math.ceil(turn * end / step)  # in a period
        self.period = self.times * step
        count = math.ceil(pulse.highest * self.period / (2 * math.pi)) + 1
        s = self.sigma + 2j * np.pi / self.period * np.arange(count)
        U = pulse.transform(s)
        # the smallest terms of the sum over k are left out, as long as they add up to little
        size = 2 / self.period * largest(s) * np.abs(U)
        order = np.argsort(size, kind="stable")
        least = LEFT_OUT_SHARE * tolerance / self.readings.max(initial=1.0)
        small = np.cumsum(size[order]) * math.exp(damped) <= least
        small[-1] = False  # something is left even where the wall drives nothing
        out, self.number = order[small], np.sort(order[~small])
        self.s, self.transform = s[self.number], U[self.number]
        self.left_out, self.left_out_speed = size[out].sum(), (size * np.abs(s))[out].sum()
        # k and -k, which is its conjugate, are one term
        self._weight = np.where(self.number == 0, 1.0, 2.0) / self.period
        self.growth = math.exp(damped) * np.sum(self._weight * np.abs(self.transform))

    def inverse(self, transforms, finer=1, before=0):
        """Return functions, from transforms (ns, ...) on the line, at the times of the signals.

        Each step is cut into `finer`, and `before` finer steps before the time 0 come first.
        """
        from scipy.fft import irfft  # here: SciPy takes its time, and all scenes are imported

        times, count = finer * self.times, finer * (len(self.time) - 1) + 1
        fold = -(-2 * (self.number[-1] + 1) // times)  # so fine a grid holds all frequencies
        n = fold * times
        spectrum = np.zeros((n // 2 + 1, *transforms.shape[1:]), dtype=complex)
        spectrum[self.number] = transforms
        # The transform repeats itself after a period: its end is what was before 0.
        #   turn   [ 0 ........ T ........ | -before ... -1 ]
        turn = irfft(spectrum, n, axis=0)
        values = np.concatenate([turn[n - fold * before :: fold], turn[: fold * count : fold]])
        time = np.linspace(0.0, self.time[-1], count)
        time = np.append(-self.period / times * np.arange(before, 0, -1), time)
        growth = np.exp(self.sigma * time) * (n / self.period)
        return values * growth.reshape(-1, *[1] * (values.ndim - 1))

    def at(self, time, transforms):
        """Yield functions at any times, (n, ...), some times after the other.

        `inverse` is quicker for many.
        """
        for some in np.array_split(time, 1 + len(time) * len(self.s) // NUMBERS_AT_ONCE):
            turning = self.turning(some)
            real, imaginary = (np.ascontiguousarray(x) for x in (turning.real, turning.imag))
            moved = np.tensordot(real, transforms.real, 1)
            yield moved - np.tensordot(imaginary, transforms.imag, 1)

    def turning(self, time):
        """Return what each transform counts at times, (n, ns): the function is the real part."""
        return self._weight * np.exp(np.outer(time, self.s))

    def signals(self, amplitude, bound):
        """Return displacement and velocity by name, each with a bound of its error, (nt, nd).

        From A(s) of each detector and the bound of its error, shape (ns, nd).
        """
        growth, U = np.exp(self.sigma * self.time)[:, None], self.transform[:, None]
        size = np.abs(self.s)
        steps = len(self.s) + 16 + 6 * math.log2(self.times + len(self.s)) + size * self.period
        rounding = 4 * EPSILON * steps * np.abs(self.transform)
        rounding += self.pulse.rounding(self.s, self.transform)
        parts = {
            "displacement": (np.ones_like(self.s), self.left_out, self._later(1)),
            "velocity": (self.s, self.left_out_speed, self._later(0)),
        }
        found = {}
        for name, (power, left_out, later) in parts.items():
            weight = (self._weight * np.abs(power))[:, None]
            error = weight * (np.abs(U) * bound + rounding[:, None] * np.abs(amplitude))
            at_start = error.sum(axis=0) + left_out * self.readings
            bounds = 1.01 * growth * at_start + later[:, None] * self.readings
            found[name] = self.inverse(power[:, None] * amplitude * U), bounds
        return found

    def summed(self, errors):
        """Return what errors (ns,) of a function, but for U, add up to without e^(sigma t)."""
        return np.sum(self._weight * np.abs(self.transform) * errors)

    def _later(self, power):
        """Bound what later turns add: |u'| <= V and |u| <= t V at the times t + n P, n >= 1."""
        total = np.zeros_like(self.time)
        for n in range(1, 4):
            t, damped = self.time + n * self.period, math.exp(-n * self.sigma * self.period)
            total += 1.1 * self.speed(t) * t**power * damped
        return total


def largest_amplitudes(limits, s):
    """Return no less than any |A(s)|, sigma > 0."""
    size = np.abs(s)
    damped = size * (limits.stability + s.real * limits.mass)
    inertial = limits.mass * size**2 - limits.stiffness - size * limits.damping
    return 1.01 * (limits.drive + size * limits.drive_damping) / np.maximum(damped, inertial)


def largest_speed(limits, pulse, t):
    """Return no less than |u'|_2 up to some times."""
    moved, turned = pulse.sizes(t)
    return (limits.drive * moved + limits.drive_damping * turned) / limits.mass


def limits_of(lattice):
    """Return what bounds the motion of a lattice."""
    from pgran.driven.counting import smallest_damping

    (drive, damped), unit = lattice.drive_norms, lattice.damping_unit
    return Limits(
        mass=lattice.mass,
        stability=unit and unit * smallest_damping(lattice),
        stiffness=lattice.stiffness_norm,
        damping=unit * lattice.damping_norm,
        drive=1.01 * drive,
        drive_damping=1.01 * lattice.damping * damped,
    )
