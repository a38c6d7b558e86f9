"""Newton's method for the balance of harmonics, by GMRES with real coefficients, over all ranks.

Residuals are measured after the preconditioner, as parts of the field: near the linear state they
are its error. With a `Plane` the amplitude or the frequency is unknown as well, and the state lies
on a plane across the branch of states, which so passes its folds.
"""

from typing import NamedTuple

import numpy as np

STEPS, HALVINGS, FORCING = 10, 4, 1e-2
RESTART, MOST = 100, 200  # vectors of GMRES, and products
MANY = 60  # products in a Newton step, above which mean tangents are worth new factors
ROUGH = 0.5  # to which part a residual is reduced at least


class Plane(NamedTuple):
    """A step ahead of a state on a branch: weight <along, U - U_0> + rate (p - p_0) = step."""

    parameter: str  # p: amplitude or omega
    along: np.ndarray
    rate: float
    weight: float
    field: np.ndarray
    value: float
    step: float

    def height(self, balance, D, change):
        """Return how far a change of a state moves it ahead."""
        return self.weight * balance.inner(self.along, D) + self.rate * change


def solved(balance, U, tolerance, plane=None):
    """Return the state that a field leads to, or None; with a plane its parameter moves, too.

    Its residual is at most `tolerance` of the field, and of the plane's step.
    """
    if not balance.factor():
        return None
    missed = _missed(balance, U, plane)
    for _ in range(STEPS):
        if not missed.size > tolerance:
            break
        reduction = max(min(FORCING, missed.size), 0.1 * tolerance / missed.size)
        D, change, missed = newton_step(balance, U, reduction, plane, missed)
        value = plane and getattr(balance, plane.parameter)
        for halving in range(HALVINGS + 1) if D is not None else ():
            if plane:
                setattr(balance, plane.parameter, value + change / 2**halving)
            now = _missed(balance, U + D / 2**halving, plane)
            if now.force < missed.force or now.size <= tolerance:
                break
        else:
            return None
        U, missed = U + D / 2**halving, now
    return U if missed.size <= tolerance else None


def newton_step(balance, U, reduction, plane=None, missed=None):
    """Return Newton's step of a field, None if GMRES fails; of the parameter; what was missed.

    GMRES reduces that by so much. Where it takes many products mean tangents make a better
    preconditioner, by which what is missed is another.
    """
    for most in (MANY, MOST):
        if not balance.factor(None if most == MANY else True):
            break
        if missed is None or most == MOST:
            missed = _missed(balance, U, plane)
        if not np.isfinite(missed.size):
            break
        product, unit = _jacobian(balance, U, plane)
        b = -packed(missed.field, missed.plane * unit)
        x, reached = gmres(product, b, reduction, most, balance.comm)
        if reached <= reduction or (most == MOST and reached <= ROUGH):
            return x[:-1].view(complex).reshape(U.shape), x[-1] / unit, missed
    return None, 0.0, missed


def _jacobian(balance, U, plane):
    """Return the product with the Jacobian at the last residual, and the parameter's unit in it.

    The parameter is the last number of each vector.
    """
    balance.linearize()
    column, unit = 0.0, 1.0
    if plane:
        column = balance.solve(balance.slope(U, plane.parameter))
        unit = balance.norm(U) / plane.step

    def product(x):
        D, change = x[:-1].view(complex).reshape(U.shape), x[-1] / unit
        missed = plane.height(balance, D, change) if plane else change
        return packed(balance.solve(balance.product(D)) + change * column, missed * unit)

    return product, unit


class Missed(NamedTuple):
    """The preconditioned residual, how far the plane is, and sizes: of forces, of both."""

    field: np.ndarray
    plane: float
    force: float
    size: float


def _missed(balance, U, plane):
    """Return what a state misses."""
    R, far = balance.residual(U), 0.0
    Z = balance.solve(R)
    force, size = balance.norm(R) / balance.drive_norm, balance.norm(Z) / balance.norm(U)
    if plane:
        change = getattr(balance, plane.parameter) - plane.value
        far = plane.height(balance, U - plane.field, change) - plane.step
        force, size = (np.hypot(x, far / plane.step) for x in (force, size))
    return Missed(Z, far, force, size)


def packed(U, number):
    """Return a field and a number as one vector of real numbers."""
    return np.append(np.ascontiguousarray(U).view(float).ravel(), number)


def gmres(product, b, reduction, most, comm):
    """Solve A x = b with at most so many products; return x and |b - A x| / |b|.

    Vectors are of all ranks, but for the last number, which all have. Y. Saad and M. H. Schultz,
    SIAM J. Sci. Stat. Comput. 7, 856 (1986); orthogonal to rounding by two passes.
    """

    def inner(V, w):
        total = V[..., :-1] @ w[:-1]
        return (comm.allreduce(total) if comm.size > 1 else total) + V[..., -1] * w[-1]

    x, r, done = np.zeros_like(b), b, 0
    first = left = np.sqrt(inner(b, b))
    while reduction * first < left < np.inf and done < most:
        count = min(RESTART, most - done)
        V, H = np.empty((count + 1, len(b))), np.zeros((count + 1, count))
        V[0], turns, g = r / left, np.zeros((count, 2)), np.zeros(count + 1)
        g[0] = left
        for j in range(count):
            w, done = product(V[j]), done + 1
            for _ in range(2):
                h = inner(V[: j + 1], w)
                w, H[: j + 1, j] = w - h @ V[: j + 1], H[: j + 1, j] + h
            H[j + 1, j] = np.sqrt(inner(w, w))
            V[j + 1] = w / (H[j + 1, j] or 1.0)
            for i, (c, s) in enumerate(turns[:j]):  # Givens' rotations make H a triangle
                H[i : i + 2, j] = c * H[i, j] + s * H[i + 1, j], c * H[i + 1, j] - s * H[i, j]
            c, s = turns[j] = H[j : j + 2, j] / (np.hypot(*H[j : j + 2, j]) or 1.0)
            H[j : j + 2, j] = c * H[j, j] + s * H[j + 1, j], 0.0
            g[j : j + 2] = c * g[j], -s * g[j]
            if not abs(g[j + 1]) > reduction * first:
                break
        x = x + np.linalg.solve(H[: j + 1, : j + 1], g[: j + 1]) @ V[: j + 1]
        if abs(g[j + 1]) <= reduction * first or done >= most:
            return x, abs(g[j + 1]) / first
        r = b - product(x)
        left = np.sqrt(inner(r, r))
    return x, left / first if first else 0.0
