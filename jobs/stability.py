"""Extreme cases, run as a user would and judged against references with many digits: one table.

Started by jobs/stability.sh. A file of options/extreme/ says in its comments what must come out:

    # must: be accurate             every point is as accurate as asked, and says so
    # must: be marked               every point is marked as missing its accuracy, exit code 3
    # must: be accurate or marked   each is one or the other
    # must: be refused              one line says why, nothing is computed, exit code 2
    # must: equal OTHER             the amplitudes are those of another file

and, if it is less, what must come out where ranks share a lattice, `# must, shared: be ...`.

Whatever comes out, no unmarked point may be wrong, no error exceed its bound, nothing end in a
traceback or hang.
"""

import math
import re
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import mpmath
import numpy as np

FOLDER = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(FOLDER), str(FOLDER / "tests")]

from reference import Reference, continuum_amplitude, exact_amplitudes  # noqa: E402

import pgran  # noqa: E402
from pgran.files.reading import read_file, resolve  # noqa: E402
from pgran.physics.lattice import AXES  # noqa: E402

FILES = sorted((FOLDER / "options" / "extreme").glob("*.opts"))
LU = "-steady_pc_type lu -steady_pc_factor_mat_solver_type"
SOLVERS = {"": [], **{name: [*LU.split(), name] for name in ("petsc", "mumps", "superlu_dist")}}
SHARED = ("mumps", "superlu_dist")  # with two ranks on one lattice
SECONDS, TIMED_OUT = 60, 124  # for a run that takes about one; exit code of timeout
STATES = 16  # of a relaxation, compared with the reference
CONTINUUM = 1e-12  # what the series promises
MODES = 1e-12  # of |K|: what eigenvalues and residuals promise
mpmath.mp.dps = 60


@dataclass(frozen=True)
class Run:
    """One run of a file: how, its exit code, what it said, and its result if there is one."""

    label: str
    code: int
    said: str
    seconds: float
    shared: bool
    result: object = None


@dataclass
class Judgement:
    """What came out of a run; errors and bounds are relative, the largest of unmarked points."""

    points: int = 0
    marked: int = 0
    error: float = math.nan
    bound: float = math.nan
    refused: bool = False
    faults: list = field(default_factory=list)

    @property
    def outcomes(self):
        """What the points, or the whole run, came out as."""
        if self.refused:
            return {"refused"}
        kinds = {"marked": self.marked > 0, "accurate": self.marked < self.points}
        return {kind for kind, present in kinds.items() if present}

    def add(self, where, found, exact, bound, tolerance, good, at_floor=None):
        """Count a value with its absolute bound, NaN if none is known, and find its faults.

        Of an amplitude at the floor `at_floor` is what its bound must be below.
        """
        error = abs(mpmath.mpmathify(complex(found)) - exact) if np.isfinite(found) else mpmath.inf
        if good and at_floor is not None:
            if not bound <= at_floor:
                self.faults.append(f"{where}: at the floor with the bound {bound:.1e}")
        elif good:
            size = max(abs(exact), mpmath.mpf("1e-9999"))
            self.error = np.fmax(self.error, float(error / size))
            self.bound = np.fmax(self.bound, float(mpmath.mpf(float(bound)) / size))
            if not error <= tolerance * abs(exact) or mpmath.isinf(exact):
                self.faults.append(f"{where}: wrong by {float(error / size):.1e}, not marked")
        if np.isfinite(found) and error > bound:
            told = "" if good else " (marked)"
            self.faults.append(f"{where}: error {float(error):.1e} above bound {bound:.1e}{told}")


def musts(path, shared=False):
    """Return what must come out: a set of outcomes, and which file has the same amplitudes."""
    pattern = r"^# must(, shared)?: (be|equal) (.+)$"
    said = re.findall(pattern, path.read_text(), re.MULTILINE)
    outcomes = {bool(less): set(text.split(" or ")) for less, verb, text in said if verb == "be"}
    other = next((text for _, verb, text in said if verb == "equal"), None)
    return outcomes.get(shared, outcomes[False]), other


def options_of(path):
    """Return the resolved options of a file."""
    return resolve(read_file(path))


def ways(options):
    """Yield (label, ranks, words) of every way to run an experiment."""
    steady = options.scene in ("response", "relaxation")
    for solver, words in SOLVERS.items() if steady else [("", [])]:
        for ranks in (1, 2):
            share = ranks if solver in SHARED and math.prod(options.lattice_shape) > 1 else 1
            sharing = ["-ranks_per_lattice", str(share)] if solver else []
            yield f"{solver or 'default'} on {ranks}", ranks, [*words, *sharing]


def start(path, label, ranks, words, folder, environment=None):
    """Run a file as a user would."""
    output = Path(folder) / f"{path.stem}.h5"
    output.unlink(missing_ok=True)
    command = ["mpirun", "-n", str(ranks), sys.executable, "-m", "pgran", "run", str(path), *words]
    command += ["-output_file", str(output), "-output_overwrite", "-output_progress", "none"]
    command = ["timeout", "-k", "5", str(SECONDS), *command]  # on its signal mpirun ends the ranks
    started = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=folder)
    seconds = time.perf_counter() - started
    result = pgran.load(output) if output.exists() else None
    shared = "-ranks_per_lattice 2" in " ".join(words)
    label = f"{label}: {' '.join(command)}"
    return Run(label, done.returncode, done.stderr, seconds, shared, result)


def judge(path, run):
    """Return what came out of a run, and every fault."""
    judgement, (wanted, _) = Judgement(), musts(path, run.shared)
    faults = judgement.faults
    if run.code == TIMED_OUT:
        faults.append(f"not done after {SECONDS} s")
        return judgement
    if run.result is None:
        judgement.refused = run.code == 2
        lines = [line for line in run.said.splitlines() if line.startswith("pgran")]
        if not judgement.refused or len(lines) != 1 or "refused" not in wanted:
            faults.append(f"exit code {run.code}, no result: {' '.join(run.said.split())[:300]}")
    else:
        options = options_of(path)
        SCENES[options.scene](options, run.result, judgement)
        expected = 3 if judgement.marked else 0
        if run.code != expected:
            faults.append(f"exit code {run.code}, not {expected}")
        if run.result.status != ("unconverged" if judgement.marked else "complete"):
            faults.append(f"status {run.result.status}")
        if judgement.marked and "miss the accuracy" not in run.said:
            faults.append("nothing said of marked points")
    faults += [f"{word} in the log" for word in ("Traceback", "RuntimeWarning") if word in run.said]
    if not judgement.outcomes <= wanted:
        came = " and ".join(sorted(judgement.outcomes))
        faults.append(f"came out {came}, must be {' or '.join(sorted(wanted))}")
    return judgement


def judge_response(options, result, judgement):
    """Judge every frequency and detector."""
    response, lattice = result.response, result.lattice
    judgement.points = len(response.omega)
    judgement.marked = int(np.sum(response.converged_reason <= 0))
    sites = tuple(map(tuple, response.detector.tolist()))
    for point, omega in enumerate(response.omega.tolist()):
        exact = amplitudes(Bonds.of(lattice), lattice.mass, lattice.damping, omega, sites)
        for d, value in enumerate(exact):
            judgement.add(
                f"omega {omega!r}, ball {sites[d]}", response.displacement[point, d], value,
                response.error_bound[point, d], options.error_tolerance,
                response.converged_reason[point] > 0,
                options.error_floor if response.at_floor[point, d] else None,
            )  # fmt: skip


def judge_relaxation(options, result, judgement):
    """Judge the first, the last, and some states between, drawn at random."""
    relaxation, lattice = result.relaxation, result.lattice
    good = ~np.isnan(relaxation.displacement).any(axis=2)
    judgement.points, judgement.marked = good.size, int(np.sum(~good))
    sites = tuple(map(tuple, relaxation.detector.tolist()))
    steps = relaxation.stiffness.shape[1]
    drawn = np.random.default_rng(1).integers(0, steps + 1, STATES)
    for trajectory in range(len(good)):
        axes, indices, constants = (
            getattr(relaxation, name)[trajectory]
            for name in ("bond_axis", "bond_index", "stiffness")
        )
        for state in sorted({0, steps, *drawn.tolist()}):
            stiffness = [k.copy() for k in Bonds.of(lattice).stiffness]
            for axis, index, k in zip(axes[:state], indices, constants, strict=False):
                stiffness[axis][tuple(index)] = k
            network = Bonds(stiffness)
            exact = amplitudes(network, lattice.mass, lattice.damping, relaxation.omega, sites)
            for d, value in enumerate(exact):
                judgement.add(
                    f"state {state}, ball {sites[d]}",
                    relaxation.displacement[trajectory, state, d], value,
                    relaxation.error_bound[trajectory, state, d], options.error_tolerance,
                    good[trajectory, state],
                    options.error_floor if relaxation.at_floor[trajectory, state, d] else None,
                )  # fmt: skip


def judge_continuum(options, result, judgement):
    """Judge every frequency."""
    continuum = result.continuum
    judgement.points = len(continuum.omega)
    for omega, found in zip(continuum.omega, continuum.displacement, strict=True):
        exact = continuum_amplitude(continuum, omega, continuum.point)
        judgement.add(f"omega {omega!r}", found, exact, math.nan, CONTINUUM, good=True)


def judge_modes(options, result, judgement):
    """Judge count, eigenvalues, residuals and orthogonality in units of |K|."""
    modes, lattice = result.modes, result.lattice
    K = Reference(Bonds.of(lattice).stiffness).K
    norm = float(np.abs(K).sum(axis=1).max()) or 1.0
    exact = np.linalg.eigvalsh((K / norm).astype(float))
    if options.modes_omega_min is not None:
        ends = (options.modes_omega_min, options.modes_omega_max)
        low, high = (lattice.mass * omega**2 / norm for omega in ends)
        exact = exact[(exact > low - 1e-10) & (exact < high + 1e-10)]
    judgement.points = len(exact)
    judgement.marked = 0 if modes.count_certified else max(1, abs(len(exact) - len(modes.omega)))
    if len(modes.omega) != len(exact):
        if modes.count_certified:
            judgement.faults.append(f"{len(modes.omega)} modes, not {len(exact)}, but certified")
        return
    found = lattice.mass * modes.omega**2 / norm
    shapes = modes.vector.reshape(len(found), -1)
    residuals = np.linalg.norm((shapes @ K / norm - found[:, None] * shapes).astype(float), axis=1)
    overlap = np.abs(shapes @ shapes.T - np.eye(len(found))).max()
    judgement.error = float(np.abs(found - exact).max())
    judgement.bound = float(residuals.max())
    if modes.count_certified and not max(judgement.error, judgement.bound) <= MODES:
        judgement.faults.append(
            f"eigenvalues wrong by {judgement.error:.1e}, residuals {judgement.bound:.1e} of |K|"
        )
    if not overlap <= 1e-10:
        judgement.faults.append(f"modes overlap by {overlap:.1e}")


SCENES = {
    "response": judge_response,
    "relaxation": judge_relaxation,
    "continuum": judge_continuum,
    "modes": judge_modes,
}


class Bonds:
    """Bond constants that can be a key of a cache."""

    def __init__(self, stiffness):
        """Keep the arrays."""
        self.stiffness = stiffness
        self.key = b"".join(k.tobytes() for k in stiffness)

    @classmethod
    def of(cls, record):
        """Return those of a result."""
        names = [f"stiffness_{axis}" for axis in AXES]
        return cls([getattr(record, name) for name in names if hasattr(record, name)])

    def __eq__(self, other):
        """Compare bit for bit."""
        return self.key == other.key

    def __hash__(self):
        """Go by all constants."""
        return hash(self.key)


@cache
def amplitudes(network, mass, damping, omega, sites):
    """Return the exact amplitudes at some balls, computed once for all runs."""
    return exact_amplitudes(network.stiffness, mass, damping, omega, sites)


def compare(path, run, judgement, folder):
    """Find where the amplitudes are not those of the file that must have the same."""
    _, other = musts(path)
    if other is None or run.result is None:
        return
    twin = start(path.with_name(other), other, 1, [], folder).result.response
    own, tolerance = run.result.response, options_of(path).error_tolerance
    apart = np.abs(own.displacement / twin.displacement - 1).max()
    if not apart <= tolerance:
        judgement.faults.append(f"amplitudes differ from those of {other} by {apart:.1e}")
    if not np.array_equal(own.converged_reason > 0, twin.converged_reason > 0):
        judgement.faults.append(f"not the points of {other} are marked")


def examine(path, folder):
    """Run a file in every way, print its line and its faults, and return whether there are any."""
    wanted, other = musts(path)
    found, seconds, faults = [], 0.0, []
    for way in ways(options_of(path)):
        run = start(path, *way, folder)
        judgement = judge(path, run)
        compare(path, run, judgement, folder)
        found.append(judgement)
        seconds += run.seconds
        if judgement.faults:
            faults += [run.label, *(f"    {fault}" for fault in judgement.faults[:4])]
            more = len(judgement.faults) - 4
            faults += [f"    and {more} more"] * (more > 0)
    must = " or ".join(sorted(wanted)) + (f", as {other.removesuffix('.opts')}" if other else "")
    came = "FAILED" if faults else " or ".join(sorted(set.union(*(j.outcomes for j in found))))
    error, bound = (
        f"{np.fmax.reduce([getattr(j, name) for j in found]):.1e}" for name in ("error", "bound")
    )
    marked = f"{max(j.marked for j in found)}/{max(j.points for j in found)}"
    row(path.stem, must, came, error, bound, marked, f"{seconds:.1f}")
    for line in faults:
        print(f"        {line}", flush=True)
    return bool(faults)


def row(name, must, came, *figures):
    """Print a line of the table."""
    print(
        f"{name:27} {must:27} {came:19}",
        *(f"{f.replace('nan', '-'):>8}" for f in figures),
        flush=True,
    )


def main(names):
    """Print the table and the verdict; return the exit code."""
    chosen = {Path(name).stem for name in names} or {path.stem for path in FILES}
    unknown = chosen - {path.stem for path in FILES}
    if unknown:
        print(f"no such file in options/extreme: {', '.join(sorted(unknown))}")
        return 2
    row("file", "must be", "is", "error", "bound", "marked", "seconds")
    with tempfile.TemporaryDirectory() as folder:
        failed = [path.stem for path in FILES if path.stem in chosen and examine(path, folder)]
    print(
        f"{len(chosen)} cases, {len(failed)} failed: {', '.join(failed)}"
        if failed
        else f"all {len(chosen)} cases came out as they must"
    )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
