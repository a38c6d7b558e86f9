"""Scene `sensitivity`: what a signal depends on, bond by bond and ball by ball, and its paths."""

import numpy as np

from pgran.driven import drive as driven
from pgran.experiments.sensitivity import heat
from pgran.experiments.sensitivity.adjoint import MISSED, AdjointSweep
from pgran.experiments.sensitivity.gradient import energy_flux, gradient
from pgran.experiments.sensitivity.record import Sensitivity
from pgran.medium.base import medium
from pgran.medium.bonds import bond_places
from pgran.medium.law import HERTZ
from pgran.run.agreement import agreeing
from pgran.run.experiment import Caution, Scene
from pgran.run.frequencies import SWEEP, check_sweep, checked_frequencies, driving_frequencies
from pgran.run.interface import in_parallel
from pgran.run.keys import with_solver
from pgran.run.keywords import PROGRESS, call, option, options_of
from pgran.run.task import carry_out
from pgran.store.estimate import counted, two_digits
from pgran.store.fields import ball_names, site_name
from pgran.store.si import SI

TOGETHER = 2**22  # bytes of fields that derivatives are computed of at a time


def check(values, given):
    """Raise where options contradict each other. Not collective."""
    check_sweep(values, given)
    heat.check(values)


def summary(result):
    """Return in words what a run found. Not collective."""
    found, good = result.sensitivity, result.sensitivity.converged_reason > 0
    nw, kept, bonds = len(found.omega), found.by_stiffness.shape[-1], found.flux.shape[-1]
    what = "all" if kept == bonds else f"the largest {kept} of"
    yield (
        f"{counted(nw, 'frequency')} with {counted(found.factorizations, 'factorization')} in "
        f"{found.solve_seconds:.2f} s: derivatives by {what} {bonds} bonds, by masses and beta"
    )
    if found.failures:
        yield Caution(
            f"{found.failures} of {nw} frequencies failed or missed the accuracy asked for"
        )
    for d, ball in enumerate(ball_names(found.detector)):
        size = np.abs(found.log_amplitude[good, d])
        if size.size:
            at, bond = np.unravel_index(np.argmax(size), size.shape)
            number = bond if found.bond is None else found.bond[good][at, d, bond]
            most, joined = found.log_amplitude[good][at, d, bond], joins(result.medium, number)
            omega = found.omega[good][at]
            yield (
                f"{ball}: depends most on bond {number}, {joined}, at omega = "
                f"{omega:.6g}{SI.of(result).say('Hz', omega)}: d ln|A| / d ln k = {most:.4g} "
                f"+- {two_digits(found.log_bound[good][at, d, bond])}"
            )
    if getattr(result, "heat", None):
        yield from heat.summary(result.heat)


def joins(medium, number):
    """Return in words what a bond joins, by its number. Not collective."""
    if medium.group == "network":
        return "balls {} and {}".format(*medium.bond[number].tolist())
    (axis,), (upper,) = bond_places(medium.shape, np.array([number]))
    lower = upper - (np.arange(len(upper)) == axis)
    inside = lower[axis] >= 0, upper[axis] < medium.shape[axis]
    ends = zip((lower, upper), inside, strict=True)
    ends = [site_name(site) if there else "the wall" for site, there in ends]
    return f"{ends[0]} to {ends[1]}"


@in_parallel("sensitivity", shares_lattice=True, lattice=medium, omegas=checked_frequencies)
@with_solver
def sensitivity(
    lattice,
    omegas,
    detectors,
    crew=None,
    *,
    most=option(
        0, "keep the derivatives by so many bonds and balls, the largest; 0 = by all", low=0
    ),
    error_tolerance=driven.STEADY["error_tolerance"],
    progress=PROGRESS,
):
    """Differentiate amplitudes by all bond constants, masses and beta, at each frequency.

    Collective. See `gradient`. The accuracy is asked of derivatives by bonds and masses, too,
    relative to the largest.

    Returns
    -------
    pgran.results.Sensitivity or None
        With a crew of the caller's None on all ranks but rank 0.

    Raises
    ------
    InputError
        If a detector lies outside the lattice, or a value is impossible.
    """
    with agreeing(crew.world):
        task = GradientSweep(lattice, omegas, detectors, most, error_tolerance)
    driven.check_driven(lattice, crew.world, omegas[0])
    return carry_out(task, crew, progress)


class GradientSweep(AdjointSweep):
    """The derivatives at each frequency, in the lattice's own unit.

    Parameters are those of `sensitivity`.
    """

    def __init__(self, lattice, omegas, detectors, most, error_tolerance):
        """Say what a frequency's results travel in."""
        sites, springs = lattice.sites(detectors), lattice.springs
        nd, self.most = len(sites), most
        self.balls = lattice.balls // lattice.components
        bonds, balls = (min(most, n) if most else n for n in (lattice.bonds, self.balls))
        # which blocks of springs a contact's other constants stand in
        self.blocks = {"stiffness": ["normal"]}
        if getattr(lattice, "tangential", None) is not None:
            self.blocks["tangential"] = ["transverse", "tangential"]
        if getattr(lattice, "force", None) is not None:
            self.blocks["force"] = ["transverse", "pre_stress"]
        self.blocks = {
            name: np.flatnonzero(np.isin(springs.blocks, kinds))
            for name, kinds in self.blocks.items()
        }
        kept = [
            ("iterations", np.int64),
            ("by_damping", complex, (nd,)), ("by_damping_bound", float, (nd,)),
            ("flux", float, (lattice.bonds,)), ("loss", float, (lattice.bonds,)),
        ]  # fmt: skip
        for name, size in (*((block, bonds) for block in self.blocks), ("mass", balls)):
            kept.append((f"by_{name}", complex, (nd, size)))
            kept.append((f"by_{name}_bound", float, (nd, size)))
        if most:
            kept += [("bond", np.int64, (nd, bonds)), ("ball", np.int64, (nd, balls))]
        super().__init__(lattice, omegas, sites, kept, error_tolerance)
        self._waiting = []  # states of this unit that derivatives are still to be computed of

    def keep(self, point, solver):
        """See `FrequencySweep`; the fields come to the first rank of a group."""
        super().keep(point, solver)
        systems, errors = self.systems(point, solver)
        fields = solver.operators.layout.gathered([system.solution for system in systems])
        if fields is None:
            return
        fields = fields.reshape(len(systems), -1)
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
            found = gradient(self.scaled, s, fields, np.stack(errors))
            flux, loss = energy_flux(self.scaled, s, fields[:, 0])
        values = self._kept(found) | {"flux": flux, "loss": loss}
        good = np.ones(len(rows), dtype=bool)
        for name in ("by_stiffness", "by_mass"):  # each as accurate as asked of the largest
            largest = np.abs(values[name]).max(axis=-1)
            wrong = values[f"{name}_bound"].max(axis=-1)
            good &= np.all(wrong <= self.choices["error_tolerance"] * largest, axis=1)
        for number, row in enumerate(rows):
            missed = row["converged_reason"] <= 0
            for name, value in values.items():
                row[name] = np.nan if missed and value.dtype.kind != "i" else value[number]
            if not missed and not good[number]:
                row["converged_reason"] = MISSED

    def _kept(self, found):
        """Return what rows keep of derivatives, by name, the drives first."""
        medium, bonds = self.scaled, self.scaled.bonds
        shape = (*found.damping.shape, -1, bonds)
        derivatives, bounds = (x.reshape(shape) for x in found[:2])
        parts = {
            name: [x[..., blocks, :].sum(axis=-2) for x in (derivatives, bounds)]
            for name, blocks in self.blocks.items()
        }
        if "force" in parts:  # the constant is -F / d
            value, bound = parts["force"]
            parts["force"] = -value / medium.distance, bound / medium.distance
        parts["mass"] = [found.masses, found.masses_bound]
        kept = {"by_damping": found.damping, "by_damping_bound": found.damping_bound}
        if self.most:
            constants = np.abs(medium.springs.constants[:bonds])
            sizes = {
                "bond": constants * parts["stiffness"][0],
                "ball": found.masses / medium.inertia_ratio,
            }
            for name, size in sizes.items():
                number = np.argsort(-np.abs(size), axis=-1, kind="stable")
                kept[name] = number[..., : self.row[name].shape[-1]]
        for name, pair in parts.items():
            if self.most:
                number = kept["ball" if name == "mass" else "bond"]
                pair = [np.take_along_axis(x, number, axis=-1) for x in pair]
            kept[f"by_{name}"], kept[f"by_{name}_bound"] = pair
        return kept

    def collect(self, rows, seconds):
        """See `Task`."""
        unit, constants = self.unit, np.abs(self.lattice.springs.constants[: self.lattice.bonds])
        arrays = {name: rows[name].copy() for name in rows.dtype.names if name.startswith("by_")}
        for name in arrays:  # constants, forces, masses and beta all scale with the unit
            arrays[name] /= unit
        k = constants[rows["bond"]] if self.most else constants
        A, known = rows["displacement"][:, :, None], rows["error_bound"][:, :, None]
        with np.errstate(all="ignore"):
            logs = k * arrays["by_stiffness"] / A
            wrong = arrays["by_stiffness_bound"] + np.abs(arrays["by_stiffness"] / A) * known
            log_bound = 1.01 * k * wrong / (np.abs(A) - known)
            log_bound = np.where(np.abs(A) > known, log_bound, np.inf)
        return Sensitivity(
            factorizations=int(rows["factorizations"].sum()),
            solve_seconds=seconds,
            most=self.most,
            omega=self.omegas,
            detector=self.sites,
            displacement=rows["displacement"].copy(),
            error_bound=rows["error_bound"].copy(),
            log_amplitude=logs.real.copy(),
            log_phase=logs.imag.copy(),
            log_bound=log_bound,
            flux=unit * rows["flux"],
            loss=unit * rows["loss"],
            iterations=rows["iterations"].copy(),
            converged_reason=rows["converged_reason"].copy(),
            bond=rows["bond"].copy() if self.most else None,
            ball=rows["ball"].copy() if self.most else None,
            **arrays,
        )


def run(lattice, options, crew):
    """Return the sensitivity, and what heating does if asked for; see `Scene`."""
    places = lattice, driving_frequencies(options, lattice), options.detectors
    records = [call(sensitivity, options, crew, *places)]
    if heat.is_wanted(options):
        records.append(call(heat.heat, options, crew, *places))
    return records if records[0] else None


SCENE = Scene(
    options=(*driven.DETECTORS, *SWEEP, *options_of(sensitivity, heat.heat, without=[HERTZ])),
    run=run,
    summary=summary,
    check=check,
    shares_lattice=True,
)
