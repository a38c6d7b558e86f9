"""Ranks in groups: the ranks of a group share one lattice, the groups share out the work.

Work comes in units whose size does not depend on the number of ranks, and a unit's results do not
depend on what its group did before: so the numbers do not depend on the number of ranks either.
"""

import numpy as np
from mpi4py import MPI

from pgran.errors import InputError

# Beyond this many balls all ranks share one lattice, unless options say otherwise.
LARGE = {1: 10**7, 2: 100_000, 3: 20_000}


class Crew:
    """All ranks of a run, cut into groups; free with `free` or `with`.

    Collective.

    Parameters
    ----------
    world : mpi4py.MPI.Comm
    ranks_per_lattice : int
        How many ranks share a lattice.

    Attributes
    ----------
    group : mpi4py.MPI.Comm
        The ranks that share a lattice with this one.
    number, groups : int
        Which group this rank is in, of how many.

    Raises
    ------
    InputError
        If the ranks cannot be cut into groups of that size.
    """

    def __init__(self, world, ranks_per_lattice):
        """Split the world."""
        if world.size % ranks_per_lattice:
            raise InputError(
                f"-ranks_per_lattice {ranks_per_lattice}: {world.size} ranks cannot be cut into "
                "groups of that size"
            )
        self.world = world
        self.groups = world.size // ranks_per_lattice
        self.number = world.rank // ranks_per_lattice
        self.group = world.Split(self.number, world.rank)
        self._shared = 0

    def __enter__(self):
        """Return the crew."""
        return self

    def __exit__(self, *error):
        """Free the group's communicator, unless an error is on its way: others may not follow."""
        if error[0] is None:
            self.group.Free()

    def share(self, units, work, deliver):
        """Call `work` for every unit on one group, and `deliver` with its rows on rank 0.

        Collective.

        Parameters
        ----------
        units : sequence
            The same on every rank.
        work : callable
            Takes a unit, collectively on a group, and returns its results as a structured array of
            one dtype, on the first rank of the group at least.
        deliver : callable
            Takes such an array; called on rank 0 alone, as results arrive.
        """
        # A tag of its own keeps a fast rank's next results apart from a slow one's present ones.
        self._shared += 1
        mine = [unit for position, unit in enumerate(units) if self._takes(position)]
        awaited = len(units) - len(mine)
        sent, dtype = [], None
        for unit in mine:
            rows = work(unit)
            if self.world.rank == 0:
                deliver(rows)
                dtype = rows.dtype
                while awaited and self.world.Iprobe(tag=self._shared):
                    deliver(self._receive(dtype))
                    awaited -= 1
            elif self.group.rank == 0:
                message = [rows.view(np.uint8), MPI.BYTE]
                sent.append((rows, self.world.Isend(message, dest=0, tag=self._shared)))
        if self.world.rank == 0:
            for _ in range(awaited):
                deliver(self._receive(dtype))
        for _, request in sent:
            request.Wait()

    def _takes(self, position):
        """Return whether the unit at a position is this group's.

        The groups take turns, each round in the opposite order, which shares out evenly what is
        sorted by size.
        """
        turn, place = divmod(position, self.groups)
        return self.number == (place if turn % 2 == 0 else self.groups - 1 - place)

    def _receive(self, dtype):
        """Return the next unit's rows from any group."""
        status = MPI.Status()
        self.world.Probe(status=status, tag=self._shared)
        rows = np.empty(status.Get_count(MPI.BYTE) // dtype.itemsize, dtype)
        self.world.Recv([rows.view(np.uint8), MPI.BYTE], source=status.source, tag=self._shared)
        return rows


def automatic_ranks(shape, ranks):
    """Return how many of the ranks should share a lattice: one, unless it is large."""
    return ranks if np.prod(shape, dtype=float) > LARGE[len(shape)] else 1
