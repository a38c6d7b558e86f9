"""An independent, naive reference: dense matrices summed bond by bond, solved to extra digits.

Nothing here comes from pgran but the arrays of bond constants. Residuals are computed in extended
precision (where the machine has it), corrections by a dense LU in double: so solutions are right to
rounding, component by component. Where matrices are nearly singular, or amplitudes smaller than any
double, there is elimination in mpmath.
"""

import itertools
import math

import mpmath
import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from mpmath import mp, mpf
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
        """S and f at a frequency, complex where s = i omega is, in extended precision."""
        omega = np.clongdouble(omega)
        loss = 1j * omega * np.longdouble(self.damping)
        S = self.K + loss * self.C
        S[np.diag_indices_from(S)] -= np.longdouble(self.mass) * omega * omega
        return S, self.drive_K + loss * self.drive_C

    def solve(self, omega):
        """A with S A = f, in C order."""
        S, f = self.system(omega)
        factors = lu_factor(S.astype(complex))
        x = np.zeros_like(f)
        for _ in range(6):
            x = x + lu_solve(factors, (f - S @ x).astype(complex))
        return x

    def sweep(self, omegas):
        """A and its derivative along omega, S A' = f' - S' A, shapes (frequencies, balls).

        All frequencies at once, by sparse factorizations.
        """
        w = np.asarray(omegas).astype(np.longdouble)
        parts = self.K, 1j * self.damping * self.C, -self.mass * np.eye(len(self.K))
        K, C, M = (scipy.sparse.csr_matrix(part.astype(np.clongdouble)) for part in parts)
        matrices = [(K + x * C + x * x * M).astype(complex).tocsc() for x in w]
        factors = [scipy.sparse.linalg.splu(S, "MMD_AT_PLUS_A", 0.0) for S in matrices]

        def solve(f):
            x = np.zeros_like(f)
            for _ in range(6):
                missed = (f - K @ x - C @ x * w - M @ x * w * w).astype(complex)
                for n, factor in enumerate(factors):
                    x[:, n] += factor.solve(missed[:, n].copy())
            return x

        stiff, lossy = self.drive_K[:, None], 1j * self.damping * self.drive_C[:, None]
        A = solve(stiff + lossy * w)
        return A.T, solve(lossy - C @ A - M @ A * 2 * w).T

    def across_modes(self, low, high, widest=math.inf):
        """Frequencies in a window, five across every damped mode that is narrow enough."""
        identity, zero = np.eye(len(self.K)), np.zeros(self.K.shape)
        forces = -self.K.astype(float), -self.damping * self.C.astype(float)
        rates = np.block([[zero, identity], [f / self.mass for f in forces]])
        poles = -1j * np.linalg.eigvals(rates)
        poles = poles[(poles.real > 0) & (2 * poles.imag < widest)]
        omega = (poles.real + np.linspace(-2, 2, 5)[:, None] * poles.imag).ravel()
        return omega[(low <= omega) & (omega <= high)]

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


def equations(stiffness, mass, damping, omega):
    """Number the balls, the longest axis outermost; return the numbers, and each row of S and f.

    A row is {column: entry with the digits that mpmath works with}; f is the column after the last.
    """
    shape = tuple(n - (a == 0) for a, n in enumerate(stiffness[0].shape))
    axes = np.argsort(shape, kind="stable")[::-1]
    order = sorted(balls(shape), key=lambda ball: [ball[a] for a in axes])
    number = {ball: n for n, ball in enumerate(order)}
    omega = mpf(float(omega))
    loss = mpmath.mpc(0, omega * mpf(float(damping))) if damping else mpf(0)
    rows = [{n: -mpf(float(mass)) * omega**2} for n in range(len(order))]
    for axis, index, *ends in bonds(shape):
        k = mpf(float(stiffness[axis][index])) + loss
        for end, other in (ends, ends[::-1]):
            if end in number:
                row = rows[number[end]]
                row[number[end]] += k
                if other is not REST:
                    column = len(order) if other is DRIVEN else number[other]
                    row[column] = row.get(column, 0) + (k if other is DRIVEN else -k)
    return number, rows


def exact_amplitudes(stiffness, mass, damping, omega, sites):
    """A at some balls, to mpmath's digits, by sparse elimination; infinite where S is singular."""
    number, rows = equations(stiffness, mass, damping, omega)
    size = len(rows)
    reach = max(abs(n - column) for n, row in enumerate(rows) for column in row if column < size)
    for n in range(size):
        below = range(n, min(n + reach + 1, size))
        pivot = max(below, key=lambda p: abs(rows[p].get(n, 0)))
        rows[n], rows[pivot] = rows[pivot], rows[n]
        if not rows[n].get(n):
            return [mp.inf] * len(np.atleast_2d(sites))
        for p in below[1:]:
            factor = rows[p].pop(n, 0) / rows[n][n]
            if factor:
                for column, value in rows[n].items():
                    if column != n:
                        rows[p][column] = rows[p].get(column, 0) - factor * value
    x = [mpf(0)] * size
    for n in reversed(range(size)):
        known = sum(v * x[column] for column, v in rows[n].items() if n < column < size)
        x[n] = (rows[n].get(size, mpf(0)) - known) / rows[n][n]
    return [x[number[tuple(map(int, site))]] for site in np.atleast_2d(sites)]


def refined_field(stiffness, mass, damping, omega, steps=6):
    """A as an array over the lattice, to mpmath's digits, where S is not nearly singular.

    A sparse factorization in double precision, refined: each step adds about twelve digits.
    """
    number, rows = equations(stiffness, mass, damping, omega)
    size = len(rows)
    force = [row.pop(size, mpf(0)) for row in rows]
    places = [(n, column) for n, row in enumerate(rows) for column in row]
    entries = [complex(value) for row in rows for value in row.values()]
    S = scipy.sparse.csc_matrix((entries, np.transpose(places)), shape=(size, size))
    options = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0}
    factors = scipy.sparse.linalg.splu(S, options={"SymmetricMode": True}, **options)
    x = np.full(size, mpf(0))
    for _ in range(steps):
        kept = [sum(v * x[column] for column, v in row.items()) for row in rows]
        residual = np.array(force) - kept
        largest = max(map(abs, residual))  # it may be too small for doubles
        if largest:
            found = factors.solve((residual / largest).astype(complex))
            x = x + np.vectorize(mpmath.mpmathify, otypes=[object])(found) * largest
    field = np.empty([1 + max(place) for place in zip(*number, strict=True)], object)
    for ball, n in number.items():
        field[ball] = x[n]
    return field


def uniform_field(shape, stiffness, mass, damping, omega, wall=1):
    """A of a lattice whose bonds are all alike, for 1 to 3 axes.

    Along every axis but the first, sine waves that vanish at the walls; along the first, a wave
    that is 0 at one wall and at the other how far its places move.
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
            weight = weight * 2 / (length + 1)
            wave = np.multiply.outer(wave, sines)
        weight = weight * np.sum(wave * wall)
        alpha = np.log(cosh + np.sqrt(cosh - 1) * np.sqrt(cosh + 1))
        # sinh(alpha i) / sinh(alpha (nx + 1)) without overflow
        along = np.exp(alpha * (i - nx - 1)) * np.expm1(-2 * alpha * i)
        along = along / np.expm1(-2 * alpha * (nx + 1))
        total += weight * np.multiply.outer(along, wave)
    return total


def uniform_amplitude(shape, stiffness, damping, place, omega):
    """The same at one ball of mass 1, to mpmath's digits; only odd waves across are driven."""
    (nx, *across), total = shape, 0
    for numbers in itertools.product(*(range(1, n + 1, 2) for n in across)):
        cosh, wave = 1 - omega**2 / (stiffness + 1j * omega * damping) / 2, 1
        for n, length, at in zip(numbers, across, place[1:], strict=True):
            angle = n * mp.pi / (length + 1)
            wave *= 2 / mpmath.tan(angle / 2) / (length + 1) * mpmath.sin(angle * (at + 1))
            cosh += 1 - mpmath.cos(angle)
        alpha = mpmath.acosh(cosh)
        total += wave * mpmath.sinh(alpha * (place[0] + 1)) / mpmath.sinh(alpha * (nx + 1))
    return total


def uniform_frequencies(shape, stiffness, mass):
    """All eigenfrequencies of a lattice whose bonds are all alike."""
    squares = np.zeros(1)
    for n in shape:
        axis = 2 - 2 * np.cos(np.arange(1, n + 1) * math.pi / (n + 1))
        squares = np.add.outer(squares, axis).ravel()
    return np.sqrt(stiffness / mass * np.sort(squares))


def wavenumber_squared(box, omega):
    omega = mpf(float(omega))
    return mpf(box.mass) * omega**2 / mpmath.mpc(box.stiffness, omega * mpf(box.damping))


def series_along_y(box, omega, x, y):
    """Sum the paper's series term by term: quick where x is away from the driven wall."""
    lx, ly = map(mpf, box.size)
    z, total, nu, bound = wavenumber_squared(box, omega), mpf(0), 1, mpf(1)
    while bound > 1e-25 or nu * mp.pi / ly < 2 * abs(z) ** 0.5:
        gamma = mpmath.sqrt((nu * mp.pi / ly) ** 2 - z)
        along = mpmath.sinh(gamma * x) / mpmath.sinh(gamma * lx)
        total += mpmath.sin(nu * mp.pi * y / ly) / nu * along
        bound = abs(mpmath.exp(-gamma * (lx - x))) * y * (ly - y) * x / abs(total)
        nu += 2
    return 4 / mp.pi * total


def series_along_x(box, omega, x, y):
    """Sum an expansion the code does not know: in sin(j pi x/Lx), quick away from y = 0 and Ly.

    sin(k x)/sin(k Lx) satisfies the equation and the walls x = 0, Lx; sines along x times cosh
    along y take away what it leaves on the walls y = 0, Ly.
    """
    lx, ly = map(mpf, box.size)
    z = wavenumber_squared(box, omega)
    k, j, bound = mpmath.sqrt(z), 1, mpf(1)
    total = mpmath.sin(k * x) / mpmath.sin(k * lx) if omega else x / lx
    while bound > 1e-25 or j * mp.pi / lx < 2 * abs(z) ** 0.5:
        p = j * mp.pi / lx
        eta = mpmath.sqrt(p**2 - z)
        bow = mpmath.cosh(eta * (y - ly / 2)) / mpmath.cosh(eta * ly / 2)
        total += (-1) ** j * 2 / lx * p / (p**2 - z) * mpmath.sin(p * x) * bow
        bound = abs(mpmath.exp(-eta * min(y, ly - y))) * x * (lx - x) / abs(total)
        j += 1
    return total


def continuum_amplitude(box, omega, point):
    """The amplitude of the homogeneous box, to the digits that mpmath works with."""
    x, y = (mpf(float(value)) for value in point)
    along_y = box.size[0] - x > min(y, box.size[1] - y)
    return (series_along_y if along_y else series_along_x)(box, omega, x, y)
