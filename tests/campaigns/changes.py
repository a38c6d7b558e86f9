"""Files that change under a run: it never goes on with numbers of the old and of the new one.

    python -m campaigns.changes TRIALS

Each trial stops a run that reads a file, changes what the file holds, and gives the same command:
it must be refused by the name of the option, and lose nothing. Then the run goes on with the old
file, or begins anew with the new one, on another number of ranks, and its result is that of a run
never stopped.
"""

import contextlib
import os
import signal
import sys
import tempfile
from pathlib import Path

import h5py
import numpy as np
from campaigns import faults

SEED = 1993
SIDE = 8  # balls along each side of what is written


def write_network(path, rng):
    """Write a square of balls between two walls."""
    ball = np.arange(SIDE**2).reshape(SIDE, SIDE)
    pairs = [(ball[:-1], ball[1:]), (ball[:, :-1], ball[:, 1:])]
    bond = np.concatenate([np.stack(pair, axis=-1).reshape(-1, 2) for pair in pairs])
    with h5py.File(path, "w") as file:
        file["network/bond"] = bond
        file["network/stiffness"] = rng.uniform(0.05, 0.25, len(bond))
        file["network/held"] = np.repeat([2, *(SIDE - 2) * [0], 1], SIDE)
        file["network/mass"] = np.ones(SIDE**2)
        file["network"].attrs["damping"] = 0.01


def write_bonds(path, rng):
    """Write the bonds of a lattice."""
    with h5py.File(path, "w") as file:
        file["lattice/stiffness_x"] = rng.uniform(0.0, 0.25, (SIDE + 1, SIDE))
        file["lattice/stiffness_y"] = rng.uniform(0.0, 0.25, (SIDE, SIDE + 1))


def write_motion(path, rng):
    """Write a bell times a cosine, a displacement at each time that is recorded."""
    time = np.linspace(0, 600, 1201)
    bell = np.exp(-(((time - rng.uniform(150, 250)) / 30) ** 2) / 2)
    np.savetxt(path, bell * np.cos(rng.uniform(0.2, 0.8) * time))


def write_solver(path, rng):
    """Write keys of a solver."""
    path.write_text(f"-steady_refresh_iterations {rng.integers(2, 10**6)}\n")


# Of each option that names a file, or files: what writes one at random.
WRITERS = {
    "network_file": write_network,
    "bonds_file": write_bonds,
    "pulse_file": write_motion,
    "accuracy_solvers": write_solver,
}
LATTICE = "-lattice_shape 8,8 -lattice_damping .01"
SCENES = {
    "response": "-scene response -network_file FILE -detectors 20 -sweep_points 900 "
    "-sweep_method points",
    "curve": "-scene response -network_file FILE -detectors 20 -sweep_points 3000 "
    "-sweep_method curve",
    "density": "-scene modes -network_file FILE -modes_density 2000",
    "relaxation": "-scene relaxation -network_file FILE -detectors 20 -relax_steps 8000",
    "sensitivity": "-scene sensitivity -network_file FILE -detectors 20 -sweep_points 300",
    "pulse": "-scene pulse -network_file FILE -detectors 20 -pulse_method laplace",
    "bonds": "-scene response -bonds_law file -bonds_file FILE -detectors 3,3 -sweep_points 900 "
    "-sweep_method points -lattice_damping .01",
    "motion": f"-scene pulse {LATTICE} -pulse_file FILE -detectors 3,3 -pulse_method laplace",
    "solvers": f"-scene accuracy {LATTICE} -accuracy_solvers FILE -detectors 3,3 -sweep_points 100 "
    "-accuracy_tolerances 1e-3,1e-6,1e-9",
}
TIMED = ("seconds", "seconds_min", "seconds_max", "on_front")  # of a study of accuracy


def option_of(scene):
    """Return which option of a scene names the file."""
    return next(name for name in WRITERS if f"-{name} FILE" in SCENES[scene])


def make_folder(scene, rng):
    """Return a new folder with the options file of a scene, and the file that it reads."""
    folder = Path(tempfile.mkdtemp(prefix="changes", dir="."))
    (folder / "a.opts").write_text(SCENES[scene].replace(" -", "\n-").replace("FILE", "read"))
    (folder / "results").mkdir()
    WRITERS[option_of(scene)](folder / "read", rng)
    return folder


def finish(folder, ranks, *words):
    """Let a run come to its end; return what its result holds, but times."""
    job = faults.Job(folder, ranks, *words)
    code, _ = job.end()
    assert code == 0, f"exit code {code} {job}"
    held = faults.contents(folder / faults.RESULT)
    return {name: value for name, value in held.items() if not name.endswith(TIMED)}, str(job)


def change(number):
    """Stop a run, change the file that it reads, and give the same command."""
    rng = np.random.default_rng([SEED, 2, number])
    scene, (ranks, again) = list(SCENES)[number % len(SCENES)], rng.integers(1, 3, 2).tolist()
    folder = make_folder(scene, rng)
    job = faults.Job(folder, ranks)
    job.wait_for(lambda: faults.units_kept(folder) > 0)
    with contextlib.suppress(ProcessLookupError):
        os.kill(job.process.pid, signal.SIGUSR1)
    code, seconds = job.end()
    if code == 0:
        return f"{option_of(scene)}, too late", seconds
    assert code == 75, f"exit code {code} {job}"
    journal, old = (folder / faults.JOURNAL).read_bytes(), (folder / "read").read_bytes()
    (folder / "read").unlink()
    WRITERS[option_of(scene)](folder / "read", rng)
    job = faults.Job(folder, again)
    code, _ = job.end()
    assert code == 2, f"exit code {code} {job}"
    assert f"-{option_of(scene)}: {faults.JOURNAL} holds" in str(job), f"names no option {job}"
    assert (folder / faults.JOURNAL).read_bytes() == journal, f"another journal {job}"
    words = ["-output_overwrite"]
    if rng.random() < 0.5:
        (folder / "read").write_bytes(old)
        words = []
    found, said = finish(folder, again, *words)
    assert ("going on from there" in said) == (not words), f"went on, or anew? {said}"
    (folder / faults.RESULT).unlink()
    assert found == finish(folder, 1)[0], f"numbers of another run in {folder}"
    return f"{option_of(scene)}, {'anew' if words else 'gone on with'}", seconds


if __name__ == "__main__":
    sys.exit(faults.campaign(change, count=int(sys.argv[1])))
