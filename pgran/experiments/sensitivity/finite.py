"""Amplitudes after finite changes of a few springs, exact, from one steady state.

With the rows U = B_J of r springs J whose kappa, what they pull with at s, change by Delta, A the
amplitudes before and z a detector's adjoint,

    A'_d = A_d - y^T Delta P^-1 t,    P = I + G Delta,    G = U S^-1 U^T,

t and y being how far A and z stretch these springs, what is driven counted in t. Nothing is
expanded: Delta may be as large as one likes.

Let Q be P^-1 as computed. If F = I - P Q, with what G is wrong by, is at most phi < 1, the true
P^-1 is Q (I - F)^-1, and with v = y^T Delta Q the last term is wrong by at most

    |v| (phi |t| + dt) / (1 - phi) + dy |Delta| |Q| (|t| + dt) / (1 - phi),

dt and dy bounding the errors of t and y in the 2-norm.

A warm ball expands and presses harder on its neighbours (paper: section 2, heater). Either the
constants of all its contacts grow by a factor; or the overlap h of each grows by dh, and by Hertz's
law F = c h^(3/2), of which k = (3/2) c h^(1/2) is the slope, k becomes sqrt(k^2 + (9/4) c^2 dh).
NumPy only.
"""

import numpy as np

from pgran.errors import InputError
from pgran.medium.base import EPSILON


def changed_amplitudes(before, stretched, flexibility, delta):
    """Return the amplitudes after each of many changes, one at a time, and their bounds.

    `before` are the amplitudes without any change and their bounds (nd,); `stretched` t (count, r)
    and its rows' errors (count,), y (nd, count, r) and its rows' errors (nd, count); `flexibility`
    G (count, r, r) and its errors in Frobenius' norm (count,). `delta`, shape (count, r), is zero
    for springs that only fill up a row. Both results have the shape (nd, count), and a bound is
    infinite where P is singular but for rounding.
    """
    (amplitude, amplitude_bound), (G, G_error) = before, flexibility
    t, t_error, y, y_error = stretched
    r, one = delta.shape[-1], np.eye(delta.shape[-1])
    with np.errstate(all="ignore"):
        P = one + G * delta[:, None, :]
        Q, possible = _inverses(P)
        sizes = np.abs(Q)
        rounding = (2 * r + 12) * EPSILON * (_norm(P) + np.sqrt(r)) * _norm(sizes)
        # phi, then the two terms of the bound above
        missed = _norm(one - P @ Q) + rounding + 1.01 * G_error * _norm(delta[:, :, None] * Q)
        v = np.einsum("dnr,nrq->dnq", y * delta, Q)
        after = amplitude[:, None] - np.einsum("dnq,nq->dn", v, t)
        amplified = 1.01 / (1 - missed)
        sizes_t = np.linalg.norm(t, axis=-1)
        theory = np.linalg.norm(v, axis=-1) * (missed * sizes_t + t_error)
        theory += y_error * np.abs(delta).max(axis=-1) * _norm(sizes) * (sizes_t + t_error)
        terms = np.einsum("dnr,nrq,nq->dn", np.abs(y * delta), sizes, np.abs(t))
        bound = amplitude_bound[:, None] + amplified * theory
        bound += 1.01 * EPSILON * ((2 * r + 12) * terms + 4 * np.abs(after))
        bound[:, ~((missed < 1) & possible)] = np.inf
        bound[np.isnan(bound)] = np.inf
    return after, bound


def _norm(matrices):
    """Return the Frobenius norm of each matrix."""
    return np.linalg.norm(matrices, axis=(-2, -1))


def _inverses(P):
    """Return the inverse of each matrix, and which ones have one."""
    try:
        return np.linalg.inv(P), np.ones(len(P), dtype=bool)
    except np.linalg.LinAlgError:  # NumPy gives up all if one is singular
        inverses, possible = np.zeros_like(P), np.linalg.slogdet(P)[0] != 0
        inverses[possible] = np.linalg.inv(P[possible])
        return inverses, possible


def contacts_of(medium, balls):
    """Return the contacts of some free balls, by their numbers, a row each; -1 fills rows up."""
    columns = medium.springs.columns[: medium.bonds].reshape(medium.bonds, 2, -1)
    ends = columns.max(axis=2).ravel() // medium.components  # -1 where a ball is held
    # Sorted, the ends at one ball stand side by side; end number e is of the contact e // 2.
    order = np.argsort(ends, kind="stable")
    first, last = np.searchsorted(ends[order], [balls, balls + 1])
    place = first[:, None] + np.arange(max((last - first).max(initial=0), 1))
    inside = place < last[:, None]
    return np.where(inside, order[np.where(inside, place, 0)] // 2, -1)


def stiffer_by_overlap(medium, overlap, hertz):
    """Return how far the constants of all springs grow with the overlaps, shape (blocks, contacts).

    A contact that opens has no stiffness left; tangential springs grow by the same part. `overlap`
    is dh, one for all contacts or one each; `hertz` is c, unless a network knows the forces, from
    which c follows contact by contact, or its contact law as well. Raises an InputError where the
    law gives no such contact.
    """
    elastic = medium.springs.elastic.reshape(-1, medium.bonds)
    k, force = elastic[0], getattr(medium, "force", None)
    lawless = k < 0
    if force is not None:
        lawless |= (k > 0) & (force <= 0)
    if np.any(lawless):
        raise InputError(
            f"-heat_overlap, -heat_radius: contact {np.argmax(lawless)} of the network has a "
            "negative constant, or no repulsive force: no contact law has it; use -heat_factor"
        )
    if force is not None and medium.power is not None:
        nearer = np.maximum(1 + overlap / medium.overlap, 0.0)  # in units of the overlap
        growth = np.where(nearer > 0, k * nearer ** (medium.power - 1), 0.0) - k
    else:
        squared = 2.25 * hertz**2  # (9/4) c^2
        if force is not None:  # k^2 / h, h = (3/2) F / k
            squared = np.divide(k**3, 1.5 * force, out=np.zeros_like(k), where=force > 0)
        growth = np.sqrt(np.maximum(k * k + squared * overlap, 0.0)) - k
    part = np.divide(growth, k, out=np.zeros_like(k), where=k != 0)
    return np.concatenate([growth[None], elastic[1:] * part])


def changes(medium, contacts, growth):
    """Return the springs of groups of contacts, and how far their constants change.

    Contacts have the shape (count, c), `growth` of their springs (blocks, count, c); springs and
    changes (count, r). -1 fills up, and stands for springs that do not change.
    """
    delta = np.where(contacts >= 0, growth, 0.0)
    blocks = delta.any(axis=(1, 2)) | (np.arange(len(delta)) == 0)
    springs = contacts + medium.bonds * np.arange(len(delta))[:, None, None]
    springs = np.where(delta != 0, springs, -1)
    return np.concatenate(springs[blocks], axis=1), np.concatenate(delta[blocks], axis=1)


def cuts(medium, s):
    """Return the springs of each contact, and what its being cut takes away at the drive s.

    Its dashpots, too. As `changes` does; what is zero at one s > 0 is so at any other one.
    """
    constants = medium.kappa(s)
    springs = np.arange(len(constants)).reshape(-1, medium.bonds).T
    delta = -constants[springs]
    return np.where(delta != 0, springs, -1), delta


class Flexibility:
    """The matrices G of many small groups of springs, at any frequency.

    Each unknown at these springs is solved for once, however many groups it is in. With b_j, the
    w entries of B of spring j, and L(i, u), how far x = S^-1 e_u stretches spring i,

        G_ij = sum over the unknowns u of spring j of L(i, u) b_j(u).

    `groups`, shape (count, r), are numbers of springs; -1 fills up a row.
    """

    def __init__(self, operators, groups):
        self.operators, self.groups, layout = operators, groups, operators.layout
        self._there = groups >= 0
        # `place` (count, r) is where a spring of a group stands among all `springs`, each once;
        # `number` (count, r, w) is where an unknown of that spring stands among all `unknowns`.
        # Both lists may begin with -1, which is none.
        self.springs, place = np.unique(groups, return_inverse=True)
        self._place = place.reshape(groups.shape)
        ends = np.where(self._there[..., None], layout.ends[groups], -1)
        self._unknowns, number = np.unique(ends, return_inverse=True)
        self._number = number.reshape(ends.shape)
        entries = layout.entries[groups if len(layout.entries) > 1 else 0 * groups]
        self._entries = np.where(ends >= 0, entries, 0.0)
        self._size = np.linalg.norm(np.linalg.norm(self._entries, axis=-1), axis=1)  # |U|

    def stretched(self, fields, errors):
        """Return how far fields stretch the springs of each group, and bounds of the errors.

        Fields, this rank's rows, shape (rows, 1 + nd), are the amplitudes, with which the drive
        moves, then the adjoints; `errors`, shape (1 + nd,), bound theirs in the 2-norm. Collective.
        Returns what `changed_amplitudes` takes.
        """
        springs = self.operators.lattice.springs
        stretch = self.operators.stretch(fields, np.maximum(self.springs, 0)).T
        stretch[0] += springs.drive[self.springs]
        stretch = np.where(self._there, stretch[:, self._place], 0.0)
        lengths = np.where(self._there, springs.lengths[self.groups], 0.0)
        bounds = 1.01 * errors[:, None] * np.linalg.norm(lengths, axis=1)
        bounds += 4 * EPSILON * np.linalg.norm(stretch, axis=2)
        return stretch[0], bounds[0], stretch[1:], bounds[1:]

    def matrices(self, columns):
        """Return G for each group, and a bound of its error in Frobenius' norm.

        Collective. `columns`, a `BlockSolver`, are of a solver with these operators, for whose S
        the bounds are prepared. G, shape (count, r, r), is zero in rows and columns that only fill
        up.
        """
        bounds, (count, r, width) = columns.solver.bounds, self._number.shape
        stretches = np.zeros((count, r, r, width), dtype=complex)  # L(i, u) of each i, j, u
        errors = np.zeros(len(self._unknowns))  # bounds of those of S^-1 e_u
        known = self.springs >= 0
        start = np.count_nonzero(self._unknowns < 0)
        solved = columns.solved(self._unknowns[start:], self._unit_vectors, 1.0)
        for unknowns, solutions, norms, residuals in solved:  # some columns of L at a time
            stop = start + len(unknowns)
            L = np.zeros((len(self.springs), len(unknowns)), dtype=complex)
            L[known] = self.operators.stretch(solutions, self.springs[known])
            p, j, u = np.nonzero((self._number >= start) & (self._number < stop))
            column = self._number[p, j, u] - start
            stretches[p, :, j, u] = L[self._place[p], column[:, None]]
            errors[start:stop] = residuals * bounds.inverse_norm + (width + 2) * EPSILON * norms
            start = stop
        G = np.einsum("pije,pje->pij", stretches, self._entries)
        across = np.einsum("pje,pje->pj", np.abs(self._entries), errors[self._number])
        error = 1.01 * self._size * np.linalg.norm(across, axis=1)
        # what rounds while the parts of a column are summed up
        size = np.einsum("pije,pje->pij", np.abs(stretches), np.abs(self._entries))
        error += (width + 4) * EPSILON * np.linalg.norm(size, axis=(1, 2))
        return G, error

    def _unit_vectors(self, unknowns, columns):
        """Set columns to the unit vectors of unknowns, as far as they lie in this rank's rows."""
        first, last = self.operators.first, self.operators.last
        columns[:] = 0.0
        mine = np.flatnonzero((unknowns >= first) & (unknowns < last))
        columns[unknowns[mine] - first, mine] = 1.0
