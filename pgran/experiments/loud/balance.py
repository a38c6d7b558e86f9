"""The balance of all harmonics of a motion, u(t) = Re sum_n U_n exp(i n omega t), n = 0..N:

    S(i n omega) U_n + B^T (phi_n + i n omega psi_n) = f_n,    e = B U + a w cos(omega t),

with the drive's amplitude a in f_1 alone. phi and psi (`contacts`) are taken at samples of one
period. As conjugates of harmonics act as well, the equations are linear over real numbers only. So
fields are arrays (own, N + 1) of this rank's unknowns, U_0 real, and the product of two of them is
Re sum conj(U) V, over all ranks. The preconditioner is a factorization of S(i n omega) for each n,
by -loud_* KSP and PC.
"""

import numpy as np

from pgran.driven.linear import make_ksp, set_up
from pgran.driven.operators import Owner
from pgran.medium.springs import sparse_rows
from pgran.run.petsc import PETSc, logged, note

SAMPLES = 10  # for each harmonic, at least: what limits the accuracy where contacts open


class Balance(Owner):
    """The equations of a driven medium at a frequency `omega` and an `amplitude` of the drive.

    Collective. `contacts` are those at this rank's balls, of which it counts some: all ranks
    together each one. `stretch` (contacts, samples) is that of the last residual, `tangents` are
    those of the last `linearize`.
    """

    owns = ("_solvers", "_matrices", "_right", "_image")

    def __init__(self, operators, contacts, harmonics):
        self.operators, self.comm, self.medium = operators, operators.comm, operators.lattice
        self.omega, self.amplitude, medium = 1.0, 0.0, self.medium
        layout, first, last = operators.layout, operators.first, operators.last
        ends = np.append(layout.numbers.ravel(), -1)[contacts.columns]
        mine = (ends >= first) & (ends < last)
        here = np.flatnonzero(mine.any(axis=1))
        self.contacts = contacts = contacts.of(here)
        self.counted = mine[here, np.argmax(ends[here] >= 0, axis=1)]
        self.B = sparse_rows(ends[here], contacts.entries, operators.size)
        self.spread = self.B[:, first:last].T.tocsr()
        self.K, self.C = (
            self._rows(k) for k in (medium.constants, medium.damping * medium.damped_springs)
        )
        drag = np.zeros(operators.size) + medium.damping_unit * medium.dragged
        self.drag = layout.free_values(drag.reshape(medium.shape))[:, None]
        self.force = operators.f_stiffness.getArray().copy()
        self.force_rate = 0.0 * self.force
        if operators.C is not None:
            self.force_rate = medium.damping_unit * operators.f_damping.getArray()
        self._right, self._image = operators.K.createVecs()
        self._solvers, self._matrices, self._factored, self._made = [], [], None, 0
        self._mean = np.zeros((2, len(here)))  # tangents in the preconditioner
        self.products = self.factorizations = 0
        self.resolve(harmonics)

    def _rows(self, constants):
        """Return this rank's rows of B^T diag(constants) B."""
        from scipy.sparse import csr_matrix

        pointer, columns, values = self.operators.layout.csr(constants)
        shape = len(pointer) - 1, self.operators.size
        return csr_matrix((values.real.copy(), columns, pointer), shape)

    def resolve(self, harmonics):
        """Take so many harmonics, and as many samples as they need."""
        self.harmonics, self.n = harmonics, np.arange(harmonics + 1)
        self.samples = 1 << int(np.ceil(np.log2(SAMPLES * (harmonics + 1))))
        self.to_times = waves(self.n, self.samples)
        weights = np.where(np.arange(2 * harmonics + 2) < 2, 1, 2) / self.samples
        self._to_harmonics = (weights[:, None] * self.to_times).T.copy()

    def padded(self, U, first=0):
        """Return a field of all harmonics there are now, of some, the first of a number."""
        V = np.zeros((len(U), self.harmonics + 1), complex)
        V[:, first : first + U.shape[1]] = U
        return V

    # Sums over ranks.

    def summed(self, values):
        """Return the sum of a number, or an array, over all ranks."""
        return self.comm.allreduce(values) if self.comm.size > 1 else values

    def inner(self, U, V):
        """Return the product of two fields, or of some of their harmonics."""
        return self.summed(float(np.vdot(U, V).real))

    def norm(self, U):
        """Return the 2-norm of a field, or of some of its harmonics."""
        return np.sqrt(self.inner(U, U))

    @property
    def drive_norm(self):
        """The 2-norm of the drive."""
        return self.amplitude * self.norm(self.force + 1j * self.omega * self.force_rate)

    def everyone(self, own):
        """Return the rows of all ranks."""
        if self.comm.size == 1:
            return own
        found = np.empty((self.operators.size, *own.shape[1:]), own.dtype)
        counts = self.comm.allgather(own.size)
        self.comm.Allgatherv(np.ascontiguousarray(own), [found, counts])
        return found

    # The equations.

    def stretches(self, U, amplitude):
        """Return the harmonics of the stretch of this rank's contacts."""
        E = self.B @ self.everyone(U)
        E[:, 1] += amplitude * self.contacts.drive
        return E

    def times(self, E):
        """Return harmonics (n, N + 1) as samples of one period."""
        return np.ascontiguousarray(E).view(float) @ self.to_times

    def _of_times(self, samples):
        return (samples @ self._to_harmonics).view(complex)

    def residual(self, U):
        """Return what is unbalanced, (own, N + 1)."""
        self.stretch = self.times(self.stretches(U, self.amplitude))
        self.harmonic_forces = [self._of_times(x) for x in self.contacts.forces(self.stretch)]
        return self._balanced(U, self.harmonic_forces, self.amplitude)

    def linearize(self):
        """Keep the tangents at the field of the last residual."""
        self.tangents = self.contacts.tangents(self.stretch)

    def product(self, D, amplitude=0.0):
        """Return the derivative of the residual along a field and an amplitude."""
        self.products += 1
        e = self.times(self.stretches(D, amplitude))
        phi, psi = self.tangents
        psi = self._of_times(psi * e) if self.contacts.p else 0.0
        return self._balanced(D, (self._of_times(phi * e), psi), amplitude)

    def slope(self, U, parameter):
        """Return the derivative of the residual by the `amplitude`, or by `omega`, at a field."""
        if parameter == "amplitude":
            return self.product(0.0 * U, 1.0)
        rate = self.spread @ self.harmonic_forces[1] + self.damped(U)
        rate[:, 1] -= self.amplitude * self.force_rate
        R = 1j * self.n * rate - 2 * self.omega * self.n**2 * self.medium.mass * U
        return real_mean(R)

    def damped(self, U):
        """Return C U, all damping of the medium at rest."""
        return self.C @ self.everyone(U) + self.drag * U

    def _balanced(self, U, forces, amplitude):
        """Return S U - f and what contacts add."""
        (phi, psi), w = forces, self.omega * self.n
        R = self.spread @ (phi + 1j * w * psi) + self.K @ self.everyone(U)
        R += 1j * w * self.damped(U) - self.medium.mass * w**2 * U
        R[:, 1] -= amplitude * (self.force + 1j * self.omega * self.force_rate)
        return real_mean(R)

    # The preconditioner.

    @logged("factors")
    def factor(self, mean=None):
        """Factor what is not factored yet at this frequency; return whether all that works.

        With `mean` anew, and with the mean tangents there are now (True), or none (False).
        """
        if mean is not None:
            self._mean = (
                np.array([x.mean(axis=1) for x in self.tangents]) if mean else 0 * self._mean
            )
        if mean is not None or self._factored != self.omega:
            self._factored, self._made = self.omega, 0
        works = [self._factor(n) for n in range(self._made, self.harmonics + 1)]
        self._made = max(self._made, self.harmonics + 1)
        return all(works)

    def _factor(self, n):
        """Factor S(i n omega), with the mean tangents of the medium's contacts."""
        s, medium, known = 1j * n * self.omega, self.medium, self.contacts.number >= 0
        kappa = medium.kappa(s) + 0j
        kappa[self.contacts.number[known]] += self._mean[0, known] + s * self._mean[1, known]
        if n == len(self._matrices):
            self._matrices.append(self.operators.K.duplicate())
            self._solvers.append(make_ksp(self.operators, self._matrices[n], "loud_", "preonly"))
        S, ksp = self._matrices[n], self._solvers[n]
        S.setValuesCSR(*self.operators.layout.csr(kappa))
        S.assemble()
        self._right.setArray(s * self.drag[:, 0] + medium.mass * s * s)
        S.setDiagonal(self._right, addv=PETSc.InsertMode.ADD_VALUES)
        S.setOption(PETSc.Mat.Option.SYMMETRIC, True)  # complex, not Hermitian
        S.setOption(PETSc.Mat.Option.HERMITIAN, False)
        self.factorizations += 1
        note(f"-loud_* KSP {ksp.getType()}, PC {ksp.getPC().getType()}", self.comm, factorization=1)
        return set_up(ksp, S, self.operators)

    @logged("states")
    def solve(self, R):
        """Return the preconditioner's answer to a residual."""
        Z = np.empty_like(R)
        for n, ksp in enumerate(self._solvers[: self.harmonics + 1]):
            self._right.setArray(R[:, n])
            ksp.solve(self._right, self._image)
            Z[:, n] = self._image.getArray(readonly=True)
        return real_mean(Z)


def real_mean(U):
    """Return a field whose mean is made real, in place."""
    U[:, 0] = U[:, 0].real
    return U


def waves(n, samples):
    """Return samples of Re exp(i n omega t) and of its derivative by Im, two rows an n."""
    angle = 2 * np.pi / samples * np.outer(n, np.arange(samples))
    return np.stack([np.cos(angle), -np.sin(angle)], axis=1).reshape(-1, samples)
