"""Extreme cases, run as a user would and judged against references with many digits: one table.

Started by jobs/stability.sh. A file of options/extreme/ says in its comments what must come out:

    # must: be accurate             every point is as accurate as asked, and says so
    # must: be marked               every point is marked as missing its accuracy, exit code 3
    # must: be accurate or marked   each is one or the other
    # must: be refused              one line says why, nothing is computed, exit code 2

and, if it is less, what must come out where ranks share a lattice, `# must, shared: be ...`.
Whatever comes out, no unmarked value may be wrong, no error exceed its bound, nothing end in a
traceback or hang.
"""

import math
import os
import re
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import mpmath
import numpy as np
from reference import Reference, continuum_amplitude, exact_amplitudes

import pgran
from pgran.command.resolve import resolve
from pgran.run.options import read_file

FOLDER = Path(__file__).resolve().parents[2] / "options" / "extreme"
FILES = {path.stem: path for path in sorted(FOLDER.glob("*.opts"))}
LU = "-steady_pc_type lu -steady_pc_factor_mat_solver_type"
SHARED = ("mumps", "superlu_dist")  # with two ranks on one lattice
SECONDS = 60  # for a run that takes about one
STATES = 16  # of a relaxation, compared with the reference
CONTINUUM, MODES = 1e-12, 1e-12  # what the series promises; eigenvalues and residuals, of |K|
mpmath.mp.dps = 60


@dataclass(frozen=True)
class Run:
    """One run of a file: how, its exit code, what it said, and its result if there is one."""

    command: str
    code: int
    said: str
    shared: bool
    result: object


@dataclass(frozen=True)
class Value:
    """A number found, and the exact one, None where none was computed; its bound, NaN if unknown.

    If it is good, it must be exact to `tolerance` times `scale`.
    """

    where: str
    found: complex
    exact: object
    bound: float
    good: bool
    tolerance: float
    scale: object

    @property
    def error(self):
        """The absolute error, in many digits."""
        if self.exact is None:
            return 0
        return abs(mpmath.mpmathify(complex(self.found)) - self.exact)

    def fault(self):
        """Say what is wrong, if anything is."""
        told = "" if self.good else " (marked)"
        if not np.isfinite(self.found):
            return f"{self.where}: {self.found}, not marked" if self.good else None
        if self.error > self.bound:
            return f"{self.where}: error {float(self.error):.1e} above bound {self.bound:.1e}{told}"
        close = self.error <= self.tolerance * self.scale and not mpmath.isinf(self.error)
        if self.good and not close:
            return f"{self.where}: wrong by {float(self.error / self.scale):.1e}, not marked"
        return None


def musts(path, shared=False):
    """Return what may come out, as a set."""
    found = re.findall(r"^# must(, shared)?: be (.+)$", path.read_text(), re.MULTILINE)
    outcomes = {bool(less): set(text.split(" or ")) for less, text in found}
    return outcomes.get(shared, outcomes[False])


def options_of(path):
    """Return the resolved options of a file."""
    return resolve(read_file(path))


def ways(options):
    """Yield (ranks, words) of every way to run an experiment."""
    steady = options.scene in ("response", "relaxation")
    for solver in ("", "petsc", "mumps", "superlu_dist") if steady else ("",):
        for ranks in (1, 2):
            share = solver in SHARED and math.prod(options.lattice_shape) > 1
            words = [*LU.split(), solver, "-ranks_per_lattice", str(ranks if share else 1)]
            yield ranks, words if solver else []


def start(path, ranks=1, words=()):
    """Run a file as a user would."""
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "a.h5"
        launcher = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
        command = [*launcher, sys.executable, "-m", "pgran", "run", str(path), *words]
        done = subprocess.run(  # on the signal of timeout mpirun ends the ranks
            ["timeout", "-k", "5", str(SECONDS), *command, "-output_progress", "none",
             "-output_file", str(output)],
            capture_output=True, text=True, cwd=folder, env=dict(os.environ),
        )  # fmt: skip
        result = pgran.load(output) if output.exists() else None
    shared = "-ranks_per_lattice 2" in " ".join(words)
    return Run(" ".join(command), done.returncode, done.stderr, shared, result)


def judge(path, run):
    """Return the values of a run, what they or the run came out as, and every fault."""
    wanted, values, faults = musts(path, run.shared), [], []
    if run.result is None:
        # but for what a run is, which it may say before it meets the error: response of a ...
        lines = re.findall("^pgran(?!: [a-z]+ of ).*", run.said, re.MULTILINE)
        came = {"refused" if run.code == 2 and len(lines) == 1 else f"nothing, code {run.code}"}
    else:
        options = options_of(path)
        values = list(SCENES[options.scene](path.stem, options, run.result))
        faults += filter(None, (value.fault() for value in values))
        came = {"accurate" if value.good else "marked" for value in values}
        expected = (3, "unconverged") if "marked" in came else (0, "complete")
        if (run.code, run.result.status) != expected:
            faults.append(f"exit code {run.code}, status {run.result.status}, not {expected}")
        if "marked" in came and "miss the accuracy" not in run.said:
            faults.append("nothing said of marked points")
    faults += [f"{word} in the log" for word in ("Traceback", "RuntimeWarning") if word in run.said]
    if not came <= wanted:
        faults.append(f"came out {came}, must be {wanted}: {run.said[-300:]}")
    return values, came, faults


def bonds_of(lattice):
    """Return the bond constants of a result's lattice, an array for each axis."""
    return [lattice.__dict__[f"stiffness_{axis}"].copy() for axis in "xyz"[: len(lattice.shape)]]


known = {}  # exact amplitudes, the same for all runs of a file


def compared(key, options, record, point, good):
    """Yield the amplitudes at all detectors of a point; at the floor only bounds are promised.

    `key` is the file's name and the point's index in the record's arrays; `point` are the bond
    constants, mass, damping and frequency, empty where the exact amplitudes are not asked.
    """
    if point and key not in known:
        known[key] = exact_amplitudes(*point, record.detector)
    for d, exact in enumerate(known.get(key, [None] * len(record.detector))):
        found, bound = record.displacement[key[1:]][d], record.error_bound[key[1:]][d]
        name, tolerance = f"point {key[1:]}, detector {d}", options.error_tolerance
        scale = 1 if exact is None else abs(exact)
        if record.at_floor[key[1:]][d]:
            tolerance, scale = 1.0, options.error_floor
            yield Value(f"bound of {name}", bound, 0, math.nan, good, tolerance, scale)
        yield Value(name, found, exact, bound, good, tolerance, scale)


def judge_response(name, options, result):
    """Compare every frequency and detector."""
    response, lattice = result.response, result.lattice
    for index, omega in enumerate(response.omega.tolist()):
        point = bonds_of(lattice), lattice.mass, lattice.damping, omega
        good = bool(response.converged_reason[index] > 0)
        yield from compared((name, index), options, response, point, good)


def judge_relaxation(name, options, result):
    """Compare the first, the last, and some states between, drawn at random."""
    relaxation, lattice = result.relaxation, result.lattice
    steps = relaxation.stiffness.shape[1]
    drawn = {0, steps, *np.random.default_rng(1).integers(0, steps + 1, STATES).tolist()}
    for trajectory, changes in enumerate(relaxation.stiffness):
        stiffness = bonds_of(lattice)
        for state in range(steps + 1):
            if state > 0:
                place = (trajectory, state - 1)
                axis = relaxation.bond_axis[place]
                stiffness[axis][tuple(relaxation.bond_index[place])] = changes[state - 1]
            point = stiffness, lattice.mass, lattice.damping, relaxation.omega
            good = not np.isnan(relaxation.displacement[trajectory, state]).any()
            key = (name, trajectory, state)
            yield from compared(key, options, relaxation, point if state in drawn else (), good)


def judge_continuum(name, options, result):
    """Compare every frequency."""
    continuum = result.continuum
    for omega, found in zip(continuum.omega, continuum.displacement, strict=True):
        exact = continuum_amplitude(continuum, omega, continuum.point)
        yield Value(f"omega {omega!r}", found, exact, math.nan, True, CONTINUUM, abs(exact))


def judge_modes(name, options, result):
    """Compare count, eigenvalues, residuals and orthogonality in units of |K|."""
    modes, mass = result.modes, result.lattice.mass
    K = Reference(bonds_of(result.lattice)).K
    norm = float(np.abs(K).sum(axis=1).max()) or 1.0
    exact = np.linalg.eigvalsh((K / norm).astype(float))
    if options.modes_omega_min is not None:
        low, high = mass * np.square([options.modes_omega_min, options.modes_omega_max]) / norm
        exact = exact[(exact > low - 1e-10) & (exact < high + 1e-10)]
    good, found = bool(modes.count_certified), mass * modes.omega**2 / norm
    yield Value("count", len(found), len(exact), math.nan, good, 0.0, 1)
    if len(found) == len(exact):
        shapes = modes.vector.reshape(len(found), -1)
        residuals = (shapes @ K / norm - found[:, None] * shapes).astype(float)
        overlap = np.abs(shapes @ shapes.T - np.eye(len(found))).max()
        for what, size, most in (
            ("eigenvalues", np.abs(found - exact).max(initial=0), MODES),
            ("residuals", np.linalg.norm(residuals, axis=1).max(initial=0), MODES),
            ("overlap", overlap, 1e-10),
        ):
            yield Value(what, size, 0, math.nan, good, most, 1)


SCENES = {
    "response": judge_response,
    "relaxation": judge_relaxation,
    "continuum": judge_continuum,
    "modes": judge_modes,
}


def examine(path):
    """Run a file in every way, print its line and its faults, and return whether there are any."""
    began, found, outcomes, faults = time.perf_counter(), [], set(), []
    for ranks, words in ways(options_of(path)):
        run = start(path, ranks, words)
        values, came, wrong = judge(path, run)
        found += values
        outcomes |= came
        faults += [run.command] * bool(wrong) + [f"    {fault}" for fault in wrong[:4]]
    must, came = (" or ".join(sorted(words)) for words in (musts(path), outcomes))
    marked, seconds = sum(not value.good for value in found), time.perf_counter() - began
    sizes = [float(v.error / v.scale) for v in found if v.good and v.tolerance < 1 and v.scale]
    print(
        f"{path.stem:27} {must:18} {'FAILED' if faults else came:18} {max(sizes, default=0):8.1e}"
        f" {marked:5}/{len(found):<6}{seconds:5.0f} s",
        *(f"\n        {line}" for line in faults),
        flush=True,
    )
    return bool(faults)


def main(names):
    """Print the table and the verdict; return the exit code."""
    names = [Path(name).stem for name in names] or list(FILES)
    if unknown := set(names) - set(FILES):
        sys.exit(f"stability: no extreme case is called {', '.join(unknown)}")
    print(f"{'file':27} {'must be':18} {'is':18} {'error':8}  marked")
    failed = [name for name in names if examine(FILES[name])]
    print(f"{len(names)} cases, {len(failed)} failed: {', '.join(failed) or 'none'}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
