"""The amplitudes at some balls, on every rank."""

from petsc4py import PETSc


class Detectors:
    """Balls whose entries are read out of distributed vectors; destroy with `destroy`.

    Collective.

    Parameters
    ----------
    operators : pgran.solve.operators.Operators
    sites : array_like of int, shape (nd, dim)
    """

    def __init__(self, operators, sites):
        """Make what copies the entries to every rank."""
        self._like = operators.f_stiffness
        self._numbers = operators.numbers(sites)
        self._readings = PETSc.Vec().createSeq(len(self), comm=PETSc.COMM_SELF)
        where = PETSc.IS().createGeneral(self._numbers, comm=PETSc.COMM_SELF)
        self._scatter = PETSc.Scatter().create(self._like, where, self._readings, None)
        where.destroy()

    def __len__(self):
        """Return how many there are."""
        return len(self._numbers)

    def destroy(self):
        """Free all PETSc objects. Collective."""
        self._scatter.destroy()
        self._readings.destroy()

    def read(self, x):
        """Return the entries of a vector, on every rank. Collective."""
        self._scatter.scatter(x, self._readings)
        return self._readings.getArray().copy()

    def unit_vector(self, number):
        """Return e_d for one of the detectors; the caller destroys it. Collective."""
        vector, ball = self._like.duplicate(), self._numbers[number]
        vector.set(0.0)
        first, last = vector.getOwnershipRange()
        if first <= ball < last:
            vector.setValue(ball, 1.0)
        vector.assemble()
        return vector
