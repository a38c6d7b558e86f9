"""Options files and command lines, read key by key.

Options files have PETSc's syntax (`-key value`, `#` starts a comment) but are read here, before
PETSc starts, so that what is wrong is an error that names the key and the line.
"""

import os
import re
import shlex
from dataclasses import dataclass

from pgran.errors import FileError, InputError
from pgran.run import keys as solver_keys
from pgran.store.paths import open_regular

ENVIRONMENT = " (PETSC_OPTIONS)"
LONGEST_FILE = 2**20  # bytes of an options file
# Control characters and surrogates, which stand for bytes that are no UTF-8.
NO_TEXT = re.compile(r"[^\t\n\r -~\u00a0-\ud7ff\ue000-\U0010ffff]")
KEY = re.compile(r"--?[A-Za-z][\w.-]*", re.ASCII)
UNQUOTED, QUOTES = re.compile(r"[^ \t]+"), re.compile(r"['\"\\]")
# What other programs' files begin a comment with, and what others write instead of a dash.
COMMENTS, DASHES = ("//", "/*", "%", ";", "!"), tuple("\u2010\u2011\u2013\u2014\u2212")


@dataclass(frozen=True)
class Given:
    """One key as the user gave it, and where."""

    key: str
    text: str
    where: str

    @property
    def rank(self):
        """What wins: the command line over the file over the environment."""
        return {"": 2, ENVIRONMENT: 0}.get(self.where, 1)


def read_file(path):
    """Return what an options file gives, in order; an error names what is no `-key value`."""
    with open_regular(path, ".opts") as stream:
        content = stream.read(LONGEST_FILE + 1)
    if len(content) > LONGEST_FILE:
        raise FileError(f"{path}: an options file has at most {LONGEST_FILE} bytes")
    if content.startswith(b"\x89HDF"):
        raise FileError(f"{path}: not a text file, as options files are, but a result or a network")
    text = content.decode("utf-8-sig", errors="surrogateescape")  # editors may put a mark in front
    if strange := NO_TEXT.search(text):
        line = 1 + text.count("\n", 0, strange.start())
        raise FileError(f"{path}: not a text file (line {line})")
    items = []
    for number, line in enumerate(text.splitlines(), 1):
        words = UNQUOTED.findall(line.partition("#")[0])
        if not words:
            continue
        where = f" ({path}, line {number})"
        try:
            if QUOTES.search("".join(words)):  # seldom: shlex is slow
                words = shlex.split(line, comments=True)
        except ValueError as error:
            hint = next((hint for word in line.split() if (hint := _hint(word))), error)
            raise InputError(f"{line.strip()}{where}: {hint}") from None
        items += read_words(words, where)
    return items


def read_words(words, where=""):
    """Return what a command line gives: `-key value`, or `-key` alone."""
    items = []
    for word in words:
        check_word(word, where)
        if KEY.fullmatch(word):
            items.append(Given(word.lstrip("-"), "", where))
        elif re.match("--?[A-Za-z]", word):
            key, sign, value = word.partition("=")
            hint = f"write {key} {value}" if sign else "no key has such a name"
            if " " in word:
                hint = "leave out the quotes around a key and its value"
            raise InputError(f"{word}{where}: {hint}")
        elif items and not items[-1].text:
            items[-1] = Given(items[-1].key, word, where)
        else:
            hint = _hint(word, items) or "a value without a key (keys look like -key)"
            raise InputError(f"{word}{where}: {hint}")
    return items


def check_word(word, where=""):
    """Raise where a word could not be read again from an options file."""
    if NO_TEXT.search(word) or "".join(word.splitlines()) != word:
        odd = "a line break, a control character, or a byte that is no UTF-8"
        raise InputError(f"{word}{where}: holds {odd}")


def _hint(word, items=()):
    """Return what a word may have been meant to be that is no value, or None."""
    if word.startswith(COMMENTS):
        return "a comment begins with #"
    if word.endswith(".opts"):
        return "a second options file; a run takes one"
    if word.startswith(DASHES):
        return "begins with a long dash; keys begin with -"
    if re.fullmatch("[a-z]+(_[a-z]+)+|scene|detectors", word.lower()):
        return f"a value without a key; did you mean -{word.lower()}?"
    if items and items[-1].text in ("=", ":"):
        return f"write -{items[-1].key} {word}"
    if items and re.fullmatch(r"[\d.,e+-]+", word):
        both = f"{items[-1].text.strip(',')},{word.strip(',')}"
        return f"a value without a key; a list has no blanks: -{items[-1].key} {both}"
    return None


def read_solver(path, own):
    """Return what the options file of a solver sets: of the `own` options, and keys for PETSc."""
    values, keys = {}, {}
    for item in read_file(path):
        key = item.key.lower()
        if key in own:
            values[key] = own[key].read(item.text, item.where)
        elif solver_keys.is_solver_key(key):
            solver_keys.check_in_file(key, item)
            keys[key] = item.text
        else:
            allowed = ", -".join([*own, *(f"{prefix}*" for prefix in solver_keys.SOLVERS)])
            raise InputError(f"-{key}{item.where}: the file of a solver holds -{allowed} only")
    solver_keys.check_pivot_shifts(keys)
    return values, keys


def read_environment():
    """Return what PETSC_OPTIONS gives, and keep PETSc from reading it unchecked."""
    if os.environ.pop("PETSC_OPTIONS_YAML", ""):
        raise InputError("PETSC_OPTIONS_YAML: not read; an options file or PETSC_OPTIONS is")
    return read_words(os.environ.pop("PETSC_OPTIONS", "").split(), ENVIRONMENT)
