"""pgran with a fault planted on one rank, for the fault campaign and the tests.

    python tests/campaigns/inject.py PLACE STATEMENT RANK TURN run FILE [-key value ...]

pgran itself knows nothing of this: on that rank a Python statement is executed at the TURN-th call
of a function, whose `arguments` it may use. PLACE says when and which: `before`
`pgran.store.file:write`, or `within` what `Crew.share` is given to do. The file `fault` in the
working directory tells when it happened. A name that pgran no longer has ends the run.
"""

import importlib
import itertools
import sys
from pathlib import Path

from pgran import __main__ as program
from pgran.run import launch

UNIT = "within pgran.run.crew:Crew.share"
LATTICE = "before pgran.medium.lattice:Lattice.__init__"
RECORD = "before pgran.run.journal:Journal.write"
RESULT = "before pgran.store.file:write"
OPENED = "before pgran.run.journal:Journal.__enter__"


def words(place, statement, rank=0, turn=1):
    """Return what takes the place of `-m pgran` in a command."""
    return [str(Path(__file__).resolve()), place, statement, str(rank), str(turn)]


def plant(place, strike):
    """Call `strike` with the arguments of each call of the function that a place names."""
    when, name = place.split()
    module, _, path = name.partition(":")
    owner, _, last = path.rpartition(".")
    home = importlib.import_module(module)
    home = getattr(home, owner) if owner else home
    original = getattr(home, last)

    def struck(*arguments, **keywords):
        if when == "before":
            strike(arguments)
        else:
            crew, task, work, *rest = arguments
            arguments = (crew, task, lambda unit: strike(unit) or work(unit), *rest)
        return original(*arguments, **keywords)

    setattr(home, last, struck)


def main(place, statement, rank, turn, *words):
    """Run pgran with the fault.

    A module that is not imported yet waits until the journal is open: MPI and PETSc have started by
    then, as pgran starts them.
    """
    calls = itertools.count(1)

    def strike(arguments):
        if next(calls) == int(turn):
            Path("fault").touch()
            exec(statement, {"arguments": arguments})

    sys.argv = ["pgran", *words]
    if launch.rank() == int(rank):
        if place.split()[1].partition(":")[0] in sys.modules:
            plant(place, strike)
        else:
            plant(OPENED, lambda arguments: plant(place, strike))
    program.console()


if __name__ == "__main__":
    main(*sys.argv[1:])
