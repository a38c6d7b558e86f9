"""`pgran study`: a run for each of several values of one option, stopped and continued as a whole.

Each is a `pgran run` by itself, as PETSc reads its keys once, when it starts.
"""

import os
import shlex
import shutil
import signal
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from urllib.parse import quote

import pgran
from pgran import errors
from pgran.command.export import result_of
from pgran.command.resolve import resolve
from pgran.command.words import Parser
from pgran.errors import FileError, InputError, PgranError, log
from pgran.run import launch
from pgran.run.options import KEY, RUN, files_first, read_environment, read_files, read_words

EXAMPLE = "pgran study options/damping.opts -lattice_damping .001 .003 .01"
HOW = tuple(f"-{option.name}" for option in RUN)  # what decides no number
PROGRAM = sys.executable, "-P", "-m", "pgran", "run"
COMPUTED = errors.DONE, errors.INACCURATE


def run(words):
    """Run an experiment for each of several values of one option, and tell a table of the results.

    The key with several words after it is the one that is studied; a value that is a list is one
    word, with commas. The same command leaves out what is done, and goes on where it was stopped.
    Results are named after their values, NAME-damping_.001.h5; other keys, and the exit code, which
    is that of the first run that failed, are as of pgran run. In the environment
    PGRAN_LAUNCH='mpirun -n 2' starts the ranks of each run, and SLURM_ARRAY_TASK_ID=K, of a job
    array, chooses the K-th value alone, counted from 1.
    """
    if {"-h", "--help", "-help"} & set(words):
        usage = "pgran study FILE [MORE.opts ...] -key A B ... [-other value ...]"
        Parser("study", run.__doc__, EXAMPLE, usage=usage, add_help=False).print_help()
        return errors.DONE
    if any(name in os.environ for name in launch.SIZES):
        raise InputError("study: starts ranks itself: PGRAN_LAUNCH='mpirun -n 2' pgran study ...")
    variables, part = dict(os.environ), os.environ.get("SLURM_ARRAY_TASK_ID")
    try:
        launcher = shlex.split(variables.get("PGRAN_LAUNCH", ""))
    except ValueError as error:
        raise InputError(f"study: PGRAN_LAUNCH: {error}") from None
    if launcher and not shutil.which(launcher[0]):
        raise InputError(f"study: PGRAN_LAUNCH: there is no {launcher[0]}")
    members = [(str(number), *member) for number, member in enumerate(_members(words), 1)]
    chosen = [member for member in members if part in (None, member[0])]
    if not chosen:
        raise InputError(f"study: SLURM_ARRAY_TASK_ID {part}: the parts are 1 to {len(members)}")
    codes = {path: _code_of_result(path, options) for _, path, options, _ in chosen}
    for number, path, _, own in chosen:
        told = f"part {number} of {len(members)}, {path}"
        if codes[path] is not None:
            log.info("%s: is there already", told)
            continue
        log.info("%s", told)
        codes[path] = code = _carry_out([*launcher, *PROGRAM, *own], variables)
        if code in (errors.STOPPED, errors.INTERRUPTED):
            log.info("%s: stopped; the same command goes on", told)
            return code
        if code not in COMPUTED:
            log.warning("%s: failed, with exit code %d", told, code)
    there = [path for path in codes if codes[path] in COMPUTED and os.path.exists(path)]
    if there and part is None and "-dry_run" not in words:
        from pgran.command.table import in_words, table

        try:
            print(in_words(table(there)))
        except PgranError as error:  # no pandas; the results are there
            log.warning("no table: %s", error)
    return next((code for code in codes.values() if code not in COMPUTED), max(codes.values()))


def _members(words):
    """Yield the result of each run that words ask for, its options, and its own words."""
    files, rest = files_first(words)
    if not files or files[0].startswith("-"):
        raise InputError(f"study: an options file comes first, as in {EXAMPLE}")
    starts = [place for place, word in enumerate(rest) if KEY.fullmatch(word)]
    groups = [rest[start:stop] for start, stop in pairwise([0, *starts, len(rest)])]
    studied = [group for group in groups if len(group) > 2]
    if len(studied) != 1 or studied[0][0].startswith(HOW):
        found = ", ".join(group[0] for group in studied) or "none"
        raise InputError(f"study: one key of the experiment has several values; here: {found}")
    key, *values = studied[0]
    others = [word for group in groups if group is not studied[0] for word in group]
    given = read_environment() + read_files(files) + read_words(others)
    for value in dict.fromkeys(values):
        read = given + read_words([key, value])
        options = resolve(read, f"results/{Path(files[0]).stem}.h5")
        path, name = Path(options.output_file), key.lstrip("-").lower()
        end = f"{name.partition('_')[2] or name}_{quote(value.removesuffix('.h5'), ',+')}"
        path = str(path.with_stem(f"{path.stem}-{end}"))
        yield path, options, [*files, *others, key, value, "-output_file", path]


def _code_of_result(path, options):
    """Return the exit code of a run whose result is there; None: it is to be computed.

    What was made otherwise is replaced if asked for, else refused, by a FileError.
    """
    if not os.path.exists(path):
        return None
    result = result_of(path)
    texts = getattr(result, "options", ""), options.text()
    was, now = ({line for line in t.splitlines() if not line.startswith(HOW)} for t in texts)
    for word in shlex.split(" ".join(now).replace(",", " ")):
        if os.path.isfile(word) and os.path.getmtime(word) > os.path.getmtime(path):
            was, now = was | {f"an older {word}"}, now | {f"a newer {word}"}
    version = getattr(result, "pgran_version", pgran.__version__)
    was, now = was | {f"pgran {version}"}, now | {f"pgran {pgran.__version__}"}
    if was == now:
        return errors.INACCURATE if result.status == "unconverged" else errors.DONE
    if options.output_overwrite:
        return None
    before, after = (
        ", ".join(sorted(lines)) or "other options" for lines in (was - now, now - was)
    )
    why = f"was made with {before}, and now it is {after}"
    raise FileError(f"{path}: {why}; -output_overwrite replaces it, -output_file takes another")


def _carry_out(program, variables):
    """Carry out a run, which gets the signals of this process, and return its exit code."""
    noted, child = [], None

    def note(number, frame):
        noted.append(number)
        if child and number != signal.SIGINT:  # Ctrl-C meets all processes of a terminal
            child.send_signal(signal.SIGUSR1)  # after SIGTERM mpirun leaves its ranks a second

    before = [(number, signal.signal(number, note)) for number in launch.HELD]
    child = subprocess.Popen(program, env=variables)
    code = child.wait()
    for number, handler in before:
        signal.signal(number, handler)
    if noted:
        return errors.INTERRUPTED if signal.SIGINT in noted else errors.STOPPED
    return code if code >= 0 else 128 - code  # killed, as a shell says it
