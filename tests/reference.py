"""An independent, naive reference: dense matrices summed bond by bond, solved to extra digits.

Nothing here comes from pgran but the arrays of bond constants. Systems are formed and residuals
computed in extended precision (where the machine has it), corrections by a dense LU in double: so
solutions are right to rounding, component by component, also where amplitudes are 1e-11.
"""

import math

import numpy as np
from scipy.linalg import lu_factor, lu_solve

DRIVEN, REST = "driven", "at rest"


def balls(shape):
    """All balls, in C order."""
    return list(np.ndindex(*shape))


def bonds(shape):
    """Yield every bond as (axis, index, one end, other end); an end is a ball or a wall."""
    for axis in range(len(shape)):
        lengths = [n + 1 if a == axis else n for a, n in enumerate(shape)]
        for index in np.ndindex(*lengths):
            low = list(index)
            low[axis] -= 1
            one = tuple(low) if low[axis] >= 0 else REST
            wall = DRIVEN if axis == 0 else REST
            yield axis, index, one, index if index[axis] < shape[axis] else wall


class Reference:
    """Dense K and C, and the drive of each, in C order of the balls."""

    def __init__(self, stiffness, mass=1.0, damping=0.003):
        """Sum over the bonds."""
        self.shape = tuple(n - (a == 0) for a, n in enumerate(stiffness[0].shape))
        self.mass, self.damping = mass, damping
        number = {ball: n for n, ball in enumerate(balls(self.shape))}
        size = len(number)
        self.K, self.C = np.zeros((2, size, size), np.longdouble)
        self.drive_K, self.drive_C = np.zeros((2, size), np.longdouble)
        for axis, index, *ends in bonds(self.shape):
            k = stiffness[axis][index]
            for end, other in (ends, ends[::-1]):
                if end in number:
                    p = number[end]
                    self.K[p, p] += k
                    self.C[p, p] += 1
                    if other in number:
                        self.K[p, number[other]] -= k
                        self.C[p, number[other]] -= 1
                    elif other is DRIVEN:
                        self.drive_K[p] += k
                        self.drive_C[p] += 1

    def system(self, omega):
        """S and f at a frequency, in extended precision."""
        omega = np.longdouble(omega)
        loss = 1j * omega * np.longdouble(self.damping)
        S = self.K + loss * self.C
        S[np.diag_indices_from(S)] -= np.longdouble(self.mass) * omega**2
        return S, self.drive_K + loss * self.drive_C

    def solve(self, omega, rhs=None):
        """A with S A = f, or another right-hand side, in C order."""
        S, f = self.system(omega)
        if rhs is not None:
            f = rhs.astype(np.clongdouble)
        factors = lu_factor(S.astype(complex))
        x = np.zeros_like(f)
        for _ in range(6):
            x = x + lu_solve(factors, (f - S @ x).astype(complex))
        return x

    def eigenvalues(self):
        """Those of K, ascending, in double precision."""
        return np.linalg.eigvalsh(self.K.astype(float))

    def field(self, omega):
        """A as an array over the lattice."""
        return self.solve(omega).reshape(self.shape)

    def amplitudes(self, omega, sites):
        """A at balls given by rows of indices."""
        field = self.field(omega)
        return np.array([field[tuple(site)] for site in np.atleast_2d(sites)])


def uniform_field(shape, stiffness, mass, damping, omega):
    """A of a lattice whose bonds are all alike (fact 1 of physics.md), for 1 to 3 axes.

    Along every axis but the first, sine waves that vanish at the walls; along the first, a wave
    that is 0 at one wall and 1 at the other.
    """
    nx, *across = shape
    z = np.longdouble(mass) * np.longdouble(omega) ** 2
    z = z / (np.longdouble(stiffness) + 1j * np.longdouble(omega) * np.longdouble(damping))
    pi = np.arctan(np.longdouble(1)) * 4
    i = np.arange(1, nx + 1, dtype=np.longdouble)
    total = np.zeros(shape, np.clongdouble)
    for numbers in np.ndindex(*across):
        cosh, wave, weight = 1 - z / 2, np.ones((), np.longdouble), np.longdouble(1)
        for n, length in zip(numbers, across, strict=True):
            angle = (n + 1) * pi / (length + 1)
            sines = np.sin(angle * np.arange(1, length + 1, dtype=np.longdouble))
            cosh = cosh + 1 - np.cos(angle)
            weight = weight * 2 / (length + 1) * sines.sum()
            wave = np.multiply.outer(wave, sines)
        alpha = np.log(cosh + np.sqrt(cosh - 1) * np.sqrt(cosh + 1))
        # sinh(alpha i) / sinh(alpha (nx + 1)) without overflow
        along = np.exp(alpha * (i - nx - 1)) * np.expm1(-2 * alpha * i)
        along = along / np.expm1(-2 * alpha * (nx + 1))
        total += weight * np.multiply.outer(along, wave)
    return total


def uniform_frequencies(shape, stiffness, mass):
    """All eigenfrequencies of a lattice whose bonds are all alike (fact 2)."""
    squares = np.zeros(1)
    for n in shape:
        axis = 2 - 2 * np.cos(np.arange(1, n + 1) * math.pi / (n + 1))
        squares = np.add.outer(squares, axis).ravel()
    return np.sqrt(stiffness / mass * np.sort(squares))
