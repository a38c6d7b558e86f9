"""What a scene is: the facts from which its options, its checks and its run follow."""

from collections.abc import Callable
from dataclasses import dataclass


def no_check(values, given):
    """Accept all values that are possible one by one. Not collective."""


class Caution(str):
    """A line of a summary that says what is wrong with a result: told first, as a warning."""


@dataclass(frozen=True)
class Scene:
    """The facts of an experiment. Its module has the task, and this under the name SCENE.

    Attributes
    ----------
    options : tuple of pgran.run.options.Option
        Besides those of every run.
    run : callable
        Takes the options, all ranks, and what makes a crew of them: `run(options, world, crew)`;
        `crew(ranks, lattice)` takes how many share the lattice, and it, if there is one. Returns
        the records of the result on rank 0, None on the others. Collective.
    summary : callable
        Takes the `pgran.store.record.Result`; returns in words, line by line, what a run found;
        what is wrong with it as a Caution.
    check : callable
        Takes the values of the options and what was given; raises InputError where values that are
        possible one by one contradict each other, and unsets what an alternative replaces.
    shares_lattice : bool
        Whether several ranks may share a lattice.
    needs_petsc : bool
    """

    options: tuple
    run: Callable
    summary: Callable
    check: Callable = no_check
    shares_lattice: bool = False
    needs_petsc: bool = True
