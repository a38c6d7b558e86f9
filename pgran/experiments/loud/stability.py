"""Floquet's multipliers of a periodic motion: what becomes of small deviations in one period.

    d' = (v - B^T psi'(e) B d) / m,    v' = -K d - C d' - B^T phi'(e) B d,

with v the momentum and what dashpots add, so that psi has no second derivative here, which a
contact that closes does not have. A Runge-Kutta method of order 4 integrates a period, SLEPc's EPS
(option prefix `loud_`, keys -loud_eps_*) looks for the largest multipliers mu. Above 1 in size a
deviation grows, and the motion does not stay; near -1 the period doubles.
"""

import contextlib

import numpy as np
import slepc4py

from pgran.experiments.loud.balance import waves
from pgran.run.petsc import PETSc, logged, note, plain_errors

slepc4py.init([])  # PETSc has its options already

from slepc4py import SLEPc  # noqa: E402

WANTED, SPACE, RESTARTS, TOLERANCE = 2, 60, 4, 1e-4
STEP = 0.5  # over the highest frequency of the medium


class Period:
    """One period of small deviations (d, v), v in units of m omega, as a shell matrix."""

    def __init__(self, balance, U):
        from scipy.sparse import vstack

        self.balance, self.m, self.products = balance, balance.medium.mass, 0
        highest = np.sqrt(balance.medium.stiffness_norm / self.m)
        self.steps = int(np.ceil(2 * np.pi / balance.omega * highest / STEP))
        self.length = 2 * np.pi / balance.omega / self.steps
        E = balance.stretches(U, balance.amplitude)
        e = E.view(float) @ waves(balance.n, 2 * self.steps)
        self.tangents = [x.T[:, :, None].copy() for x in balance.contacts.tangents(e)]
        self.both, self.count = vstack([balance.B, balance.K]).tocsr(), len(E)

    def mult(self, matrix, x, y):
        """Set y to what x, d of this rank and then v, becomes in a period."""
        values = x.getArray(readonly=True).reshape(2, -1)
        state, h = values.view(float).reshape(2, -1, 2).copy(), self.length
        unit = np.array([1.0, self.m * self.balance.omega])[:, None, None]
        state *= unit
        for sample in range(0, 2 * self.steps, 2):
            first = self._rate(sample, state)
            second = self._rate(sample + 1, state + h / 2 * first)
            third = self._rate(sample + 1, state + h / 2 * second)
            last = self._rate((sample + 2) % (2 * self.steps), state + h * third)
            state = state + h / 6 * (first + 2 * (second + third) + last)
        self.products += 1
        y.setArray((state / unit).view(complex).ravel())

    def _rate(self, sample, state):
        """Return the derivatives of d and v by time."""
        balance, (phi, psi) = self.balance, (x[sample] for x in self.tangents)
        longer, pull = np.split(self.both @ balance.everyone(state[0]), [self.count])
        rate = np.empty_like(state)
        added = balance.spread @ np.concatenate([phi * longer, psi * longer], axis=1)
        rate[0] = (state[1] - added[:, 2:]) / self.m
        rate[1] = -pull - added[:, :2] - balance.damped(rate[0])
        return rate


@logged("modes")
def multipliers(balance, U):
    """Return the largest multipliers of a state, the largest first; none if none converges."""
    operators, period = balance.operators, Period(balance, U)
    size = 2 * operators.size
    with plain_errors(), contextlib.ExitStack() as held:
        sizes = (2 * len(U), size)
        matrix = PETSc.Mat().createPython((sizes, sizes), period, comm=balance.comm)
        eps, start = SLEPc.EPS().create(balance.comm), matrix.createVecRight()
        for thing in (matrix, eps, start):
            held.callback(thing.destroy)
        eps.setOptionsPrefix("loud_")
        eps.setOperators(matrix)
        eps.setProblemType(SLEPc.EPS.ProblemType.NHEP)
        eps.setWhichEigenpairs(SLEPc.EPS.Which.LARGEST_MAGNITUDE)
        eps.setDimensions(min(WANTED, size), min(SPACE, size))
        eps.setTolerances(TOLERANCE, RESTARTS)
        eps.setFromOptions()
        numbers = np.random.Generator(np.random.Philox(0)).standard_normal((2, *operators.shape))
        start.setArray(np.concatenate([operators.layout.free_values(x) for x in numbers]))
        eps.setInitialSpace([start])
        eps.solve()
        found = np.array([eps.getEigenvalue(i) for i in range(eps.getConverged())], complex)
        note(f"-loud_* EPS {eps.getType()}", balance.comm, solve=1, period=period.products)
    found = found[np.argsort(-np.abs(found), kind="stable")]
    return found.real + 1j * np.abs(found.imag)  # conjugates come in pairs
