"""The fault campaign: pgran never hangs, never loses what is finished, and no file does harm.

    bash jobs/faults.sh [--short] [PART ...]

Parts: kinds, kills, signals, disks, price, fuzz; all by default. Each prints one line with its
figures, and what went wrong before it. Exit code 1 if anything did.
"""

import argparse
import contextlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from campaign import (
    JOURNAL,
    PART,
    RESULT,
    Campaign,
    Job,
    describe,
    differences,
    held,
    with_no_error,
)

HERE = Path(__file__).resolve().parent
INJECT = [str(HERE / "inject.py")]
SEED = 1993
SECONDS_TO_END = 10.0  # after a fault, the launcher's own seconds included
SECONDS_TO_STOP = 5.0  # after a signal: one unit of work, and the launcher's own second or two

BONDS = "-lattice_shape 20,20 -bonds_seed 7\n"
RELAX = f"-scene relaxation\n{BONDS}-lattice_damping .01\n"
SCENES = {
    "response": f"-scene response\n{BONDS}-sweep_points 1500\n",
    "fields": "-scene response\n-lattice_shape 30,30\n-sweep_points 400\n-output_fields\n",
    "modes": "-scene modes\n-lattice_shape 36,36\n-output_fields\n",
    "projection": f"-scene projection\n{BONDS}-sweep_points 600\n",
    "window": f"{RELAX}-relax_steps 15000\n",
    "krylov": f"{RELAX}-relax_steps 2000\n-relax_method krylov\n-relax_window 16\n",
    "trajectories": f"{RELAX}-relax_steps 4000\n-relax_trajectories 3\n",
}
# The same scenes, in a second or less: what happens at a fault does not depend on the size.
SMALL = {
    "response": "-scene response\n-lattice_shape 9,8\n-detectors 3,3\n-sweep_points 64\n",
    "modes": "-scene modes\n-lattice_shape 30,30\n",
    "projection": "-scene projection\n-lattice_shape 9,8\n-sweep_points 64\n",
    "window": "-scene relaxation\n-lattice_shape 9,8\n-detectors 3,3\n-relax_steps 9000\n",
    "krylov": "-scene relaxation\n-lattice_shape 9,8\n-detectors 3,3\n-relax_steps 9000\n"
    "-relax_method krylov\n",
}


def kinds(campaign):
    """Plant every kind of fault on a random rank: no hang, right code, one word of who and why."""
    trials = [
        (kind, ranks, repeat)
        for repeat in campaign.repeats(5, 1)
        for kind in FAULTS
        for ranks in (2, 3, 4)
    ]
    seconds = campaign.map(one_kind, trials)
    return (
        f"{len(trials)} faults of {len(FAULTS)} kinds; jobs ended {np.median(seconds):.1f} s "
        f"after the fault, the slowest {max(seconds):.1f} s"
    )


def one_kind(campaign, trial):
    """Plant one fault; return the seconds from there to the end."""
    kind, ranks, repeat = trial
    rng = np.random.default_rng([SEED, list(FAULTS).index(kind), ranks, repeat])
    codes, cause, anywhere = FAULTS[kind]
    codes = codes if isinstance(codes, tuple) else (codes,)
    # A KSP calls back while it iterates, which a fresh factorization spares it.
    calling = ("response", "projection")
    scene = rng.choice(calling if kind == "callback" else list(SMALL))
    rank = int(rng.integers(ranks)) if anywhere else 0
    turn = 1 if kind in ONCE else int(rng.integers(1, 3))
    words = ["-ranks_per_lattice", str(ranks)] if scene == "response" and rng.random() < 0.5 else []
    if kind == "callback":
        words += ["-steady_pc_type", "ilu"]
    folder = campaign.folder(SMALL[scene])
    job = Job(folder, ranks, *words, program=[*INJECT, kind, str(rank), str(turn)])
    fault = folder / "fault"
    job.wait_for(fault.exists)
    begun = time.monotonic()
    found = job.end(SECONDS_TO_END)
    seconds = time.monotonic() - begun
    said = job.said()
    # exactly one message: of pgran's own, or of mpirun where a rank cannot speak any more
    speakers = ("pgran", "mpirun", "YOUR APPLICATION")
    messages = [line for line in said.splitlines() if line.startswith(speakers)]
    who = "results" if kind in ALIKE else cause if kind in UNNAMED else f"rank {rank}"
    campaign.check(
        job,
        not fault.exists() and "the fault did not happen",
        found is None and "hangs",
        found not in codes and f"exit code {found}, not {codes[0]}",
        len(messages) != 1 and f"{len(messages)} messages",
        len(messages) == 1 and who not in messages[0] and f"does not name {who}",
        cause not in said and f"does not say {cause!r}",
        said.count("Traceback") != (kind in UNEXPECTED) and f"{said.count('Traceback')} tracebacks",
        held(folder / JOURNAL) < 0 and "unreadable journal",
        (folder / RESULT).exists() and "a result",
    )
    return seconds


# Exit code, words of the message, and whether it can happen on any rank or on rank 0 alone.
FAULTS = {
    "exception": (1, "RuntimeError: planted", True),
    "callback": (1, "RuntimeError: planted", True),
    "petsc": (1, "Unknown vector type: nonsense", True),
    "exit": (7, "ended by sys.exit(7)", True),
    "memory": (1, "Unable to allocate 1.00 PiB", True),
    "recursion": (1, "RecursionError", True),
    "interrupt": (130, "interrupted", True),
    "segfault": (139, "exited on signal 11", True),
    "kill": (137, "exited on signal 9", True),
    "abort": (134, "exited on signal 6", True),
    "vanish": (1, "exiting improperly", True),
    "import": (1, "pgran doctor", True),
    "journal": (4, "results/a.h5.unfinished: cannot be written: File too large", False),
    "result": (4, "results/a.h5: cannot be written: File too large", False),
    "folder": (4, "results/a.h5: cannot be written", False),
    "writing": (1, "RuntimeError: planted", False),
}
ONCE = {"import", "result", "folder", "writing"}  # happen once in a run
ALIKE = {"result", "folder"}  # all ranks agree on these
UNEXPECTED = {"exception", "callback", "memory", "recursion", "writing"}
UNNAMED = set()
version = subprocess.run(["mpirun", "--version"], capture_output=True, text=True, check=True).stdout
if (
    "HYDRA" in version
):  # MPICH's names no rank, but a signal: the crash's, or one that it sent after it
    for kind in ("segfault", "kill", "abort"):
        FAULTS[kind] = ((FAULTS[kind][0] - 128, signal.SIGKILL, signal.SIGTERM), "(signal ", True)
        UNNAMED.add(kind)
    del FAULTS["vanish"]  # for MPICH's mpirun that is no fault


def kills(campaign):
    """Kill all processes of a run at a random moment, and go on, also with other ranks."""
    killed, again, writing, units = np.sum(
        campaign.map(one_kill, campaign.repeats(100, 7), SCENES), axis=0
    )
    return (
        f"{killed} kills, {again} of them of a run that went on already, {writing} while the "
        f"result was written; {units} finished units were all found again"
    )


def one_kill(campaign, trial):
    """Kill a run, perhaps again, and let it go on; return what happened in numbers."""
    rng = np.random.default_rng([SEED, 1, trial])
    scene = list(SCENES)[trial % len(SCENES)]
    reference, seconds = campaign.references[scene]
    folder = campaign.folder(SCENES[scene])
    killed, writing, units, times = 0, 0, 0, 1 + (rng.random() < 0.3)
    for _ in range(times):
        job = Job(folder, int(rng.integers(1, 4)))
        moment = rng.random()
        if moment < 0.15:  # any, start-up included
            time.sleep(rng.uniform(0, 1.5))
        elif moment < 0.8:
            job.wait_for((folder / JOURNAL).exists)
            time.sleep(rng.uniform(0, seconds))
        else:
            job.wait_for((folder / PART).exists)
            time.sleep(rng.uniform(0, 0.02))
        killed += job.running()
        job.kill()
        writing += (folder / PART).exists()
        there, kept = (folder / RESULT).exists(), held(folder / JOURNAL)
        units += kept
        campaign.check(
            job,
            kept < 0 and "unreadable journal",
            there and describe(differences(folder / RESULT, reference)),
        )
    campaign.finish(folder, scene, int(rng.integers(1, 4)))
    return killed, times - 1, writing, units


def signals(campaign):
    """Send SIGUSR1 to the launcher, or SIGTERM to one rank, and go on."""
    codes, seconds = zip(*campaign.map(one_signal, campaign.repeats(50, 6), SCENES), strict=True)
    return (
        f"{codes.count(75)} runs stopped by a signal, {codes.count(0)} done, "
        f"{len(codes) - codes.count(75) - codes.count(0)} that had not begun; ended "
        f"{np.median(seconds):.1f} s after it, the slowest {max(seconds):.1f} s"
    )


def one_signal(campaign, trial):
    """Signal a run and let it go on; return its exit code, and the seconds it took to stop."""
    rng = np.random.default_rng([SEED, 2, trial])
    scene = list(SCENES)[trial // 2 % len(SCENES)]
    ranks = int(rng.integers(1, 4))
    folder = campaign.folder(SCENES[scene])
    job = Job(folder, ranks)
    if rng.random() < 0.1:
        time.sleep(rng.uniform(0, 1.5))
    else:
        job.wait_for((folder / JOURNAL).exists)
        time.sleep(rng.uniform(0, campaign.references[scene][1] / min(ranks, 2)))
    begun = (folder / JOURNAL).exists() or (folder / RESULT).exists()
    # SIGTERM at mpirun makes it kill the ranks a second later: so one rank gets it
    pids = [job.process.pid] if trial % 2 == 0 else job.ranks()
    if pids:
        with_no_error(
            os.kill, int(rng.choice(pids)), signal.SIGUSR1 if trial % 2 == 0 else signal.SIGTERM
        )
    sent = time.monotonic()
    code = job.end()
    seconds = time.monotonic() - sent
    campaign.check(
        job,
        code is None and "hangs",
        code not in (0, 75) and begun and f"exit code {code}",
        seconds > SECONDS_TO_STOP and f"stops after {seconds:.1f} s",
        (code == 0) != (folder / RESULT).exists() and "exit code and result do not agree",
        code == 75 and "Traceback" in job.said() and "a traceback",
        held(folder / JOURNAL) < 0 and "unreadable journal",
    )
    campaign.finish(folder, scene, int(rng.integers(1, 4)))
    return code, seconds


def disks(campaign):
    """Let the disk run full, be read-only, or the folder vanish: the earlier result stays."""
    outcomes = campaign.map(one_disk, campaign.repeats(24, 8), SCENES)
    figures = ", ".join(f"{outcomes.count(text)} {text}" for text in sorted(set(outcomes)))
    return f"{figures}; all went on to the same result"


def one_disk(campaign, trial):
    """Carry out one trial; return in words what happened."""
    rng = np.random.default_rng([SEED, 3, trial])
    scene = ["response", "fields", "projection", "krylov"][trial // 4 % 4]
    do = [limited, small_disk, read_only, removed][trial % 4]
    return do(campaign, rng, campaign.folder(SCENES[scene]), scene)


def earlier_result(campaign, folder, scene):
    """Leave an earlier result, of other bonds; return its bytes."""
    words = ["-bonds_seed", "5"]
    if scene != "krylov":
        words += ["-sweep_points", "20", "-sweep_max", "1"]
    job = Job(folder, 1, *words)
    campaign.check(job, job.end() != 0 and "the earlier result failed")
    return (folder / RESULT).read_bytes()


def check_refused(campaign, job, earlier):
    """Check that a job without room left everything as it was; return whether it had none."""
    code, folder = job.end(), job.folder
    if code == 0:
        return False
    campaign.check(
        job,
        code != 4 and f"exit code {code}",
        "Traceback" in job.said() and "a traceback",
        "results" not in job.said() and "does not name the file",
        (folder / RESULT).read_bytes() != earlier and "the earlier result is not whole",
        (folder / PART).exists() and "left behind a part",
        held(folder / JOURNAL) < 0 and "unreadable journal",
    )
    return True


def check_goes_on(campaign, job, scene):
    """Check that the same command, with room, comes to the same result."""
    campaign.check(
        job,
        job.end() != 0 and "failed with room",
        describe(differences(job.folder / RESULT, campaign.references[scene][0])),
        (job.folder / JOURNAL).exists() and "left behind a journal",
    )


def limited(campaign, rng, folder, scene):
    """Let rank 0 have no room for the journal, or for the result."""
    earlier = earlier_result(campaign, folder, scene)
    ranks, kind = int(rng.integers(1, 4)), str(rng.choice(["journal", "result"]))
    turn = str(int(rng.integers(1, 20)) if kind == "journal" else 1)
    job = Job(folder, ranks, "-output_overwrite", program=[*INJECT, kind, "0", turn])
    check_refused(campaign, job, earlier)
    check_goes_on(campaign, Job(folder, ranks, "-output_overwrite"), scene)
    return f"without room for the {kind}"


def small_disk(campaign, rng, folder, scene):
    """Run on a disk that is too small, then make room."""
    with small_mount(folder / "results") as remount:
        if not remount:
            return "small disks that only root can make"
        earlier = earlier_result(campaign, folder, scene)
        needed = 2 * campaign.references[scene][0].stat().st_size
        remount(f"size={len(earlier) + int(rng.integers(needed))}")
        refused = check_refused(campaign, Job(folder, 2, "-output_overwrite"), earlier)
        remount("size=100m")
        if refused:
            check_goes_on(campaign, Job(folder, 2, "-output_overwrite"), scene)
        return "on a full disk" if refused else "on a disk just large enough"


def read_only(campaign, rng, folder, scene):
    """Run in a folder that is read-only for a while."""
    with small_mount(folder / "results") as remount:
        if not remount:
            return "read-only disks that only root can make"
        earlier = earlier_result(campaign, folder, scene)
        remount("ro")
        check_refused(campaign, Job(folder, 2, "-output_overwrite"), earlier)
        remount("rw")
        check_goes_on(campaign, Job(folder, 2, "-output_overwrite"), scene)
        return "on a read-only disk"


def removed(campaign, rng, folder, scene):
    """Remove the folder in the middle: it is made anew for the result."""
    job = Job(folder, int(rng.integers(1, 4)))
    units = int(rng.integers(1, 10))
    job.wait_for(lambda: held(folder / JOURNAL) >= units)
    shutil.rmtree(folder / "results")
    check_goes_on(campaign, job, scene)
    return "with their folder removed"


@contextlib.contextmanager
def small_mount(folder):
    """Mount a disk in memory; yield what mounts it otherwise, or None if that is not allowed."""
    folder.mkdir()

    def mount(*words):
        return subprocess.run(["mount", *words, folder], capture_output=True).returncode == 0

    if not mount("-t", "tmpfs", "-o", "size=100m", "tmpfs"):
        yield None
        return
    try:
        yield lambda option: mount("-o", f"remount,{option}")
    finally:
        subprocess.run(["umount", folder], check=True)


def price(campaign):
    """Measure what keeping finished units costs."""
    done = subprocess.run([sys.executable, HERE / "price.py"], capture_output=True, text=True)
    if done.returncode:
        campaign.failures += 1
        print(f"FAILED: {done.stderr}")
    return "; ".join(done.stdout.splitlines())


def fuzz(campaign):
    """Call the campaign of damaged options and files."""
    if not (HERE / "fuzz.py").exists():
        return "not called: there is no jobs/fuzz.py"
    said = []
    for what in ("options", "hdf5"):
        words = [sys.executable, HERE / "fuzz.py", what, "100" if campaign.short else "1000"]
        done = subprocess.run(words, capture_output=True, text=True)
        if done.returncode:
            campaign.failures += 1
            print(f"FAILED: {done.stdout}{done.stderr}")
        said += done.stdout.splitlines()[-1:]
    return "; ".join(said)


PARTS = {part.__name__: part for part in (kinds, kills, signals, disks, price, fuzz)}


def main():
    """Carry out the parts asked for; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], metavar="PART")
    parser.add_argument("--short", action="store_true", help="fewer trials")
    given = parser.parse_args()
    root = Path(tempfile.mkdtemp(prefix="pgran-faults-"))
    campaign = Campaign(root, given.short)
    for name in given.parts or PARTS:
        began = time.monotonic()
        figures = PARTS[name](campaign)
        print(f"{name}: {figures} ({time.monotonic() - began:.0f} s)", flush=True)
    if campaign.failures:
        print(f"{campaign.failures} failures; their folders are in {root}")
        return 1
    shutil.rmtree(root)
    print("no failures")
    return 0


if __name__ == "__main__":
    sys.exit(main())
