"""Models of the response between frequencies: moments, their bases, and a march that proves them.

The moments of A at omega_0 are its scaled derivatives x_k = h^k A^(k) / k!; with d = omega -
omega_0, S = S_0 + d S_1 + d^2 S_2 and f = f_0 + d f_1 they follow from the factorization of S_0,

    S_0 x_k = h^k f_k - h S_1 x_(k-1) - h^2 S_2 x_(k-2),    S_1 = i C - 2 omega_0 M,    S_2 = -M,

f_k being 0 from k = 2 on, and those of a detector's adjoint from the same with e_d for f_0. A and
all adjoints are solved as one block of right-hand sides. Models are evaluated by `models`; they
need damping, which bounds S^-1 for all frequencies alike. Tall matrices, whose rows several ranks
hold, are factored block by block.
"""

import math
from functools import cached_property

import numpy as np

from pgran.driven.accuracy import Detectors
from pgran.driven.counting import smallest_damping, smallest_loss
from pgran.driven.linear import LEAST_NORM, Krylov, ends_run
from pgran.driven.operators import Owner
from pgran.errors import log, petsc_message
from pgran.experiments.response.models import ModelLimits, evaluate, moments_of, poles, squares
from pgran.experiments.response.record import model_dtype
from pgran.medium.base import EPSILON
from pgran.run.petsc import PETSc, logged

CHECKED_POINTS = 9  # Chebyshev points of an interval where its bound is checked
LENGTH_SHARE = 0.5  # of what rounding leaves of the allowed, at checked points: more is between
QR_ROWS = 400  # rows that are factored at once, and stay in the cache
SUM_ROWS = 256  # rows of a product that are summed up on their own


class IntervalModels(Owner):
    """Makes models of one lattice, with damping, and proves them; destroy with `destroy` or `with`.

    Collective. The `tolerance` is the relative accuracy asked of each amplitude at the detectors,
    `sites` (nd, dim); `length` takes a frequency and returns about how long an interval may be.
    """

    owns = ("_krylov", "_correction", "_rhs", "_solution", "_image", "_columns", "_products")

    def __init__(self, operators, sites, tolerance, length):
        self.operators, self.comm = operators, operators.comm
        self.tolerance, self.length = tolerance, length
        self.factorizations, self._works = 0, False
        self._count = moments_of(operators.lattice)
        self.width = min(2 * self._count, operators.size)
        systems = 1 + len(sites)
        self.dtype = model_dtype(self.width, len(sites), operators.size)
        self._rhs, self._solution, self._image = (operators.block(systems) for _ in range(3))
        columns = (systems + 1) * self.width
        self._columns, self._products = (operators.block(columns) for _ in range(2))
        # this rank's rows of g_0, g_1 of each system: of an adjoint e_d, 0
        detectors = Detectors(operators, sites)
        units, self._names = detectors.unit_vectors(), ["amplitudes", *detectors.names]
        self._loads = np.zeros((systems, operators.last - operators.first, 2), complex)
        for load, vector in zip(self._loads, [operators.f_stiffness, *units], strict=True):
            load[:, 0] = vector.getArray()
        self._loads[0, :, 1] = 1j * operators.damping * operators.f_damping.getArray()
        self._correction, *others = units
        for vector in others:
            vector.destroy()
        self.limits = self._limits(sites)

    @cached_property
    def _krylov(self):
        """What factors S. Collective when first asked for."""
        return Krylov(self.operators, self._correction)

    def _limits(self, sites):
        """Return what bounds the errors of all models."""
        operators, rounding = self.operators, self.operators.rounding
        # a path through the sums of `products`, over the ranks, and of the small algebra
        terms = 2 * SUM_ROWS + operators.size / SUM_ROWS + 2 * self.comm.size + 3 * self.width + 16
        loads = np.stack(operators.drive_sizes(), axis=1)
        drive, *damped = 1.01 * np.sqrt(self._total(squares(loads)))
        return ModelLimits(
            stability=operators.damping * smallest_damping(operators.lattice),
            stiffness=1.01 * operators.stiffness_norm,
            damping=1.01 * operators.damping * operators.lattice.damping_norm,
            mass=1.01 * operators.mass,
            drive=drive,
            drive_damping=operators.damping * sum(damped),
            rounding=rounding + 4 * qr_rounding(2 + 2 * self.width),
            sum_rounding=2 * rounding + 4 * EPSILON * terms,
            receiver=float(operators.lattice.reading_norms(sites).max()),
            steady_stability=smallest_loss(operators.lattice) or None,
        )

    def _total(self, part):
        """Return a sum over the ranks of the lattice, the same on each."""
        return part if self.comm.size == 1 else sum(self.comm.allgather(part))

    def cover(self, low, high):
        """Yield models of intervals that follow each other from `low` to `high`, one row each.

        Collective. Nothing depends on clocks.
        """
        # Strategy: the model of an interval takes the moments at its two ends, each a factorization
        # that the next interval shares. An interval whose bound misses the accuracy is shortened by
        # the order of the model, m moments at both ends: the bound grows like length^(4 m). The far
        # ends of intervals that were too long, which are factored already, wait `ahead`, to become
        # ends of later ones; up to the nearest of them the way is cut into equal pieces.
        #
        #     low         start   end     ahead[-1]            ahead[-2]            ahead[0] = high
        #      |==|==|=====|.......|.......|....................|....................|
        #         yielded     tried
        #
        # Where rounding alone misses the accuracy no shorter interval is better: it is yielded as
        # it is, and the next one is twice as long.
        start, ahead, step, done = low, [high], 2 * self.length(low), self.factorizations
        moments = {}  # at `start`, and at ends ahead
        while ahead:
            pieces = max(1, math.ceil((ahead[-1] - start) / step - 1e-9))
            end = start + (ahead[-1] - start) / pieces if pieces > 1 else ahead[-1]
            for omega in (start, end):
                if omega not in moments:
                    moments[omega] = self.moments(omega)
            model = self._model(start, end, moments[start], moments[end])
            # the first rank's: a last digit must not part the ranks' ways
            missed, rounded = self.comm.bcast(self._missed(model[0]))
            # the length that would just be accurate, in limits
            reach = 0.9 * max(missed, 1e-300) ** (-1 / (4 * self._count))
            reach = min(max(reach, 0.3), 3.0 if missed <= 1 else 0.8)
            step = (end - start) * (2.0 if rounded else reach)
            shortest = max(self.length(start) / 16, 1e-9 * start)
            if missed <= 1 or rounded or end - start <= shortest:
                model["proven"] = missed <= 1
                model["factorizations"] = self.factorizations - done
                yield model
                del moments[start]
                start, done = end, self.factorizations
                step = max(step, shortest)
                if end == ahead[-1]:
                    ahead.pop()
            elif end != ahead[-1]:
                ahead.append(end)

    @logged("bounds")
    def _missed(self, model):
        """Return the largest bound relative to what is allowed; whether rounding alone exceeds it.

        Checked at the ends, at Chebyshev points, and above the poles.
        """
        low, high = model["low"], model["high"]
        angles = np.pi * (np.arange(CHECKED_POINTS) + 0.5) / CHECKED_POINTS
        inner = 0.5 * (low + high) - 0.5 * (high - low) * np.cos(angles)
        above = poles(model["own"], low, high)
        model["poles"] = above[0]
        checked = np.unique(np.concatenate([[low, high], inner, above[np.isfinite(above)]]))
        checked = checked[np.diff(checked, prepend=0.0) > 1e-4 * (high - low)]  # A's, not z's twins
        points = evaluate(model, checked, self.limits, derivatives=False)
        with np.errstate(all="ignore"):
            allowed = self.tolerance * np.abs(points["displacement"]) / (1 + self.tolerance)
            # the part of a bound that the length decides may be a share of what rounding leaves
            room = allowed - points["rounding"]
            missed = (points["error_bound"] - points["rounding"]) / (LENGTH_SHARE * room)
            rounded = ~np.all(room > 0, axis=1)
            missed = np.where(rounded, np.inf, missed.max(axis=1))
        missed[np.isnan(missed)] = np.inf
        return missed.max(), np.any(rounded)

    def moments(self, omega):
        """Return moments of A and adjoints, (systems, own balls, m); NaN on failure. Collective."""
        self.operators.combine(1j * omega)
        self.factorizations += 1
        moments = None
        try:
            if self._krylov.factor():
                moments = self._series(omega)
        except PETSc.Error as error:
            if ends_run(error, self._works, self.comm):
                raise
            log.warning("no model at omega = %g: %s", omega, petsc_message(error))
        if moments is None:
            self.forget("_krylov")
            return np.full((*self._loads.shape[:2], self._count), np.nan, dtype=complex)
        self._works = True
        return moments

    def _series(self, omega):
        """Return the moments at a frequency whose S is factored."""
        operators = self.operators
        h, damping, mass = self.length(omega), operators.damping, operators.mass
        g = operators.f.getArray()[:, None]
        rhs = np.concatenate([g, self._loads[1:, :, 0].T], axis=1)
        x = np.empty((self._count, *rhs.shape), dtype=complex)
        for k in range(self._count):
            self._rhs.getDenseArray()[:] = rhs
            self._rhs.assemble()
            names = [f"{name}, derivative {k}" if k else name for name in self._names]
            self._krylov.invert(self._rhs, self._solution, names)
            x[k] = self._solution.getDenseArray(readonly=True)
            operators.C.matMult(self._solution, self._image)
            damped = 1j * damping * self._image.getDenseArray(readonly=True)
            rhs = -h * (damped - 2 * omega * mass * x[k])
            if k == 0:
                rhs[:, 0] += h * self._loads[0, :, 1]
            else:
                rhs += h * h * mass * x[k - 1]
        return np.ascontiguousarray(x.transpose(2, 1, 0))

    @logged("models")
    def _model(self, low, high, *moments):
        """Return the model of an interval from the moments at its ends. Collective."""
        model = np.zeros(1, self.dtype)
        into = model[0]
        into["low"], into["high"] = low, high
        moments = np.concatenate(moments, axis=-1)  # (systems, own balls, columns)
        largest = np.maximum(np.abs(moments.real), np.abs(moments.imag)).max(axis=-2)
        largest = np.max(self.comm.allgather(largest), axis=0)
        if not np.all(np.isfinite(largest)):
            into["own"] = np.nan
            return model
        # Where there are fewer balls than moments, as many columns span everything.
        X, _ = tall_qr(moments / np.maximum(largest, LEAST_NORM)[:, None], self.comm)
        X = X[..., : self.width]
        operators, size = self.operators, np.abs(X[0])
        K, C = self._applied([*X, size], (operators.K, operators.C))
        W = np.concatenate([self._loads, K[:-1], 1j * C[:-1], -operators.mass * X], axis=-1)
        into["own"], across = self._across(X, W)
        into["triangle"] = self._triangle(X, W, across)
        into["cross"] = self._total(products(X[1:], W[0]))
        into["reading"] = self._total(self._loads[1:, :, 0].real @ X[0])
        # |S| |X| at the highest frequency
        sizes = high * high * operators.mass * size
        if operators.laplacian:
            # |K| has the same diagonal as K, and so on; its other entries are those of -K.
            stiff, damped = operators.doubled_diagonals
            doubled = stiff + high * operators.damping * damped
            sizes += doubled[:, None] * size
            sizes -= K[-1].real + high * C[-1].real
        else:
            K, C = self._applied([*X, size], operators.sizes[::2])
            sizes += K[-1].real + high * C[-1].real
        drive = np.abs(self._loads[0]) @ [1.0, high]
        Z = np.abs(X[1:]).swapaxes(1, 2)
        into["sizes"], into["drive_sizes"] = self._total(Z @ sizes), self._total(Z @ drive)
        return model

    def _across(self, X, W):
        """Return X^T W and X^H W, by half the multiplications of both: X is a sum of two parts."""
        parts = np.stack([X.real, X.imag]).swapaxes(2, 3)
        real, imaginary = self._total((parts @ W.view(float)).view(complex))
        return real + 1j * imaginary, real - 1j * imaginary

    def _triangle(self, X, W, inside):
        """Return R of W = Q R, Q being X and columns of what W has beside X; `inside` is X^H W.

        M X has nothing beside it, all balls having one mass. Not finite if Q R misses W.
        """
        p = X.shape[-1]
        beside = W[..., :-p] - X @ inside[..., :-p]
        Q, R = tall_qr(beside, self.comm)
        missed = self._total(squares(beside - Q @ R))
        good = np.all(missed <= qr_rounding(p) ** 2 * squares(R))
        # both parts of Q are orthonormal, and orthogonal to each other but for this
        overlap = self._total(X.conj().swapaxes(1, 2) @ Q)
        overlap = np.sqrt(squares(overlap).sum(axis=-1))
        # W = [X, Q] [inside; R, 0]
        R = np.pad(R, [(0, 0), (0, 0), (0, p)])
        R = np.concatenate([inside, R], axis=1) * np.sqrt(1 + overlap)[:, None, None]
        return R if good else np.full_like(R, np.nan)

    def _applied(self, blocks, matrices):
        """Return K x and C x, all damping, of this rank's rows of blocks of columns. Collective."""
        width, images = self.width, []
        columns = self._columns.getDenseArray()
        for number, block in enumerate(blocks):
            columns[:, number * width : (number + 1) * width] = block
        self._columns.assemble()
        for matrix in matrices:
            matrix.matMult(self._columns, self._products)
            product = self._products.getDenseArray(readonly=True)
            # a copy, of one row too: the next product overwrites this one
            product = product.reshape(-1, len(blocks), width).swapaxes(0, 1)
            images.append(np.array(product, order="C"))
        return images[0], self.operators.damping * images[1]


def tall_qr(columns, comm):
    """Return Q, this rank's rows, and R of QR factorizations of tall matrices; the same R on all.

    Collective over `comm`, whose ranks hold the rows, the last axis but one.
    """
    q, r = _qr(columns)
    if comm.size == 1:
        return q, r
    parts = comm.allgather(r)
    q2, r = np.linalg.qr(np.concatenate(parts, axis=-2))
    start = sum(part.shape[-2] for part in parts[: comm.rank])
    return q @ q2[..., start : start + q.shape[-1], :], r


def _qr(columns):
    """Factor block by block, small enough for the cache, then the triangles of the blocks."""
    *several, rows, width = columns.shape
    blocks = rows // max(QR_ROWS, 4 * width)
    if blocks < 2:
        return np.linalg.qr(columns)
    padding = [(0, 0)] * len(several) + [(0, -rows % blocks), (0, 0)]
    q, r = np.linalg.qr(np.pad(columns, padding).reshape(*several, blocks, -1, width))
    q2, r = _qr(r.reshape(*several, -1, width))
    q = q @ q2.reshape(*several, blocks, width, width)
    return q.reshape(*several, -1, width)[..., :rows, :], r


def qr_rounding(width):
    """Return a u: W - Q R is known to u times the norms of R's columns, and is no more."""
    return 2 * EPSILON * (width + 4) * math.sqrt(width)


def products(Z, W):
    """Return Z^T W of this rank's rows, block by block: rounding adds up in short sums."""
    if len(W) <= 2 * SUM_ROWS:
        return Z.swapaxes(-1, -2) @ W
    blocks = -(-len(W) // SUM_ROWS)
    Z, W = (
        np.pad(x, [*[(0, 0)] * (x.ndim - 2), (0, blocks * SUM_ROWS - len(W)), (0, 0)])
        .reshape(*x.shape[:-2], blocks, SUM_ROWS, x.shape[-1])
        for x in (Z, W)
    )  # fmt: skip
    return (Z.swapaxes(-1, -2) @ W).sum(axis=-3)
