"""What a table of the paper has: sections, a figure of the paper each, and their rows."""

from typing import NamedTuple


class Row(NamedTuple):
    """What the paper says of a quantity, what pgran found, and whether the paper is right.

    What pgran found is said by a function of results, whose parameters name them.
    """

    what: str
    paper: str
    form: str
    found: callable
    verdict: str


class Section(NamedTuple):
    """A figure of the paper, or numbers beyond figures: files of figures, and rows."""

    title: str
    drawn: tuple
    rows: tuple
