"""What a scene is: the facts from which its options, its checks and its run follow."""

from collections.abc import Callable
from dataclasses import dataclass


def no_check(values, given):
    """Accept all values that are possible one by one."""


def draws_nothing(values):
    """Return that no bond constants are drawn."""
    return False


class Caution(str):
    """A line of a summary that says what is wrong with a result: told first, as a warning."""


@dataclass(frozen=True)
class Scene:
    """The facts of an experiment. Its module has the task, and this under the name SCENE.

    Attributes
    ----------
    options : tuple of pgran.run.options.Option
        Besides those of the medium and of every run.
    run : callable
        Takes the medium, the options of the run and a crew: `run(medium, options, crew)`. Returns a
        list of records on rank 0, None on the others. Collective.
    summary : callable
        Takes the `pgran.store.record.Result`; returns in words, line by line, what a run found;
        what is wrong with it as a Caution.
    check : callable
        Takes the values of the options and what was given; raises InputError where values that are
        possible one by one contradict each other, and unsets what an alternative replaces.
    on_medium : bool
        Whether it is on a lattice or another network, for which it needs PETSc.
    draws : callable
        Takes the values of the options; returns whether it draws bond constants itself, by the law.
    shares_lattice : bool
        Whether several ranks may share a lattice.
    whole : bool
        Whether all ranks work on each unit together.
    """

    options: tuple
    run: Callable
    summary: Callable
    check: Callable = no_check
    on_medium: bool = True
    draws: Callable = draws_nothing
    shares_lattice: bool = False
    whole: bool = False
