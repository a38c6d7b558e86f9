"""Damped modes S(s) x = 0, S(s) = K + s C + s^2 m: what rings in a medium, and dies away.

A mode rings like exp(s t), s = -Gamma / 2 + i Omega. S is symmetric, so that left modes are right
ones, and with x^T (2 s m + C) x = 1 all modes together, those below the real axis too, make

    S(i omega)^-1 = sum x x^T / (i omega - s),    A_d = sum R_d / (i omega - s),

R_d = (e_d^T x) (x^T f(s)) the residue of a mode at a detector. LAPACK finds all modes, as those of

    [   0        1    ] [ x   ]       [ x   ]
    [ -K / m   -C / m ] [ s x ]  =  s [ s x ],

SLEPc's PEP (option prefix `damped_`) those near a target, by S(target)^-1.
"""

import contextlib

import numpy as np

from pgran.errors import InputError, PgranError
from pgran.experiments.modes import certain
from pgran.experiments.modes.record import DampedModes
from pgran.experiments.modes.shapes import least_frequency, participation
from pgran.medium.springs import drive_of, quadratic
from pgran.run.experiment import Caution
from pgran.run.machine import check_memory
from pgran.run.task import Task
from pgran.store.estimate import counted
from pgran.store.record import columns_of, row_of
from pgran.store.si import SI

COUNTED = 5000  # unknowns up to which modes are counted unasked
BYTES = 400  # of all modes and their discs, times the square of the unknowns
# Of the largest |s|: equal up to rounding; and of a mode's own what x^T (2 s m + C) x / 2 m is at
# most where modes have become one (at critical damping, at rest).
EQUAL, DEFECTIVE = 1e-12, 1e-6
SPARE, SPACE = 4, 3  # modes that are searched for beyond those wanted; vectors for each
MORE = 1, 2, 4, 8, 16  # times as many are searched for until enough are found
BESIDE = 1e-3, 1e-6  # from zero, as modes at rest make S(0) singular, and from other targets


class DampedSearch(Task):
    """The damped modes of a medium: all by `dense`, or by `eps` those near i times a target."""

    items = "modes"

    def __init__(self, medium, resonances, shapes, method, certificate, wanted):
        if not medium.dissipates:
            raise InputError("-modes_damped: nothing is damped here; leave it out")
        self.medium, self.resonances, self.wanted = medium, resonances, wanted
        scaled, self.stiffness = medium.in_own_unit()
        self.scaled, self.rate = scaled.in_own_time()
        self.system = quadratic(self.scaled)
        self.near = method == "eps"
        if certificate == "auto":
            certificate = "counted" if medium.size <= COUNTED or not self.near else "none"
        self.certificate = certificate if self.near or certificate == "none" else "discs"
        self.units = [wanted.count if self.near else medium.size]
        check_memory("modes_method", 0 if self.near else BYTES * medium.size**2)
        heard = resonances.driven and resonances.sites is not None
        without = ["residue"] * (not heard) + ["vector"] * (not shapes)
        lengths = {"balls": medium.shape, "detector_number": np.shape(resonances.sites)[:1]}
        columns = row_of(DampedModes, without, **lengths)
        self.row = np.dtype([("missing", int), ("known", "U8"), *columns])

    def length(self, unit):
        """See `Task`."""
        return unit

    def work(self, unit, group):
        """See `Task`."""
        K, C, m = self.system
        if self.near:
            target = 1j * self.wanted.targets[0] / self.rate
            s, X = nearest(self.scaled, target, self.wanted.count)
        else:
            s, X = companion(K, C, m)
        X, good = normalised(C, m, s, X)
        rows, size, CX = np.zeros(len(s), self.row), np.linalg.norm(X, axis=0), C @ X
        residual = np.linalg.norm(K @ X + s * CX + m * s**2 * X, axis=0)
        off = np.where(good, 2 * residual * size, DEFECTIVE * np.abs(s))  # to first order
        s = np.where(np.abs(s.imag) <= off, s.real, s)  # overdamped, as far as can be known
        rows["eigenvalue"] = self.rate * s
        radius, missing, known = self.certified(s, X)
        rows["radius"] = self.rate * radius
        rows["missing"], rows["known"] = missing or 0, known if missing is not None else ""
        largest, damped = (abs(matrix).sum(axis=1).max() for matrix in (K, C))
        largest = largest + np.abs(s) * damped + np.abs(s) ** 2 * m
        rows["residual"] = residual / (largest * size)
        both = np.abs(np.sum(X * (2 * m * s * X + CX), axis=0))
        rows["rigidity"] = good * both / (np.maximum(2 * np.abs(s), EQUAL) * m * size**2)
        fields = (np.abs(X) / size).T.reshape(-1, *self.medium.shape)
        rows["participation"] = participation(self.medium, fields)
        # of the medium itself, whose K, C and m have other units, and s too
        s, X = self.rate * s, np.where(good, X * np.sqrt(self.rate / self.stiffness), np.nan)
        if "residue" in self.row.names:
            heard = np.einsum("dw,dwn->nd", self.resonances.weights, X[self.resonances.unknowns])
            rest, dashpots = drive_of(self.medium)
            rows["residue"] = heard * (rest @ X + s * (dashpots @ X))[:, None]
        if "vector" in self.row.names:
            rows["vector"] = X.T.reshape(-1, *self.medium.shape)
        return rows[s.imag >= 0]

    def certified(self, s, X):
        """Return within which radii modes are proven, how many are missing, and how that is known.

        None are unknown.
        """
        radius = np.full(len(s), np.nan)
        if not self.near and self.certificate == "none":
            return radius, None, ""
        if not self.near:
            radius = certain.discs(*self.system, s, X)
            return radius, 0 if np.all(np.isfinite(radius)) else None, "discs"
        proven, centre = self.certificate == "proven", 1j * self.wanted.targets[0] / self.rate
        if proven:
            radius = certain.radii(*self.system, s, X)
        distance = np.abs(s - centre)
        wanted = np.sort(distance[s.imag >= 0])[: self.wanted.count]
        beyond = np.sort(distance[distance >= wanted[-1]])
        if len(beyond) < 2:
            return radius, None, ""
        gap = np.argmax(np.diff(beyond))  # the widest: there the count is the surest
        reach = 0.5 * (beyond[gap] + beyond[gap + 1])
        known, there = "below", None
        if not centre:
            there = certain.number_below(*self.system, reach)
        if there is None and self.certificate != "none":
            known = self.certificate
            there = certain.number_within(*self.system, centre, reach, proven)
        found = np.count_nonzero(distance < reach)
        return radius, None if there is None else there - found, known

    def collect(self, rows, seconds):
        """See `Task`; modes that are not asked for are left out."""
        missing, known = int(rows["missing"][0]), str(rows["known"][0])
        rows = rows[np.lexsort((-rows["eigenvalue"].real, rows["eigenvalue"].imag))]
        wanted = self.wanted.among(-1j * rows["eigenvalue"])
        return DampedModes(
            complete=self.medium.losses is None and not self.near and bool(wanted.all()),
            certificate=known or self.certificate,
            count_expected=np.count_nonzero(wanted) + missing,
            count_certified=bool(known) and missing == 0,
            solve_seconds=seconds,
            detector=self.resonances.sites,
            **columns_of(DampedModes, rows[wanted]),
        )


def companion(K, C, m):
    """Return all s, shape (2 n,), and x, a column each."""
    import scipy.linalg  # here: SciPy takes its time

    n = K.shape[0]
    unit = np.sqrt(abs(K).sum(axis=1).max() / m) or 1.0  # of s, which balances the blocks
    A = np.zeros((2 * n, 2 * n), K.dtype, order="F")
    A[:n, n:] = np.eye(n)
    A[n:, :n] = -K.toarray() / (m * unit**2)
    A[n:, n:] = -C.toarray() / (m * unit)
    s, V = scipy.linalg.eig(A, overwrite_a=True, check_finite=False)
    return unit * s + 0j, np.where(np.abs(s) > 1, V[n:], V[:n]) + 0j


def nearest(medium, target, count):
    """Return s and x, columns, of modes nearest to a target, `count` above the real axis and more.

    The medium is in its own unit and time. Raises PgranError if there is none.
    """
    from mpi4py import MPI

    from pgran.driven.operators import Operators

    aside = BESIDE[bool(target)]
    with Operators(medium, MPI.COMM_SELF) as operators:
        for more in MORE:  # mirrored ones take places, and small spaces may not converge
            wanted = min(more * (count + SPARE), medium.size)
            s, x = search(operators, target + aside * 1j, wanted)
            # beyond the farthest one others may be
            here = np.abs(s - target) <= np.abs(s - target - aside * 1j).max(initial=0.0) - aside
            enough = np.count_nonzero(here & (s.imag >= 0)) >= count + SPARE // 2
            if enough or wanted == medium.size:
                break
        s, x = (s[here], x[here]) if enough else (s, x)
        if not np.any(s.imag >= 0):
            raise PgranError(
                "SLEPc's PEP has found no damped mode: many at rest, of rattlers, may hide others "
                "(-network_rattlers remove); else -modes_target or -damped_pep_* choose otherwise"
            )
        return s, operators.layout.fields(x).reshape(len(s), -1).T


def search(operators, target, count):
    """Return s and x, a row each as PETSc numbers unknowns, of modes nearest to a target."""
    from pgran.driven.operators import SAME
    from pgran.experiments.modes.normal import SLEPc, invert, note_search
    from pgran.run.petsc import PETSc, logged, plain_errors

    K, lattice = operators.K, operators.lattice
    M, x, pep = K.duplicate(), K.createVecRight(), SLEPc.PEP().create(PETSc.COMM_SELF)
    M.setDiagonal(operators.M)
    C = M.duplicate() if operators.C is None else operators.C.copy()
    C.scale(operators.damping)
    with plain_errors(), contextlib.ExitStack() as held:
        for thing in (M, C, x, pep):
            held.callback(thing.destroy)
        for matrix in (K, C, M):  # complex symmetric, not Hermitian
            matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            matrix.setOption(PETSc.Mat.Option.HERMITIAN, False)
        pep.setOptionsPrefix("damped_")
        pep.setOperators([K, C, M])
        pep.setType("toar")
        pep.setTarget(target)
        pep.setWhichEigenpairs(SLEPc.PEP.Which.TARGET_MAGNITUDE)
        pep.setDimensions(count, min(SPACE * count, 2 * lattice.size))
        pep.setTolerances(1e-13, 200)
        invert(pep.getST(), lattice)
        pep.getST().setTransform(True)
        pep.getST().setMatStructure(SAME)
        pep.setFromOptions()
        x.setArray(np.random.Generator(np.random.Philox(0)).standard_normal(lattice.size))
        pep.setInitialSpace([x])
        logged("modes")(pep.solve)()
        note_search(pep)
        s, rows = np.empty(min(pep.getConverged(), 2 * count), complex), []
        for number in range(len(s)):
            s[number] = pep.getEigenpair(number, x)
            rows.append(x.getArray(readonly=True).copy())
        return s, np.reshape(rows, (len(s), lattice.size))


def normalised(C, m, s, X):
    """Return X with x^T (2 s m + C) x = 1 and x^T ((s + t) m + C) y = 0, and where that is so.

    Of modes that share an s solvers return any vectors x of their space. Of these G, the matrix of
    such products, is symmetric, and X G^(-1/2) is as it should be. Where G is singular to rounding
    modes have length 1 instead.
    """
    X = X / np.linalg.norm(X, axis=0)
    CX, good, largest = C @ X, np.ones(len(s), bool), np.abs(s).max()
    near = np.abs(s[:, None] - s) <= EQUAL * largest
    for first in np.unique(near.argmax(axis=1)):
        equal = np.flatnonzero(near[first])
        x, t = X[:, equal], s[equal]
        G = x.T @ CX[:, equal] + m * (t[:, None] + t) * (x.T @ x)
        least = max(DEFECTIVE * np.abs(t).max(), 1e2 * EQUAL * largest)
        good[equal] = np.linalg.svd(G, compute_uv=False)[-1] > 2 * m * least
        if good[first]:
            squares, V = np.linalg.eig(G)
            X[:, equal] = x @ (V / np.sqrt(squares)) @ np.linalg.inv(V)
    return X, good


def summary(result):
    """Yield in words what a run found."""
    modes, si, s = result.damped_modes, SI.of(result), result.damped_modes.eigenvalue
    words = f"{counted(len(s), 'damped mode')} in {modes.solve_seconds:.2f} s"
    yield f"{words}, backward errors at most {modes.residual.max(initial=0.0):.1e}"
    yield Caution(modes.exactness()) if modes.failures else modes.exactness()
    moving = np.abs(s) > least_frequency(result.medium.built)
    kinds = {
        "UNSTABLE: growing modes": moving & modes.growing & (not modes.failures),
        "overdamped modes, which do not ring": moving & (s.imag == 0),
        "defective modes, at rest or critically damped, without residues": modes.rigidity == 0,
    }
    for kind, such in kinds.items():
        if np.any(such):
            text = f"{kind}: {np.count_nonzero(such)}, one of them at s = {s[such][0]:.6g}"
            yield Caution(text) if "UNSTABLE" in kind else text
    rings = moving & (s.imag > 0) & (modes.rigidity > 0)
    facts = [("omega", "Hz"), ("width", "1/s"), ("quality |s| / width", ""), ("rigidity", "")]
    for fact, unit in facts if np.any(rings) else ():
        values = getattr(modes, fact.split()[0])[rings]  # no mean of two infinite ones
        low, middle, high = np.quantile(values, (0, 0.5, 1), method="inverted_cdf")
        in_si = si.say(unit, low, high) if unit else ""
        yield f"{fact}: {low:.4g} to {high:.4g}{in_si}, median {middle:.4g}"
