#!/usr/bin/env python3
"""Feed pgran damaged and malicious files: python jobs/fuzz.py options|hdf5 CASES [SEED].

Every case is a file made from the shipped options files, from a result or from bonds, and a pure
function of the seed and the number of the case. Workers of limited memory read it. pgran must
refuse it in one line, or accept it with good reason, in little memory and time; other files are
kept in results/fuzz, and the exit code is 1.
"""

import hashlib
import multiprocessing
import os
import resource
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

import h5py
import numpy as np

from pgran.errors import PgranError
from pgran.files import hdf5 as foreign
from pgran.files import store
from pgran.files.reading import read_file, resolve
from pgran.physics.lattice import Lattice, bond_shape
from pgran.results import LatticeRecord, Modes
from pgran.scenes.common import read_bonds

SECONDS = 30  # for one case; a real run is given twice as long
MEMORY, ADDRESSES = 500 * 10**6, 2 * 2**30  # bytes: what may be used, and where a worker ends
OPTIONS = Path(__file__).resolve().parent.parent / "options"
KEPT = Path("results") / "fuzz"


# Workers


def work(connection, task):
    """Carry out the task on every file named, in a process that may die of it."""
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESSES, ADDRESSES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    foreign.SECONDS = SECONDS / 3
    while True:
        try:
            found = judge(task, *connection.recv())
        except EOFError:
            return
        kinds = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
        connection.send((*found, max(1024 * resource.getrusage(kind).ru_maxrss for kind in kinds)))


def judge(task, *case):
    """Return whether a task refuses a file or accepts it, and what it says."""
    try:
        wrong = task(*case)
    except PgranError as error:
        return ("refused" if tidy(str(error)) else "untidy"), str(error)
    except Exception as error:
        return "untidy", f"{type(error).__name__}: {error}"
    return ("wrong", wrong) if wrong else ("accepted", "")


def tidy(message):
    """Return whether a message is one line that a terminal can show."""
    return message.isprintable() and 0 < len(message) < 1100


class Worker:
    """A process that carries out a task, replaced when it dies or hangs."""

    def __init__(self, task):
        """Start it."""
        self.task = task
        self._start()

    def _start(self):
        context = multiprocessing.get_context("fork")
        self.connection, there = context.Pipe()
        self.process = context.Process(target=work, args=(there, self.task), daemon=True)
        self.process.start()
        there.close()

    def ask(self, *case):
        """Return what becomes of a case: a verdict, words, bytes of memory."""
        self.connection.send(case)
        try:
            if self.connection.poll(SECONDS):
                return self.connection.recv()
            verdict = "hang", f"more than {SECONDS} s", 0
        except EOFError:
            self.process.join()
            verdict = "crash", f"exit code {self.process.exitcode}", 0
        self.process.kill()
        self._start()
        return verdict


def campaign(name, task, cases, more=lambda case, number, verdict: None):
    """Make and judge all cases; print one line, and return how many were judged bad.

    `cases(folder, number, rng)` returns the arguments of the task, a path first; `more` has the
    last word on what the task did not fail at, if it returns a verdict.
    """
    count, seed = int(sys.argv[2]), int(sys.argv[3]) if len(sys.argv) > 3 else 1
    tally, most, contained = Counter(), 0, 0
    worker = Worker(task)
    with tempfile.TemporaryDirectory() as folder:
        for number in range(count):
            rng = np.random.default_rng([seed, number])
            case = cases(Path(folder), number, rng)
            verdict, said, memory = worker.ask(*case)
            most, contained = max(most, memory), contained + ("crashed" in said or "took" in said)
            if memory > MEMORY:
                verdict, said = "memory", f"{memory / 1e6:.0f} MB"
            if verdict in ("refused", "accepted"):
                verdict, said = more(case, number, verdict) or (verdict, said)
            tally[verdict] += 1
            if verdict not in ("refused", "accepted"):
                KEPT.mkdir(parents=True, exist_ok=True)
                kept = KEPT / f"{name}-{seed}-{number}{case[0].suffix}"
                shutil.copy(case[0], kept)
                print(f"{kept}: {verdict}: {said}", file=sys.stderr)
            shutil.rmtree(folder)
            os.mkdir(folder)
    bad = count - tally["refused"] - tally["accepted"]
    print(
        f"{name}: {count} cases, seed {seed}: {tally['refused']} refused"
        + (f" ({contained} by the death of the reading process)" if name == "hdf5" else "")
        + f", {tally['accepted']} accepted, {tally['wrong']} wrongly accepted, "
        f"{tally['crash']} crashes, {tally['hang']} hangs, {tally['untidy']} tracebacks or untidy "
        f"messages, {tally['memory']} too large; at most {most / 1e6:.0f} MB"
    )
    return bad


# Options files

NUMBERS = (
    "0", "-1", "1e999", "1e308", "-1e308", "1e-320", "nan", "inf", "1,2,3,4,5", "1_0", "0x10",
    "1e5", "\u00b2", "\uff13", "9" * 30, "9" * 5000, "1000000000,1000000000", "10" + 14 * "0",
    "1.5", "", "--", "x", "3", "7", "0.2", ".8", "4,2",
)  # fmt: skip
KEYS = (
    """
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
""".replace("\n", "; ")
    .strip("; ")
    .split("; ")
)
TINY = {  # what keeps a real run short, whatever the file says
    "response": "-lattice_shape 4,3 -detectors 2,1 -sweep_points 7",
    "continuum": "-sweep_points 7 -sweep_max 40",
    "modes": "-lattice_shape 4,3",
    "projection": "-lattice_shape 4,3",
    "relaxation": "-lattice_shape 4,3 -detectors 2,1 -relax_steps 2500 -relax_trajectories 1",
}
RUNS = {"accepted": 5, "refused": 50}  # one case of so many is run as a program


def options_case(folder, number, rng):
    """Write a changed experiment, of some with the choices of a solver."""
    content = rng.choice(sorted(OPTIONS.glob("*.opts"))).read_bytes()
    if rng.random() < 0.3:
        content += rng.choice(sorted(OPTIONS.glob("solvers/*.opts"))).read_bytes()
    for _ in range(rng.choice([1, 1, 1, 2, 3])):
        content = rng.choice(OPTIONS_CHANGES)(content, rng)
    path = folder / "case.opts"
    path.write_bytes(content)
    return (path,)


def flip(content, rng):
    """Change one bit in each of a few bytes."""
    changed = bytearray(content)
    for place in rng.integers(0, max(1, len(content)), rng.integers(1, 9)) if content else ():
        changed[place] ^= 1 << rng.integers(8)
    return bytes(changed)


def words(content, rng):
    """Delete, double or swap words of the lines that are no comments."""
    lines = content.split(b"\n")
    keys = [n for n, line in enumerate(lines) if line.startswith(b"-")]
    for number in rng.choice(keys, min(2, len(keys)), replace=False) if keys else ():
        parts = lines[number].split(b" ")
        one, other = rng.integers(0, len(parts), 2)
        match rng.integers(3):
            case 0:
                del parts[one]
            case 1:
                parts.insert(other, parts[one])
            case 2:
                parts[one], parts[other] = parts[other], parts[one]
        lines[number] = b" ".join(parts)
    return b"\n".join(lines)


def value(content, rng):
    """Give a key an odd value."""
    lines = content.split(b"\n")
    keys = [n for n, line in enumerate(lines) if line.startswith(b"-")]
    if keys:
        number = rng.choice(keys)
        key = lines[number].split(b" ")[0]
        lines[number] = key + b" " + rng.choice(NUMBERS).encode()
    return b"\n".join(lines)


def insert(content, rng):
    """Insert a key, of PETSc or of another scene, or what is no key."""
    odd = ("\0", "é", "\x1b[2J", "\u2028", "\ufeff", "'", '"', "\\", 10**5 * "x", "-" + 10**4 * "y")
    some = str(rng.choice(KEYS)) if rng.random() < 0.7 else odd[rng.integers(len(odd))]
    lines = content.split(b"\n")
    lines.insert(rng.integers(len(lines) + 1), some.encode())
    return b"\n".join(lines)


def cut(content, rng):
    """Keep a part, or put another file behind it."""
    if rng.random() < 0.5:
        return content[: rng.integers(len(content) + 1)]
    return content + rng.choice(sorted(OPTIONS.rglob("*.opts"))).read_bytes()


def noise(content, rng):
    """Replace all by random bytes, or by a long file."""
    return rng.bytes(rng.integers(1, 2000)) if rng.random() < 0.7 else (content * 2000)[: 2**21]


OPTIONS_CHANGES = (flip, words, words, value, value, value, insert, insert, insert, cut, noise)


def check_options(path):
    """Resolve a file; what is accepted must come back from its own text, and must do no harm."""
    options = resolve(read_file(path), output_file="results/case.h5")
    text = options.text()
    copy = path.with_suffix(".copy")
    copy.write_text(text, encoding="utf-8")
    if resolve(read_file(copy)).text() != text:
        return "its resolved text means something else"
    values = options.solver.values()
    harm = [v for v in values if "harm" in v or "pyth" in v or set(v) & set(":/")]
    return f"harmful values {harm}" if harm else None


def run_options(case, number, verdict):
    """Run some cases as a program: exit code, messages, and the files it leaves."""
    if number % RUNS[verdict]:
        return None
    (path,) = case
    text = path.read_bytes()
    scenes = [scene for scene in TINY if f"-scene {scene}".encode() in text]
    words = [sys.executable, "-m", "pgran", "run", "case.opts", "-output_progress", "none"]
    words += TINY[scenes[0]].split() if scenes else []
    room = Path(tempfile.mkdtemp(dir=path.parent))
    shutil.copy(path, room / "case.opts")
    home = {"PYTHONPATH": os.pathsep.join(filter(None, [str(OPTIONS.parent), *sys.path]))}
    limit = {"env": os.environ | home, "cwd": room, "timeout": 2 * SECONDS, "errors": "replace"}
    try:
        done = subprocess.run(words, capture_output=True, text=True, **limit)
    except subprocess.TimeoutExpired:
        return "hang", "the run did not end"
    lines = done.stderr.splitlines()
    if done.returncode not in (0, 2, 3, 4) or any("Traceback" in line for line in lines):
        return "untidy", f"exit code {done.returncode}: {' | '.join(lines[-3:])}"
    if done.returncode in (2, 4) and sum(line.startswith("pgran") for line in lines) != 1:
        return "untidy", f"refused in {len(lines)} lines: {' | '.join(lines[:3])}"
    for left in room.rglob("*"):
        if left.is_file() and left.name != "case.opts" and not store.is_result(left):
            return "wrong", f"it left {left.relative_to(room)}"
    return None


# HDF5 files


def hdf5_case(folder, number, rng):
    """Write a changed result, or a changed file of bonds, and say what may be accepted of it."""
    path = folder / "case.h5"
    shape = tuple(map(int, rng.integers(1, 6, rng.integers(1, 4))))
    stiffness = [rng.random(bond_shape(shape, axis)) for axis in range(len(shape))]
    kind = ("result", "result", "resealed", "bonds", "bonds", "structure")[rng.integers(6)]
    if kind in ("result", "resealed"):
        write_result(path, stiffness, rng)
    else:
        write_bonds(path, stiffness, rng)
    if kind in ("resealed", "structure"):
        with h5py.File(path, "r+") as file:
            rng.choice(STRUCTURES)(file, shape, rng)
    else:
        whole = path.read_bytes()
        while path.read_bytes() == whole:
            damage(path, rng)
    if kind == "resealed":  # closed by h5py it has lost its seal
        content = path.read_bytes()
        digest = hashlib.sha256(content).hexdigest()
        path.write_bytes(content + f"pgran result 2\nsha256 {digest}\n".encode().ljust(512, b"\0"))
    return path, kind, shape


def write_result(path, stiffness, rng):
    """Write a result of some modes."""
    balls = stiffness[0].size
    modes = Modes(
        count_expected=balls,
        count_certified=True,
        solve_seconds=0.1,
        omega=np.sort(rng.random(balls)),
        residual=rng.random(balls),
        participation=rng.random(balls),
    )
    store.write(path, {"scene": "modes"}, [LatticeRecord.of(Lattice(stiffness)), modes])


def write_bonds(path, stiffness, rng):
    """Write bonds by hand: in one piece, in chunks, or compressed."""
    how = [{}, {"chunks": True}, {"compression": "gzip", "shuffle": True}][rng.integers(3)]
    with h5py.File(path, "w", userblock_size=512 * rng.integers(2)) as file:
        for axis, k in enumerate(stiffness):
            file.create_dataset(f"lattice/stiffness_{'xyz'[axis]}", data=k, **how)


def damage(path, rng):
    """Overwrite, cut, lengthen, swap or clear bytes."""
    content = bytearray(path.read_bytes())
    near = (
        len(content) if rng.random() < 0.3 else min(len(content), 3000)
    )  # what HDF5 says of itself
    first, second = sorted(map(int, rng.integers(0, near, 2)))
    size = min(int(2 ** rng.uniform(0, 9)), second - first + 1, len(content) - second)
    match rng.integers(6):
        case 0:
            for place in rng.integers(0, near, rng.integers(1, 20)):
                content[place] = rng.integers(256)
        case 1:
            content[first] ^= 1 << rng.integers(8)
        case 2:
            del content[rng.integers(len(content)) :]
        case 3:
            content += rng.bytes(rng.integers(1, 2000))
        case 4:
            one, other = content[first : first + size], content[second : second + size]
            content[first : first + size], content[second : second + size] = other, one
        case 5:
            content[first : first + size] = bytes([rng.choice([0, 255])]) * size
    path.write_bytes(content)


def change(file, rng):
    """Take a stiffness away, and return its name, where another may take its place."""
    name = f"lattice/stiffness_{'xyz'[rng.integers(3)]}"
    if name in file:
        del file[name]
    return name


def linked(file, shape, rng):
    """A link, inside the file or out of it."""
    links = (
        h5py.SoftLink("/lattice"), h5py.SoftLink("/lattice/stiffness_x"), h5py.SoftLink("nowhere"),
        h5py.ExternalLink("/dev/zero", "/"), h5py.ExternalLink("case.h5", "/lattice"),
    )  # fmt: skip
    name = change(file, rng) if rng.random() < 0.7 else "lattice"
    if name in file:
        del file[name]
    file[name] = links[rng.integers(len(links))]


def shaped(file, shape, rng):
    """A dataset of any shape."""
    file.create_dataset(change(file, rng), tuple(rng.integers(0, 5, rng.integers(0, 6))), float)


def typed(file, shape, rng):
    """A dataset of any type."""
    types = (
        "S5", complex, bool, [("a", float), ("b", "S3")], h5py.string_dtype(), h5py.ref_dtype,
        h5py.vlen_dtype(float), "V7", "f2", "f16", "u8", "i1", np.dtype((float, (2, 2))),
        h5py.enum_dtype({"a": 1, "b": 2}, "i4"), h5py.opaque_dtype(np.dtype("M8[s]")),
    )  # fmt: skip
    kind = types[rng.integers(len(types))]
    file.create_dataset(change(file, rng), bond_shape(shape, 0), kind)


def declared(file, shape, rng):
    """A dataset far larger than the file, plain, in chunks, or compressed."""
    how = [{}, {"chunks": (1000, 1000)}, {"compression": "gzip"}, {"chunks": (5000, 10000)}]
    some = how[rng.integers(len(how))]
    size = int(10 ** rng.uniform(4, 6))
    data = file.create_dataset(change(file, rng), (size + 1, size), float, **some)
    if "compression" in some:
        data[0, 0] = 1.0  # of plain data all would be written, not a chunk


def inflated(file, shape, rng):
    """A compressed dataset of a few kB that becomes about as large as may be, or larger."""
    for name in list(file["lattice"]):
        del file[f"lattice/{name}"]
    zeros = np.zeros(rng.integers(6_000_000, 10_000_000))
    file.create_dataset("lattice/stiffness_x", data=zeros, chunks=(10**6,), compression=1)


def valued(file, shape, rng):
    """A value that no bond constant has."""
    data = file["lattice/stiffness_x"]
    place = tuple(int(rng.integers(n)) for n in data.shape)
    data[place] = rng.choice([np.nan, np.inf, -np.inf, -0.25, 1e308])


def elsewhere(file, shape, rng):
    """Data of another file: external storage, or a virtual dataset."""
    size = bond_shape(shape, 0)
    if rng.random() < 0.5:
        external = [("/dev/zero", 0, 8 * int(np.prod(size)))]
        file.create_dataset(change(file, rng), size, float, external=external)
    else:
        layout = h5py.VirtualLayout(size, float)
        layout[...] = h5py.VirtualSource("/dev/zero", "lattice/stiffness_x", size)
        file.create_virtual_dataset(change(file, rng), layout)


def nested(file, shape, rng):
    """Groups in groups, a thousand deep or going round in a circle."""
    group = file["lattice"]
    if rng.random() < 0.5:
        for _ in range(1000):
            group = group.create_group("deeper")
    else:
        name = change(file, rng)
        file[name] = file["/"] if rng.random() < 0.5 else file["lattice"]


def missing(file, shape, rng):
    """Something is not there."""
    if rng.random() < 0.3:
        del file["lattice"]
    else:
        change(file, rng)


def described(file, shape, rng):
    """Attributes of any type, names that no terminal should show, many members."""
    group = file["lattice"]
    values = ("text", 1e308, -1, np.ones(4000), [b"a", b"b"], h5py.Empty("f"), 1 + 2j, np.nan)
    for name in ("mass", "omega_mx", "shape", "x\n\x1b[2J"):
        group.attrs[name] = values[rng.integers(len(values))]
    for number in range(rng.integers(200)):
        group[f"\x1b[2J\n{number}"] = number


STRUCTURES = (
    linked, shaped, typed, declared, inflated, valued, elsewhere, nested, missing, described,
)  # fmt: skip


def check_hdf5(path, kind, shape):
    """Read a file as a result and as bonds; say what is wrong with what was accepted.

    A result that changed is never as it was written; what is read of it is still possible. So are
    the numbers of a damaged bonds file, which cannot be told from other numbers.
    """
    refused = []
    for read in (store.check_seal, store.load, read_bonds):
        try:
            found = read(path)
        except PgranError as error:
            refused.append(error)
            if not tidy(str(error)):
                raise
            continue
        if read is store.check_seal and kind != "resealed":
            return "a changed file is taken for one as it was written"
        if read is store.load and kind in ("bonds", "structure"):
            return "load accepted what is no result"
        wrong = read is read_bonds and impossible(*found, shape if kind == "bonds" else None)
        if wrong:
            return wrong
    if len(refused) == 3:
        raise refused[-1]


def impossible(stiffness, kmax, expected):
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
    if kmax is not None and not 0 < kmax < np.inf:
        return f"accepted kmax = {kmax}"
    return None


CAMPAIGNS = {
    "options": (check_options, options_case, run_options),
    "hdf5": (check_hdf5, hdf5_case),
}

if __name__ == "__main__":
    if len(sys.argv) not in (3, 4) or sys.argv[1] not in CAMPAIGNS:
        sys.exit(__doc__.splitlines()[0])
    sys.exit(1 if campaign(sys.argv[1], *CAMPAIGNS[sys.argv[1]]) else 0)
