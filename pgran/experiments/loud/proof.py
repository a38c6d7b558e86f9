"""Whether a periodic state exists, and how near it is to the one found: a proof by computer.

e_bar are the stretches of a motion U of some harmonics, x what those of the true one are beyond.
With tangents t, S_t = S + B^T t (1 + i n omega A) B and d(e) = phi(e) - t e, as psi = A phi,

    x = -B S_t^-1 (R + B^T (1 + i n omega A) (g + d(e_bar + x) - d(e_bar))),

R what U misses with P in place of phi(e_bar), a polynomial of the harmonics 0 to `HIGHEST`, and g
the rest, phi(e_bar(t)) - P(t). With weights D and the L2 norm over a period of D^(1/2) x this is a
contraction by

    Z = gamma max l / D,    gamma = max_n |D^(1/2) B S_t^-1 B^T (1 + i n omega A) D^(1/2)|_2,

l no less than |phi' - t| of a contact at any time while |x| <= rho; phi' falls with e, so its ends
tell. Where Z < 1 there is one x, if its largest values, by Cauchy and Schwarz over all harmonics,
are within rho, which grows until they are. Nothing is said of stability.

Everything is enclosed. Between samples e and P are straight lines, up to (omega dt)^2 / 8 times
sum n^2 |E_n|; and phi, which is concave, is no farther from its chord than a quarter of the step of
e times that of phi', whether or not the contact opens there. Inverses Y are proven by
|1 - S Y| < 1, norms by Cholesky's factors, which exist of no matrix with an eigenvalue below
-4 EPSILON n trace (S. Rump, Acta Numerica 19, 287 (2010)); harmonics above the band have
|S_t^-1| <= 1 / (m n^2 omega^2 - lambda_max). The medium is B, k, c, h and C as they are stored.
"""

from typing import NamedTuple

import numpy as np

from pgran.medium.base import EPSILON, SMALLEST_NORMAL
from pgran.medium.springs import drive_of, norm_of, quadratic, sparse_rows

MOST = 3000  # contacts, as matrices are dense
HIGHEST, SAMPLES, CHUNK = 255, 4096, 256  # of P; of a period; contacts that are sampled at a time
CURVED = (2 * np.pi / SAMPLES) ** 2 / 8
COVER = 1.01  # covers the rounding of a bound itself
NEAR, LEAST = 0.02, 1e-6  # D is l for an x of so much of e; at least so much of the largest k
GROWTHS = 60


class Proof(NamedTuple):
    """Of a state: is it proven, and then how far harmonics are from its at most, (nd, N + 1).

    No other periodic motion's stretches are all within `radius` of its, inf: there is none; `gain`
    is Z, NaN where it is unknown.
    """

    proven: bool
    bound: np.ndarray
    radius: float
    gain: float


def proof_of(medium, contacts, omega, amplitude, U, sites, harmonic):
    """Return the Proof of a motion U, shape (unknowns, more than N), of all contacts.

    `harmonic` is what is said of it at the sites. None where no proof is tried: other laws, too
    many contacts.
    """
    if contacts.p not in (0, 1) or contacts.power < 1 or len(contacts.drive) > MOST:
        return None
    unproven = Proof(False, np.full(harmonic.shape, np.nan), np.nan, np.nan)
    readings = sparse_rows(*medium.readings(sites), len(U))
    try:
        orbit = _Orbit(contacts, omega, amplitude, U)
        return _proven(medium, orbit, readings, harmonic) or unproven
    except (ArithmeticError, np.linalg.LinAlgError):
        return unproven


class _Orbit:
    """A motion: its extreme stretches `low`, `high`, P, and bounds `rest` of g in L2."""

    def __init__(self, contacts, omega, amplitude, U):
        self.contacts, self.omega, self.amplitude, self.U = contacts, omega, amplitude, U
        self.B = sparse_rows(contacts.columns, contacts.entries, len(U))
        E, size = self.B @ U, abs(self.B) @ np.abs(U)
        E[:, 1] += amplitude * contacts.drive
        size[:, 1] += amplitude * np.abs(contacts.drive)
        turns = np.outer(np.arange(HIGHEST + 1), np.arange(SAMPLES)) % SAMPLES  # exact
        wave = np.exp(2j * np.pi / SAMPLES * turns)
        wave = np.stack([wave.real, -wave.imag], axis=1).reshape(-1, SAMPLES)
        starts = range(0, len(E), CHUNK)
        parts = [self._sampled(slice(n, n + CHUNK), E, size, wave) for n in starts]
        self.low, self.high, self.P, self.rest = map(np.concatenate, zip(*parts, strict=True))

    def _sampled(self, some, E, size, wave):
        """Return low, high, P and rest of some contacts."""
        contacts, E, size = self.contacts.of(some), E[some], size[some]
        n2 = np.arange(HIGHEST + 1.0) ** 2
        e = E.view(float) @ wave[: 2 * E.shape[1]]
        off = CURVED * COVER * (np.abs(E) @ n2[: E.shape[1]])
        off += (2 * E.shape[1] + 64) * EPSILON * size.sum(axis=1)
        low, high = e.min(axis=1) - 2 * off, e.max(axis=1) + 2 * off
        phi, slope = contacts.forces(e)[0], contacts.tangents(e)[0]
        P = np.fft.rfft(phi)[:, : HIGHEST + 1] * (2 / SAMPLES)
        P[:, 0] = P[:, 0].real / 2
        missed = np.abs(phi - P.view(float) @ wave)
        # what holds at all times, then what differs from one interval to the next
        steepest = np.abs(_slopes(contacts, low, high)).max(axis=0)
        rounding = 16 * EPSILON * (steepest + contacts.stiffness)
        height = np.maximum(contacts.overlap - low, np.abs(contacts.overlap))
        force = 2 * contacts.constant * height**contacts.power
        force += contacts.stiffness * np.maximum(np.abs(low), np.abs(high))
        fixed = (steepest + rounding) * off + 16 * EPSILON * force + 64 * SMALLEST_NORMAL
        fixed += np.abs(P) @ (CURVED * n2 + (2 * HIGHEST + 64) * EPSILON)
        bent = np.abs(np.diff(slope, append=slope[:, :1])) + rounding[:, None]
        bent *= np.abs(np.diff(e, append=e[:, :1])) / 4
        worst = np.maximum(missed, np.roll(missed, -1, axis=1)) + bent + COVER * fixed[:, None]
        return low, high, P, COVER * np.sqrt(np.mean(worst**2, axis=1))


class _Systems:
    """S_t at each harmonic, and its inverse; `top` bounds the eigenvalues of K_t."""

    def __init__(self, medium, orbit, t, A):
        from scipy.sparse import identity

        self.orbit, self.A, springs = orbit, A, medium.springs
        self.K, self.C, self.m = quadratic(medium)
        self.f, self.f_rate = drive_of(medium)
        self.one = identity(len(orbit.U), format="csr")
        K, C = (orbit.B.T @ orbit.B.multiply(x[:, None]) for x in (t, t * A))
        self.tangent = (self.K + K).tocsr(), (self.C + C).tocsr()
        # the norms of what all is summed from, and how many terms there are
        k, c = np.abs(springs.constants), medium.damping * springs.damped
        added = [norm_of(orbit.B, np.abs(x)) for x in (t, t * A)]
        self.norms = norm_of(springs.B, k) + added[0], norm_of(springs.B, c) + added[1]
        self.reach = np.sqrt(norm_of(orbit.B, np.ones(len(t))))
        self.pull = np.sum((k + orbit.omega * c) * springs.drive**2)
        met = sum(np.bincount(B.indices).max(initial=0) for B in (springs.B, orbit.B))
        terms = met * (springs.columns.shape[1] + 1)
        self.unit = 8 * EPSILON * (len(orbit.U) + 2 * terms + 64)
        self.top = COVER * _above(self.tangent[0].toarray()) + self.unit * self.norms[0]

    def missed(self, n):
        """Return R at a harmonic, and how far rounding may have moved it."""
        a, s, m = self.orbit.amplitude, 1j * n * self.orbit.omega, self.m
        push = (1 + s * self.A) * self.orbit.P[:, n]
        R, size = self.orbit.B.T @ push, self.reach * np.linalg.norm(push)
        if n < self.orbit.U.shape[1]:
            U = self.orbit.U[:, n]
            R = R + self.K @ U + s * (self.C @ U) + m * s * s * U
            size += self._norm(n) * np.linalg.norm(U)
        if n == 1:
            force = self.f + s * self.f_rate
            R = R - a * force
            size += a * (np.linalg.norm(force) + np.sqrt(self._norm(n) * self.pull))
        return R, 2 * self.unit * size + 64 * len(R) * SMALLEST_NORMAL

    def inverse(self, n):
        """Return Y near S_t^-1, |Y|, and how far it is at most, rounding of products included."""
        s, (K, C) = 1j * n * self.orbit.omega, self.tangent
        S = (K + s * C + self.m * s * s * self.one).tocsr()
        Y = np.linalg.inv(S.toarray())
        length = COVER * np.linalg.norm(Y)
        off = COVER * np.linalg.norm(S @ Y - np.eye(len(Y))) + self.unit * length * self._norm(n)
        if not off < 0.1:
            raise ArithmeticError
        return Y, length, 1.2 * length * (off + self.unit)

    def _norm(self, n):
        w, drag = n * self.orbit.omega, np.abs(self.C.diagonal()).max()
        return self.norms[0] + w * (self.norms[1] + drag) + self.m * w * w


def _proven(medium, orbit, readings, harmonic):
    """Return the Proof, None if there is none."""
    contacts, omega = orbit.contacts, orbit.omega
    A = contacts.share if contacts.p else 0.0 * contacts.share
    t = _slopes(contacts, orbit.low, orbit.high).mean(axis=0)

    def spread(rho):
        """Return l."""
        ends = _slopes(contacts, orbit.low - COVER * rho, orbit.high + COVER * rho)
        rounding = 16 * EPSILON * (np.abs(ends).max(axis=0) + 2 * contacts.stiffness)
        return np.abs(ends - t).max(axis=0) + rounding

    D = spread(NEAR * np.maximum(np.abs(orbit.low), np.abs(orbit.high)))
    D = np.sqrt(np.maximum(D, LEAST * contacts.stiffness.max()))  # its root from here on
    X = orbit.B.multiply(D[:, None]).tocsr()
    rows, norm, read = _lengths(X), np.sqrt(norm_of(orbit.B, D**2)), _lengths(readings)
    systems = _Systems(medium, orbit, t, A)
    last = max(int(2 * np.sqrt(systems.top / systems.m) / omega) + 1, orbit.U.shape[1])
    if last >= HIGHEST:
        return None
    # of each contact: the largest value that R causes, and sums of squares of rows; by one harmonic
    # of each detector: what R causes, and what a force of size 1 can
    sup, sums = np.zeros((2, len(rows)))
    base, per = np.zeros((2, *harmonic.shape))
    square = wide = Y2 = 0.0
    for n in range(HIGHEST + 1):
        share, (R, lost) = 0.5 if n else 1.0, systems.missed(n)
        if n > last:
            far = COVER * (np.linalg.norm(R) + lost)
            far /= systems.m * (n * omega) ** 2 - systems.top
            Y2, sup = Y2 + share * (norm * far) ** 2, sup + rows * far
            continue
        (Y, length, doubt), factor = systems.inverse(n), 1 + 1j * n * omega * A
        z, far = Y @ R, COVER * (doubt * np.linalg.norm(R) + (length + doubt) * lost)
        x, V = X @ z, (X.multiply(factor[:, None]).tocsr() @ Y.T).T
        W, doubt = X @ V, norm * np.abs(factor).max() * doubt
        square, wide = _above(W.conj().T @ W, square), max(wide, norm * doubt)
        Y2, sup = Y2 + share * (np.linalg.norm(x) + norm * far) ** 2, sup + np.abs(x) + rows * far
        sums += (np.linalg.norm(W, axis=1) + rows * doubt) ** 2 / share
        if n < harmonic.shape[1]:
            U = orbit.U[:, n]
            base[:, n] = np.abs(harmonic[:, n] - readings @ U) + np.abs(readings @ z) + read * far
            base[:, n] += 16 * EPSILON * (abs(readings) @ np.abs(U))
            per[:, n] = (np.linalg.norm(readings @ V, axis=1) + read * doubt) / np.sqrt(share)
    # the sum over n > last of (1 + (n omega A)^2) / (m (n omega)^2 - top)^2, and the largest root
    after, damping = last + 1, omega * np.abs(A).max(initial=0.0)
    least = systems.m * omega**2 - systems.top / after**2
    sums += 2 * (rows * norm / least) ** 2 * (1 / (3 * last**3) + damping**2 / last)
    tail = norm**2 * (1 + after * damping) / (least * after**2)
    gamma, sums = COVER * max(np.sqrt(square) + wide, tail), COVER * np.sqrt(sums)
    between = COVER * np.linalg.norm(orbit.rest / D)
    Y, sup = COVER * (np.sqrt(Y2) + gamma * between), COVER * (sup + sums * between)

    def gain(rho):
        """Return Z."""
        return COVER * gamma * np.max(spread(rho) / D**2)

    rho = 1.2 * sup / D
    for _ in range(GROWTHS):
        Z = gain(rho)
        if not Z < 1:
            return Proof(False, np.full(harmonic.shape, np.nan), np.nan, Z)
        push = COVER * Z / gamma * Y / (1 - Z)
        reached = COVER * (sup + sums * push) / D
        if np.all(reached <= rho):
            bound = COVER * (base + per * (push + between))
            # a larger rho allows no other state either
            with np.errstate(invalid="ignore"):  # 0 inf, of psi, which nobody asks for
                wide = [rho * growth for growth in (*2.0 ** np.arange(GROWTHS), np.inf)]
                free = [(x - reached)[rows > 0] for x in wide if gain(x) < 1]
            radius = max(np.min(x, initial=np.inf) for x in free)
            return Proof(True, bound, float(radius), Z)
        rho = 1.1 * np.maximum(rho, reached)
    return None


def _slopes(contacts, low, high):
    """Return phi' of contacts at their smallest and their largest stretch."""
    return contacts.tangents(np.stack([low, high], axis=1))[0].T


def _lengths(X):
    """Return no less than the 2-norms of sparse rows."""
    return COVER * np.sqrt(np.asarray(X.multiply(X).sum(axis=1)).ravel())


def _above(H, least=0.0):
    """Return what no eigenvalue of a Hermitian matrix exceeds by a thousandth, from `least` on."""
    v = np.random.Generator(np.random.Philox(0)).standard_normal(len(H))
    for _ in range(20):
        v = H @ v
        v = v / (np.linalg.norm(v) or 1.0)
    size = np.linalg.norm(H @ v)
    if not np.isfinite(size):
        raise ArithmeticError
    bound = max(least, 1.01 * size, SMALLEST_NORMAL)
    while True:
        try:
            np.linalg.cholesky(bound * np.eye(len(H)) - H)
            return bound
        except np.linalg.LinAlgError:
            bound *= 1.02
