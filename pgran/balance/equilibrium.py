"""Balls under a contact law come to rest: Newton's method on their energy.

Its matrix is made positive definite by a shift where its pivots are not, steps are halved until the
enthalpy falls (`motion`), and end before a ball could meet one that is not in the list of pairs,
which is then made anew. No search on |force| does this: its least value, 0, is also that of balls
that have flown apart.
"""

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from pgran.balance.motion import Balls, Contacts, Motion, listed
from pgran.errors import PgranError
from pgran.medium.graph import loose_balls
from pgran.medium.springs import SYMMETRIC

BALANCED = 1e-12  # of the mean force: the largest force that is left on a ball
UNDECIDED_FORCE = 1e-11  # of the mean force: what bears less may be open, or bear rounding
PATIENCE = 4  # steps in a row that lower neither the energy, beyond its rounding, nor the forces
STEPS, ROUNDS = 100, 40  # of Newton's method with one list of pairs, and lists
LEAST_SHIFT = 1e-10  # of the mean diagonal of K: what is less is rounding
SADDLE_PIVOT = 1e-10  # of the mean diagonal: how negative a pivot is that counts
SOLVE_COST = 20  # multiplications of a factorization that take as long as an entry of a solve
FEWEST_SOLVES = 20  # solves that a factorization must cost, or it is not kept
INEXACT = 1e-6  # the part of a step that conjugate gradients leave out


class NotBalancedError(PgranError):
    """Balls found no rest."""


class Rest(NamedTuple):
    """Balls at rest: where and with which contacts, and how they came there.

    `residual` is the largest force left on a ball in units of the mean one; `undecided` counts the
    contacts, and balls that these alone hold, that the balance cannot tell from open ones.
    """

    balls: Balls
    contacts: Contacts
    residual: float
    factorizations: int
    undecided: int = 0

    @property
    def bearing(self):
        """Which contacts bear a force for certain."""
        force = self.balls.law.force(self.contacts.constants, self.contacts.overlap)
        return force > UNDECIDED_FORCE * force[force > 0].mean()

    @property
    def saddle(self):
        """Whether the energy is least in no neighbourhood; it takes a factorization."""
        motion = Motion(self.balls, self.contacts)
        K, _, _ = motion.matrix(motion.state(np.zeros(self.balls.position.shape), 0.0))
        factors = factored(K)
        lowest = 0.0 if factors is None else factors.U.diagonal().min()  # singular: some float
        return bool(lowest < -SADDLE_PIVOT * K.diagonal().mean())


def at_rest(balls, contacts=None, pressure=None, tolerance=BALANCED):
    """Return balls at rest, as a `Rest`, from where they are; contacts open and close.

    `contacts` are those that are known more exactly than positions say; with a `pressure` a
    periodic box finds its size. Raises NotBalancedError where they find no rest.
    """
    factorizations = 0
    for _ in range(ROUNDS):
        reach = reach_of(balls, contacts)
        contacts = listed(balls, contacts, reach=reach)
        motion = Motion(balls, contacts, pressure)
        state, residual, counted = newton(motion, reach, tolerance)
        factorizations += counted
        larger = math.exp(state.growth)
        position = (balls.position + state.u) * larger
        balls = dataclasses.replace(balls, position=position, box=balls.box * larger)
        away = state.normal * state.distance[:, None]
        contacts = dataclasses.replace(contacts, away=away, overlap=state.overlap)
        if residual < tolerance:
            return Rest(balls, contacts, residual, factorizations)
        if not has_moved_far(state, reach):
            raise NotBalancedError(
                f"the balls find no rest: {residual:.1e} of the mean force is left on one of them"
            )
    raise NotBalancedError(f"the balls still move after {ROUNDS} lists of neighbours")


def without_rattlers(rest):
    """Return a rest without the contacts of balls that bear no force for certain.

    These balls stay where they are, and the others find their rest without them. Fewer than d + 1
    contacts in d dimensions hold no ball, so that such a one does not count as undecided.
    """
    pairs, balls, bearing = rest.contacts.pairs, rest.balls, rest.bearing
    pressed = rest.contacts.overlap > 0
    carrying = np.isin(np.arange(len(balls.held)), pairs[bearing])
    between, others = carrying[pairs].all(axis=1), balls.held | carrying
    wedged = ~(others | loose_balls(pairs[pressed], others, balls.position.shape[1] + 1))
    felt = others[pairs].all(axis=1) & carrying[pairs].any(axis=1)  # held rattlers are obstacles
    undecided = np.count_nonzero(wedged) + np.count_nonzero(pressed & felt & ~bearing)
    rest = rest._replace(undecided=undecided)
    if np.all(between[pressed]):
        return rest
    numbers, contacts = np.flatnonzero(carrying), rest.contacts.of(between)
    own = dataclasses.replace(contacts, pairs=np.searchsorted(numbers, contacts.pairs))
    found = at_rest(balls.of(numbers), own)
    position = balls.position.copy()
    position[numbers] = found.balls.position
    return Rest(
        dataclasses.replace(balls, position=position),
        dataclasses.replace(found.contacts, pairs=numbers[found.contacts.pairs]),
        found.residual,
        rest.factorizations + found.factorizations,
        undecided,
    )


def reach_of(balls, contacts):
    """Return how wide a gap may be between balls that are listed: some overlaps, no more."""
    overlap = np.zeros(0) if contacts is None else contacts.overlap[contacts.overlap > 0]
    size = 2 * float(np.mean(balls.radius))
    return min(max(10 * overlap.mean(), 2e-3 * size), 0.1 * size) if overlap.size else 0.02 * size


def newton(motion, reach, tolerance):
    """Return the state of least residual, the residual, and the number of factorizations.

    It ends at rest, where `PATIENCE` steps make it no better, or, with the last state, where balls
    have moved so far that the pairs nearer than `reach` are no longer all that could touch.
    """
    state, kept = motion.state(np.zeros((len(motion.number), motion.size)), 0.0), Factors()
    best, least, shift, stalled, factorizations = state, math.inf, 0.0, 0, 0
    for _ in range(STEPS):
        if not np.any(state.force > 0):
            raise NotBalancedError("the balls have flown apart: no contact is left")
        forces, swelling = motion.forces(state)
        residual = motion.residual(state, forces, swelling)
        if residual < least:
            best, least, stalled = state, residual, 0
        if has_moved_far(state, reach):
            return state, residual, factorizations
        if residual < tolerance or stalled > PATIENCE:
            break
        step, swell, shift, tried = direction(motion, state, forces, swelling, shift, kept)
        factorizations += tried
        slope = np.sum(forces * step[motion.free]) + swelling * swell
        part = min(1.0, 0.2 * reach / max(np.abs(step).max(), 1.5 * abs(swell), 1e-300))
        part, state, rounds = shortened(motion, state, step, swell, slope, part)
        stalled = stalled + 1 if rounds else 0
        if part < 0.1:
            shift = max(4 * shift, LEAST_SHIFT)
        elif part == 1:
            shift = shift / 10 if shift > 10 * LEAST_SHIFT else 0.0
    return best, least, factorizations


def has_moved_far(state, reach):
    """Return whether balls may touch by now that were not nearer than `reach`."""
    return np.abs(state.u).max(initial=0.0) + 1.5 * abs(state.growth) > reach / 2


def direction(motion, state, forces, swelling, shift, kept):
    """Return a step downhill (N, d) and of eps, the shift it took, and the factorizations.

    `shift` is in units of the mean diagonal; it grows until K and the border are positive definite.
    Factors that are `kept` may do without another factorization.
    """
    from scipy.sparse import identity

    K, border, corner = motion.matrix(state)
    mean, tried = K.diagonal().mean(), 0
    one = identity(K.shape[0], format="csc")
    if border is None:
        step = kept.solve(K + shift * mean * one, forces.ravel())
        if step is not None:
            return motion.of_all(step), 0.0, shift, 0
    while shift < 1:
        factors = factored(K + shift * mean * one)
        tried += 1
        if factors is not None and np.all(factors.U.diagonal() > 0):
            step, swell, last = factors.solve(forces.ravel()), 0.0, 1.0
            if border is None:
                kept.keep(factors)
            else:
                turned = factors.solve(border)
                last = corner - border @ turned  # what is left of the last pivot
                swell = (swelling - border @ step) / last
                step = step - swell * turned
            if last > 0:
                return motion.of_all(step), swell, shift, tried
        shift = max(4 * shift, LEAST_SHIFT)
    raise NotBalancedError("the packing has lost its rigidity: no shift makes its matrix definite")


def shortened(motion, state, step, swell, slope, part):
    """Return a part of a step that leads downhill, the state there, and if H rounds.

    `slope` is how steeply H falls. Where it falls by less than its rounding, it is enough that its
    slope does not turn.
    """
    energy = np.sum(state.work)
    if motion.pressure is not None:
        energy += motion.pressure * motion.volume
    while True:
        ahead = motion.state(state.u + part * step, state.growth + part * swell)
        rounds = part * slope <= 1e-11 * energy
        if rounds:
            forces, swelling = motion.forces(ahead)
            downhill = np.sum(forces * step[motion.free]) + swelling * swell >= -0.9 * slope
        else:
            change = motion.enthalpy_change(state, ahead, part * step)
            downhill = change <= -1e-4 * part * slope
        if downhill or part < 1e-9:
            return part, ahead, rounds
        part /= 2


def factored(K):
    """Return the factors of a symmetric matrix in SuperLU's symmetric mode, None if singular."""
    from scipy.sparse.linalg import splu  # here: SciPy takes its time

    try:
        return splu(K, "MMD_AT_PLUS_A", **SYMMETRIC)
    except RuntimeError:
        return None


class Factors:
    """Factors of the last matrix that was factored, which solve with others near it, too.

    Where a step opens or closes a few contacts, seven or so solves do. In three dimensions the time
    of a factorization grows like N^2: of 5000 spheres it is that of 50 solves. Where it is that of
    `FEWEST_SOLVES` or less, factors are not kept.
    """

    def __init__(self):
        self.factors, self.solves = None, 0

    def keep(self, factors):
        """Keep factors, if they are worth it."""
        lengths = np.diff(factors.L.indptr).astype(float)
        self.solves = int(lengths @ lengths / (SOLVE_COST * lengths.sum()))
        self.factors = factors if self.solves >= FEWEST_SOLVES else None

    def solve(self, K, right):
        """Return x of K x = right by conjugate gradients, None where factoring K is cheaper.

        None, too, where K is seen not to be positive definite. In any case x leads downhill.
        """
        if self.factors is None:
            return None
        x, residual = np.zeros_like(right), right.copy()
        along = near = self.factors.solve(residual)
        size = first = residual @ near
        for _ in range(self.solves):
            product = K @ along
            curvature = along @ product
            if not curvature > 0:
                break
            x += size / curvature * along
            residual -= size / curvature * product
            near = self.factors.solve(residual)
            before, size = size, residual @ near
            if size <= INEXACT**2 * first:
                return x
            along = near + size / before * along
        self.factors = None
        return None
