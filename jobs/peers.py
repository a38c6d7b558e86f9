"""What a careful user would write with NumPy and SciPy, for the benchmark."""

from functools import cached_property

import numpy as np
import scipy.linalg
import scipy.sparse as sp
from scipy.integrate import solve_ivp
from scipy.sparse._sparsetools import csr_matvec
from scipy.sparse.linalg import LinearOperator, eigs, eigsh, splu

# No pivoting: with it SymmetricMode fills in completely on these matrices.
SPLU = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}


class Peer:
    """The matrices of a lattice or network in SciPy: S = K + i omega beta C - m omega^2.

    Parameters
    ----------
    medium : pgran.medium.lattice.Lattice or pgran.medium.network.Network
    site : tuple of int, optional
        The detector.
    """

    def __init__(self, medium, site=None):
        """Assemble K from the springs."""
        self.medium, self.springs = medium, medium.springs
        self.B = sp.csr_matrix(self.springs.B)
        self.K = self._laplacian(medium.constants)
        self.identity = sp.identity(self.B.shape[1], format="csc")
        self.read = np.zeros(self.B.shape[1])
        if site is not None:
            unknowns, weights = medium.readings([site])
            self.read[unknowns] = weights

    @cached_property
    def C(self):  # noqa: N802
        """The matrix of the dashpots, each of the constant 1."""
        return self._laplacian(self.springs.damped)

    def _laplacian(self, constants):
        return (self.B.T @ sp.diags(constants) @ self.B).tocsc()

    def amplitude(self, omega, K, constants):
        """Return the amplitude at the detector."""
        return self.read @ self.field(omega, K, constants)

    def field(self, omega, K, constants):
        """Return the amplitudes of all, by a splu."""
        damping = 1j * omega * self.medium.damping
        S = K + damping * self.C - (self.medium.mass * omega**2) * self.identity
        drive = self.B.T @ ((constants + damping * self.springs.damped) * self.springs.drive)
        return splu(S, **SPLU).solve(-drive)

    def sweep(self, omegas):
        """Return the amplitudes over frequencies."""
        return np.array([self.amplitude(omega, self.K, self.medium.constants) for omega in omegas])

    def relaxation(self, omega, changes):
        """Return the amplitudes after each change of a bond."""
        K, constants, amplitudes = self.K, self.medium.constants.copy(), []
        for bond, stiffness in zip(changes.bond, changes.stiffness, strict=True):
            row = self.B[bond]
            K = K + (stiffness - constants[bond]) * (row.T @ row).tocsc()
            constants[bond] = stiffness
            amplitudes.append(self.amplitude(omega, K, constants))
        return np.array(amplitudes)

    def settled(self, omega, amplitude, good):
        """Return the fundamental at the detector once it stands, of contacts that open.

        By DOP853, from the linear motion on, until what geometric decay leaves is below `good`.
        """
        medium, drive, n = self.medium, amplitude * self.springs.drive, len(self.read)
        h, p, bonds, turned = medium.overlap, medium.power, medium.bonds, self.B.T.tocsr()
        C, time = medium.force / h**p, 2 * np.pi / omega
        lag = medium.damping * self.springs.damped[:bonds] / medium.constants[:bonds]

        def rate(t, y):
            e = self.B @ y[:n] + drive * np.cos(omega * t)
            speed = self.B @ y[n:] - omega * drive * np.sin(omega * t)
            tension, x = medium.constants * e, np.maximum(h - e[:bonds], 0)
            tension[:bonds] = C * (h**p - x**p + lag * p * x ** (p - 1) * speed[:bonds])
            return np.concatenate([y[n:], -(turned @ tension) / medium.mass])

        u = amplitude * self.field(omega, self.K, medium.constants)
        y, at = np.concatenate([u.real, (1j * omega * u).real]), np.arange(33) / 32
        found, left = [], np.inf
        while not left < good:
            chosen = {"method": "DOP853", "rtol": 1e-6, "atol": 1e-7 * amplitude}
            path = solve_ivp(rate, (0, time), y, t_eval=time * at * (1 - 1e-15), **chosen).y
            y = path[:, -1]
            found.append(path[:n, :-1] @ np.exp(-2j * np.pi * at[:-1]) / 16)
            if len(found) > 2:
                steps = np.linalg.norm(np.diff(found[-3:], axis=0), axis=1)
                before, changed = steps / np.linalg.norm(found[-1])
                left = changed**2 / (before - changed) if changed < before else np.inf
        return self.read @ found[-1]

    def all_modes(self):
        """Return omega^2 of all modes, found with their shapes."""
        squares, _ = np.linalg.eigh(self.K.toarray())
        return squares / self.medium.mass

    def all_damped_modes(self):
        """Return all s of S(s) x = 0, found with their shapes, by the dense linearisation."""
        m, n = self.medium.mass, self.K.shape[0]
        C = self.medium.damping * self.C
        blocks = [[None, sp.identity(n)], [-self.K / m, -C / m]]
        s, _ = scipy.linalg.eig(sp.bmat(blocks).toarray())
        return s

    def damped_modes_near(self, omega, count):
        """Return the s nearest to i omega, by eigs of the linearisation on a splu of S."""
        m, n, sigma = self.medium.mass, self.K.shape[0], 1j * omega
        C = self.medium.damping * self.C
        factor = splu((self.K + sigma * C + sigma**2 * m * self.identity).tocsc(), **SPLU)

        def solve(b):
            b = b.ravel()
            x = -factor.solve(m * b[n:] + C @ b[:n] + sigma * m * b[:n])
            return np.concatenate([x, sigma * x + b[:n]])

        inverse = LinearOperator((2 * n, 2 * n), solve, dtype=complex)
        t, _ = eigs(inverse, k=count)
        return sigma + 1 / t[np.argsort(-np.abs(t))]

    def modes_near(self, omega, count):
        """Return the frequencies of the modes nearest to one, in this order, by eigsh on a splu."""
        sigma = self.medium.mass * omega**2
        factor = splu(self.K - sigma * self.identity, **SPLU)
        inverse = LinearOperator(self.K.shape, factor.solve)
        squares, _ = eigsh(self.K, k=count, sigma=sigma, OPinv=inverse)
        return np.sqrt(squares[np.argsort(np.abs(squares - sigma))] / self.medium.mass)

    def moments(self, f, count, highest):
        """Return f^T T_n(2 K / highest - 1) f, n < count, which is even: two of a product."""
        H = ((4 / highest) * self.K - 2 * self.identity).tocsr()
        matrix = *H.shape, H.indptr, H.indices, H.data
        before, now, found = f.copy(), 0.5 * (H @ f), np.empty(count)
        found[:2] = f @ f, f @ now
        for n in range(2, count, 2):
            found[n : n + 2] = 2 * (now @ now) - found[0], -found[1]
            np.negative(before, out=before)
            csr_matvec(*matrix, now, before)  # adds to what is there
            before, now = now, before
            found[n + 1] += 2 * (before @ now)
        return found

    def spectra(self, patterns, s, count, highest):
        """Return Re(s f^T S(s)^-1 f) 2 m / pi of patterns f, by kernel polynomials."""
        w = -2 * self.medium.mass * s**2 / highest - 1
        root = np.sqrt(w - 1) * np.sqrt(w + 1)
        c = -2 / root[:, None] * (w + root)[:, None] ** -np.arange(count)
        c[:, 0] /= 2
        found = [c @ self.moments(f, count, highest) for f in patterns]
        return 2 * self.medium.mass / np.pi * np.real(s * 2 / highest * np.array(found))

    def density(self, omegas, vectors, count, highest):
        """Return modes a unit of frequency between some, by Jackson's kernel and random signs."""
        x = np.clip(2 * self.medium.mass * omegas**2 / highest - 1, -1, 1)
        angle, n = np.arccos(x), np.arange(count)
        turn = np.pi / (count + 1)
        kernel = (count - n + 1) * np.cos(n * turn) + np.sin(n * turn) / np.tan(turn)
        below = 0.0
        for vector in range(vectors):
            bits = np.random.Generator(np.random.Philox(key=[1, vector]))
            signs = bits.integers(0, 2, self.K.shape[0], dtype=np.int8) * 2.0 - 1.0
            moments = self.moments(signs, count, highest) * kernel / (count + 1)
            steps = np.sin(np.outer(angle, n[1:])) @ (moments[1:] / n[1:])
            below = below + (moments[0] * (np.pi - angle) - 2 * steps) / np.pi / vectors
        return np.diff(below) / np.diff(omegas)
