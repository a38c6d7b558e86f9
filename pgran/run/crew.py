"""Ranks in groups: the ranks of a group share one lattice, the groups share out the work.

Work comes in units whose size does not depend on the number of ranks, and a unit's results do not
depend on what its group did before: so the numbers do not depend on the number of ranks either,
nor on whether the run was stopped in between and went on from its journal.
"""

import contextlib

import numpy as np

from pgran.errors import InputError, is_foreseen
from pgran.run.agreement import agreeing, on_root

STOP, FIRST_RESULTS = 1, 2  # tags of messages: a word to stop; results, a tag a call of `share`


class Crew(contextlib.AbstractContextManager):
    """All ranks of a run, cut into groups that share a lattice. Collective; use with `with`.

    `group` is the communicator of this rank's group, which is `number` of `groups`. The journal, if
    there is one, keeps finished units and says when to stop. `begins`, if any, is called on rank 0
    when all input has been read and checked, before the work.
    """

    dry = False  # whether units are only tried

    def __init__(self, world, ranks_per_lattice, journal=None, begins=None):
        if world.size % ranks_per_lattice:
            why = f"does not divide the number of ranks, {world.size}"
            raise InputError(f"-ranks_per_lattice {ranks_per_lattice}: {why}")
        self.world, self.journal, self._begins = world, journal, begins
        self.groups = world.size // ranks_per_lattice
        self.number = world.rank // ranks_per_lattice
        self.group = world.Split(self.number, world.rank)
        self._shared, self._stopped_by, self._words = 0, None, []

    def __exit__(self, *error):
        if error[0] is None:
            self.group.Free()

    @contextlib.contextmanager
    def together(self, wanted=True):
        """Let all ranks be one group meanwhile, if that is wanted. Collective."""
        own = self.groups, self.number, self.group
        if wanted:
            self.groups, self.number, self.group = 1, 0, self.world
        try:
            yield
        finally:
            self.groups, self.number, self.group = own

    def begin(self):
        """Note, once, that all input has been read and checked. Collective."""
        begins, self._begins = self._begins, None
        if begins is not None:
            on_root(self.world, begins)

    def open(self, task):
        """Return the context of a task, whose value works on its units. Collective."""
        return task.open(self.group)

    def share(self, task, work, deliver):
        """Call `work` for every unit on one group, and `deliver` with its rows on rank 0.

        Collective. `work` is so on a group, whose first rank's rows count. `deliver` takes the
        position of a unit and its rows, as they arrive, or at once where the journal holds them. A
        StoppedError on every rank says that a signal asked to stop.
        """
        # A tag of its own keeps a fast rank's next results apart from a slow one's present ones.
        self._shared += 1
        results = _Results(self, FIRST_RESULTS + self._shared, task, deliver)
        left = self.world.bcast(results.left)
        for position in (p for turn, p in enumerate(left) if self._takes(turn)):
            if self.journal is not None and self._stop_asked():
                break
            rows = work(task.units[position])
            if self.group.rank == 0:
                results.put((position, rows))
        if self.group.rank == 0:
            results.put(None)
        if self.journal is not None:
            self._agree_to_stop()

    def _takes(self, turn):
        """Return whether a unit is this group's: evenly shared out, too, where sorted by size."""
        # turn   0 1 2 3 4 5 6 7 8
        # group  0 1 2 2 1 0 0 1 2
        cycle, place = divmod(turn, self.groups)
        return self.number == (place if cycle % 2 == 0 else self.groups - 1 - place)

    def _stop_asked(self):
        """Return whether a signal asks to stop, here or in another group. Collective over a group.

        Groups do not wait for each other, so the one that gets a signal sends word.
        """
        first = self.group.rank == 0
        heard = first and self.world.Iprobe(tag=STOP)
        names, heard = zip(*self.group.allgather((self.journal.stop_asked, heard)), strict=True)
        name = next(filter(None, names), None)
        if name and first:
            others = set(range(0, self.world.size, self.group.size)) - {self.world.rank}
            self._stopped_by = name
            self._words = [self.world.isend(name, rank, tag=STOP) for rank in others]
        return name or any(heard)

    def _agree_to_stop(self):
        """Raise StoppedError on all ranks if one of them has stopped; leave no word unheard."""
        names = self.world.allgather(self._stopped_by)
        for rank, name in enumerate(names):
            if name and self.group.rank == 0 and rank != self.world.rank:
                self.world.recv(source=rank, tag=STOP)
        for word in self._words:
            word.wait()
        if stopped := next(filter(None, names), None):
            self.journal.stop(stopped)


class _Results:
    """The way of results to rank 0: into the journal, and to whom they are delivered."""

    def __init__(self, crew, tag, task, deliver):
        self.world, self.tag, self.deliver, self.journal = crew.world, tag, deliver, crew.journal
        self.left, self._sent, self._working = list(range(len(task.units))), [], crew.groups
        if self.journal is not None and self.world.rank == 0:
            self.stage = self.journal.stage(tag, task.units, task.row)
            finished = self.journal.kept(self.stage, task.row)
            for position, rows in finished.items():
                deliver(position, rows)
            self.left = sorted(set(self.left).difference(finished))

    def put(self, message):
        """Hand in a unit's position and rows, or None after the last, on a group's first rank."""
        if self.world.rank == 0:
            self._take(message)
            while self._working and (message is None or self.world.Iprobe(tag=self.tag)):
                self._take(self.world.recv(tag=self.tag))
            return
        self._sent = [request for request in self._sent if not request.Test()]
        self._sent.append(self.world.isend(message, 0, tag=self.tag))
        for request in self._sent if message is None else ():
            request.wait()

    def _take(self, message):
        """Keep and deliver the rows of a unit, or note that a group has no more, on rank 0."""
        if message is None:
            self._working -= 1
            return
        if self.journal is not None:
            self.journal.write(self.stage, *message)
        self.deliver(*message)


class AgreeingCrew(Crew):
    """Ranks of which all raise what one of them meets: where a study goes on, others end.

    Of ranks that share a lattice one could not agree while the others wait for it: there only what
    all meet alike is agreed on.
    """

    @contextlib.contextmanager
    def open(self, task):
        """See `Crew`."""
        alone = self.group.size == 1
        with contextlib.ExitStack() as opened:
            with agreeing(self.world) if alone else contextlib.nullcontext():
                work = opened.enter_context(task.open(self.group))
            yield work

    def share(self, task, work, deliver):
        """Do as `Crew.share`; after an error a rank takes part without working. Collective."""
        met = []

        def tried(unit):
            if not met:
                try:
                    return work(unit)
                except Exception as error:
                    if self.group.size > 1 and not is_foreseen(error):
                        raise
                    met.append(error)
            return np.zeros(0, task.row)

        super().share(task, tried, deliver)
        with agreeing(self.world):  # after it: what ends it on one rank ends all, as nobody waits
            if met:
                raise met[0]
