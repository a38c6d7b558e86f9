"""Scene `sensitivity`: what a signal depends on, bond by bond and ball by ball, and its paths."""

import numpy as np

from pgran.driven import drive as driven
from pgran.errors import InputError
from pgran.experiments.sensitivity import heat
from pgran.experiments.sensitivity.adjoint import MISSED, AdjointSweep
from pgran.experiments.sensitivity.gradient import energy_flux, gradient
from pgran.experiments.sensitivity.record import Sensitivity
from pgran.experiments.sensitivity.warmth import WAYS, check_options
from pgran.medium.base import medium
from pgran.medium.bonds import bond_ends
from pgran.medium.law import HERTZ
from pgran.run.agreement import agreeing
from pgran.run.experiment import PROGRESS, Caution, Scene, call, in_parallel, option, options_of
from pgran.run.frequencies import SWEEP, check_sweep
from pgran.run.task import carry_out
from pgran.store.estimate import counted, with_error
from pgran.store.record import ball_names, columns_of, site_name
from pgran.store.si import SI

# Bytes of fields that derivatives are computed of at a time: for one state of a small lattice the
# calls of NumPy would take as long as the solve.
TOGETHER = 2**22


def check(values, given):
    """Raise where options contradict each other."""
    check_sweep(values, given)
    check_options(values)
    loads = [name for name in WAYS if name != "heat_factor" and values[name] is not None]
    if values["network_file"] is not None and values["bonds_redrawn"] and loads:
        raise InputError(f"-{loads[0]}: a redrawn contact is not as stiff as its force makes it")


def summary(result):
    """Return in words what a run found."""
    record, good = result.sensitivity, result.sensitivity.converged_reason > 0
    nw, kept, bonds = len(record.omega), record.by_stiffness.shape[-1], record.flux.shape[-1]
    what = "all" if kept == bonds else f"the largest {kept} of"
    yield (
        f"{counted(nw, 'frequency')} with {counted(record.factorizations, 'factorization')} in "
        f"{record.solve_seconds:.2f} s: derivatives by {what} {bonds} bonds, by masses and beta"
    )
    if record.failures:
        failed = f"{record.failures} of {nw} frequencies"
        yield Caution(f"{failed} failed or missed the accuracy asked for")
    for d, ball in enumerate(ball_names(record.detector) if good.any() else []):
        slopes = record.log_amplitude[good, d]
        at, bond = np.unravel_index(np.argmax(np.abs(slopes)), slopes.shape)
        number = bond if record.bond is None else record.bond[good][at, d, bond]
        omega, error = record.omega[good][at], record.log_bound[good][at, d, bond]
        yield (
            f"{ball}: depends most on bond {number}, {joins(result.medium, number)}, at omega = "
            f"{omega:.6g}{SI.of(result).say('Hz', omega)}: d ln|A| / d ln k = "
            f"{with_error(slopes[at, bond], error)}"
        )
    if getattr(result, "heat", None):
        yield from heat.summary(result.heat)


def joins(medium, number):
    """Return in words what a bond joins, by its number."""
    if medium.group == "network":
        return "balls {} and {}".format(*medium.bond[number].tolist())
    shape, numbers = medium.shape, np.arange(medium.free_balls)
    ends = bond_ends(numbers.reshape(shape))[number]  # -1 for a wall
    names = [site_name(np.unravel_index(n, shape)) if n >= 0 else "the wall" for n in ends]
    return " to ".join(names)


@in_parallel(
    "sensitivity", shares_lattice=True, lattice=medium, detectors=driven.DETECTORS, omegas=SWEEP
)
def sensitivity(
    lattice,
    omegas,
    detectors,
    crew=None,
    *,
    most=option(0, "keep only the largest derivatives, by so many bonds and balls; 0 = all", low=0),
    error_tolerance=driven.STEADY["error_tolerance"],
    progress=PROGRESS,
) -> Sensitivity:
    """Differentiate amplitudes by all bond constants, masses and beta, at each frequency.

    See `gradient`. The accuracy holds for derivatives by bonds and masses as well, relative to the
    largest one.
    """
    with agreeing(crew.world):
        task = GradientSweep(lattice, omegas, detectors, most, error_tolerance)
    driven.check_driven(lattice, crew.world, omegas[0])
    return carry_out(task, crew, progress)


class GradientSweep(AdjointSweep):
    """The derivatives at each frequency, in the lattice's own unit."""

    def __init__(self, lattice, omegas, detectors, most, error_tolerance):
        sites, springs = lattice.sites(detectors), lattice.springs
        self.most = most
        # which blocks of springs a contact's constants stand in
        kinds = {"stiffness": ["normal"]}
        if getattr(lattice, "tangential", None) is not None:
            kinds["tangential"] = ["transverse", "tangential"]
        if getattr(lattice, "force", None) is not None:
            kinds["force"] = ["transverse", "pre_stress"]
        self.blocks = {
            name: np.flatnonzero(np.isin(springs.blocks, blocks)) for name, blocks in kinds.items()
        }
        missing = {f"by_{name}" for name in {"tangential", "force"} - kinds.keys()}
        bonds, balls = lattice.bonds, lattice.size // lattice.components
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

    def _by_name(self, derivatives, s):
        """Return what rows keep of a Gradient at some s, by the names of the record's arrays."""
        medium, bonds = self.scaled, self.scaled.bonds
        # Springs stand block by block, one of each for every contact: (n, nd, blocks, bonds).
        shape = (*derivatives.damping.shape, -1, bonds)
        by_spring = [x.reshape(shape) for x in (derivatives.springs, derivatives.springs_bound)]
        by_stiffness = by_spring
        if medium.has_law:  # kappa follows the stiffness by the law, not that of pre-stress
            slopes = np.array([medium.slope(one) for one in s]).reshape(len(s), 1, -1, bonds)
            by_stiffness = [by_spring[0] * slopes, 1.01 * by_spring[1] * np.abs(slopes)]
        pairs = {
            name: [
                x[..., blocks, :].sum(axis=-2)
                for x in (by_spring if name == "force" else by_stiffness)
            ]
            for name, blocks in self.blocks.items()
        }
        if "force" in pairs:  # the constant is -F / d
            value, bound = pairs["force"]
            pairs["force"] = -value / medium.distance, bound / medium.distance
        pairs["mass"] = [derivatives.masses, derivatives.masses_bound]
        values = {}
        if self.most:  # the numbers of the largest, in the record's shapes
            constants = np.abs(medium.springs.constants[:bonds])
            sizes = {
                "bond": constants * pairs["stiffness"][0],
                "ball": derivatives.masses / medium.inertia_ratio,
            }
            for name, size in sizes.items():
                number = np.argsort(-np.abs(size), axis=-1, kind="stable")
                values[name] = number[..., : self.row[name].shape[-1]]
            for name, pair in pairs.items():
                number = values["ball" if name == "mass" else "bond"]
                pairs[name] = [np.take_along_axis(x, number, axis=-1) for x in pair]
        pairs["damping"] = [derivatives.damping, derivatives.damping_bound]
        for name, pair in pairs.items():
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


def run(lattice, options, crew):
    """Return the sensitivity, and what heating does if asked for; see `Scene`."""
    records = [call(sensitivity, options, crew, lattice)]
    if options.heat_cut or any(getattr(options, way) is not None for way in WAYS):
        records.append(call(heat.heat, options, crew, lattice))
    return records if records[0] else None


OPTIONS = options_of(sensitivity, heat.heat, without=[HERTZ])
SCENE = Scene(OPTIONS, run, summary, check, shares_lattice=True, function=sensitivity)
