"""What Python hands in: calls that fit, texts and whole numbers, and how a value is shown.

And what a call says: each warning once.
"""

import contextlib
import difflib
import functools
import inspect
import logging
import operator
import re
import reprlib

from pgran.errors import InputError


def shown(value):
    """Return a value in words, short, whatever it is."""
    try:
        return reprlib.repr(value)
    except Exception:  # whole numbers of thousands of digits, or whatever an object's own raises
        return f"a {type(value).__name__}"


def nearest(word, words):
    """Return the word most like `word`, in letters of either case, or None."""
    lower = {each.lower(): each for each in words}
    return lower.get(*difflib.get_close_matches(word.lower(), lower, n=1, cutoff=0.6) or [None])


def meant(word, otherwise=""):
    """Return how a message ends that suggests a word, or what else to do where there is none."""
    return f"; did you mean {word}?" if word else otherwise


def whole_number(name, value):
    """Return a whole number of any size as an int; raise an InputError if it is anything else."""
    try:
        if type(value).__name__ not in ("bool", "bool_"):  # or NumPy's
            return operator.index(value)
    except TypeError:
        pass
    raise InputError(f"{name}: a whole number is needed, not {shown(value)}")


def choice(name, value, choices):
    """Return a text that is one of the choices; raise an InputError if it is none."""
    if not isinstance(value, str) or value not in choices:
        near = isinstance(value, str) and nearest(value, choices)
        raise InputError(f"{name}: {shown(value)} is none of {', '.join(choices)}{meant(near)}")
    return value


def bound(function, arguments, choices):
    """Return the arguments of a call, bound; raise an InputError if it does not fit."""
    signature = inspect.signature(function)
    try:
        return signature.bind(*arguments, **choices)
    except TypeError as error:
        name = function.__qualname__.removesuffix(".__init__")
        takes = ", ".join(n for n in signature.parameters if n not in ("self", "cls", "crew"))
        wrong = re.search("unexpected keyword argument '(.*)'", str(error))
        hint = meant(wrong and nearest(wrong[1], takes.split(", ")), f"; it takes {takes}")
        raise InputError(f"{name}: {error}{hint}") from None


@contextlib.contextmanager
def saying_once():
    """Let each warning be said once, however often it is met meanwhile."""
    log, texts = logging.getLogger("pgran"), set()

    def is_new(record):
        text = record.getMessage()
        new = text not in texts
        texts.add(text)
        return new or record.levelno < logging.WARNING

    log.addFilter(is_new)
    try:
        yield
    finally:
        log.removeFilter(is_new)


def called_right(function):
    """Let calls of a function, or of a class, that do not fit raise an InputError.

    Meanwhile each warning is said once.
    """
    if isinstance(function, type):
        function.__init__ = called_right(function.__init__)
        return function

    @functools.wraps(function)
    def called(*arguments, **choices):
        try:
            with saying_once():
                return function(*arguments, **choices)
        except TypeError:
            bound(function, arguments, choices)
            raise

    return called
