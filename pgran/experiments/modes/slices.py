"""The spectrum cut by counts into slices that hold the wanted modes.

lambda  ----|--------------|----------|-----------------|---->     lambda = m omega^2
below       0              57        110               171         a `Cut` each
             `--57 modes--' `---53---' `------61------'            a slice each: (low, high, 57)
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from pgran.driven.counting import ModeCounter
from pgran.errors import PgranError
from pgran.experiments.modes.nearest import SPARE, Cut, Search
from pgran.experiments.modes.normal import eps_type
from pgran.run.agreement import agreeing

SLICE = 60  # modes that are computed together; measured for 40 x 40 and 100 x 100
MARGIN = 1e-11  # of |K|: how far the ends of an interval are moved outward
WIDE = 1e-8  # the same at most where an interval's ends are as good as any others nearby
CLOSE = 1e-4  # part of an interval: ends that near need not be told apart
ATTEMPTS = 40  # at an end, at an interval around a frequency, at cutting what is left


class Slice(NamedTuple):
    """The modes between two cuts: their shifts, how many modes there are, what has found them."""

    low: float
    high: float
    count: int
    search: Search | None = None


def find_slices(solver, crew, interval=None, targets=None, count=None):
    """Return the slices of the spectrum that hold the wanted modes, as `pgran.find_modes` has them.

    Collective: the ranks share out the counts. From the lowest frequency 0 on modes include the
    unstable ones. In a dry run one slice amid the wanted modes stands for all, unless searches have
    found them. The `solver` has a K of this rank alone.
    """
    world, mass = crew.world, solver.lattice.mass
    with ModeCounter(solver.K, solver.lattice) as counter:
        if targets is None:
            low, high = interval or (0.0, np.inf)
            sides = [(mass * low**2, -1), (mass * high**2, 1)]
            intervals = [(*shared(world, sides, lambda side: end(counter, *side)), None)]
        else:
            wanted = targets[:: max(1, len(targets) // 3)] if crew.dry else targets

            def nearest_to(omega):
                found = solver.interval(omega, count)
                if found is not None:
                    return found
                reach = _reach(solver, omega, mass, count) if counter.costly else None
                return (*around(counter, omega, mass, count, reach), None)

            intervals = _united(shared(world, wanted, nearest_to))
        searches = [search for *_, search in intervals]
        intervals = [ends for *ends, _ in intervals]
        if eps_type() == "lapack":  # which needs no slices
            return _between(intervals)
        if crew.dry and None in searches:
            return _like_one_slice(counter, intervals, mass)
        slices = []
        for ends, search in zip(intervals, searches, strict=True):
            pieces = cut(counter, ends, world) if search is None else _between([ends])
            slices += [piece._replace(search=search) for piece in pieces]
        return slices


def end(counter, shift, side, margin=MARGIN):
    """Return a cut at the lower end of an interval, `side` -1, or the upper one, 1, moved outward.

    So a mode at the end belongs to it. It is moved by a part of |K|, and on where another mode is
    too close for a certain count. Raises PgranError if no reliable count is found.
    """
    norm = counter.norm
    # 0 stands for the lowest frequency; unstable modes may be on both sides of less
    if side < 0 and shift <= 0 and (counter.semidefinite or not -norm < shift < 0):
        return Cut(-(margin if counter.semidefinite else 1 + margin) * norm, 0)
    if side > 0 and shift >= norm:
        return Cut((1 + margin) * norm, counter.order)
    margin *= norm
    for _ in range(ATTEMPTS):
        below = counter.below(shift + side * margin, 0.5 * margin)
        if below is not None:
            return Cut(shift + side * margin, below)
        margin *= 1.5
    raise PgranError(
        f"no reliable count of the modes below omega^2 m = {shift:g}: the factorization that "
        "-normal_count_pc_* chooses gives none"
    )


def around(counter, omega, mass, wanted, reach=None):
    """Return both ends of an interval around `omega` with `wanted` modes or a few more.

    It is symmetric in omega, so that the modes nearest to omega are in it; first it is tried to
    extend as far as `reach`. A reach too short and one too long are bisected, or less where the
    counts suggest a better one.
    """
    wanted = min(wanted, counter.order)
    few = wanted + max(4, wanted // 4)
    short, long, top = 0.0, np.inf, np.sqrt(counter.norm / mass)
    reach = reach or top * wanted / counter.order
    for _ in range(ATTEMPTS):
        first, last = omega - reach, omega + reach  # below 0: unstable
        lowest, highest = mass * first * abs(first), mass * last**2
        margin = np.clip(CLOSE * (highest - lowest) / counter.norm, MARGIN, WIDE)
        low, high = end(counter, lowest, -1, margin), end(counter, highest, 1, margin)
        inside = high.below - low.below
        if inside >= wanted:
            best, long = (low, high), reach
        else:
            short = reach
        if wanted <= inside <= few or long - short <= max(MARGIN * top, CLOSE * reach):
            break
        guess = reach * np.clip(0.5 * (wanted + few) / max(inside, 1), 0.125, 8.0)
        reach = guess if short < guess < long else 0.5 * (short + long)
    return best


def cut(counter, ends, comm):
    """Cut an interval into slices of about SLICE modes, the largest first; none is empty.

    Collective over `comm`, whose ranks share out the counts. All cuts keep clear of eigenvalues,
    and a cluster of equal ones stays in one slice however many they are.
    """
    # so far from all eigenvalues that slices are orthogonal to rounding
    clearance = counter.norm * min(max(0.1 / counter.order, 2e-6), 0.5 / counter.order)
    cuts = set(ends)
    for attempt in range(ATTEMPTS):
        shifts = []
        for low, high in pairwise(sorted(cuts)):
            count = high.below - low.below
            if count > 1.5 * SLICE and high.shift - low.shift > 4 * clearance:
                # more pieces at each attempt, so that a shift that failed is not tried again
                pieces = count // SLICE + 1 + attempt
                shifts += np.linspace(low.shift, high.shift, pieces + 1)[1:-1].tolist()
        if not shifts:
            break
        counts = shared(comm, shifts, lambda shift: counter.below(shift, clearance))
        cuts |= {Cut(*pair) for pair in zip(shifts, counts, strict=True) if pair[1] is not None}
    return _merged(sorted(cuts))


def shared(comm, items, work):
    """Return `work` of each item; the ranks share out the items, which all of them have.

    Collective. What one rank meets is raised on all.
    """
    with agreeing(comm):
        mine = [work(item) for item in items[comm.rank :: comm.size]]
    results = comm.allgather(mine)
    return [results[number % comm.size][number // comm.size] for number in range(len(items))]


def _between(pairs):
    """Return the slices between pairs of cuts, without the empty ones."""
    slices = [Slice(low.shift, high.shift, high.below - low.below) for low, high in pairs]
    return [piece for piece in slices if piece.count > 0]


def _merged(cuts):
    """Return the slices between cuts, neighbours joined where they are small."""
    first, *middle, last = cuts
    chosen = [first]
    for candidate, following in pairwise([*middle, last]):
        if following.below - chosen[-1].below > SLICE:
            chosen.append(candidate)
    return sorted(_between(pairwise([*chosen, last])), key=lambda piece: -piece.count)


def _united(intervals):
    """Return intervals with overlapping ones joined, whose modes no single search has found."""
    joined = []
    for low, high, search in sorted(intervals, key=lambda interval: interval[:2]):
        if joined and low <= joined[-1][1]:
            joined[-1] = joined[-1][0], max(joined[-1][1], high), None
        else:
            joined.append((low, high, search))
    return joined


def _reach(solver, omega, mass, count):
    """Return a distance from omega within which there seem to be `count` modes; None if unknown."""
    squares = solver.nearest(mass * omega**2, count + SPARE)
    omegas = np.sign(squares) * np.sqrt(np.abs(squares) / mass)
    apart = np.sort(np.abs(omegas - omega))[max(count - 1, 0) : count + SPARE]
    if len(apart) < 2:
        return None
    widest = np.argmax(np.diff(apart))  # there the count is the surest
    return 0.5 * (apart[widest] + apart[widest + 1])


def _like_one_slice(counter, intervals, mass):
    """Return as many slices as intervals need, all of them one that lies amid the first."""
    total = sum(high.below - low.below for low, high in intervals)
    low, high = (min(max(ends.shift, 0.0), counter.norm) for ends in intervals[0])
    omega = (0.5 * (low + high) / mass) ** 0.5
    pieces = []
    while total > 0:
        (piece,) = _between([around(counter, omega, mass, min(SLICE, total))])
        copies = max(1, total // piece.count)
        pieces += [piece] * copies
        total -= piece.count * copies
    return pieces
