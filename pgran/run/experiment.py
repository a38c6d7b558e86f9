"""What a scene is: the facts from which its options, its checks and its run follow."""

from collections.abc import Callable
from dataclasses import dataclass


class Caution(str):
    """A line of a summary that says what is wrong with a result: told first, as a warning."""


@dataclass(frozen=True)
class Scene:
    """The facts of an experiment. Its module has the task, and this under the name SCENE.

    `run(medium, options, crew)` returns a list of records on rank 0, None on the others, and is
    collective. `summary` takes the `pgran.store.record.Result` and returns in words, line by line,
    what a run found. `check` takes the values of the options and what was given: it raises an
    InputError where values that are possible one by one contradict each other, and unsets what an
    alternative replaces.
    """

    options: tuple  # besides those of the medium and of every run
    run: Callable
    summary: Callable
    check: Callable = lambda values, given: None
    on_medium: bool = True  # whether it is on a lattice or another network, which takes PETSc
    draws: bool = False  # whether it draws bond constants itself, by the law
    shares_lattice: bool = False  # whether several ranks may share a lattice
    whole: bool = False  # whether all ranks work on each unit together
    subject: Callable = lambda options: ()  # in words what a scene on no medium is about
    function: Callable | None = None  # what scenes that repeat it call
    decides: tuple = ()  # options of the scene that it repeats, by -NAME_of, which it has not
