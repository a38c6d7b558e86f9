"""The slices of the spectrum that hold the wanted modes, and how many modes each has.

    lambda  ----|--------------|----------|-----------------|---->     lambda = m omega^2
    below       0              57        110               171         a `Cut` each
                 `--57 modes--' `---53---' `------61------'            a `Slice` each

For all modes, or those of an interval, counts come first: at its ends, then between them (`split`).

Modes nearest to a frequency are searched first. Their values tell where to count: in the widest
gaps that leave the wanted modes between them, one factorization each (`proven`).

    lambda  --x-|--x-o-oo-o---o-oo-|---x-->    o wanted, x found beside them, | a cut

With K - cut = L D L^T + E at either cut, |E|_2 <= eps, and m more negative pivots at the upper one,
let m of the modes found, X with R = K X - X W and |X^T X - 1|_F <= delta < 1, all lie farther than

    sqrt(2) |R|_F / sqrt(1 - delta)

inside (low + eps, high - eps). Then K has exactly m eigenvalues there: no more by the counts, and
no fewer, since to each value belongs an eigenvalue of its own within that distance (W. Kahan; see
G. W. Stewart and J. Sun, Matrix Perturbation Theory, section IV.4). Where that proves nothing, as
where modes are equal and a search misses some, counts widen an interval around the frequency until
it has the wanted modes (`around`).
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from pgran.driven.counting import ModeCounter
from pgran.driven.factors import RealFactors
from pgran.errors import PgranError
from pgran.medium.base import EPSILON
from pgran.run.agreement import agreeing

SLICE = 60  # modes that are computed together; measured for 40 x 40 and 100 x 100
MARGIN = 1e-11  # of |K|: how far the ends of an interval are moved outward
WIDE = 1e-8  # the same at most where an interval's ends are as good as any others nearby
CLOSE = 1e-4  # part of an interval: ends that near need not be told apart
ATTEMPTS = 40  # at an end, at an interval around a frequency, at cutting what is left
SPARE = 4  # modes that are searched for beyond those that are wanted
MORE = 1, 1.5, 2.25  # times as many are searched for until there are gaps beside the wanted ones
PLACES = (0.5, 0.36, 0.64)  # parts of a gap where it is counted, the next if one is no good
ROOM = 0.8  # part of the way to a gap's nearer side that eps may be


class Cut(NamedTuple):
    """A value of lambda that is clear of all eigenvalues, and how many of them lie below it."""

    shift: float
    below: int


class Search(NamedTuple):
    """Finds so many modes nearest to a value of lambda."""

    value: float
    wanted: int


class Slice(NamedTuple):
    """The modes between two cuts: their shifts, how many modes there are, what has found them."""

    low: float
    high: float
    count: int
    search: Search | None = None


def find_slices(solver, crew, wanted):
    """Return the slices of the spectrum that hold the wanted modes, as `pgran.find_modes` has them.

    Collective: the ranks share out the counts. From the lowest frequency 0 on modes include the
    unstable ones. In a dry run one slice amid the wanted modes stands for all, unless searches have
    found them. The `solver` has a K of this rank alone.
    """
    world, mass, count = crew.world, solver.lattice.mass, wanted.count
    with ModeCounter(solver.K, solver.lattice) as counter:
        if wanted.targets is None:
            low, high = wanted.interval or (0.0, np.inf)
            sides = [(mass * low**2, -1), (mass * high**2, 1)]
            intervals = [(*shared(world, sides, lambda side: end(counter, *side)), None)]
        else:
            targets = wanted.targets
            apart = 2 * len(targets) * count <= counter.order  # else they share modes
            search_first = apart and count <= SLICE and solver.by_default
            tried = targets[:: max(1, len(targets) // 3)] if crew.dry else targets

            def nearest_to(omega):
                found = proven(solver, omega, count) if search_first else None
                return found or (*around(counter, omega, mass, count), None)

            intervals = _united(shared(world, tried, nearest_to))
        if solver.type == "lapack":  # which needs no slices
            return _between([(low, high) for low, high, _ in intervals])
        if crew.dry and any(search is None for *_, search in intervals):
            return _like_one_slice(counter, intervals, mass)
        slices = []
        for low, high, search in intervals:
            pieces = _between([(low, high)]) if search else split(counter, (low, high), world)
            slices += [piece._replace(search=search) for piece in pieces]
        return slices


def proven(solver, omega, count):
    """Return cuts below and above the `count` modes nearest to omega, and the search for them.

    None where it is not proven that the search finds all modes between the cuts.
    """
    mass, norm, order = solver.lattice.mass, solver.norm, solver.lattice.size
    least = 0.0 if solver.lattice.semidefinite else -norm
    for more in MORE:
        search = Search(mass * omega**2, int(more * (count + SPARE)))
        found = solver.near(search) if 2 * search.wanted <= order else None
        if found is None:
            return None
        omegas = np.sign(found.values) * np.sqrt(np.abs(found.values) / mass)
        farthest = np.sort(np.abs(omegas - omega))[count - 1]
        sides = [mass * side * abs(side) for side in (omega - farthest, omega + farthest)]
        reach = np.abs(found.values - search.value).max()
        first, last = search.value - reach, search.value + reach
        if first <= least:  # the search has reached below all eigenvalues
            low = Cut(least - MARGIN * norm, 0)
        else:
            low = _cut_in_gap(solver.real, found.values, first, sides[0], 1)
        if last >= norm:
            high = Cut((1 + MARGIN) * norm, order)
        else:
            high = low and _cut_in_gap(solver.real, found.values, sides[1], last, -1)
        if low and high:
            return (low, high, search) if _is_complete(solver, found, low, high) else None
    return None


def _cut_in_gap(K, values, start, stop, side):
    """Return a cut in the widest gap between start and stop, moved inward by its error.

    `side` is 1 at an interval's lower end, -1 at its upper one. None where no count is certain.
    """
    inside = values[(values > start) & (values < stop)]
    edges = np.concatenate([[start], inside, [stop]])
    widest = np.argmax(np.diff(edges))
    start, width = edges[widest], edges[widest + 1] - edges[widest]
    for place in PLACES if width > 0 else ():
        shift = start + place * width
        try:
            factors = RealFactors(K, shift)
        except ZeroDivisionError:
            continue
        room = ROOM * min(place, 1 - place) * width
        error = factors.error(room)
        if error <= room:
            return Cut(shift + side * error, factors.negative)
    return None


def _is_complete(solver, modes, low, high):
    """Return whether the modes between two cuts are proven to be all eigenvalues there."""
    values, vectors, residuals = modes.within(low.shift, high.shift)
    if len(values) != high.below - low.below or not len(values):
        return not len(values) and high.below == low.below
    # What rounding adds: each entry of a product of n factors is off by less than n EPSILON / 2 of
    # the magnitudes that it is summed from.
    order, squares = vectors.shape[1], vectors @ vectors.T
    delta = np.linalg.norm(squares - np.eye(len(values)))
    delta += 1.01 * order * EPSILON * np.trace(squares)
    met = int(np.diff(solver.real.indptr).max())
    size = solver.norm + np.abs(values).max()
    rounding = (met + 3) * EPSILON * size * np.sqrt(order * np.trace(squares))
    radius = np.sqrt(2.0) * (solver.norm * np.linalg.norm(residuals) + rounding)
    if not delta < 1:
        return False
    radius /= np.sqrt(1 - delta)
    return low.shift < values.min() - radius and values.max() + radius < high.shift


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


def around(counter, omega, mass, wanted):
    """Return both ends of an interval around `omega` with `wanted` modes or a few more.

    It is symmetric in omega, so that the modes nearest to omega are in it. A reach too short and
    one too long are bisected, or less where the counts suggest a better one.
    """
    wanted = min(wanted, counter.order)
    few = wanted + max(4, wanted // 4)
    short, long, top = 0.0, np.inf, np.sqrt(counter.norm / mass)
    reach = top * wanted / counter.order
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


def split(counter, ends, comm):
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
    first, *middle, last = sorted(cuts)
    chosen = [first]
    for candidate, following in pairwise([*middle, last]):  # small neighbours are joined
        if following.below - chosen[-1].below > SLICE:
            chosen.append(candidate)
    return sorted(_between(pairwise([*chosen, last])), key=lambda piece: -piece.count)


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


def _united(intervals):
    """Return intervals with overlapping ones joined, whose modes no single search has found."""
    joined = []
    for low, high, search in sorted(intervals, key=lambda interval: interval[:2]):
        if joined and low <= joined[-1][1]:
            joined[-1] = joined[-1][0], max(joined[-1][1], high), None
        else:
            joined.append((low, high, search))
    return joined


def _like_one_slice(counter, intervals, mass):
    """Return as many slices as intervals need, all of them one that lies amid the first."""
    total = sum(high.below - low.below for low, high, _ in intervals)
    low, high = (min(max(ends.shift, 0.0), counter.norm) for ends in intervals[0][:2])
    omega = (0.5 * (low + high) / mass) ** 0.5
    pieces = []
    while total > 0:
        (piece,) = _between([around(counter, omega, mass, min(SLICE, total))])
        copies = max(1, total // piece.count)
        pieces += [piece] * copies
        total -= piece.count * copies
    return pieces
