"""pgran with a fault planted on one rank: python jobs/inject.py KIND RANK TURN run FILE ...

The program itself knows nothing of this: functions are replaced from outside, on the one rank.
`TURN` counts the units of work (or iterations, or records) of that rank up to the fault. The file
`fault` in the working directory tells when it happened.
"""

import ctypes
import itertools
import os
import resource
import shutil
import signal
import sys
from pathlib import Path

from pgran import __main__ as program
from pgran.command import run as running


def planted():
    """Raise what no part of pgran expects."""
    raise RuntimeError("planted")


def recurse():
    """Never return."""
    recurse()


def ask_for_memory():
    """Ask for a petabyte."""
    import numpy as np

    np.ones(2**47)


def misuse_petsc():
    """Let PETSc itself fail, on this rank alone."""
    from petsc4py import PETSc

    PETSc.Vec().createSeq(3).setType("nonsense")


def fill_disk():
    """Leave no room: files cannot grow beyond some bytes."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, resource.RLIM_INFINITY))


def lose_folder():
    """Put a file where the result's folder was."""
    shutil.rmtree("results")
    Path("results").write_text("in the way")


def after(turn, action):
    """Return a function that performs the fault when it is called for the `turn`-th time."""
    calls = itertools.count(1)

    def maybe(*arguments):
        if next(calls) == turn:
            Path("fault").touch()
            action()

    return maybe


def before(owner, name, maybe):
    """Call `maybe` before each call of `owner.name`."""
    original = getattr(owner, name)

    def replaced(*arguments, **keywords):
        maybe()
        return original(*arguments, **keywords)

    setattr(owner, name, replaced)


def in_unit(maybe):
    """Call `maybe` before each unit of work."""
    from pgran.parallel.crew import Crew

    share = Crew.share

    def replaced(crew, units, work, deliver, row):
        def failing(unit):
            maybe()
            return work(unit)

        share(crew, units, failing, deliver, row)

    Crew.share = replaced


def in_callback(maybe):
    """Call `maybe` in the monitor of every driven steady state's KSP."""
    start = running.start_petsc

    def replaced(options):
        start(options)
        from pgran.solve import linear

        make_ksp = linear.make_ksp

        def monitored(operators, matrix):
            ksp = make_ksp(operators, matrix)
            ksp.setMonitor(maybe)
            return ksp

        linear.make_ksp = monitored

    running.start_petsc = replaced


def in_import(maybe):
    """Let the scenes be missing."""
    for name in ("response", "modes", "projection", "relaxation"):
        sys.modules[f"pgran.scenes.{name}"] = None
    before(running, "start_petsc", maybe)


def in_journal(maybe):
    """Call `maybe` before each record of the journal."""
    from pgran.parallel.journal import Journal

    before(Journal, "write", maybe)


def in_result(maybe):
    """Call `maybe` before the result is written."""
    from pgran.files import store

    before(store, "write", maybe)


KINDS = {
    "exception": (in_unit, planted),
    "callback": (in_callback, planted),
    "petsc": (in_unit, misuse_petsc),
    "exit": (in_unit, lambda: sys.exit(7)),
    "memory": (in_unit, ask_for_memory),
    "recursion": (in_unit, recurse),
    "interrupt": (in_unit, lambda: os.kill(os.getpid(), signal.SIGINT)),
    "segfault": (in_unit, lambda: ctypes.string_at(0)),
    "kill": (in_unit, lambda: os.kill(os.getpid(), signal.SIGKILL)),
    "abort": (in_unit, os.abort),
    "vanish": (in_unit, lambda: os._exit(0)),
    "import": (in_import, lambda: None),
    "journal": (in_journal, fill_disk),
    "result": (in_result, fill_disk),
    "folder": (in_result, lose_folder),
    "writing": (in_result, planted),
}


def plant(kind, rank, turn):
    """Plant the fault once MPI has started: then this process knows its rank."""
    start = running.start_mpi

    def replaced():
        world = start()
        if world.rank == rank:
            place, action = KINDS[kind]
            place(after(turn, action))
        return world

    running.start_mpi = replaced


if __name__ == "__main__":
    _, kind, rank, turn, *words = sys.argv
    sys.argv = ["pgran", *words]
    plant(kind, int(rank), int(turn))
    program.console()
