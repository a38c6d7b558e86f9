"""The driven box without particles: the exact series (paper: diffeq, axysol, alndef).

With z = m omega^2 / (K0 + i omega beta), laplacian A + z A = 0 on [0, Lx] x [0, Ly], A = 1 on the
wall x = Lx and 0 on the others, is solved by the sum over odd nu = 2n + 1 of

    A = 4/pi sum sin(nu pi y/Ly)/nu R(nu),      R(nu) = sinh(gamma x) / sinh(gamma Lx),
    gamma^2 = (nu pi/Ly)^2 - z,                 gamma = alpha_n / Lx.

Three things stand between these formulas and numbers that are right to 1e-12 all over the box:

- Overflow of sinh, and rounding where x is small: R is a decaying exponential times a quotient of
  two expm1.
- A resonance, gamma Lx = i pi w: there everything hangs on gamma^2 + (w pi/Lx)^2, which is
  computed with twice the digits of a double; phases are counted from the resonance.
- Slow convergence next to the driven wall: from some nu on, the sum is a contour integral, which
  the trapezoidal rule takes to full precision with a few hundred nodes.

Extended precision, where the machine has it, because terms cancel where the amplitude is 0.
"""

import math
from dataclasses import dataclass
from decimal import Context, Decimal, localcontext

import numpy as np

from pgran.errors import InputError

PI = np.longdouble("3.14159265358979323846264338327950288419716939937510582")
PI_SQUARED = Decimal("9.86960440108935861883449099987615113531369940724079")
EXACT = Context(prec=50)  # of all decimals below

# What is smaller than the leading term by exp(-NEGLECTED), 2e-22, is left out.
NEGLECTED = 50.0
# The contour nu = start + cosh(u + i ANGLE) - cos(ANGLE), start even, leaves the poles at odd nu
# alone as long as u is off the real axis by less than ANGLE, and the integrand decays out to .68 at
# least: a trapezoidal rule of step STEP is wrong by about exp(-2 pi .68 / STEP) = 3e-19.
ANGLE = PI / 4
STEP = np.longdouble(0.1)
TOGETHER = 64  # frequencies treated at once, which bounds memory
HALF_WAVES = 2000  # along a side: integers below 2^11 times a double are exact in long doubles


@dataclass(frozen=True)
class Continuum:
    """A box of the size Lx, Ly, of uniform stiffness K0, driven at the wall x = Lx.

    Parameters and their inverses are 1e100 at most, so that no square overflows.
    """

    size: tuple = (1.0, 1.0)
    mass: float = 1.0
    stiffness: float = 1.0
    damping: float = 0.003

    def __post_init__(self):
        if len(self.size) != 2:
            raise InputError(
                f"-continuum_size: two lengths are needed; numbers given: {len(self.size)}"
            )

    def response(self, omega, point):
        """Return the amplitude at (x, y) for each driving frequency, 0 or more (paper: axysol).

        Complex, relative to the driven wall, for exp(+i omega t), in the shape of `omega`; the
        corners belong to the walls at rest. No double falls on an undamped resonance exactly.
        Raises an InputError if the point lies outside the box, or a frequency is negative, not
        finite, or so high that more than `HALF_WAVES` half-waves fit along the box.

        The result is exact for the given doubles to 1e-12 of itself, next to every wall and every
        resonance too. Exceptions: within about 1e-10 of omega of a zero of the undamped response,
        where A is more than 1e6 times smaller than the terms that cancel (there the error is below
        1e-18 of these terms); below 1e-308, where A becomes 0; and next to resonances where long
        double is no more than double (not on Linux on x86 or ARM): 1e-9 then, and more on the nodal
        lines of the resonant mode.
        """
        omega = np.asarray(omega, dtype=float)
        if len(point) != 2:
            raise InputError(f"-continuum_point: x and y are needed; numbers given: {len(point)}")
        for name, value, length in zip("xy", point, self.size, strict=True):
            if not 0 <= value <= length:
                raise InputError(f"-continuum_point: {name} = {value} is outside [0, {length}]")
        x, y = (np.longdouble(float(value)) for value in point)
        amplitude = np.empty(omega.size, dtype=complex)
        with localcontext(EXACT):
            for first in range(0, omega.size, TOGETHER):
                these = slice(first, first + TOGETHER)
                amplitude[these] = self._series(omega.ravel()[these], x, y)
        return amplitude.reshape(omega.shape)

    def resonances(self, omega_max):
        """Return the frequencies up to `omega_max` of the modes that the wall drives, ascending.

        omega^2 = (K0/m) pi^2 (q1^2/Lx^2 + q2^2/Ly^2) with q1 >= 1 and q2 odd (paper: eigvalues,
        simpfreq), damping left aside. Raises as `response` does.
        """
        with localcontext(EXACT):
            self._half_waves(*self._wavenumber(np.array([omega_max], dtype=float), 0.0)[0])
        unit = math.pi * math.sqrt(self.stiffness / self.mass)
        q1, q2 = (np.arange(1, int(omega_max / unit * length) + 2) for length in self.size)
        omega = unit * np.hypot(q1[:, None] / self.size[0], q2[::2] / self.size[1]).ravel()
        return np.sort(omega[omega <= omega_max])

    def _series(self, omega, x, y):
        """Return the sum of axysol for a few frequencies."""
        lx, ly = (np.longdouble(length) for length in self.size)
        y = min(y, ly - y)  # the sum is symmetric, and its terms are most accurate for small y
        real, loss = self._wavenumber(omega, self.damping)
        half_waves = self._half_waves(max(a + b for a, b in zip(real, loss, strict=True)))
        z, loss = _pairs(real), _sum(_pairs(loss))
        wave = np.sqrt(_sum(z) - 1j * loss)
        # nu = 1, 3, ... 2 count - 1 in the sum, and above in the integral, if that is less work
        count = math.ceil(half_waves * self.size[1] / 2) + 1
        nodes, weights = _contour(2 * count, PI * (lx - x) / ly, PI * y / ly)
        enough = _enough(wave, lx - x, ly)
        if enough <= count + nodes.size:
            count, nodes = enough, nodes[:0]
        nu = np.arange(1, 2 * count, 2)
        whole, rest = _turn(nu, y, ly)
        sine = (1 - 2 * (whole % 2)) * np.sin(PI * rest)  # accurate also next to its zeros
        amplitude = self._head(nu, z, loss, x) @ (sine / nu)
        if nodes.size:
            gamma = np.sqrt((PI * nodes / ly) ** 2 - (wave**2)[:, None])
            amplitude += _ratio(gamma, lx - x, gamma * x, gamma * lx) @ weights
        return 4 / PI * amplitude

    def _wavenumber(self, omega, damping):
        """Return Re z and -Im z of z = m omega^2 / (K0 + i omega beta), as decimals."""
        if not np.all(np.isfinite(omega) & (omega >= 0)):
            raise InputError("omega: every frequency must be 0 or more and finite")
        m, k, beta = (Decimal(float(v)) for v in (self.mass, self.stiffness, damping))
        real, loss = [], []
        for w in map(Decimal, omega.tolist()):
            drag = w * beta
            scale = m * (w * w) / (k * k + drag * drag)
            real.append(scale * k)
            loss.append(scale * drag)
        return real, loss

    def _half_waves(self, z):
        """Return sqrt(z)/pi, half-waves to a unit of length, unless too many."""
        half_waves = float(z.sqrt()) / math.pi
        if half_waves * max(self.size) > HALF_WAVES:
            raise InputError(f"omega: too high, more than {HALF_WAVES} half-waves along the box")
        return half_waves

    def _head(self, nu, z, loss, x):
        """Return R (nw, terms) of axysol for the first odd numbers nu.

        Let w be the whole number next to Im(gamma) Lx/pi, p = w pi/Lx and
        theta = gamma Lx - i pi w. Then theta = Lx (gamma^2 + p^2) / (gamma + i p) and
        gamma x = theta x/Lx + i pi w x/Lx, and exp(-2 gamma Lx) = exp(-2 theta).
        """
        lx = np.longdouble(self.size[0])
        z, loss = -z[:, :, None], 1j * loss[:, None]
        q_squared = _squares(nu, self.size[1])
        gamma = np.sqrt(_sum(q_squared, z) + loss)
        w = np.rint(gamma.imag * lx / PI).astype(int)
        p_squared = _squares(range(w.max() + 1), self.size[0])[:, w]
        theta = lx * (_sum(q_squared, z, p_squared) + loss) / (gamma + 1j * PI * w / lx)
        phase = theta * (x / lx) + 1j * PI * _turn(w, x, lx)[1]
        return _ratio(gamma, lx - x, phase, theta)


def _ratio(gamma, distance, phase, theta):
    """Return sinh(gamma x)/sinh(gamma Lx), whatever gamma; distance = Lx - x.

    phase and theta are gamma x and gamma Lx, up to multiples of i pi.
    """
    return np.exp(-gamma * distance) * np.expm1(-2 * phase) / np.expm1(-2 * theta)


def _turn(n, s, length):
    """Return n s/length as a whole number and a rest of at most 1/2, exact.

    A product of a double and an integer below 2^11 is exact in extended precision, and so is the
    difference of two such products that nearly agree.
    """
    whole = np.rint(n * (s / length))
    return whole, (n * s - whole * length) / length


def _squares(n, length):
    """Return (n pi/length)^2 as pairs of doubles, shape (2, len(n))."""
    unit = PI_SQUARED / Decimal(length) ** 2
    return _pairs([unit * int(i) ** 2 for i in n])


def _pairs(numbers):
    """Return decimals as pairs of doubles, high and low, shape (2, len)."""
    high = [float(number) for number in numbers]
    low = [float(number - Decimal(h)) for number, h in zip(numbers, high, strict=True)]
    return np.array([high, low])


def _sum(*pairs):
    """Return the sum of pairs of doubles, rounded only once."""
    high, low = 0.0, 0.0
    for more, lower in pairs:
        total = high + more
        added = total - high
        # Knuth's two-sum: what rounding took from the total.
        low = low + ((high - (total - added)) + (more - added)) + lower
        high = total
    return high + np.asarray(low, dtype=np.longdouble)


def _enough(wave, distance, ly):
    """Return how many terms axysol needs.

    |sin(nu t)|/nu <= sin t, and Re gamma >= sqrt((nu pi/Ly)^2 - Re z), which grows by more than
    2 pi/Ly from term to term. So from where exp(-(Lx - x) Re gamma) is exp(-NEGLECTED) of that of
    the first term, what follows is at most a geometric series.
    """
    if distance == 0:
        return math.inf
    first = np.sqrt((PI / ly) ** 2 - wave**2).real
    q = np.sqrt((wave**2).real + (first + NEGLECTED / distance) ** 2).max()
    return math.ceil(float(q * ly / PI) / 2 + 0.5)


def _contour(start, distance, height):
    """Return nodes nu and weights for the terms of axysol with odd nu > start, start even.

    With t = `height` = pi y/Ly <= pi/2 and `distance` = pi (Lx - x)/Ly,

        sum sin(nu t)/nu R(nu) = 1/(4i) integral kernel(nu)/nu R(nu) dnu,
        kernel = cos(nu (pi/2 - t)) / cos(nu pi/2)   or   sin(nu t) tan(nu pi/2),

    along a contour from infinity below the axis through `start` to infinity above: both kernels
    have the residues -2/pi sin(nu t) at odd nu. The first decays like exp(-t |Im nu|); the second
    grows like exp(t |Im nu|), but is small where t is, and serves where t << distance: R decays
    like exp(-distance Re nu). All poles of R lie left of `start`, if that exceeds
    Re sqrt(z) Ly/pi, since R is an even function of gamma.
    """
    steep = height < distance / 10
    decay = (distance + (-height if steep else height)) * math.sqrt(0.5)
    if not decay > 0:
        return np.empty(0), np.empty(0)
    reach = int(np.arccosh(1 + NEGLECTED / decay) / STEP) + 2
    u = STEP * np.arange(-reach, reach + 1) + 1j * ANGLE
    shift = np.cosh(u) - np.cos(ANGLE)
    nu = start + shift
    side = 1j * np.where(nu.imag < 0, -1, 1)
    turn = np.exp(side * PI * shift)  # exp(+-i pi nu), of magnitude at most 1
    if steep:
        kernel = np.sin(nu * height) * side * (1 - turn) / (1 + turn)
    else:
        kernel = np.exp(side * nu * height)
        kernel *= (1 + np.exp(side * nu * (PI - 2 * height))) / (1 + turn)
    return nu, STEP * np.sinh(u) * kernel / (4j * nu)
