"""Conditions that choose balls: `x<1.5`, `x>max-1.5 and type==2`, or a list of ids, `12,30-40`."""

import operator
import re

import numpy as np

from pgran.errors import InputError
from pgran.medium.springs import AT_REST, DRIVEN

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


def hold(held, ids, column, *, rest=None, drive=None):
    """Return `held`, shape (N,), changed for the balls that two conditions choose."""
    held, chosen = held.copy(), []
    for name, condition, kind in (("rest", rest, AT_REST), ("drive", drive, DRIVEN)):
        if condition is not None:
            chosen.append(choose(f"--{name}", str(condition), ids, column))
            held[chosen[-1]] = kind
    if len(chosen) == 2:
        for ball in ids[np.logical_and(*chosen)][:1]:
            raise InputError(f"--rest and --drive: ball {ball} cannot be both")
    return held


def choose(name, condition, ids, column):
    """Return which balls of some ids a condition chooses, shape (N,).

    `column` returns the numbers, shape (N,), of a column by its name. `and` binds closer than `or`;
    `min` and `max` are those of the column. Raises InputError, which calls it by its `name`.
    """
    chosen = np.zeros(len(ids), dtype=bool)
    try:
        if LIST.fullmatch(condition):
            for item in condition.split(","):
                first, _, last = item.partition("-")
                named = (ids >= int(first)) & (ids <= int(last or first))
                if not np.any(named):
                    raise InputError(f"{item.strip()}: no ball has such an id")
                chosen |= named
        for comparisons in _alternatives(condition):
            holds = np.ones(len(ids), dtype=bool)
            for name_of_column, sign, end, number in comparisons:
                values = column(name_of_column)
                bound = getattr(values, end)() if end else 0.0
                holds &= COMPARE[sign](values, bound + number)
            chosen |= holds
        if not np.any(chosen):
            raise InputError(f"{condition!r} chooses no ball")
    except InputError as error:
        raise InputError(f"{name}: {error}") from None
    return chosen


def columns_in(condition):
    """Return the names of the columns that a condition compares; raise InputError if it is none."""
    return [name for comparisons in _alternatives(condition) for name, *_ in comparisons]


def _alternatives(condition):
    """Return lists of comparisons that must hold together, none for a list of ids."""
    if LIST.fullmatch(condition):
        return []
    parted = [re.split(r"\band\b", text) for text in re.split(r"\bor\b", condition)]
    return [[_comparison(text) for text in texts] for texts in parted]


def _comparison(text):
    """Return the column, the sign, min or max, and the number of one comparison."""
    match = COMPARISON.fullmatch(text)
    name, sign, end, number = match.groups() if match else [None] * 4
    # "x<max-1.5", "x<max", "x<1.5" are comparisons, but "x<" and "x<max1.5" are none
    if not (end or number) or (end and number and number[0] not in "+-"):
        raise InputError(
            f"{text.strip()!r} is no condition; x<1.5, x>max-1.5 and type==2, 12,15,30-40 are"
        )
    return name, sign, end, float(number.replace(" ", "") if number else 0)
