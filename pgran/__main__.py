"""The command line. Starts MPI and PETSc for `run`, and ends all ranks when one fails."""

import argparse
import faulthandler
import hashlib
import importlib
import logging
import os
import shlex
import signal
import sys
import time
import traceback
from pathlib import Path

import pgran
from pgran import errors, launch
from pgran.errors import InputError, PgranError, on_root

log = logging.getLogger("pgran")

USAGE = """\
pgran: sound in a granular material, a lattice of balls and random springs

  pgran run FILE [-key value ...]   compute the experiment in an options file; keys given here win
  pgran plot RESULT [OTHER] [-o FIGURE]
                                    draw the figures of a result; of a response and of modes of the
                                    same lattice: the response, with the modes marked
  pgran options [SCENE]             list every option: type, unit, default, range, meaning
  pgran doctor                      say what is installed, and what is wrong with it
  pgran --help, pgran --version

In parallel: mpirun -n 2 pgran run options/response.opts
"""


def main(words):
    """Carry out one command and return its exit code."""
    if not words or words[0] in ("-h", "--help", "help"):
        print(USAGE, end="")
        return errors.DONE if words else errors.BAD_INPUT
    if words[0] == "--version":
        print(f"pgran {pgran.__version__}")
        return errors.DONE
    commands = {"run": run, "plot": plot, "options": list_options, "doctor": doctor}
    if words[0] not in commands:
        raise InputError(f"{words[0]}: no such command; pgran --help lists them")
    if sys.version_info < (3, 11) and words[0] != "doctor":
        raise PgranError("this Python is older than 3.11; pgran doctor says how to mend it")
    return commands[words[0]](words[1:])


def run(words):
    """Run the experiment of an options file. Collective over all ranks."""
    # Signals to stop wait until the journal listens, and do no harm once the result is written;
    # blocked before anything starts threads, which else would get them.
    signal.pthread_sigmask(signal.SIG_BLOCK, errors.SIGNALS)
    faulthandler.enable()  # a crash in a library names the line that called it

    from pgran.options import WITHOUT_PETSC
    from pgran.reading import read_environment, read_file, read_words, resolve

    if not words or words[0].startswith("-"):
        raise InputError("run: an options file is needed, as in pgran run options/response.opts")
    started = time.perf_counter()
    path, *rest = words
    world = start_mpi()
    given = read_environment() + on_root(world, lambda: read_file(path)) + read_words(rest)
    options = resolve(given, output_file=f"results/{Path(path).stem}.h5")
    if options.output_log:
        start_log(options, words, world)
    if options.scene not in WITHOUT_PETSC:
        start_petsc(options)

    import numpy

    from pgran import store
    from pgran.journal import Journal

    output = options.output_file
    if options.dry_run:
        from pgran.forecast import forecast

        on_root(world, lambda: store.check_output(output, options.output_overwrite, make=False))
        for line in forecast(options, world, started):
            print(line)
        if world.rank == 0:
            warn_of_unused(options)
        return errors.DONE
    on_root(world, lambda: store.check_output(output, options.output_overwrite))
    identity = on_root(world, lambda: run_identity(options))
    try:
        with Journal(world, output, identity, options.output_overwrite) as journal:
            # again: another run may have written it just before the journal was locked
            on_root(world, lambda: store.check_output(output, options.output_overwrite))
            scene = importlib.import_module(f"pgran.scenes.{options.scene}")
            records = scene.run(options, world, journal)

            def finish():
                failures = sum(int(numpy.sum(getattr(r, "failures", 0))) for r in records)
                seconds = time.perf_counter() - started
                attributes = run_attributes(options, words, world, failures, seconds)
                store.write(output, attributes, records)
                warn_of_unused(options)
                for line in scene.summary(records):
                    log.info(line)
                log.info("written to %s after %.1f s", output, seconds)
                if failures:
                    log.warning(
                        "%d results miss the accuracy asked for; the file marks them", failures
                    )
                return failures

            return errors.INACCURATE if on_root(world, finish) else errors.DONE
    except errors.StoppedError as stopped:  # on all ranks alike: they end in order
        if world.rank == 0:
            log.info("%s", stopped)
        return errors.STOPPED


def run_identity(options):
    """Return what decides a run's numbers, {option: text}. Not collective."""
    identity = {"pgran": pgran.__version__} | options.identity()
    for name in ("bonds_file", "accuracy_solvers"):
        paths = getattr(options, name, None) or ()
        for path in [paths] if isinstance(paths, str) else paths:
            contents = hashlib.sha256(Path(path).read_bytes()).hexdigest()
            identity[name] += f" ({path} holds {contents[:16]})"
    return identity


def start_mpi():
    """Start MPI and the log, and return all ranks.

    Raises
    ------
    InputError
        If a foreign mpirun started independent copies.
    """
    from mpi4py import MPI

    world = MPI.COMM_WORLD
    if world.rank > 0:
        log.setLevel(logging.WARNING)
        name_rank(world)
    if world.size == 1 and launch.size() > 1:
        raise InputError(
            f"mpirun started {launch.size()} ranks that do not know of each other: it belongs to "
            f"another MPI than mpi4py ({MPI.Get_library_version().split(',')[0]})"
        )
    return world


def start_log(options, words, world):
    """Let messages go to the log file of the options, too. Collective."""
    from pgran import logfile

    path = options.output_log
    if Path(path).absolute() == Path(options.output_file).absolute():
        raise InputError(f"-output_log {path}: is the -output_file")
    on_root(world, lambda: logfile.check(path, make=not options.dry_run))
    if not options.dry_run:
        handler = logfile.LogFile(path, world.rank)
        log.addHandler(handler)
        if world.rank == 0:
            command = shlex.join(["pgran", "run", *words])
            text = f"{command} on {world.size} rank{'s' if world.size > 1 else ''}"
            handler.handle(logging.makeLogRecord({"msg": text, "levelno": logging.INFO}))


def start_petsc(options):
    """Hand the solver keys to PETSc, which reads no file and no environment of its own."""
    try:
        import petsc4py
    except ImportError:
        raise PgranError(
            "petsc4py cannot be imported: bash jobs/setup.sh makes .venv with it; "
            "pgran doctor says more"
        ) from None
    words = [word for key, text in options.solver.items() for word in (f"-{key}", text) if word]
    petsc4py.init(["pgran", "-skip_petscrc", "-no_signal_handler", *words])
    from petsc4py import PETSc

    if PETSc.ScalarType().dtype.kind != "c":
        raise PgranError("this PETSc has real scalars; pgran needs a complex one (pgran doctor)")


def run_attributes(options, words, world, failures, seconds):
    """Return what a result file says of its run."""
    import numpy

    return {
        "pgran_version": pgran.__version__,
        "scene": options.scene,
        "status": "unconverged" if failures else "complete",
        "command": shlex.join(["pgran", "run", *words]),
        "options": options.text(),
        "petsc_version": loaded_version("petsc4py.PETSc"),
        "slepc_version": loaded_version("slepc4py.SLEPc"),
        "numpy_version": numpy.__version__,
        "mpi_size": world.size,
        "seconds": seconds,
        "time_convention": "exp(+i omega t)",
    }


def loaded_version(name):
    """Return the version of PETSc or SLEPc, if this run has loaded it."""
    module = sys.modules.get(name)
    return ".".join(map(str, module.Sys.getVersion())) if module else "not loaded"


def warn_of_unused(options):
    """Warn of solver keys that no PETSc object asked for."""
    from pgran.options import SOLVER_PREFIXES

    keys = [key for key in options.solver if key.startswith(tuple(SOLVER_PREFIXES))]
    if "petsc4py.PETSc" in sys.modules:
        from pgran.database import unused

        keys = unused(keys)
    for key in keys:
        log.warning("-%s was not used: no solver of this run has such an option", key)


def plot(words):
    """Draw the figures of a result, a response with the modes of another one marked."""
    parser = argparse.ArgumentParser("pgran plot", description=plot.__doc__)
    parser.add_argument("result", help="HDF5 file that pgran run has written")
    parser.add_argument("other", nargs="?", help="modes of the response's lattice, or vice versa")
    parser.add_argument("-o", "--output", help="figure file; its ending decides the format")
    given = parser.parse_intermixed_args(words)
    from pgran import figures

    shown, modes = pgran.load(given.result), None
    if given.other:
        shown, marked, swapped = figures.pair(shown, pgran.load(given.other))
        modes = marked.modes.omega
        if not getattr(marked.modes, "count_certified", False):
            log.warning("modes are missing or inaccurate, so not all are marked")
        given.result = given.other if swapped else given.result
    for path in figures.draw(
        shown, given.output or str(Path(given.result).with_suffix(".png")), modes
    ):
        print(path)
    return errors.DONE


def list_options(words):
    """List every option of one scene, or of all."""
    from pgran.options import SCENES, describe_options, nearest

    if words and words[0] not in SCENES:
        near = nearest(words[0], SCENES)
        raise InputError(
            f"{words[0]}: no scene; choose {', '.join(SCENES)}"
            + (f"; did you mean {near}?" if near else "")
        )
    print(describe_options(words[0] if words else None), end="")
    return errors.DONE


def doctor(words):
    """Say what is installed, and how to mend what is wrong."""
    from pgran.doctor import examine

    return examine()


def console():
    """Run the command line; whatever goes wrong on one rank ends all of them at once."""
    log.propagate = False
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("pgran: %(message)s"))
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    try:
        code = main(sys.argv[1:])
    except BaseException as error:
        end_all_ranks(error)
    sys.exit(code)


def end_all_ranks(error):
    """Report an error once, and end this process, or the whole job where there are other ranks."""
    code, text = explain(error)
    mpi = sys.modules.get("mpi4py.MPI")
    running = mpi and mpi.Is_initialized() and not mpi.Is_finalized()
    world = mpi.COMM_WORLD if running and mpi.COMM_WORLD.size > 1 else None
    try:
        if world:
            kind = (type(error).__name__, str(error).partition("\n")[0])
            first, alike = errors.who_reports(world, kind)
            if world.rank != first:  # that one ends all
                signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGTERM])
                time.sleep(5 * errors.SECONDS_FOR_OTHERS)
            if not alike:
                name_rank(world)
        elif isinstance(error, InputError) and launch.rank() > 0:
            text = None  # before MPI joined them all copies met it alike; the first one says it
        elif isinstance(error, SystemExit) and isinstance(error.code, int):
            text = None  # whoever called sys.exit has said why
        if text:
            log.error("%s", text)
        sys.stderr.flush()
        sys.stdout.flush()
    finally:  # whatever else goes wrong: no rank must be left waiting
        if world:
            world.Abort(code)
    if is_petsc(error):
        os._exit(code)  # after an error of its own PETSc can crash while it is shut down
    sys.exit(code)


def explain(error):
    """Return the exit code of an error, and what to say of it."""
    if isinstance(error, PgranError):
        return error.exit_code, str(error)
    if isinstance(error, SystemExit):
        code = error.code if isinstance(error.code, int) else 1
        return code, f"ended by sys.exit({error.code!r})"
    if isinstance(error, KeyboardInterrupt):
        return 130, "interrupted"
    if isinstance(error, ModuleNotFoundError):
        return 1, f"{error}: pgran doctor says how to mend it"
    if is_petsc(error):
        wrong_option = "SetFromOptions()" in str(error)
        return errors.BAD_INPUT if wrong_option else 1, petsc_message(error)
    return 1, "".join(traceback.format_exception(error)).rstrip()


def petsc_message(error):
    """Return in one line what went wrong in PETSc, and in which call of pgran's."""
    # Its text: a number, the calls, a kind of error, and what it was in particular.
    lines = [line.split("] ", 1)[-1] for line in str(error).splitlines()]
    calls = [line.split(" at ")[0] for line in lines if "() at " in line]
    said = [line for line in lines[1:] if "() at " not in line]
    return str(PgranError(f"PETSc: {(said[1:] or said or lines)[0]} ({', '.join(calls[:1])})"))


def is_petsc(error):
    """Return whether PETSc or SLEPc raised an error: a wrong solver option, a failing package."""
    return type(error).__module__.startswith("petsc4py")


def name_rank(world):
    """Begin all further messages of this process with its rank."""
    log.handlers[0].setFormatter(logging.Formatter(f"pgran (rank {world.rank}): %(message)s"))


if __name__ == "__main__":
    console()
