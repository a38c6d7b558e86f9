"""What an amplitude depends on, and where the sound goes: of every spring, ball, and of damping.

With the amplitudes S A = f, the adjoint S z = e_d of a detector, and how far both stretch the
springs, t = B A + w with the driven balls' motion w, and y = B z (they stay at rest),

    dA_d/dk_b = -y_b t_b,    dA_d/dm_p = -s^2 z_p A_p,    dA_d/dbeta = -s sum_b d_b y_b t_b,

d_b being the part of beta that a spring has. Where loss angles and dashpots depend on k_b, the
first is times dkappa_b/dk_b; drag makes s^2 + s alpha_p of s^2. A is homogeneous of degree 0 in all
constants, masses and dashpots: the sum of each derivative times what it is by, (1 - p) beta of
dashpots (k / k_ref)^p, vanishes (Euler).

Where A and z are known to errors a and c in the 2-norm, y_b t_b is wrong by at most
|b| (|y_b| a + |t_b| c) + |b|^2 a c, and likewise for the rest.
"""

import numpy as np

from pgran.driven.drive import FrequencySweep
from pgran.experiments.sensitivity.record import Sensitivity
from pgran.medium.base import EPSILON, SMALLEST_NORMAL
from pgran.store.record import columns_of, row_of

MISSED = 0  # the reason of a frequency whose results miss the accuracy asked for
# The blocks of springs that a contact's constants stand in, by the fields of a medium.
BLOCKS = {
    "stiffness": ("normal",),
    "tangential": ("transverse", "tangential"),
    "force": ("transverse", "pre_stress"),
}
# Bytes of fields that derivatives are computed of at a time: for one state of a small lattice the
# calls of NumPy would take as long as the solve.
TOGETHER = 2**22


class AdjointSweep(FrequencySweep):
    """Steady states of which more than the amplitudes is computed, frequency by frequency.

    A row holds what `record` declares, but for `missing`, optional arrays with their bounds, which
    the sweep does not compute; `lengths` are those of the record's other axes.
    """

    def __init__(self, lattice, omegas, sites, error_tolerance, record, missing, **lengths):
        without = {*missing, *(f"{name}_bound" for name in missing)}
        lengths |= {"detector_number": (len(sites),), "every_bond": (lattice.bonds,)}
        row = [("field_bound", float), *row_of(record, without, **lengths)]
        choices = {"error_tolerance": error_tolerance, "whole_field": True, "whole_adjoints": True}
        super().__init__(lattice, omegas, sites, row, choices)

    def keep(self, point, solver):
        """See `FrequencySweep`; a frequency without proven bounds misses the accuracy."""
        # Factor S anew at each frequency: a reused factorization stops at the tolerance asked for,
        # and derivatives need the field to rounding.
        solver.restart()
        if not solver.bounds.proven:
            point["converged_reason"] = min(point["converged_reason"], MISSED)


def systems_of(solver, field_bound):
    """Return the solved systems, the field's, then each adjoint's, and bounds of their errors.

    Collective over a group. The errors are those of the solutions in the 2-norm.
    """
    bounds = solver.bounds
    errors = [1.01 * bounds.inverse_norm * bounds.adjoint_residual(z) for z in solver.adjoints]
    return [solver.primal, *solver.adjoints], np.array([field_bound, *errors])


def fields_of(solver, systems):
    """Return solutions as arrays, (1 + nd, unknowns), on the first rank of a group, else None.

    Collective over the group.
    """
    fields = solver.operators.layout.gathered([system.solution for system in systems])
    return None if fields is None else fields.reshape(len(systems), -1)


class GradientSweep(AdjointSweep):
    """The derivatives at each frequency, in the lattice's own unit."""

    def __init__(self, lattice, omegas, detectors, most, error_tolerance):
        sites, self.most = lattice.sites(detectors), most
        self.blocks = {
            name: np.flatnonzero(np.isin(lattice.springs.blocks, blocks))
            for name, blocks in BLOCKS.items()
            if getattr(lattice, name, None) is not None
        }
        missing = {f"by_{name}" for name in BLOCKS.keys() - self.blocks.keys()}
        bonds, balls = lattice.bonds, lattice.free_balls
        if most:
            bonds, balls = min(most, bonds), min(most, balls)
        else:
            missing |= {"bond", "ball"}
        lengths = {"bond_number": (bonds,), "ball_number": (balls,)}
        super().__init__(lattice, omegas, sites, error_tolerance, Sensitivity, missing, **lengths)
        self._waiting = []  # states of this unit that derivatives are still to be computed of

    def keep(self, point, solver):
        """See `FrequencySweep`; the fields come to the first rank of a group."""
        super().keep(point, solver)
        systems, errors = systems_of(solver, point["field_bound"])
        fields = fields_of(solver, systems)
        if fields is None:
            return
        self._waiting.append((point, solver.operators.s, fields, errors))
        if len(self._waiting) * fields.nbytes > TOGETHER:
            self.complete(None)

    def complete(self, points):
        """See `FrequencySweep`."""
        if not self._waiting:
            return
        rows, s, fields, errors = zip(*self._waiting, strict=True)
        self._waiting.clear()
        s, fields = np.array(s), np.stack(fields)
        with np.errstate(all="ignore"):  # what failed is marked below
            values = self._by_name(gradient(self.scaled, s, fields, np.stack(errors)), s)
            values["flux"], values["loss"] = energy_flux(self.scaled, s, fields[:, 0])
        good = np.ones(len(rows), dtype=bool)
        for name in ("by_stiffness", "by_mass"):  # each as accurate as asked of the largest
            largest = np.abs(values[name]).max(axis=-1)
            error = values[f"{name}_bound"].max(axis=-1)
            good &= np.all(error <= self.choices["error_tolerance"] * largest, axis=1)
        for number, row in enumerate(rows):
            missed = row["converged_reason"] <= 0
            for name, value in values.items():
                row[name] = np.nan if missed and value.dtype.kind != "i" else value[number]
            if not missed and not good[number]:
                row["converged_reason"] = MISSED

    def _by_name(self, found, s):
        """Return what rows keep of a `gradient` at some s, by the names of the record's arrays."""
        medium, bonds = self.scaled, self.scaled.bonds
        # Springs stand block by block, one of each for every contact: (n, nd, blocks, bonds).
        by_spring = [x.reshape(*x.shape[:2], -1, bonds) for x in found["springs"]]
        by_stiffness = by_spring
        if medium.has_law:  # kappa follows the stiffness by the law, not that of pre-stress
            slopes = np.array([medium.slope(one) for one in s]).reshape(len(s), 1, -1, bonds)
            by_stiffness = [by_spring[0] * slopes, 1.01 * by_spring[1] * np.abs(slopes)]
        pairs = {"mass": found["mass"]}
        for name, blocks in self.blocks.items():
            parts = by_spring if name == "force" else by_stiffness
            pairs[name] = [x[..., blocks, :].sum(axis=-2) for x in parts]
        if "force" in pairs:  # the constant is -F / d
            value, bound = pairs["force"]
            pairs["force"] = -value / medium.distance, bound / medium.distance
        values = {}
        if self.most:  # the numbers of the largest, in the record's shapes
            constants = np.abs(medium.springs.constants[:bonds])
            sizes = {
                "bond": constants * pairs["stiffness"][0],
                "ball": pairs["mass"][0] / medium.inertia_ratio,
            }
            for name, size in sizes.items():
                number = np.argsort(-np.abs(size), axis=-1, kind="stable")
                values[name] = number[..., : self.row[name].shape[-1]]
            for name, pair in pairs.items():
                number = values["ball" if name == "mass" else "bond"]
                pairs[name] = [np.take_along_axis(x, number, axis=-1) for x in pair]
        for name, pair in (pairs | {"damping": found["damping"]}).items():
            values[f"by_{name}"], values[f"by_{name}_bound"] = pair
        return values

    def collect(self, rows, seconds):
        """See `Task`."""
        arrays = columns_of(Sensitivity, rows)
        for name in arrays:
            if name.startswith("by_"):  # constants, forces, masses and beta all scale with the unit
                arrays[name] /= self.unit
        arrays["flux"] *= self.unit
        arrays["loss"] *= self.unit
        k = self.lattice.springs.constants[: self.lattice.bonds]  # negative ones, too: dk / k
        k = k[arrays["bond"]] if self.most else k
        A, A_bound = rows["displacement"][:, :, None], rows["error_bound"][:, :, None]
        slope, slope_bound = arrays["by_stiffness"], arrays["by_stiffness_bound"]
        with np.errstate(all="ignore"):
            logs = k * slope / A
            log_bound = 1.01 * np.abs(k) * (slope_bound + np.abs(slope / A) * A_bound)
            log_bound = log_bound / (np.abs(A) - A_bound)
            log_bound = np.where(np.abs(A) > A_bound, log_bound, np.inf)
        return Sensitivity(
            factorizations=int(rows["factorizations"].sum()),
            solve_seconds=seconds,
            most=self.most,
            omega=self.omegas,
            detector=self.sites,
            log_amplitude=logs.real.copy(),
            log_phase=logs.imag.copy(),
            log_bound=log_bound,
            **arrays,
        )


def gradient(medium, s, fields, errors):
    """Return derivatives of the amplitudes at n values of s, and bounds of their errors, by name.

    `springs` (n, nd, springs) by the pulls kappa of all springs at s, `mass` (n, nd, free balls),
    `damping` (n, nd) by beta. Fields, shape (n, 1 + nd, unknowns), are the amplitudes of all
    unknowns, then the adjoints; `errors`, shape (n, 1 + nd), bound their errors in the 2-norm.
    """
    springs, s = medium.springs, s[:, None]
    stretch = _applied(springs.B, fields)
    rounding = (springs.columns.shape[1] + 2) * EPSILON
    errors = (errors + rounding * np.linalg.norm(fields, axis=-1))[..., None]
    # shapes (n, 1, springs), (n, nd, springs), (n, 1, unknowns), (n, nd, unknowns)
    t, y, A, z = stretch[:, :1] + springs.drive, stretch[:, 1:], fields[:, :1], fields[:, 1:]
    products, a, c = t * y, errors[:, :1], errors[:, 1:]
    spring_errors = _product_error(_size(y), _size(t), springs.lengths * c, springs.lengths * a)
    mass_errors = _product_error(_size(z), _size(A), c, a)
    # what rounds while the sum over the springs is formed
    summing = (len(springs.damped) + 8) * EPSILON * (_size(products) @ springs.damped)
    damping_errors = np.abs(s) * (spring_errors @ springs.damped + summing + SMALLEST_NORMAL)
    inertia = -(s[..., None] ** 2)
    if medium.drags is not None:  # a number a ball
        inertia = inertia - s[..., None] * medium.drags[:: medium.components]
    inertia = inertia * medium.inertia_ratio
    by_mass = inertia * _per_ball(medium, z * A)
    return {
        "springs": (-products, spring_errors),
        "mass": (by_mass, np.abs(inertia) * _per_ball(medium, mass_errors)),
        "damping": (-s * (products @ springs.damped), damping_errors),
    }


def energy_flux(medium, s, fields):
    """Return the mean power through each contact, and what it loses, for drives s = i omega.

    The power that the springs of a contact give to one of its balls is
    -(omega/2) Im(kappa t conj(b u)), kappa = k (1 + i eta) + s beta d and b u the ball's part of
    the stretch; both powers sum up to minus the loss (omega/2) Im(kappa) |t|^2. What flows from the
    first ball to the second is half their difference. What all contacts give to a free ball is what
    its drag takes.

    Fields have the shape (n, unknowns), flux and loss (n, contacts), in units of the constants
    times frequency, for a driven motion of amplitude 1.
    """
    springs, beta, s = medium.springs, medium.damping, s[:, None]
    lossy = s.imag * beta * springs.damped
    if medium.losses is not None:
        lossy = lossy + medium.losses
    t = _applied(springs.B, fields) + springs.drive
    moved = t * (_applied(springs.D, fields) + springs.drive_apart).conj()
    # Im(kappa moved)
    tension = springs.constants * moved.imag + lossy * moved.real
    flux = -0.25 * s.imag * tension
    loss = 0.5 * beta * s.imag**2 * springs.damped * (t.real**2 + t.imag**2)
    if medium.losses is not None:
        loss = loss + 0.5 * s.imag * medium.losses * (t.real**2 + t.imag**2)
    return tuple(x.reshape(len(s), -1, medium.bonds).sum(axis=1) for x in (flux, loss))


def _applied(matrix, fields):
    """Return a sparse matrix times fields (..., unknowns)."""
    flat = fields.reshape(-1, fields.shape[-1])
    return np.ascontiguousarray((matrix @ flat.T).T).reshape(*fields.shape[:-1], -1)


def _per_ball(medium, values):
    """Return sums over the components of each ball of values (..., unknowns)."""
    return values.reshape(*values.shape[:-1], -1, medium.components).sum(axis=-1)


def _size(x):
    """Return no less than magnitudes, which take longer, and less than 1.5 times them."""
    return np.abs(x.real) + np.abs(x.imag)


def _product_error(x, y, x_error, y_error):
    """Return how far a product of numbers of these sizes may be off, its rounding included."""
    error = x * (1.01 * y_error + 16 * EPSILON * y) + 1.01 * x_error * (y + y_error)
    return error + SMALLEST_NORMAL
