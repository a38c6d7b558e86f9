"""Damaged and malicious files: pgran refuses them in one line, or accepts them with good reason.

    PYTHONPATH=tests python -m campaigns.fuzz CASES [SEED]

So many changed options files, and so many changed files of bonds and results. Every case is a pure
function of the seed and its number. A process of bounded memory and time reads it, so that a crash
or a hang is noticed. Cases that fail are kept in results/fuzz, and the exit code is 1.
"""

import contextlib
import hashlib
import multiprocessing
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from pathlib import Path

import h5py
import numpy as np

from pgran import PgranError, load
from pgran.command.resolve import resolve
from pgran.medium.bonds import bond_shape
from pgran.medium.bonds_file import read_bonds
from pgran.run.options import read_file
from pgran.store import file as store

SECONDS = 30  # for one case; a real run is given twice as long
MEMORY, ADDRESSES = 500 * 10**6, 2 * 2**30  # bytes: what may be used, and what there is
VERDICTS = ("refused", "accepted", "wrong", "untidy", "memory", "ended")
FOLDER = Path(__file__).resolve().parents[2]
OPTIONS = FOLDER / "options"


def limit():
    """Bound what a process may use."""
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESSES, ADDRESSES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.alarm(SECONDS)
    store.SECONDS = SECONDS / 3


def outcome(task, case):
    """Return a verdict on what a task says of a case, and words."""
    try:
        wrong = task(*case)
    except PgranError as error:
        message = str(error)
        tidy = message.isprintable() and 0 < len(message) < 1100  # a line for a terminal
        return "refused" if tidy else "untidy", message
    except Exception as error:
        return "untidy", f"{type(error).__name__}: {error}"
    used = [resource.getrusage(who).ru_maxrss for who in (0, resource.RUSAGE_CHILDREN)]
    if 1024 * max(used) > MEMORY:
        return "memory", f"{max(used)} kB"
    return "wrong" if wrong else "accepted", wrong


def campaign(name, make, task, count, seed):
    """Make and judge all cases; print one line, and return how many failed.

    `make(folder, rng)` returns the arguments of the task, a path first.
    """
    tally = Counter()
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        with tempfile.TemporaryDirectory() as folder:
            case = make(Path(folder), rng)
            with ProcessPoolExecutor(1, multiprocessing.get_context("fork"), limit) as process:
                try:
                    verdict, said = process.submit(outcome, task, case).result()
                except BrokenProcessPool:
                    verdict, said = "ended", "crashed, or not done in time"
            if verdict not in VERDICTS[:2]:
                kept = Path("results") / "fuzz" / f"{name}-{seed}-{number}{case[0].suffix}"
                kept.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(case[0], kept)
                print(f"{kept}: {verdict}: {said}", file=sys.stderr)
        tally[verdict] += 1
    figures = ", ".join(f"{tally[verdict]} {verdict}" for verdict in VERDICTS)
    print(f"{name}: {count} cases, seed {seed}: {figures}")
    return count - tally["refused"] - tally["accepted"]


def change_bytes(content, rng):
    """Overwrite, cut, move or clear bytes, often where HDF5 says what a file holds."""
    changed, size = bytearray(content), len(content)
    near = min(size, 3000) if rng.random() < 0.7 else size
    first, second = sorted(map(int, rng.integers(0, near, 2)))
    match rng.integers(4):
        case 0:
            for place in rng.integers(0, near, rng.integers(1, 20)):
                changed[place] = rng.integers(256)
        case 1:
            del changed[rng.integers(1, size) :]
        case 2:
            changed[second:second], changed[first : first + 8] = changed[first : first + 8], b""
        case 3:
            changed[first:second] = bytes([rng.choice([0, 255])]) * (second - first)
    return bytes(changed)


# Options files


VALUES = (
    "0", "-1", "1e999", "-1e308", "1e-320", "nan", "1_0", "0x10", "\u00b2", "\uff13", "1.5", "--",
    "x", "7", ".8", "4,2", "1,2,3,4,5", "1000000000,1000000000", 30 * "9", 5000 * "9",
)  # fmt: skip
LINES = """\
-steady_pc_type python; -steady_pc_python_type a.b; -steady_ksp_view ascii:harm; -history harm
-normal_eps_view binary:harm; -steady_ksp_view binary; -log_view :harm; -log_trace harm; -info harm
-malloc_dump harm; -citations harm; -start_in_debugger; -on_error_attach_debugger
-dll_append harm.so; -python; -options_file harm; -prefix_push steady_; -saws_root harm
-steady_mat_mumps_ooc_tmpdir harm; -steady_mat_mumps_icntl_3 7; -viewer_binary_filename harm
-steady_pc_mg_dump_binary; -help; -petsc_sleep 5; -steady_ksp_monitor; -log_view; -options_left
-steady_ksp_type gmres; -steady_ksp_type nonsense; -steady_pc_type none; -steady_ksp_max_it 2
-steady_ksp_rtol 1e999; -normal_eps_tol 1e-300; -normal_eps_nev 99999999999
-output_file /dev/full; -output_file .; -bonds_law file; -bonds_file /dev/zero -bonds_law file
-output_overwrite; -modes_count 99999999999; -relax_steps 5; -ranks_per_lattice 3; -detectors 0,0,0
""".replace("\n", "; ").split("; ")
LINES += ["\0", "\x1b[2J", "\u2028", "\ufeff", "'", '"', "\\", 10**5 * "x", "-" + 10**4 * "y"]
TINY = {  # what keeps a real run short, whatever the file says
    "response": "-lattice_shape 4,3 -detectors 2,1 -sweep_points 7",
    "continuum": "-sweep_points 7 -sweep_max 40",
    "modes": "-lattice_shape 4,3",
    "projection": "-lattice_shape 4,3",
    "relaxation": "-lattice_shape 4,3 -detectors 2,1 -relax_steps 2500 -relax_trajectories 1",
    "accuracy": "-lattice_shape 4,3 -accuracy_repeats 1",
    "ensemble": "-lattice_shape 4,3 -ensemble_samples 2",
    "pulse": "-lattice_shape 4,3 -detectors 2,1 -pulse_time 20 -pulse_points 21",
    "sensitivity": "-lattice_shape 4,3 -detectors 2,1 -sweep_points 3",
    "structure": "-lattice_shape 4,3 -structure_count 2 -sweep_points 7",
    "loud": "-lattice_shape 4,3 -detectors 2,1 -sweep_points 2 "
    "-loud_harmonics 2 -loud_stability false -loud_amplitudes .1 -bonds_hertz 1",
    "green": "-lattice_shape 4,3 -green_sources 2,1 -sweep_points 3",
}
RUN = 0.2  # what part of those accepted is run as a program


def options(folder, rng):
    """Write an experiment with one or two changes, and say whether it is to be run."""
    content = rng.choice(sorted(OPTIONS.glob("*.opts"))).read_bytes()
    for _ in range(rng.integers(1, 3)):
        if rng.random() < 0.25:
            content = change_bytes(content, rng)
            continue
        lines = content.split(b"\n")
        number = rng.integers(len(lines))
        if lines[number].startswith(b"-"):
            lines[number] = lines[number].split()[0] + f" {rng.choice(VALUES)}".encode()
        else:
            lines.insert(number, str(rng.choice(LINES)).encode())
        content = b"\n".join(lines)
    (folder / "case.opts").write_bytes(content)
    return folder / "case.opts", rng.random() < RUN


def check_options(path, run):
    """Resolve a file; what is accepted must come back from its own text, and must do no harm."""
    resolved = resolve(read_file(path), output_file="results/case.h5")
    again = path.with_suffix(".again")
    again.write_text(resolved.text(), encoding="utf-8")
    if resolve(read_file(again)).text() != resolved.text():
        return "its resolved text means something else"
    values = resolved.solver.values()
    harm = [v for v in values if "harm" in v or "pyth" in v or set(v) & set(":/")]
    return f"harmful values {harm}" if harm else run and run_options(path, TINY[resolved.scene])


def run_options(path, tiny):
    """Run a case as a program: exit code, messages, and the files it leaves."""
    room = path.parent / "room"
    room.mkdir()
    words = ["timeout", str(2 * SECONDS), sys.executable, "-m", "pgran", "run", path]
    done = subprocess.run(
        [*words, *tiny.split(), "-output_progress", "none"],
        capture_output=True, cwd=room, text=True, errors="replace",
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(FOLDER), *sys.path])},
    )  # fmt: skip
    # but for what a run is, which it may say before it meets the error: response of a ...
    said = re.findall("^pgran(?!: [a-z]+ of ).*", done.stderr, re.MULTILINE)
    if done.returncode not in (0, 2, 3, 4) or "Traceback" in done.stderr:
        return f"exit code {done.returncode}: {done.stderr[-300:]}"
    if done.returncode in (2, 4) and len(said) != 1:
        return f"refused in {len(said)} lines: {' | '.join(said[:3])}"
    left = [p.name for p in room.rglob("*") if p.is_file() and not store.is_result(p)]
    return left and f"it left {left}"


# HDF5 files


SHAPE, SIZE = (3, 2), (4, 2)  # of a lattice, and of its bonds along the first axis
LAYOUTS = ({}, {"chunks": True}, {"compression": "gzip", "shuffle": True})
VIRTUAL = h5py.VirtualLayout(SIZE, float)
VIRTUAL[...] = h5py.VirtualSource("/dev/zero", "lattice/stiffness_x", SIZE)
LINKS = [h5py.SoftLink("/lattice"), h5py.SoftLink("/lattice/stiffness_y"), h5py.SoftLink("no"),
         h5py.ExternalLink("/dev/zero", "/"), h5py.ExternalLink("case.h5", "/lattice")]  # fmt: skip
TYPES = (
    "S5", complex, bool, [("a", float), ("b", "S3")], h5py.string_dtype(), h5py.ref_dtype,
    h5py.vlen_dtype(float), "V7", h5py.opaque_dtype(np.dtype("M8[s]")),
)  # fmt: skip
NUMBERS = "f2", "f16", "u8", "i1", h5py.enum_dtype({"a": 1, "b": 2}, "i4")
SHAPES = (), (0,), (0, 3), (1, 2), (4, 3), (2, 2, 2), (1, 2, 3, 4)
REAL = {"shape": SIZE, "dtype": float}
# What takes the place of bonds: nothing, a link, words for an array; and why they are refused, if
# they must be.
PLACED = (
    (None, "needs stiffness_x"),
    *((link, "is a link; links are not read") for link in LINKS),
    (VIRTUAL, "lies in another file"),
    (REAL | {"external": [("/dev/zero", 0, 64)]}, "lies in another file"),
    *((REAL | {"dtype": kind}, "/stiffness_x holds no real numbers") for kind in TYPES),
    *((REAL | {"dtype": kind}, None) for kind in NUMBERS),
    *((REAL | {"shape": shape}, "/lattice/stiffness") for shape in SHAPES),
    (REAL | {"dtype": np.dtype((float, (2, 2)))}, "/lattice/stiffness"),
    ({"data": h5py.Empty(float)}, "/stiffness_x is empty"),
    (REAL | {"shape": (10**6, 10**6), "chunks": (5000, 10000)}, "far more than the file holds"),
    ({"data": np.zeros(9 * 10**6), "compression": 1}, "far more than the file holds"),
    *(({"data": np.full(SIZE, value)}, "every bond constant must be") for value in (-1, np.nan)),
    ({"data": np.full(SIZE, np.longdouble(1e308) * 100)}, "every bond constant must be finite"),
    ({"data": np.full(SIZE, 1e308)}, None),
)
ATTRIBUTES = ("text", 1e308, -1, np.ones(4000), [b"a"], h5py.Empty("f"), 1 + 2j, np.nan)


def write_result(folder):
    """Let pgran write a result into a folder; whole, it is accepted."""
    words = f"-lattice_shape 3,2 -detectors 2,1 -output_file {folder}/result.h5 -output_fields"
    run = [sys.executable, "-m", "pgran", "run", OPTIONS / "response.opts", *words.split()]
    subprocess.run(run, check=True, cwd=FOLDER, capture_output=True)
    assert check_bonds(folder / "result.h5", True, SHAPE) is None
    return folder / "result.h5"


def bonds(folder, rng, result):
    """Write changed bonds, of a result or of their own: damaged bytes, or another structure."""
    path, of_result = folder / "case.h5", rng.random() < 0.5
    if of_result:
        shutil.copy(result, path)
    else:
        layout = LAYOUTS[rng.integers(len(LAYOUTS))]
        with h5py.File(path, "w", userblock_size=512 * rng.integers(2)) as file:
            for axis, name in enumerate("xy"):
                k = rng.random(bond_shape(SHAPE, axis))
                file.create_dataset(f"lattice/stiffness_{name}", data=k, **layout)
    if rng.random() < 0.5:
        path.write_bytes(change_bytes(path.read_bytes(), rng))
        return path, path.read_bytes() == result.read_bytes(), SHAPE
    with h5py.File(path, "r+") as file:
        restructure(file["lattice"], rng)
    if of_result and rng.random() < 0.7:  # closed by h5py it has lost its seal
        content = path.read_bytes()
        seal = f"pgran result 2\nsha256 {hashlib.sha256(content).hexdigest()}\n"
        path.write_bytes(content + seal.encode().ljust(512, b"\0"))
    return path, of_result, None


def restructure(group, rng):
    """Put odd attributes and names beside the bonds, or something else in their place."""
    if rng.random() < 0.2:
        for key in ("mass", "omega_mx", "shape", "x\n\x1b[2J"):
            group.attrs[key] = ATTRIBUTES[rng.integers(len(ATTRIBUTES))]
        group["\x1b[2J\n"] = group  # it holds itself
        return
    placed, _ = PLACED[rng.integers(len(PLACED))]
    if isinstance(placed, dict) and rng.random() < 0.5:
        del group["stiffness_y"]
    place(group, placed)


def place(group, placed):
    """Put something in the place of the bonds along the first axis."""
    del group["stiffness_x"]
    if isinstance(placed, dict):
        group.create_dataset("stiffness_x", **placed)
    elif placed is VIRTUAL:
        group.create_virtual_dataset("stiffness_x", placed)
    elif placed:
        group["stiffness_x"] = placed


def check_bonds(path, of_result, shape):
    """Read a file as a result and as bonds; say what is wrong with what was accepted.

    Damage to numbers cannot be told from other numbers, but they are still possible ones.
    """
    with contextlib.suppress(PgranError):
        load(path)
        if not of_result:
            return "load accepted what is no result"
    stiffness, kmax = read_bonds(path)
    found = tuple(n - (axis == 0) for axis, n in enumerate(np.shape(stiffness[0])))
    if found != (shape or found) or len(found) != len(stiffness) or min(found) < 1:
        return f"accepted {len(stiffness)} arrays for {found} balls"
    for axis, k in enumerate(stiffness):
        if k.shape != bond_shape(found, axis) or k.dtype != float:
            return f"accepted shape {k.shape}, type {k.dtype} along axis {axis}"
        if not (np.isfinite(k) & (k >= 0)).all():
            return f"accepted {k.min()} along axis {axis}"
    return None if kmax is None or 0 < kmax < np.inf else f"accepted kmax = {kmax}"


def main(count, seed=1):
    """Carry out both campaigns; return the exit code."""
    count, seed = int(count), int(seed)
    failed = campaign("options", options, check_options, count, seed)
    with tempfile.TemporaryDirectory() as folder:
        result = write_result(Path(folder))
        failed += campaign("bonds", partial(bonds, result=result), check_bonds, count, seed)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
