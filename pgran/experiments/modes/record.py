"""The records of modes, of their counts, and of a drive in terms of them."""

import math
from dataclasses import dataclass, fields, replace

import numpy as np

from pgran.errors import InputError, PgranError
from pgran.experiments.modes.shapes import RESIDUAL, least_frequency
from pgran.medium.base import medium as medium_of
from pgran.store.record import DETECTOR, Frequencies, Record, array, attribute

FEWEST = 10  # modes of which an energy diffusivity is one of a continuum


@dataclass(frozen=True, eq=False, repr=False)
class Density(Record):
    """How many normal modes lie below each of N frequencies, unstable ones included.

    A count is exact where `certified`; where a mode is so close to the frequency that it is open on
    which side it lies, the count is that at `omega - margin`. Unstable modes, whose omega^2 < 0,
    have a negative omega; `unstable` says how many there are, without those that rounding hides at
    0, and -1 if that is not certain. Between neighbouring frequencies the
    `density` is the modes there, per ball and per `omega_mx`: its integral over omega / omega_mx is
    the number of modes a ball, NaN next to a count that is not certified.

    By the `method` moments all are estimates by random `vectors`, with standard errors: of counts
    smoothed by the `resolution`, and of energy diffusivities, if these were asked for.
    """

    group = "density"
    balls: int = attribute("how many move freely", "1")
    omega_mx: float = attribute("that of the medium", "sqrt(k/m)")
    solve_seconds: float = attribute("time of solving, of the slowest rank", "s")
    unstable: int = attribute("modes with omega^2 < 0; -1: not certain", "1", since=5)
    omega: np.ndarray = array("frequency, angular", "sqrt(k/m)")
    count: np.ndarray = array(
        "how many modes lie below; -1: not certain", "1", "omega", dtype=int, row=True
    )
    certified: np.ndarray = array(
        "the count is exact at omega - margin", "1", "omega", dtype=bool, row=True
    )
    margin: np.ndarray = array(
        "how far below omega the modes are counted", "sqrt(k/m)", "omega", row=True
    )
    middle: np.ndarray = array("middle between neighbouring frequencies, angular", "sqrt(k/m)")
    density: np.ndarray = array("modes there per ball and omega_mx", "1", "middle")
    method: str | None = attribute("count, or moments: estimates", optional=True)
    vectors: int | None = attribute("random vectors of the moments", optional=True)
    moments: int | None = attribute("moments of each vector", optional=True)
    density_error: np.ndarray | None = array(
        "its standard error, an estimate", "1", "middle", optional=True
    )
    count_error: np.ndarray | None = array(
        "standard error of the count, an estimate", "1", "omega", optional=True
    )
    resolution: np.ndarray | None = array(
        "how far steps of the count are smoothed", "sqrt(k/m)", "middle", optional=True
    )
    diffusivity: np.ndarray | None = array(
        "energy diffusivity of modes, an estimate", "length^2 sqrt(k/m)", "middle", optional=True
    )
    diffusivity_error: np.ndarray | None = array(
        "its standard error, an estimate", "length^2 sqrt(k/m)", "middle", optional=True
    )
    diffusivity_axis: str | None = attribute("along which these are", optional=True)

    @property
    def modes(self):
        """The modes between neighbouring frequencies; NaN: not certified."""
        return self.density * self._balls_of_bins

    @property
    def modes_error(self):
        """Their standard errors, of counts their square roots."""
        counted = self.density_error is None
        return np.sqrt(self.modes) if counted else self.density_error * self._balls_of_bins

    @property
    def diffuses(self):
        """Where d is twice its error or more, of FEWEST modes or more within the resolution."""
        alike = self.modes * self.resolution / np.diff(self.omega)
        known = 2 * self.diffusivity_error <= self.diffusivity
        return known & (alike >= FEWEST) & (self.resolution < self.middle)

    @property
    def _balls_of_bins(self):
        return self.balls * np.diff(self.omega) / self.omega_mx

    @property
    def failures(self):
        """How many counts are not certified; estimates, which no count is, do not fail."""
        return 0 if self.method == "moments" else int(np.count_nonzero(~self.certified))

    @staticmethod
    def weyl(lattice, omega):
        """Return how many modes long waves have below frequencies, by Weyl's law for a rectangle.

        N(omega) = A omega^2 / (4 pi c^2) - P omega / (4 pi c), c = sqrt(k/m), with the area A and
        the perimeter P of the box between the walls, which are at rest one spacing outside of the
        balls; for L x L, L^2 omega^2 / (4 pi c^2) - L omega / (pi c). Shorter waves are slower on a
        lattice: A (omega / c)^4 / (64 pi) modes more. None unless `lattice` is the record of one of
        two axes whose bonds are all equal.
        """
        if lattice.group != "lattice" or len(lattice.shape) != 2:
            return None
        bonds = np.concatenate([k.ravel() for k in lattice.stiffness])
        if not np.all(bonds == bonds[0]):
            return None
        sides = np.add(lattice.shape, 1.0)
        waves = np.asarray(omega) / np.sqrt(bonds[0] / lattice.mass)
        return (sides.prod() * waves**2 - 2 * sides.sum() * waves) / (4 * math.pi)


CERTIFICATES = {
    "discs": "none is missing, proven by discs",
    "proven": "none is missing, proven by a ring of counts around them",
    "below": "none is missing, proven by two counts of undamped modes",
    "counted": "none is missing, counted by the phase of det S around them",
    "none": "not counted: others may be as near",
}


def exactness(record, number="{:.1e}".format):
    """Return in words how sure it is that a record's modes, its own or those it is on, are all."""
    bounds = [getattr(record, name, None) for name in ("omega_bound", "mode_omega_bound")]
    proven = next((bound for bound in bounds if bound is not None), None)
    if proven is None:
        return "certified by their count"
    if not len(proven):
        return "proven by their residuals"
    typical, most = number(np.median(proven)), number(proven.max())
    return f"proven by their residuals, omega to {typical} (median; at most {most})"


class Counted:
    """A record of modes, or on modes, that says how many there are: `count_expected`."""

    each_mode = "omega"  # the array that has an entry for each

    def displacements(self, medium):
        """Return how balls of a medium move, not mass-weighted: u of each mode's `vector`.

        Of a lattice (nm, nx, ny, ...); of a network (nm, N, components) of all balls, 0 of held
        ones. Of normal modes u^T M u = m, the median mass; of damped ones u^T (2 s M + C) u = 1.
        """
        from pgran.medium.space import everywhere

        medium = self._shaped_by(medium)
        moved = medium.displacements(self.vector)
        return moved if medium.is_grid else everywhere(medium, moved)

    def _shaped_by(self, medium):
        """Return a medium that modes with shapes are of; raise InputError where they are not."""
        medium = medium_of(medium)
        if np.shape(getattr(self, "vector", None))[1:] != medium.shape:
            raise InputError("needs modes of this medium, with shapes: -output_fields, shapes=True")
        return medium

    @property
    def count_found(self):
        """How many modes there are here."""
        return len(getattr(self, self.each_mode))

    @property
    def missing(self):
        """How many modes are missing or too many, at least 1 unless they are certified."""
        return 0 if self.count_certified else max(1, abs(self.count_expected - self.count_found))


@dataclass(frozen=True, eq=False, repr=False)
class Modes(Counted, Record):
    """Normal modes K f = m omega^2 f (paper: modepic), `nm` of them.

    `count_expected` says how many there are, `count_certified` whether all of these were found,
    each with a residual of rounding size: certified by counts, or, where there is an `omega_bound`,
    proven. Modes that are unstable, omega^2 < 0, have the negative omega -sqrt(-omega^2), and it is
    this number that the bound is of; `inf` proves nothing. What `width` to `residue` are says
    `pgran/experiments/modes/resonances.py`.
    """

    group = "modes"
    count_expected: int = attribute("how many modes there are", "1")
    count_certified: bool = attribute("1: these are all, by their count or proven")
    solve_seconds: float = attribute("time of solving, of the slowest rank", "s")
    omega: np.ndarray = array("frequency of the mode, angular", "sqrt(k/m)")
    residual: np.ndarray = array("|K f - m omega^2 f| / |K|", "1", "omega", row=True)
    participation: np.ndarray = array(
        "how many balls take part, 1 / sum f^4", "1", "omega", row=True
    )
    omega_bound: np.ndarray | None = array(
        "bound of the error of omega, proven for all modes together: none is missing",
        "sqrt(k/m)", "omega", optional=True,
    )  # fmt: skip
    width: np.ndarray | None = array(
        "full width at half power of the mode's peak, to first order in the damping", "sqrt(k/m)",
        "omega", optional=True, row=True,
    )  # fmt: skip
    source: np.ndarray | None = array(
        "f^T times the force of the drive at omega = 0", "k", "omega", optional=True, row=True
    )
    detector: np.ndarray | None = array(
        DETECTOR, "1", "detector_number", "axis", dtype=int, optional=True
    )
    reading: np.ndarray | None = array(
        "reading of f by the detectors", "1", "omega", "detector_number", optional=True, row=True
    )
    residue: np.ndarray | None = array(
        "reading times source over 2 m omega: of the mode's peak alone |A| = 2 |residue| / width",
        "sqrt(k/m)", "omega", "detector_number", optional=True,
    )  # fmt: skip
    vector: np.ndarray | None = array(
        "mass-weighted shape of the mode, sqrt(m_p / m) u_p, m the median mass, orthonormal, its "
        "largest entry positive",
        "1", "omega", "balls", optional=True, row=True,
    )  # fmt: skip

    @property
    def failures(self):
        """How many modes are missing or inaccurate."""
        return self.missing

    @property
    def quality(self):
        """omega / width of each mode, infinite without damping, NaN of modes at rest."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.omega > 0, self.omega / self.width, np.nan)

    @property
    def peak(self):
        """|A| of each detector at each mode's peak, if it stood alone, (nm, nd)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return 2 * np.abs(self.residue) / self.width[:, None]

    def wave_numbers(self, medium):
        """Return k_i, branch and share of what waves each mode of this medium is made of most.

        Modes need a `vector`. c_i = omega_i / k_i. k_i is known to about pi / L in a period L; the
        share is 1 of a mode that is a wave, and small where it is none.
        """
        from pgran.medium.waves import Waves

        return Waves(self._shaped_by(medium)).strongest(self.vector.reshape(len(self.omega), -1))

    def moving(self, lattice):
        """Return these modes without those at rest, of the `lattice` or of a network itself."""
        here = np.abs(self.omega) > least_frequency(lattice)
        along = {
            item.name: getattr(self, item.name)[here]
            for item in fields(self)
            if item.name == "omega" or item.metadata.get("axes", ())[:1] == ("omega",)
            if getattr(self, item.name) is not None
        }
        left = self.count_expected - np.count_nonzero(~here)
        return replace(self, count_expected=int(left), **along)


@dataclass(frozen=True, eq=False, repr=False)
class DampedModes(Counted, Record):
    """Damped modes S(s) x = 0, s = -width / 2 + i omega with omega >= 0, `nm` of them.

    Modes of omega = 0 are overdamped. With rigidity 0 several have become one (critical damping):
    x^T (2 s m + C) x = 0 normalises nothing, and residue and vector are NaN. Where springs have a
    loss, others than conj(s) lie below the real axis; they are not here.
    """

    group = "damped_modes"
    complete: bool = attribute("1: these and all conj(s), conj(x) are all modes")
    certificate: str = attribute("how sure that is: discs, below, counted, proven, none")
    count_expected: int = attribute("how many modes there are", "1")
    count_certified: bool = attribute("1: these are all, by their count or proven")
    solve_seconds: float = attribute("time of solving, of the slowest rank", "s")
    eigenvalue: np.ndarray = array("s", "sqrt(k/m)", "mode", dtype=complex, row=True)
    residual: np.ndarray = array("|S x| / ((|K| + |s C| + |s^2 m|) |x|)", "1", "mode", row=True)
    radius: np.ndarray = array(
        "a mode is this near s, proven; inf: not, NaN: not asked for", "sqrt(k/m)", "mode", row=True
    )
    rigidity: np.ndarray = array("|x^T (2 s m + C) x| / (2 |s| m |x|^2)", "1", "mode", row=True)
    participation: np.ndarray = array("how many balls take part", "1", "mode", row=True)
    detector: np.ndarray | None = array(
        DETECTOR, "1", "detector_number", "axis", dtype=int, optional=True
    )
    residue: np.ndarray | None = array(
        "what the detectors read of x, times x^T f(s), f the drive", "sqrt(k/m)",
        "mode", "detector_number", dtype=complex, optional=True, row=True,
    )  # fmt: skip
    vector: np.ndarray | None = array(
        "x, mass-weighted: sqrt(m_p / m) u_p, x^T (2 s m + C) x = 1", "1/sqrt(sqrt(k m))",
        "mode", "balls", dtype=complex, optional=True, row=True,
    )  # fmt: skip

    omega = property(lambda self: self.eigenvalue.imag, doc="The angular frequency of each mode.")

    @property
    def growing(self):
        """Which modes grow: by more than the radius, or rounding where there is none, may hide."""
        rounding = RESIDUAL * np.abs(self.eigenvalue).max(initial=0.0)
        return self.eigenvalue.real > np.where(np.isfinite(self.radius), self.radius, rounding)

    @property
    def width(self):
        """Full width at half power, negative of growing modes only."""
        damped = -self.eigenvalue.real
        return 2 * np.where(self.growing, damped, np.maximum(damped, 0.0)) + 0.0

    @property
    def quality(self):
        """|s| / width of each mode, infinite where nothing damps it."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.abs(self.eigenvalue) / self.width

    @property
    def poor(self):
        """How many modes have a backward error beyond rounding, and are not proven."""
        return np.count_nonzero((self.residual > RESIDUAL) & ~np.isfinite(self.radius))

    @property
    def failures(self):
        """How many modes are poor or missing, at least 1 unless that is certain, or nobody asks."""
        return self.poor + (0 if self.certificate == "none" else self.missing)

    def exactness(self, number="{:.1e}".format):
        """Return in words how sure it is that no mode is missing."""
        found, expected = self.count_found, self.count_expected
        if not self.failures:
            words, known = CERTIFICATES[self.certificate], self.radius[np.isfinite(self.radius)]
            alone = np.count_nonzero(np.isinf(self.radius))
            if len(known):
                words += f", each s within {number(known.max())}"
            return words + (f", but {alone} of which no s is proven" if alone else "")
        if self.poor:
            return (
                f"NOT ACCURATE: {self.poor} of {found} modes, backward errors up to "
                f"{number(self.residual.max())}; -damped_pep_tol and -damped_pep_max_it make them "
                "smaller, -modes_method dense finds all"
            )
        if found != expected:
            return (
                f"NOT ALL MODES: {found} found where there are {expected}; -modes_method dense "
                "finds all, of equal ones too"
            )
        return f"NOT CERTIFIED: whether these {found} modes are all is not certain"

    def response(self, omegas):
        """Return A at each detector, (nw, nd), as far as these modes and their images make it.

        Of `complete` modes it is right to some 1e-15 of the sum of |e_d| |f| |x|^2 / |i omega - s|.
        """
        if self.residue is None:
            raise PgranError("these modes have no residues: they need detectors, and a drive")
        at, paired = 1j * np.reshape(omegas, (-1, 1)), self.omega > 0
        upper, lower = (self.residue / (x - self.eigenvalue)[..., None] for x in (at, -at))
        return upper.sum(axis=1) + lower[:, paired].conj().sum(axis=1)


@dataclass(frozen=True, eq=False, repr=False)
class Projection(Counted, Frequencies, Record):
    """The driven lattice in terms of its normal modes (paper: cidef, onefreq, maxci, cifreq).

    `nw` driving frequencies, `nm` modes. A frequency whose `converged_reason` is not positive
    missed the accuracy asked for.
    """

    group, each_mode = "projection", "mode_omega"
    count_expected: int = attribute("how many modes there are", "1")
    count_certified: bool = attribute("1: these are all, by their count or proven")
    mode_omega: np.ndarray = array("frequency of the mode, angular", "sqrt(k/m)")
    coefficient: np.ndarray = array(
        "sum over balls of amplitude times mode shape", "1", "omega", "mode_omega", dtype=complex,
        row=True,
    )  # fmt: skip
    dominant: np.ndarray = array(
        "mode of the largest coefficient; -1: none", "1", "omega", dtype=int
    )
    error_bound: np.ndarray = array(
        "bound of the field's part in each coefficient's error; NaN: none is known", "1", "omega"
    )
    mode_omega_bound: np.ndarray | None = array(
        "bound of the error of mode_omega, as `omega_bound` of modes",
        "sqrt(k/m)", "mode_omega", optional=True,
    )  # fmt: skip

    @property
    def failures(self):
        """How many frequencies missed their accuracy, and how many modes are missing."""
        return super().failures + self.missing
