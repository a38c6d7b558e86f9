"""How modes resound: their widths, how strongly a drive pushes them, and what detectors see of it.

To first order in the damping, where modes stand apart, detector d moves by

    A_d = sum_i 2 omega_i R_i / (omega_i^2 - omega^2 + i omega Gamma_i),

with the residues R_i = (e_d^T f_i) (f_i^T f) / (2 m omega_i), f the force of the drive at rest, e_d
what the detector reads. A mode alone has its peak |A_d| = 2 |R_i| / Gamma_i at omega_i.
"""

import numpy as np

from pgran.experiments.modes.levels import modal_widths
from pgran.store.record import ball_names

LOUDEST = 3  # modes that a summary names


def drive_of(medium):
    """Return both parts of the drive f(s) = f + s f', over the unknowns."""
    springs = medium.springs
    parts = medium.moduli, medium.damping * springs.damped
    rest, dashpots = (-springs.B.T @ (part * springs.drive) for part in parts)
    return rest + (0.0 if medium.pushed is None else np.ravel(medium.pushed)), dashpots


class Resonances:
    """What the modes of a medium mean to its drive, if it has one, and to detectors, if any."""

    def __init__(self, medium, detectors=None):
        self.medium, self.sites = medium, None
        self.force = medium.driving.ravel()
        self.driven = bool(np.any(self.force))
        if detectors is not None:
            self.sites = medium.sites(detectors, "-modes_detectors")
            self.unknowns, self.weights = medium.readings(self.sites)

    @property
    def left_out(self):
        """Arrays of a mode's row that there are not."""
        return ("source",) * (not self.driven) + ("reading",) * (self.sites is None)

    def of(self, vectors):
        """Return arrays by their names in `record.Modes`, of modes f, a row of `vectors` each."""
        flat = vectors.reshape(len(vectors), self.medium.size)
        found = {"width": modal_widths(self.medium, vectors)}
        if self.driven:
            found["source"] = flat @ self.force
        if self.sites is not None:
            found["reading"] = np.sum(self.weights * flat[:, self.unknowns], axis=2)
        return found

    def residues(self, omega, columns):
        """Return residues, shape (nm, nd), NaN of modes at rest or unstable; None if unknown."""
        if not {"source", "reading"} <= columns.keys():
            return None
        whole = np.where(omega > 0, 2 * self.medium.mass * omega, np.nan)
        return columns["reading"] * (columns["source"] / whole)[:, None]


def summary(modes, si):
    """Yield in words how wide the moving modes of a record are, and which of them sound loudest."""
    sharp = None if modes.width is None else modes.quality[modes.omega > 0]
    if sharp is None or not np.isfinite(sharp).any():
        return
    yield f"quality omega / width: median {np.median(sharp):.3g}, {sharp.min():.3g} at least"
    for d, ball in enumerate([] if modes.residue is None else ball_names(modes.detector)):
        peaks = np.nan_to_num(modes.peak[:, d])
        loudest = [f"{modes.omega[n]:.6g}{si.say('Hz', modes.omega[n])} with |A| = {peaks[n]:.3g}"
                   for n in np.argsort(-peaks)[:LOUDEST]]  # fmt: skip
        yield f"{ball}: the strongest modes, each alone, are at omega = {', '.join(loudest)}"
