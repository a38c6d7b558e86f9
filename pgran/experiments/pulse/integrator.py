"""The driven lattice in time, by PETSc's integrators (TS, option prefix `pulse_`).

    m u'' + beta C u' + K u = U f_k + U' beta f_c,      U the wall's motion.

By default an explicit Runge-Kutta method works on y = (u, u'), interleaved ball by ball:
y' = J y + drive, a product with one sparse matrix each stage. Of a ball p, and q next to it, J has

    columns          2 p    2 p + 1     2 q    2 q + 1
    row 2 p           0        1         0        0         u_p' is the velocity
    row 2 p + 1    -K_pp/m  -C_pp/m   -K_pq/m  -C_pq/m      with C times beta

`alpha2` takes the equation of second order as it stands. Both count time in 1 / `rate`, about one
over the highest frequency, so that their tolerances mean u and u' alike in any unit of time.
"""

import logging
import math
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_matrix

from pgran.driven.operators import SAME, Owner
from pgran.errors import InputError
from pgran.experiments.pulse.wall import BAND
from pgran.run.petsc import PETSc, holding, note

log = logging.getLogger("pgran")

STEPS_AT_MOST = 10**8
KINDS = ("rk", "alpha2")
STEP_KEYS = ("ts_adapt_dt_min", "ts_adapt_dt_max")  # keys, in the user's unit of time
LONGEST_STEP = 2.0  # step, in units of one over the highest frequency: in between is interpolated
LIMIT_RATIO, STEP_RATIO = 0.7, 0.5  # longest and fixed steps against those of the one before
# What options of a run say, and what leaves alpha2 the velocity that it began with.
REFUSED = {
    "ts_rtol": "-error_tolerance says how accurate",
    "ts_atol": "-error_tolerance says how accurate",
    "ts_init_time": "an integration begins before the pulse",
    "ts_max_time": "-pulse_time says how long",
    "ts_time_span": "-pulse_time and -pulse_points say when",
    "ts_exact_final_time": "-pulse_time says how long",
}
# Errors by the largest ball: most of a large lattice is at rest, and a mean would hide the front.
DEFAULTS = {
    "ts_type": "rk",
    "ts_rk_type": "7vr",
    "ts_adapt_type": "basic",
    "ts_adapt_wnormtype": "infinity",
    "snes_linesearch_type": "basic",
    "pc_type": "lu",
}


class History(NamedTuple):
    """What an integrator found at each of its steps."""

    time: np.ndarray
    functions: dict  # by name the values and the slopes, shape (steps, ...), of each function
    fields: list  # times, and on the first rank displacements of all balls
    complete: bool  # whether the last time was reached


class Integrator(Owner):
    """Integrates a lattice from rest; destroy with `destroy` or `with`. Collective.

    `sites` are the detectors, and no normal mode has a higher frequency than `highest`.
    """

    owns = ("_matrix", "_u", "_v", "_Ku", "_Cv")

    def __init__(self, operators, sites, pulse, highest):
        self.operators, self.comm, self.pulse = operators, operators.comm, pulse
        top = min(highest or pulse.reach, pulse.reach)
        self._later, self.rate = LONGEST_STEP / top, 2.0 ** math.frexp(top)[1]
        self._mass = operators.mass * self.rate**2  # with times in 1 / rate, as the damping
        self._damping = operators.damping * self.rate
        self._longest = min(self._later, BAND / pulse.band)  # a longer step could miss the pulse
        self._given = PETSc.Options("pulse_")
        self._second_order = checked_kind(self._given) == "alpha2"
        self._matrix = operators.K.duplicate() if self._second_order else self._first_order_matrix()
        self._u, self._v, self._Ku, self._Cv = (operators.M.duplicate() for _ in range(4))
        numbers, weights = operators.layout.readings(sites)
        mine = (numbers >= operators.first) & (numbers < operators.last)
        # of unknowns of others the weight is zero
        self._detectors = np.where(mine, numbers - operators.first, 0)
        self._weights = np.where(mine, weights, 0.0)
        drives = [operators.f_stiffness.getArray().real, 0.0 * self._u.getArray().real]
        if operators.C is not None:
            drives[1] = operators.damping * operators.f_damping.getArray().real
        self._driven = np.flatnonzero(np.any(drives, axis=0))
        self._drives = np.array(drives)[:, self._driven]  # of U and of U'

    def _first_order_matrix(self):
        """Return J, from this rank's rows of K and C, which have the same entries."""
        operators = self.operators
        pointer, columns, k = operators.K.getValuesCSR()
        c = 0.0 * k
        if operators.C is not None:
            c = self._damping * operators.C.getValuesCSR()[2]
        ball = np.arange(operators.last - operators.first, dtype=columns.dtype)
        force = 2 * np.repeat(ball, np.diff(pointer)) + 1  # the row that an entry of K is in
        places = (
            np.concatenate([2 * ball, force, force]),
            np.concatenate([2 * (ball + operators.first) + 1, 2 * columns, 2 * columns + 1]),
        )
        values = np.concatenate([np.ones(len(ball)), k / -self._mass, c / -self._mass])
        sizes = 2 * len(ball), 2 * operators.size  # of this rank's part, and of all
        J = coo_matrix((values, places), sizes).tocsr()
        csr = J.indptr, J.indices, J.data
        return PETSc.Mat().createAIJ((sizes, sizes), csr=csr, comm=self.comm)

    def run(self, number, tolerance, begin, end, keep_at=()):
        """Integrate from rest, and return the History. Collective.

        A step makes an error of `tolerance` at most, relative to u and to the drive. After `number`
        coarser integrations steps of a fixed length, and the longest of others, are as many times
        shorter, so that two integrations are never the same. It begins before the pulse and the
        time 0 if `begin` is None. Of the times `keep_at`, which increase, the field is kept at the
        first step from each on.
        """
        self._rows, self._fields, self._keep_at = [], [], list(keep_at)
        self._shrink = LIMIT_RATIO**number
        self._limited = not self._given.hasName("ts_adapt_dt_max")
        begin = min(0.0, self.pulse.begin) if begin is None else begin
        ts, pair = PETSc.TS().create(self.comm), [self._u.duplicate(), self._v.duplicate()]
        state = pair[0] if self._second_order else self._matrix.createVecRight()
        # PETSc 3.25 calls the key otherwise, and would change it for all integrations to come.
        step = self._given.getReal("ts_dt", 0.1 * self._longest)
        with holding(self._keys()):
            ts.setOptionsPrefix("pulse_")
            ts.setTime(self.rate * begin)
            ts.setMaxTime(self.rate * end)
            ts.setMaxSteps(STEPS_AT_MOST)
            ts.setExactFinalTime(PETSc.TS.ExactFinalTime.MATCHSTEP)
            ts.setTolerances(rtol=tolerance, atol=tolerance * self.operators.lattice.drive_size)
            ts.setErrorIfStepFails(False)
            ts.setTimeStep(self.rate * step)
            if self._second_order:
                ts.setI2Function(self._balance, self._u.duplicate())
                ts.setI2Jacobian(self._balance_matrix, self._matrix, self._matrix)
                ts.setSolution2(*pair)
                self._shifts = None
            else:
                ts.setRHSFunction(self._slope, state.duplicate())
            ts.setMonitor(self._note)
            ts.setFromOptions()
            if self._limited:
                ts.setStepLimits(0.0, self.rate * self._shrink * self._longest)
            if self._given.getString("ts_adapt_type", "") == "none":
                ts.setTimeStep(STEP_RATIO**number * ts.getTimeStep())
            ts.solve(state)
        note(f"-pulse_* TS {ts.getType()}", self.comm, integration=1, step=ts.getStepNumber())
        self._given.getReal("ts_dt", step)  # it was used
        reason, ended = ts.getConvergedReason(), ts.getTime() / self.rate
        complete = reason > 0 and ended >= end
        if not complete and self.comm.rank == 0:
            text = "an integration has ended at time %.6g, before %g (TSConvergedReason %d)"
            log.warning(text, ended, end, reason)
        for held in (ts, *pair, *([] if self._second_order else [state])):
            held.destroy()
        steps, functions = self._functions()
        return History(steps, functions, self._fields, complete)

    def _keys(self):
        """Return the options of an integration that are not given, and `ts_dt` as one that is."""
        solver = {"pc_factor_mat_solver_type": "petsc" if self.comm.size == 1 else "mumps"}
        keys = {k: v for k, v in (DEFAULTS | solver).items() if not self._given.hasName(k)}
        if self._given.hasName("ts_dt"):
            keys["ts_dt"] = None
        for key in STEP_KEYS:
            if self._given.hasName(key):
                keys[key] = self.rate * self._given.getReal(key)
        return {f"pulse_{key}": value for key, value in keys.items()}

    def _drive(self, t):
        """Return what drives this rank's balls at the driven wall."""
        return self.pulse.moves(t, 2) @ self._drives

    def _slope(self, ts, t, y, slope):
        """Set y' = J y + drive."""
        self._matrix.mult(y, slope)
        slope.getArray()[2 * self._driven + 1] += self._drive(t / self.rate) / self._mass

    def _balance(self, ts, t, u, v, a, balance):
        """Set M a + C v + K u - f."""
        operators = self.operators
        operators.K.mult(u, balance)
        if operators.C is not None:
            operators.C.mult(v, self._Cv)
            balance.axpy(self._damping, self._Cv)
        balance.axpy(self._mass, a)
        balance.getArray()[self._driven] -= self._drive(t / self.rate)

    def _balance_matrix(self, ts, t, u, v, a, of_velocity, of_acceleration, matrix, _):
        """Set the matrix of a step, and leave it and its factors while the step stays the same."""
        if self._shifts != (of_velocity, of_acceleration):
            self._shifts = (of_velocity, of_acceleration)
            operators = self.operators
            operators.K.copy(matrix, structure=SAME)
            if operators.C is not None:
                matrix.axpy(of_velocity * self._damping, operators.C, structure=SAME)
            matrix.shift(of_acceleration * self._mass)
        return True

    def _note(self, ts, step, t, state):
        """Note, as this rank's part of sums, what the lattice does at the end of a step."""
        operators, t = self.operators, t / self.rate
        if self._limited and t > self.pulse.rest:
            ts.setStepLimits(0.0, self.rate * self._shrink * self._later)
            self._limited = False
        if self._second_order:
            for own, now in zip((self._u, self._v), ts.getSolution2(), strict=True):
                now.copy(own)
        else:
            both = state.getArray(readonly=True)
            self._u.setArray(both[::2])
            self._v.setArray(both[1::2])
        self._v.scale(self.rate)
        u, v = (x.getArray(readonly=True).real for x in (self._u, self._v))
        operators.K.mult(self._u, self._Ku)
        forces = 1.0 * self._Ku.getArray(readonly=True).real  # K u + beta C u'
        held, taken = u @ forces, 0.0
        if operators.C is not None:
            operators.C.mult(self._v, self._Cv)
            drag = operators.damping * self._Cv.getArray(readonly=True).real
            forces, taken = forces + drag, v @ drag
        a = -forces
        a[self._driven] += self._drive(t)
        a /= operators.mass
        # u, u', u'' of each detector and along both drives; then u^T K u, u'^T beta C u', m u'^2.
        balls = np.array([np.sum(self._weights * x[self._detectors], axis=1) for x in (u, v, a)])
        wall = np.array([x[self._driven] for x in (u, v, a)]) @ self._drives.T
        self._rows.append((t, balls, wall, np.array([held, taken, operators.mass * v @ v])))
        if self._keep_at and t >= self._keep_at[0] - 1e-9 * abs(t):
            del self._keep_at[0]
            self._fields.append((t, operators.layout.field(self._u)))

    def _functions(self):
        """Return the times of all steps, and what all ranks have noted: values and slopes by name.

        With u_k = f_k^T u, u_c = beta f_c^T u and so on, and k, c what holds the balls at the wall:
        the force is k U - u_k + c U' - u_c', the energy (m u'^2 + u^T K u - 2 U u_k + k U^2) / 2,
        and the dashpots take u'^T beta C u' - 2 U' u_c' + c U'^2. Of a push, which springs do not
        hold, the velocity f_k^T u' is in the place of the force.
        """
        time, *noted = (np.array(column) for column in zip(*self._rows, strict=True))
        balls, wall, sums = (self.comm.allreduce(each) for each in noted)
        u, v, a = np.moveaxis(balls, 1, 0)
        (u_k, _), (v_k, v_c), (a_k, a_c) = np.moveaxis(wall, 0, -1)
        held, taken, moving = sums.T
        k, c = self.operators.lattice.pulls
        U, speed, turn = self.pulse.moves(time, 3)
        power = taken - 2 * speed * v_c + speed * speed * c
        if self.operators.lattice.push is None:
            force, force_slope = U * k - u_k + speed * c - v_c, speed * k - v_k + turn * c - a_c
            energy = 0.5 * (moving + held - 2 * U * u_k + U * U * k)
            energy_slope = force * speed - power
        else:
            force, force_slope, energy = v_k, a_k, 0.5 * (moving + held)
            energy_slope = U * v_k - power
        return time, {
            "displacement": (u, v),
            "velocity": (v, a),
            "force": (force, force_slope),
            "energy": (energy, energy_slope),
        }


def checked_kind(options):
    """Return which of KINDS options ask for; raise for what would make another integration."""
    for key, why in REFUSED.items():
        if options.hasName(key):
            raise InputError(f"-pulse_{key}: not for pulses; {why}")
    if options.getString("snes_type", "") == "ksponly":
        raise InputError("-pulse_snes_type ksponly: alpha2 needs one that updates velocities")
    if options.hasName("ts_dt") and not 0 < options.getReal("ts_dt") < np.inf:
        raise InputError("-pulse_ts_dt: a step must be positive")
    kind = options.getString("ts_type", DEFAULTS["ts_type"])
    if kind not in KINDS:
        raise InputError(f"-pulse_ts_type {kind}: lattices are integrated by rk or alpha2")
    return kind
