"""Exceptions, exit codes, and the log of what is said besides."""

import logging
import sys
import traceback
from importlib import import_module
from pathlib import Path

log = logging.getLogger("pgran")

DONE, BAD_INPUT, INACCURATE, BAD_FILE, STOPPED, INTERRUPTED = 0, 2, 3, 4, 75, 130
LONGEST = 1010  # characters of a message
# What PETSc's errors hold where an option of the user's is to blame.
WRONG_OPTION = ("SetFromOptions()", "Could not locate solver type")


class PgranError(Exception):
    """An error whose message is meant for the user, without a traceback.

    One line of bounded length without control characters, whatever a file put into it.
    """

    exit_code = 1

    def __init__(self, message):
        text = "".join(c if c.isprintable() else "?" for c in str(message))
        super().__init__(text if len(text) <= LONGEST else f"{text[:500]} ... {text[-500:]}")

    def _render_traceback_(self, *_):
        """Return the lines that IPython shows: those of the user that led here, what is wrong."""
        named, home, lines = sys.modules["IPython"].get_ipython().compile, Path(__file__).parent, []
        for name, number, _, line in traceback.extract_tb(self.__traceback__):
            if home in Path(name).parents:
                break
            if "-packages" not in name:  # as IPython's own
                place = " ".join(named.format_code_name(name) or [name])
                lines.append(f"{place}, line {number}: {line}")
        return [*lines, f"{type(self).__name__}: {self}"]


class InputError(PgranError):
    """Bad input: nothing was computed."""

    exit_code = BAD_INPUT


def is_petsc(error):
    """Return whether PETSc or SLEPc raised an error."""
    return type(error).__module__.startswith("petsc4py")


def is_foreseen(error):
    """Return whether pgran or PETSc raised an error, on purpose."""
    return isinstance(error, PgranError) or is_petsc(error)


def is_bad_input(error):
    """Return whether an error is to blame on the user's options."""
    blamed = is_petsc(error) and any(sign in str(error) for sign in WRONG_OPTION)
    return blamed or isinstance(error, InputError)


def petsc_message(error):
    """Return in one line what went wrong in PETSc, and in which call."""
    # Its text: a number, the calls, a kind of error, and what it was in particular.
    lines = [line.split("] ", 1)[-1] for line in str(error).splitlines()]
    calls = [line.split(" at ")[0] for line in lines if "() at " in line]
    details = [line for line in lines[1:] if "() at " not in line]
    return str(
        PgranError(f"PETSc: {(details[1:] or details or lines)[0]} ({', '.join(calls[:1])})")
    )


class FileError(PgranError):
    """A file that cannot be read or written, or is not what it should be."""

    exit_code = BAD_FILE


class StoppedError(PgranError):
    """A signal has stopped the run; what is finished is kept."""

    exit_code = STOPPED


def needed(who, package, module=None):
    """Return a package that only some need, or a module by it; raise where it is not installed."""
    try:
        import_module(package)
        return import_module(module or package)
    except ImportError as error:
        why = f"{who} needs {package}, which cannot be imported ({error})"
        cure = f"pip install {package}, or apt install python3-{package}"
        raise PgranError(f"{why}: {cure}") from None


def reason_of(error):
    """Return an OSError as `path: reason`."""
    reason = error.strerror or str(error)
    return f"{error.filename}: {reason}" if error.filename else reason


def explain(error):
    """Return the exit code of an error, and what to say of it."""
    if isinstance(error, PgranError):
        return error.exit_code, str(error)
    if isinstance(error, SystemExit):
        code = error.code if isinstance(error.code, int) else 1
        return code, f"ended by sys.exit({error.code!r})"
    if isinstance(error, KeyboardInterrupt):
        return INTERRUPTED, str(error) or "interrupted"
    if isinstance(error, MemoryError):
        return 1, str(PgranError(f"out of memory: {type(error).__name__}: {error}"))
    if isinstance(error, ImportError):
        return 1, str(PgranError(f"{error}: pgran doctor says how to mend it"))
    if is_petsc(error) and error.__cause__:
        return explain(error.__cause__)  # a Python error that PETSc has met in a callback
    if is_petsc(error):
        return BAD_INPUT if is_bad_input(error) else 1, petsc_message(error)
    return 1, "".join(traceback.format_exception(error)).rstrip()
