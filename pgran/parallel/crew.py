"""Ranks in groups: the ranks of a group share one lattice, the groups share out the work.

Work comes in units whose size does not depend on the number of ranks, and a unit's results do not
depend on what its group did before: so the numbers do not depend on the number of ranks either,
nor on whether the run was stopped in between and went on from its journal.
"""

import numpy as np
from mpi4py import MPI

from pgran.errors import InputError, is_foreseen
from pgran.parallel.agreement import agree

WORD, FIRST_TAG = 1, 2  # tags of messages: a word to stop; results, a tag for each call of `share`
NO_MORE = -1  # in place of a unit's position


class Crew:
    """All ranks of a run, cut into groups; free with `free` or `with`.

    Collective.

    Parameters
    ----------
    world : mpi4py.MPI.Comm
    ranks_per_lattice : int
        How many ranks share a lattice.
    journal : pgran.parallel.journal.Journal, optional
        Keeps finished units, and says when to stop.

    Attributes
    ----------
    group : mpi4py.MPI.Comm
        The ranks that share a lattice with this one.
    number, groups : int
        Which group this rank is in, of how many.
    dry : bool
        Whether units are only tried, in a dry run.

    Raises
    ------
    InputError
        If the ranks cannot be cut into groups of that size.
    """

    dry = False

    def __init__(self, world, ranks_per_lattice, journal=None):
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
        self.journal = journal
        self._shared = 0
        self._stopped, self._told, self._heard, self._words = None, False, set(), []

    def __enter__(self):
        """Return the crew."""
        return self

    def __exit__(self, *error):
        """Free the group's communicator, unless an error is on its way: others may not follow."""
        if error[0] is None:
            self.group.Free()

    def share(self, task, work, deliver):
        """Call `work` for every unit on one group, and `deliver` with its rows on rank 0.

        Collective. Units that the journal holds are delivered from there.

        Parameters
        ----------
        task : pgran.parallel.task.Task
            Its `units` and `row`, the same on every rank.
        work : callable
            Takes a unit, collectively on a group, and returns its rows, on the first rank of the
            group at least.
        deliver : callable
            Takes the position of a unit and its rows; called on rank 0 alone, as they arrive.

        Raises
        ------
        StoppedError
            If a signal asked for it; on every rank.
        """
        # A tag of its own keeps a fast rank's next results apart from a slow one's present ones.
        self._shared += 1
        results = _Results(self, FIRST_TAG + self._shared, task, deliver)
        left = self.world.bcast(results.left)
        for position in (p for turn, p in enumerate(left) if self._takes(turn)):
            if self._stop_asked():
                break
            rows = work(task.units[position])
            if self.group.rank == 0:
                results.put(position, rows)
        if self.group.rank == 0:
            results.end()
        self._agree_to_stop()

    def _takes(self, turn):
        """Return whether a unit is this group's.

        The groups take turns, each round in the opposite order, which shares out evenly what is
        sorted by size.
        """
        cycle, place = divmod(turn, self.groups)
        return self.number == (place if cycle % 2 == 0 else self.groups - 1 - place)

    def _stop_asked(self):
        """Return whether a signal asks to stop, here or on another rank. Collective over a group.

        Groups do not wait for each other, so the one that gets a signal sends word.
        """
        if self.journal is None:
            return False
        here, first = self.journal.stop_asked, self.group.rank == 0
        while first and self.world.Iprobe(tag=WORD):
            status = MPI.Status()
            self._stopped = self.world.recv(tag=WORD, status=status)
            self._heard.add(status.source)
        if self.group.size > 1:
            names = self.group.allgather((here, self._stopped))
            here, self._stopped = (_first(column) for column in zip(*names, strict=True))
        if here and not self._told:
            self._told = True
            if first:
                others = range(0, self.world.size, self.group.size)
                self._words = [
                    self.world.isend(here, rank, tag=WORD)
                    for rank in others
                    if rank != self.world.rank
                ]
        self._stopped = self._stopped or here
        return bool(self._stopped)

    def _agree_to_stop(self):
        """Raise StoppedError on all ranks if one of them has stopped; leave no word unheard."""
        if self.journal is None:
            return
        everyone = self.world.allgather((self._stopped, self._told))
        if self.group.rank == 0:
            for rank in range(0, self.world.size, self.group.size):
                if everyone[rank][1] and rank != self.world.rank and rank not in self._heard:
                    self.world.recv(source=rank, tag=WORD)
        MPI.Request.waitall(self._words)
        stopped = _first(name for name, _ in everyone)
        if stopped:
            self.journal.stop(stopped)


class AgreeingCrew(Crew):
    """Ranks of which all raise what one of them meets: where a study goes on, others end."""

    def share(self, task, work, deliver):
        """Do as a Crew does; after an error a rank takes part without working. Collective."""
        met = []

        def tried(unit):
            if not met:
                try:
                    return work(unit)
                except Exception as error:
                    if not is_foreseen(error):
                        raise
                    met.append(error)
            return np.zeros(0, task.row)

        super().share(task, tried, deliver)
        agree(self.world, met[0] if met else None)


class _Results:
    """The way of results to rank 0: into the journal, and to whom they are delivered."""

    def __init__(self, crew, tag, task, deliver):
        """Deliver what the journal holds; `left` are the positions of the other units."""
        self.world, self.groups, self.tag = crew.world, crew.groups, tag
        self.deliver, self.row, self.journal = deliver, task.row, crew.journal
        self.left, self._sent, self._working = list(range(len(task.units))), [], crew.groups - 1
        if self.journal is not None and self.world.rank == 0:
            self.stage = self.journal.stage(tag, task.units, task.row)
            kept = self.journal.kept(self.stage)
            for position in kept:
                deliver(position, self.journal.read(self.stage, position, task.row))
            self.left = sorted(set(self.left).difference(kept))

    def put(self, position, rows):
        """Hand in the rows of a unit, on the first rank of a group."""
        if self.world.rank == 0:
            self._take(position, rows)
            while self._working and self.world.Iprobe(tag=self.tag):
                self._receive()
        else:
            self._sent = [request for request in self._sent if not request[0].Test()]
            for message in (np.array([position], dtype=np.int64), rows.view(np.uint8)):
                request = self.world.Isend([message, MPI.BYTE], dest=0, tag=self.tag)
                self._sent.append((request, message))

    def end(self):
        """Hand in nothing more; on rank 0, wait for the other groups' results."""
        if self.world.rank == 0:
            while self._working:
                self._receive()
        else:
            self.world.Send([np.array([NO_MORE], dtype=np.int64), MPI.BYTE], dest=0, tag=self.tag)
            for request, _ in self._sent:
                request.Wait()

    def _take(self, position, rows):
        """Keep and deliver the rows of a unit, on rank 0."""
        if self.journal is not None:
            self.journal.write(self.stage, position, rows)
        self.deliver(position, rows)

    def _receive(self):
        """Receive a unit's rows, or that a group has no more, from any."""
        status, position = MPI.Status(), np.empty(1, dtype=np.int64)
        self.world.Recv([position, MPI.BYTE], tag=self.tag, status=status)
        if position[0] == NO_MORE:
            self._working -= 1
            return
        source = status.source
        self.world.Probe(source=source, tag=self.tag, status=status)
        rows = np.empty(status.Get_count(MPI.BYTE) // self.row.itemsize, self.row)
        self.world.Recv([rows.view(np.uint8), MPI.BYTE], source=source, tag=self.tag)
        self._take(int(position[0]), rows)


def _first(names):
    """Return the first name that is not None, if there is one."""
    return next(filter(None, names), None)
