"""The command line; whatever goes wrong on one rank ends all of them."""

import contextlib
import importlib
import logging
import os
import signal
import sys
import time
import warnings
from pathlib import Path

import pgran
from pgran import errors
from pgran.arguments import meant, nearest, saying_once
from pgran.errors import FileError, InputError, PgranError, explain, is_petsc, log
from pgran.run import launch, machine, streams

SECONDS_TO_BE_ENDED = 5.0  # that a rank waits for another one's abort
# Of each command what it takes, what it does, and its function in `pgran.command`, which returns an
# exit code.
COMMANDS = {
    "run": ("FILE [-key value ...]", "compute the experiment in an options file", "run.run"),
    "study": ("FILE -key A B ...", "compute it for each of several values", "study.run"),
    "plot": ("RESULT [OTHER ...]", "draw the figures of a result, or of several", "plot.run"),
    "table": ("RESULT OTHER ...", "tell the numbers of several results", "table.run"),
    "compare": ("A B", "say how alike two responses or two codas are", "compare.run"),
    "export": ("RESULT TO", "write it as a table, or for ParaView", "export.run"),
    "verify": ("RESULT", "say whether it is unchanged", "verify.verify"),
    "import": ("ATOMS CONTACTS -o TO", "make a network of another program's balls", "imports.run"),
    "pack": ("--balls N -o TO", "make a packing in mechanical equilibrium", "pack.run"),
    "units": ("--diameter M ...", "say what its numbers are in SI units", "units.run"),
    "sound": ("FILE", "compute the speeds of long waves, by statics", "sound.run"),
    "options": ("[SCENE]", "list every option", "listing.list_options"),
    "manual": ("[WORD]", "show a page of the manual, or what holds a word", "manual.run"),
    "doctor": ("", "say what is installed, and what is wrong", "doctor.examine"),
    "cite": ("", "say how to cite pgran", "manual.cite"),
}
LINES = [f"  {f'pgran {name} {words}':<35} {does}\n" for name, (words, does, _) in COMMANDS.items()]
USAGE = f"""\
pgran: sound in a granular material, balls joined by springs of random strength

{"".join(LINES)}
pgran COMMAND --help says more; pgran --version says which this is.
In parallel: mpirun -n 2 pgran run options/response.opts
"""


def main(words):
    """Carry out one command and return its exit code."""
    if words[:1] == ["help"] and words[1:]:
        words = [words[1], "--help"]
    if not words or words[0] in ("-h", "-help", "--help", "help"):
        if launch.rank() == 0:
            print(USAGE, end="")
        return errors.DONE if words else errors.BAD_INPUT
    if words[0] == "--version":
        print(f"pgran {pgran.__version__}")
        return errors.DONE
    if words[0] not in COMMANDS:
        file = {".opts": f"run {words[0]}", ".h5": f"plot {words[0]}"}.get(Path(words[0]).suffix)
        near = file or nearest(words[0], [*COMMANDS, "--help", "--version"])
        hint = meant(near and f"pgran {near}", "; pgran --help lists them")
        raise InputError(f"{words[0] or repr('')}: no such command{hint}")
    if sys.version_info < (3, 11) and words[0] != "doctor":
        raise PgranError("this Python is older than 3.11; pgran doctor says how to mend it")
    if words[0] != "doctor":
        machine.check_limits()
    module, _, function = COMMANDS[words[0]][-1].partition(".")
    command = getattr(importlib.import_module(f"pgran.command.{module}"), function)
    with saying_once():
        return command(words[1:])


def console(command=None):
    """Carry out a command; `main` unless another function from words to an exit code is given."""
    if sys.argv[1:2] == ["run"]:
        # Signals wait, to stop until the journal listens, Ctrl-C until all is imported: the others
        # would wait for ever for a rank that ends before MPI joins them, or within. Before anything
        # starts threads, which else would get them. They do no harm once the result is written.
        signal.pthread_sigmask(signal.SIG_BLOCK, launch.HELD)
    streams.guard()
    log.propagate = False
    handler = logging.StreamHandler()
    handler.setFormatter(streams.Messages("pgran"))
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    # in one line, without the place in a library's source
    warnings.showwarning = lambda message, category, *where: log.warning(
        "%s: %s", category.__name__, " ".join(str(message).split())
    )
    try:
        try:
            code = (command or main)(sys.argv[1:])
        except SystemExit:  # a help text has been printed
            sys.stdout.flush()
            raise
        sys.stdout.flush()
    except BaseException as error:
        end_all_ranks(error)
    sys.exit(code)


def end_all_ranks(error):
    """Report an error, and end this process, or the whole job where there are other ranks.

    What all ranks meet the first one reports, anything else whoever has met it.
    """
    from pgran.run import agreement  # here: most commands do without

    code, text = explain(error)
    mpi = sys.modules.get("mpi4py.MPI")
    running = mpi and mpi.Is_initialized() and not mpi.Is_finalized()
    world = mpi.COMM_WORLD if running and mpi.COMM_WORLD.size > 1 else None
    try:
        if world is not None:
            if not agreement.met_by_all(world):
                streams.name_rank(world)
            elif world.rank > 0:  # the first one ends all
                text = None
                signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGTERM])
                time.sleep(SECONDS_TO_BE_ENDED)
        elif isinstance(error, (InputError, FileError)) and launch.rank() > 0:
            text = None  # before MPI joined them all copies met it alike; the first one says it
        elif isinstance(error, SystemExit) and isinstance(error.code, int):
            text = None  # whoever called sys.exit has said why
        if text:
            log.error("%s", text)
        sys.stderr.flush()
        with contextlib.suppress(PgranError):  # of a full device: the error is told
            sys.stdout.flush()
    finally:  # whatever else goes wrong: no rank must be left waiting
        if world is not None:
            time.sleep(agreement.SECONDS_FOR_MPIRUN)
            world.Abort(code)
    if is_petsc(error):
        os._exit(code)  # after an error of its own PETSc can crash while it is shut down
    sys.exit(code)


if __name__ == "__main__":
    console()
