"""Keys that belong to PETSc and SLEPc, and which of them a file may set.

A file can choose solvers and set numbers; it cannot make PETSc load code, start programs or write
files. Who gives such keys on the command line means them.
"""

import re

from pgran.errors import InputError

SMALLEST_SHIFT = 1e-14  # of pivots, against bond constants of about 1
# What a value in a file may be: names and numbers, one or several. No path, no `viewer:file`.
PLAIN = re.compile(r"[\w.+-]+(,[\w.+-]+)*", re.ASCII)
# MUMPS: units of Fortran that it prints to (files fort.N), and factors on disk.
MUMPS_FILES = re.compile(r".*_mumps_icntl_(1|2|3|22)")

SOLVER_PREFIXES = {
    "steady_": "every driven steady state (KSP, PC)",
    "normal_": "normal modes (EPS, ST; count_pc for the factorizations that count them)",
}
# PETSc's own run-time keys, as they are and with these beginnings.
PETSC_KEYS = {
    "citations", "get_total_flops", "history", "info", "log", "log_all", "nox", "objects_dump",
    "on_error_abort", "on_error_attach_debugger", "options_left", "skip_petscrc",
    "start_in_debugger", "stop_for_debugger", "fp_trap",
}  # fmt: skip
PETSC_BEGINNINGS = ("log_", "malloc", "memory_", "options_left", "options_view", "info_", "viewer_")
# Those that only print, as long as they stand alone: a value names a file.
PETSC_PRINTS = {
    "citations", "get_total_flops", "info", "log_view", "log_view_memory", "malloc_view",
    "memory_view", "options_left", "options_view",
}  # fmt: skip
# Words that make PETSc run code, call a program, or write a file or a socket: as a part of a solver
# key, or as the end of its value (PETSc looks at the ends of viewers' names).
HARMFUL = (
    "python", "shell", "exec", "binary", "draw", "socket", "matlab", "saws", "vtk", "hdf5", "glvis",
    "exodusii", "pyvista", "file", "filename", "dir", "tmpdir", "load", "save", "dump", "write",
    "print",
)  # fmt: skip


def is_solver_key(key):
    """Return whether a key goes to a solver."""
    return key.startswith(tuple(SOLVER_PREFIXES)) and key not in SOLVER_PREFIXES


def is_petsc_key(key):
    """Return whether a key is one of PETSc's own at run time. Not collective."""
    return key in PETSC_KEYS or key.startswith(PETSC_BEGINNINGS)


def check_harmless(key, item):
    """Raise where a key of PETSc's could do more than it should, unless the command line has it."""
    quiet = key in PETSC_PRINTS and not item.text
    if item.where and not (_harmless(key, item.text) if is_solver_key(key) else quiet):
        raise InputError(
            f"-{key} {item.text}".rstrip() + f"{item.where}: could load code, start a program "
            "or write a file; give it on the command line if you mean it"
        )


def check_ends(keys):
    """Raise where PETSc would shift the pivots of a singular matrix by nothing, and never end."""
    for key, text in keys.items():
        if not (key.startswith("steady_") and key.endswith("pc_factor_zeropivot")):
            continue
        pc = key.removesuffix("factor_zeropivot")
        # what a preconditioner inside another one shifts by default depends on both
        plain = pc == "steady_pc_" and keys.get("steady_pc_type", "lu") in ("lu", "cholesky", "ilu")
        shift = keys.get(f"{pc}factor_shift_type", "none" if plain else "unknown").lower()
        try:
            small = float(text) < SMALLEST_SHIFT
        except ValueError:
            continue  # PETSc says so itself
        if small and shift not in ("none", "nonzero"):
            raise InputError(
                f"-{key} {text}: PETSc may shift the pivots of a singular matrix by as little, and "
                f"never end; leave it out, give {SMALLEST_SHIFT:g} or more, or say "
                f"-{pc}factor_shift_type none"
            )


def _harmless(key, text):
    """Return whether a solver key cannot make PETSc load code, start programs or write files."""
    return (
        not set(key.split("_")) & set(HARMFUL)
        and not any(word.endswith(HARMFUL) for word in text.lower().split(","))
        and (not text or PLAIN.fullmatch(text) is not None)
        and (text in ("0", "6") or not MUMPS_FILES.fullmatch(key))
    )
