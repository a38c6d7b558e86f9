"""Damaged and malicious files: pgran refuses them in one line, or accepts them with good reason.

    PYTHONPATH=tests python -m campaigns.fuzz CASES [SEED]

So many changed options files, and so many changed files of bonds and results. Every case is a pure
function of the seed and its number. A process of bounded memory and time reads it, so that a crash
or a hang is noticed. Cases that fail are kept in results/fuzz, and the exit code is 1.
"""

import contextlib
import hashlib
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from functools import partial
from pathlib import Path

import h5py
import numpy as np

from pgran.command.resolve import resolve
from pgran.errors import PgranError
from pgran.files import hdf5, store
from pgran.files.reading import read_file
from pgran.physics.lattice import bond_shape

SECONDS = 30  # for one case; a real run is given twice as long
MEMORY, ADDRESSES = 500 * 10**6, 2 * 2**30  # bytes: what may be used, and what ends the process
VERDICTS = ("refused", "accepted", "wrong", "crash", "hang", "untidy", "memory")
FOLDER = Path(__file__).resolve().parents[2]
OPTIONS = FOLDER / "options"


# One case


def judge(task, *case):
    """Carry out a task in a process that may die of it; return a verdict, words, and bytes used."""
    here, there = os.pipe()
    child = os.fork()
    if child == 0:
        os.setpgid(0, 0)
        resource.setrlimit(resource.RLIMIT_AS, (ADDRESSES, ADDRESSES))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        signal.alarm(SECONDS)
        hdf5.SECONDS = SECONDS / 3
        os.write(there, " ".join(outcome(task, *case)).encode()[:2000])
        os._exit(0)
    os.close(there)
    with open(here, errors="replace") as pipe:
        verdict, _, said = pipe.read().partition(" ")
    _, status, used = os.wait4(child, 0)
    with contextlib.suppress(ProcessLookupError):  # what it may have started
        os.killpg(child, signal.SIGKILL)
    memory = 1024 * used.ru_maxrss
    if os.WIFSIGNALED(status):
        verdict = "hang" if os.WTERMSIG(status) == signal.SIGALRM else "crash"
        said = f"ended by signal {os.WTERMSIG(status)}"
    if memory > MEMORY:
        verdict, said = "memory", f"{memory / 1e6:.0f} MB"
    return verdict, said, memory


def outcome(task, *case):
    """Return whether a task refuses a file or accepts it, and what it says."""
    try:
        wrong = task(*case)
    except PgranError as error:
        message = str(error)
        tidy = message.isprintable() and 0 < len(message) < 1100  # a line for a terminal
        return "refused" if tidy else "untidy", message
    except Exception as error:
        return "untidy", f"{type(error).__name__}: {error}"
    return "wrong" if wrong else "accepted", wrong or ""


def campaign(name, make, task, count, seed, more=None):
    """Make and judge all cases; print one line, and return how many failed.

    `make(folder, rng)` returns the arguments of the task, a path first; `more(path, verdict, rng)`
    has the last word on what the task refused or accepted.
    """
    tally, most = Counter(), 0
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        with tempfile.TemporaryDirectory() as folder:
            path, *rest = make(Path(folder), rng)
            verdict, said, memory = judge(task, path, *rest)
            if more and verdict in VERDICTS[:2]:
                verdict, said = more(path, verdict, rng) or (verdict, said)
            if verdict not in VERDICTS[:2]:
                kept = Path("results") / "fuzz" / f"{name}-{seed}-{number}{path.suffix}"
                kept.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(path, kept)
                print(f"{kept}: {verdict}: {said}", file=sys.stderr)
        tally[verdict], most = tally[verdict] + 1, max(most, memory)
    figures = ", ".join(f"{tally[verdict]} {verdict}" for verdict in VERDICTS)
    print(f"{name}: {count} cases, seed {seed}: {figures}; at most {most / 1e6:.0f} MB")
    return count - tally["refused"] - tally["accepted"]


# Options files


VALUES = (
    "0", "-1", "1e999", "1e308", "-1e308", "1e-320", "nan", "inf", "1_0", "0x10", "1e5", "\u00b2",
    "\uff13", "1.5", "--", "x", "3", "7", "0.2", ".8", "4,2", "1,2,3,4,5", "1000000000,1000000000",
    "1" + 14 * "0", 30 * "9", 5000 * "9",
)  # fmt: skip
KEYS = """\
-steady_pc_type python; -steady_pc_python_type a.b; -steady_ksp_view ascii:harm; -history harm
-steady_ksp_view :harm; -normal_eps_view binary:harm; -steady_ksp_view binary; -log_view :harm
-steady_ksp_monitor ascii:harm; -log_trace harm; -log_all; -info harm; -history; -malloc_dump harm
-citations harm; -start_in_debugger; -on_error_attach_debugger; -dll_append harm.so; -python
-options_file harm; -prefix_push steady_; -steady_mat_mumps_ooc_tmpdir harm; -saws_root harm
-steady_mat_mumps_icntl_3 7; -viewer_binary_filename harm; -steady_pc_mg_dump_binary; -help
-version; -petsc_sleep 5; -steady_ksp_view; -steady_ksp_monitor; -log_view; -info; -options_left
-options_view; -steady_ksp_type gmres; -steady_ksp_type nonsense; -steady_pc_type ilu
-steady_pc_type none; -steady_ksp_max_it 2; -steady_ksp_rtol -1; -steady_ksp_rtol 1e999
-normal_eps_tol 1e-300; -normal_eps_type lapack; -normal_eps_nev 99999999999
-normal_st_type nonsense; -output_file /dev/full; -output_file /proc/harm; -output_file .
-bonds_law file; -bonds_file /dev/zero -bonds_law file; -bonds_file . -bonds_law file
-output_overwrite; -modes_target .5; -modes_count 99999999999; -relax_steps 5; -bonds_kmin 1
-continuum_damping 0; -ranks_per_lattice 3; -output_progress bar; -detectors 0,0,0
""".replace("\n", "; ").split("; ")
ODD = ("\0", "\x1b[2J", "\u2028", "\ufeff", "'", '"', "\\", 10**5 * "x", "-" + 10**4 * "y")
TINY = {  # what keeps a real run short, whatever the file says
    "response": "-lattice_shape 4,3 -detectors 2,1 -sweep_points 7",
    "continuum": "-sweep_points 7 -sweep_max 40",
    "modes": "-lattice_shape 4,3",
    "projection": "-lattice_shape 4,3",
    "relaxation": "-lattice_shape 4,3 -detectors 2,1 -relax_steps 2500 -relax_trajectories 1",
}
RUNS = {"accepted": 0.2, "refused": 0.02}  # what part of the cases is run as a program


def options(folder, rng):
    """Write an experiment, some with the choices of a solver, with one to three changes."""
    content = rng.choice(sorted(OPTIONS.glob("*.opts"))).read_bytes()
    if rng.random() < 0.3:
        content += rng.choice(sorted(OPTIONS.glob("solvers/*.opts"))).read_bytes()
    for _ in range(rng.choice([1, 1, 1, 2, 3])):
        how = rng.random()
        if how < 0.75:
            lines = content.split(b"\n")
            change_line(lines, rng)
            content = b"\n".join(lines)
        elif how < 0.95:
            content = change_bytes(content, rng) if content else b""
        else:
            content = (content * 2000)[: 2**21]
    path = folder / "case.opts"
    path.write_bytes(content)
    return (path,)


def change_line(lines, rng):
    """Insert a line, give a key another value, or delete, double or swap words."""
    numbers = [n for n, line in enumerate(lines) if line.startswith(b"-")]
    kind = rng.integers(5) if numbers else 0
    if kind < 2:
        some = rng.choice(KEYS) if rng.random() < 0.7 else ODD[rng.integers(len(ODD))]
        lines.insert(rng.integers(len(lines) + 1), str(some).encode())
        return
    number = rng.choice(numbers)
    parts = lines[number].split(b" ")
    one, other = rng.integers(0, len(parts), 2)
    if kind < 4:
        parts[1:] = [str(rng.choice(VALUES)).encode()]
    elif rng.random() < 0.5:
        parts.insert(other, parts.pop(one))
    else:
        parts[other : other + rng.integers(2)] = [parts[one]] * rng.integers(3)
    lines[number] = b" ".join(parts)


def change_bytes(content, rng, most=0):
    """Overwrite, cut, lengthen, swap or clear bytes, most of them before a place."""
    changed, near = bytearray(content), len(content)
    if most and rng.random() < 0.7:
        near = min(near, most)
    first, second = sorted(map(int, rng.integers(0, near, 2)))
    size = min(int(2 ** rng.uniform(0, 9)), second - first + 1, len(content) - second)
    one, other = slice(first, first + size), slice(second, second + size)
    match rng.integers(6):
        case 0:
            for place in rng.integers(0, near, rng.integers(1, 20)):
                changed[place] = rng.integers(256)
        case 1:
            changed[first] ^= 1 << rng.integers(8)
        case 2:
            del changed[rng.integers(len(content)) :]
        case 3:
            changed += rng.bytes(rng.integers(1, 2000))
        case 4:
            changed[one], changed[other] = changed[other], changed[one]
        case 5:
            changed[one] = bytes([rng.choice([0, 255])]) * size
    return bytes(changed)


def check_options(path):
    """Resolve a file; what is accepted must come back from its own text, and must do no harm."""
    resolved = resolve(read_file(path), output_file="results/case.h5")
    text = resolved.text()
    copy = path.with_suffix(".copy")
    copy.write_text(text, encoding="utf-8")
    if resolve(read_file(copy)).text() != text:
        return "its resolved text means something else"
    values = resolved.solver.values()
    harm = [v for v in values if "harm" in v or "pyth" in v or set(v) & set(":/")]
    return f"harmful values {harm}" if harm else None


def run_options(path, verdict, rng):
    """Run some cases as a program: exit code, messages, and the files it leaves."""
    if rng.random() > RUNS[verdict]:
        return None
    scenes = [scene for scene in TINY if f"-scene {scene}".encode() in path.read_bytes()]
    words = [sys.executable, "-m", "pgran", "run", "case.opts", "-output_progress", "none"]
    words += TINY[scenes[0]].split() if scenes else []
    room = path.parent / "room"
    room.mkdir()
    shutil.copy(path, room / "case.opts")
    kept = os.environ | {"PYTHONPATH": os.pathsep.join([str(FOLDER), *sys.path])}
    how = {"env": kept, "cwd": room, "text": True, "errors": "replace", "timeout": 2 * SECONDS}
    try:
        done = subprocess.run(words, capture_output=True, **how)
    except subprocess.TimeoutExpired:
        return "hang", "the run did not end"
    lines = done.stderr.splitlines()
    if done.returncode not in (0, 2, 3, 4) or "Traceback" in done.stderr:
        return "untidy", f"exit code {done.returncode}: {' | '.join(lines[-3:])}"
    if done.returncode in (2, 4) and sum(line.startswith("pgran") for line in lines) != 1:
        return "untidy", f"refused in {len(lines)} lines: {' | '.join(lines[:3])}"
    left = [p.name for p in room.rglob("*") if p.is_file() and not store.is_result(p)]
    return ("wrong", f"it left {left}") if left != ["case.opts"] else None


# HDF5 files


RUN = "-scene response -lattice_shape 3,2 -detectors 2,1 -sweep_points 5 -output_fields\n"
SHAPE, HEAD = (3, 2), 3000  # of that run's lattice; bytes in which HDF5 says what a file holds


def write_result(folder):
    """Let pgran write a result into a folder; whole, it is accepted."""
    (folder / "case.opts").write_text(RUN)
    words = [sys.executable, "-m", "pgran", "run", folder / "case.opts"]
    words += ["-output_progress", "none", "-output_file", folder / "result.h5"]
    subprocess.run(words, check=True, cwd=FOLDER, stderr=subprocess.DEVNULL)
    assert len(store.load(folder / "result.h5").response.omega) == 5
    assert impossible(*store.read_stiffness(folder / "result.h5"), SHAPE) is None
    return folder / "result.h5"


def bonds(folder, rng, result):
    """Write changed bonds, of a result or of their own: damaged bytes, or another structure."""
    path, of_result = folder / "case.h5", rng.random() < 0.5
    if of_result:
        shutil.copy(result, path)
        shape = SHAPE
    else:
        shape = tuple(map(int, rng.integers(1, 6, rng.integers(1, 4))))
        how = [{}, {"chunks": True}, {"compression": "gzip", "shuffle": True}][rng.integers(3)]
        with h5py.File(path, "w", userblock_size=512 * rng.integers(2)) as file:
            for axis in range(len(shape)):
                k = rng.random(bond_shape(shape, axis))
                file.create_dataset(f"lattice/stiffness_{'xyz'[axis]}", data=k, **how)
    damaged = rng.random() < 0.5
    if damaged:
        path.write_bytes(change_bytes(path.read_bytes(), rng, HEAD))
        return path, of_result, True, shape
    with h5py.File(path, "r+") as file:
        restructure(file, shape, rng)
    if of_result and rng.random() < 0.7:  # closed by h5py it has lost its seal
        content = path.read_bytes()
        seal = f"pgran result 2\nsha256 {hashlib.sha256(content).hexdigest()}\n"
        path.write_bytes(content + seal.encode().ljust(512, b"\0"))
    return path, of_result, False, shape


LINKS = (
    h5py.SoftLink("/lattice"), h5py.SoftLink("/lattice/stiffness_x"), h5py.SoftLink("nowhere"),
    h5py.ExternalLink("/dev/zero", "/"), h5py.ExternalLink("case.h5", "/lattice"),
)  # fmt: skip
TYPES = (
    "S5", complex, bool, [("a", float), ("b", "S3")], h5py.string_dtype(), h5py.ref_dtype,
    h5py.vlen_dtype(float), "V7", "f2", "f16", "u8", "i1", np.dtype((float, (2, 2))),
    h5py.enum_dtype({"a": 1, "b": 2}, "i4"), h5py.opaque_dtype(np.dtype("M8[s]")),
)  # fmt: skip
LAYOUTS = ({}, {"chunks": (1000, 1000)}, {"compression": "gzip"}, {"chunks": (5000, 10000)})
ATTRIBUTES = ("text", 1e308, -1, np.ones(4000), [b"a"], h5py.Empty("f"), 1 + 2j, np.nan)


def restructure(file, shape, rng):
    """Put something else in the place of a stiffness, or of more."""
    name, kind = f"lattice/stiffness_{'xyz'[rng.integers(3)]}", rng.integers(11)
    size = bond_shape(shape, 0)
    if kind < 8 and name in file:
        del file[name]
    match kind:
        case 0:  # nothing, or not even a group
            if rng.random() < 0.3:
                del file["lattice"]
        case 1:  # a link, inside the file or out of it
            file[name] = LINKS[rng.integers(len(LINKS))]
        case 2:
            file.create_dataset(name, tuple(rng.integers(0, 5, rng.integers(0, 6))), float)
        case 3:
            file.create_dataset(name, size, TYPES[rng.integers(len(TYPES))])
        case 4:  # far larger than the file; of plain data all would be written, not a chunk
            layout, length = LAYOUTS[rng.integers(len(LAYOUTS))], int(10 ** rng.uniform(4, 6))
            data = file.create_dataset(name, (length + 1, length), float, **layout)
            if "compression" in layout:
                data[0, 0] = 1.0
        case 5:  # data of another file
            external = [("/dev/zero", 0, 8 * int(np.prod(size)))]
            file.create_dataset(name, size, float, external=external)
        case 6:
            layout = h5py.VirtualLayout(size, float)
            layout[...] = h5py.VirtualSource("/dev/zero", "lattice/stiffness_x", size)
            file.create_virtual_dataset(name, layout)
        case 7:  # a group that holds itself
            file[name] = file["/"] if rng.random() < 0.5 else file["lattice"]
        case 8:  # a value that no bond constant has
            data = file["lattice/stiffness_x"]
            place = tuple(int(rng.integers(n)) for n in data.shape)
            data[place] = rng.choice([np.nan, np.inf, -np.inf, -0.25, 1e308])
        case 9:  # a few kB that become about as large as may be, or larger
            for name in list(file["lattice"]):
                del file[f"lattice/{name}"]
            zeros = np.zeros(rng.integers(6_000_000, 10_000_000))
            file.create_dataset("lattice/stiffness_x", data=zeros, chunks=(10**6,), compression=1)
        case 10:  # odd attributes, and names that no terminal should show
            for key in ("mass", "omega_mx", "shape", "x\n\x1b[2J"):
                file["lattice"].attrs[key] = ATTRIBUTES[rng.integers(len(ATTRIBUTES))]
            for number in range(rng.integers(200)):
                file[f"lattice/\x1b[2J\n{number}"] = number


def check_bonds(path, of_result, damaged, shape):
    """Read a file as bonds and as a result; say what is wrong with what was accepted.

    Damage to numbers cannot be told from other numbers, but they are still possible ones. Bytes of
    a result are only damaged for the reading of bonds, which is done with more care.
    """
    if not (of_result and damaged):
        try:
            store.load(path)
            if not of_result:
                return "load accepted what is no result"
        except PgranError:
            pass
    return impossible(*store.read_stiffness(path), shape if damaged else None)


def impossible(stiffness, kmax, expected=None):
    """Say what is wrong with bonds that were accepted."""
    shape = tuple(n - (axis == 0) for axis, n in enumerate(np.shape(stiffness[0])))
    if expected and shape != expected:
        return f"accepted {shape} balls instead of {expected}"
    if len(shape) != len(stiffness) or not 1 <= len(shape) <= 3 or min(shape) < 1:
        return f"accepted {len(stiffness)} arrays, the first of shape {np.shape(stiffness[0])}"
    for axis, k in enumerate(stiffness):
        if k.shape != bond_shape(shape, axis) or k.dtype != float:
            return f"accepted shape {k.shape}, type {k.dtype} along axis {axis}"
        if not (np.isfinite(k) & (k >= 0)).all():
            return f"accepted {k.min()} along axis {axis}"
    return None if kmax is None or 0 < kmax < np.inf else f"accepted kmax = {kmax}"


def main(count, seed=1):
    """Carry out both campaigns; return the exit code."""
    count, seed = int(count), int(seed)
    failed = campaign("options", options, check_options, count, seed, run_options)
    with tempfile.TemporaryDirectory() as folder:
        result = write_result(Path(folder))
        failed += campaign("bonds", partial(bonds, result=result), check_bonds, count, seed)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
