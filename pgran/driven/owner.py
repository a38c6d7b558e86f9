"""Who frees PETSc's objects."""

from contextlib import AbstractContextManager

from pgran.run.petsc import PETSc


class Owner(AbstractContextManager):
    """Owns what its attributes `owns` hold: PETSc objects, other owners, or lists of them.

    `destroy` or the end of a `with` frees it on the ranks `comm`. An attribute that is a
    `cached_property` is made when it is first asked for, and anew after `forget`.
    """

    owns = ()

    def __exit__(self, *error):
        if error[0] is None or self.comm.size == 1:
            self.destroy()

    def destroy(self):
        """Free all PETSc objects. Collective."""
        for held in self._held(self.owns):
            held.destroy()

    def forget(self, *names):
        """Free what some attributes hold, which nothing else may use any more. Collective."""
        for held in self._held(names):
            held.destroy()
        for name in names:
            vars(self).pop(name, None)

    def vectors(self):
        """Yield all vectors, those of other owners too."""
        for held in self._held(self.owns):
            if isinstance(held, Owner):
                yield from held.vectors()
            elif isinstance(held, PETSc.Vec):
                yield held

    def _held(self, names):
        """Return what some attributes hold, as far as it is made."""
        values = [vars(self).get(name) for name in names]
        lists = [item if isinstance(item, list) else [item] for item in values]
        return [held for several in lists for held in several if held is not None]
