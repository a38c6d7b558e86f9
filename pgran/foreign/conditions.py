"""Conditions that choose balls: `x<1.5`, `x>max-1.5 and type==2`, or a list of ids, `12,30-40`."""

import operator
import re

import numpy as np

from pgran.errors import InputError

COMPARE = {
    "<=": operator.le, ">=": operator.ge, "==": operator.eq, "!=": operator.ne,
    "<": operator.lt, ">": operator.gt,
}  # fmt: skip
NUMBER = r"(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
COMPARISON = re.compile(
    rf"\s*([A-Za-z_][\w.\[\]]*)\s*(<=|>=|==|!=|<|>)\s*(?:(min|max)\b\s*)?([-+]?\s*{NUMBER})?\s*"
)
ITEM = r"\s*\d{1,18}(?:\s*-\s*\d{1,18})?\s*"
LIST = re.compile(rf"{ITEM}(?:,{ITEM})*")


def choose(condition, ids, column):
    """Return which balls a condition chooses, shape (N,).

    Not collective. `and` binds closer than `or`; `min` and `max` are those of the column.

    Parameters
    ----------
    condition : str
    ids : numpy.ndarray of int, shape (N,)
    column : callable
        Returns the numbers, shape (N,), of a column by its name.

    Raises
    ------
    InputError
        If it cannot be understood, or chooses no ball.
    """
    if LIST.fullmatch(condition):
        chosen = _listed(condition, ids)
    else:
        chosen = np.zeros(len(ids), dtype=bool)
        for alternative in re.split(r"\bor\b", condition):
            compared = [_compared(part, column) for part in re.split(r"\band\b", alternative)]
            chosen |= np.logical_and.reduce(compared)
    if not np.any(chosen):
        raise InputError(f"{condition!r} chooses no ball")
    return chosen


def _listed(condition, ids):
    """Return which balls a list of ids names; each of its items must name one."""
    chosen = np.zeros(len(ids), dtype=bool)
    for item in condition.split(","):
        first, _, last = item.partition("-")
        found = (ids >= int(first)) & (ids <= int(last or first))
        if not np.any(found):
            raise InputError(f"{item.strip()}: no ball has such an id")
        chosen |= found
    return chosen


def _compared(text, column):
    """Return where one comparison holds."""
    found = COMPARISON.fullmatch(text)
    name, sign, end, number = found.groups() if found else [None] * 4
    bare = number and not end
    if not found or not (end or number) or (end and number and number[0] not in "+-"):
        raise InputError(
            f"{text.strip()!r} is no condition; x<1.5, x>max-1.5 and type==2, 12,15,30-40 are"
        )
    values = column(name)
    bound = 0.0 if bare or not end else getattr(values, end)()
    return COMPARE[sign](values, bound + float(number.replace(" ", "") if number else 0))
