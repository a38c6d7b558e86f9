"""`pgran run`: MPI and PETSc started, a scene computed under its journal, its result written."""

import faulthandler
import importlib
import logging
import shlex
import signal
import sys
import time
from importlib import metadata
from pathlib import Path

import pgran
from pgran import errors
from pgran.catalogue import code_of
from pgran.command.resolve import SCENES, opening, resolve, run_scene
from pgran.errors import FileError, InputError, PgranError, log
from pgran.run import launch, machine, streams
from pgran.run.agreement import agreeing, on_root
from pgran.run.options import files_first, read_environment, read_files, read_words

DOES = """\
Compute the experiment in an options file, and write its result to results/NAME.h5. Further files,
NAME.opts, win over those before, keys given here over all. The same command goes on with a run that
was stopped."""
EXAMPLES = (
    "pgran run options/response.opts",
    "mpirun -n 2 pgran run options/response.opts -bonds_seed 7 -output_file results/seven.h5",
    "pgran run options/response.opts options/solvers/gmres.opts -lattice_shape 40,40 -dry_run",
)
MORE = """\
keys:
  pgran options SCENE lists all, with their units, ranges and defaults.
  pgran manual options says how they are written, pgran manual experiments which
  options files there are.

exit codes:
  0   done
  2   bad input; nothing was computed
  3   computed, but some numbers miss the accuracy asked for; they are marked
  4   files, or an output that is full
  75  stopped by a signal; the same command goes on
  130 interrupted by Ctrl-C; the same command goes on
  1   anything else
"""


def run(words):
    """Run the experiment of an options file, and return the exit code. Collective."""
    if {"-h", "--help", "-help"} & set(words):
        from pgran.command.words import Parser

        usage = "pgran run FILE [MORE.opts ...] [-key value ...]"
        Parser("run", DOES, *EXAMPLES, more=MORE, usage=usage, add_help=False).print_help()
        return errors.DONE
    faulthandler.enable()  # a crash in a library names the line that called it
    started = time.perf_counter()
    world = start_mpi()  # before any error: without MPI mpirun would have more to say of it
    if not words or words[0].startswith("-"):
        raise InputError(f"run: an options file comes first, as in {EXAMPLES[0]}")
    files, rest = files_first(words)
    environment = world.bcast(read_environment())  # each rank's own is not to be read by PETSc
    given = environment + on_root(world, lambda: read_files(files)) + read_words(rest)
    options = resolve(given, output_file=f"results/{Path(files[0]).stem}.h5")
    if options.output_log:
        _start_log(options, words, world)
    scene = SCENES[options.scene]
    if scene.on_medium:
        start_petsc(options)
    if options.dry_run:
        return _foresee(scene, options, world, started)
    try:
        return _compute(scene, options, words, world, started)
    except errors.StoppedError as stopped:  # on all ranks alike: they end in order
        if world.rank == 0:
            log.info("%s", stopped)
        return errors.STOPPED
    except KeyboardInterrupt:
        text = "interrupted; what is finished is kept, and the same command goes on"
        raise KeyboardInterrupt(text) from None


def start_mpi():
    """Start MPI, and return all ranks, which must know of each other. Collective."""
    MPI = launch.start()
    world = MPI.COMM_WORLD
    if world.rank > 0:
        log.setLevel(logging.WARNING)
        streams.name_rank(world)
    if strangers := launch.strangers(MPI):
        raise InputError(strangers)
    return world


def _start_log(options, words, world):
    """Let messages go to the log file of the options, too. Collective."""
    from pgran.store.estimate import counted

    path = options.output_log
    if Path(path).absolute() == Path(options.output_file).absolute():
        raise InputError(f"-output_log {path}: is the -output_file")
    on_root(world, lambda: streams.check_log(path, make=not options.dry_run))
    if not options.dry_run:
        handler = streams.LogFile(path, world.rank)
        log.addHandler(handler)
        if world.rank == 0:
            text = f"{shlex.join(['pgran', 'run', *words])} on {counted(world.size, 'rank')}"
            handler.handle(logging.makeLogRecord({"msg": text, "levelno": logging.INFO}))


def start_petsc(options):
    """Hand the solver keys to PETSc, which reads nothing of its own accord. Collective."""
    try:
        import petsc4py
    except ImportError:
        cure = "bash jobs/setup.sh makes .venv with it; pgran doctor says more"
        raise PgranError(f"petsc4py cannot be imported: {cure}") from None
    words = [word for key, text in options.solver.items() for word in (f"-{key}", text) if word]
    petsc4py.init(["pgran", "-skip_petscrc", "-no_signal_handler", *words])
    importlib.import_module("pgran.run.petsc")  # where a PETSc that is no use is refused


def _foresee(scene, options, world, started):
    """Say what a run will need. Collective."""
    from pgran.command.forecast import forecast
    from pgran.run.journal import Journal
    from pgran.store.file import check_output

    signal.pthread_sigmask(signal.SIG_UNBLOCK, launch.HELD)  # there is nothing to keep
    output, overwrite = options.output_file, options.output_overwrite
    identity = _run_identity(on_root(world, options.identity), options.scene)
    for line in forecast(scene, options, world, started):
        print(line)
    if world.rank == 0:
        _warn_of_unused(options)
    # what refuses the run refuses this as well, once its needs are said
    on_root(world, lambda: check_output(output, overwrite, make=False))
    with Journal(world, output, identity, overwrite, dry=True):
        return errors.DONE


def _compute(scene, options, words, world, started):
    """Compute a scene, or go on with it, and write its result. Collective."""
    from pgran.run.crew import Crew
    from pgran.run.journal import Journal
    from pgran.store.file import check_output

    output, overwrite = options.output_file, options.output_overwrite
    on_root(world, lambda: check_output(output, overwrite))
    asked = on_root(world, options.identity)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
    with Journal(world, output, _run_identity(asked, options.scene), overwrite) as journal:
        # again: another run may have written it just before the journal was locked
        on_root(world, lambda: check_output(output, overwrite))

        def crew(ranks, medium=None):
            if medium is not None:
                journal.medium = medium.bonds_sha256
                _check_room(options, medium, ranks, world)
            text = opening(options, world.size, medium)

            def begins():
                for name, now in options.identity().items():
                    if asked[name] != now:
                        why = "has changed since the run started; start it again"
                        raise FileError(f"-{name} {now}: {why}")
                log.info("%s", text)

            return Crew(world, ranks, journal, begins)

        records = run_scene(scene, options, world, crew)
        solvers = sys.modules["pgran.run.petsc"].work_done(world) if scene.on_medium else []
        if not journal.is_new:
            solvers = [f"{line}, since it went on" for line in solvers]
        facts = scene, options, words, world, records, solvers, started
        failures = on_root(world, lambda: _write(*facts))
        return errors.INACCURATE if failures else errors.DONE


def _check_room(options, medium, ranks, world):
    """Raise where the matrices and factors of a medium exceed the memory. Collective."""
    from pgran.command.medium import is_factored, lattice_memory

    # modes take other factors, and pulses may take none
    of = getattr(options, f"{options.scene}_of", options.scene)
    factored = SCENES[of].shares_lattice and of != "pulse" and is_factored(options, medium)
    key = "lattice_shape" if medium.is_grid else "network_file"
    with agreeing(world):  # what is foreseen is right to a third
        machine.check_memory(key, lattice_memory(medium, ranks, factored) / 3)


def _write(scene, options, words, world, records, solvers, started):
    """Write the result of a run, say what it is, and return how many numbers failed, on rank 0."""
    import numpy

    from pgran.run.experiment import Caution
    from pgran.store import file as store
    from pgran.store.record import Result

    failures = sum(int(numpy.sum(record.failures)) for record in records)
    seconds = time.perf_counter() - started
    attributes = _run_attributes(options, words, world, failures, seconds)
    attributes |= {"solvers": "\n".join(solvers)} if solvers else {}
    output = options.output_file
    store.write(output, attributes, records, options.output_overwrite)
    if failures:
        log.warning("results that miss the accuracy asked for, and are marked: %d", failures)
    try:
        _warn_of_unused(options)
        lines = [*scene.summary(Result(records, **attributes)), *solvers]
        for line in sorted(lines, key=lambda line: not isinstance(line, Caution)):
            level = logging.WARNING if isinstance(line, Caution) else logging.INFO
            log.log(level, "%s", line)
    except Exception as error:  # no reason to fail: the result is there
        log.warning("no summary: %s: %s", type(error).__name__, error)
    draw = f"pgran plot {shlex.quote(output)}"
    log.info("written after %.1f s; to draw it: %s", seconds, draw)
    return failures


def _run_identity(asked, scene):
    """Return what decides a run's numbers, {name: text}: what is asked, and who computes it."""
    versions = {
        "pgran": pgran.__version__,
        "PETSc": machine.loaded_version("petsc4py.PETSc"),  # of whose release SLEPc is
        "NumPy": _installed_version("numpy"),
        "SciPy": _installed_version("scipy"),  # not imported by all that run
    }
    return versions | code_of(scene) | {f"-{name}": text for name, text in asked.items()}


def _run_attributes(options, words, world, failures, seconds):
    """Return what a result file says of its run."""
    from pgran.run.experiment import facts_of_run

    units = {name: getattr(options, name) for name in ("units_length", "units_time")}
    told = {"scene": options.scene, "options": options.text(), "seconds": seconds}
    told |= {"command": shlex.join(["pgran", "run", *words]), "blas_kernel": machine.blas_kernels()}
    told |= {name: value for name, value in units.items() if value is not None}
    return facts_of_run(failures, world.size) | told


def _installed_version(name):
    """Return the version of a package, which need not be imported."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:  # built by hand, without a word of what it is
        return "unknown"


def _warn_of_unused(options):
    """Warn of solver keys that no PETSc object asked for."""
    if options.solver_keys:
        from pgran.run.keys import warn_of_unused

        warn_of_unused(options.solver_keys)
