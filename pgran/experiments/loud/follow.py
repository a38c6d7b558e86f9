"""Along a branch of periodic states, by amplitude or by frequency, past its folds.

From the last two states the branch is taken to be a straight line. Where a wanted value of the
parameter is within a step, the state there is looked for; else, or where that fails, one on a
`Plane` across the branch, which has states where the parameter turns back, too.
"""

import numpy as np

from pgran.experiments.loud.newton import Plane, solved

WAY, CURVE = 1e-3, 1e-5  # of the field: how well states on the way are solved, and on planes
FEW = 2  # harmonics of states on the way
TURN, STRAIGHT = 0.8, 0.97  # cosines of angles between two steps: the largest, and of longer steps
FAR = 0.2  # of the field: how far a state may be from the straight line
POINTS = 400  # on a branch, at most
LEAST = 1e-5  # steps, in units of the longest
# Of the field against the parameter; the longest step, of the amplitude, of the whole range.
WEIGHT = {"amplitude": 1.0, "omega": 0.1}
LONGEST = {"amplitude": 3.0, "omega": 0.03}
PLAIN = {"amplitude": 0.01, "omega": np.inf}  # longer steps, in its units, need no plane
LOOKS, NEAR = 12, 1e-4  # for a fold, and parts of a step that it is found to


class Branch:
    """A branch of states of a balance, solved to a tolerance where a value is wanted.

    `folds` are the values of the parameter where it turned back so far.
    """

    def __init__(self, balance, parameter, tolerance, span=None):
        self.balance, self.parameter, self.tolerance = balance, parameter, tolerance
        self.span, self.folds = span, []

    def states(self, before, last, targets):
        """Yield the state at each value in their order, None where it is not reached.

        `before` and `last` are states on the branch, (field, value) each.
        """
        targets, points, forward = list(targets), 0, np.sign(last[1] - before[1])
        plane = self._plane(before, last)
        while targets and points < POINTS and plane.step > LEAST * self._longest(last):
            points += 1
            reach = (targets[0] - last[1]) / plane.rate
            here = 0 < reach <= plane.step * (1 + 1e-9)
            step = plane._replace(step=reach) if here else plane
            ahead = step.step * step.rate
            plain = here or ahead * forward > PLAIN[self.parameter] * abs(last[1])
            if plain:
                U = self._at(targets[0] if here else last[1] + ahead, step, not here)
            else:
                U = self._on(step)
            if U is None:
                plane = plane._replace(step=0.4 * step.step)
                continue
            found = U, getattr(self.balance, self.parameter)
            ahead = self._plane(last, found)
            turn = plane.height(self.balance, ahead.along, ahead.rate)
            if turn < TURN and step.step > 100 * LEAST * self._longest(last):
                plane = plane._replace(step=0.5 * step.step)
                continue
            if ahead.rate * plane.rate < 0:
                self.folds.append(self._fold([before, last, found]))
            while targets and forward * (found[1] - targets[0]) >= 0:
                part = (targets[0] - last[1]) / (found[1] - last[1])
                between = plane._replace(along=U - last[0], step=part)
                yield U if here else self._at(targets[0], between)
                targets.pop(0)
            growth = 2.0 if turn > STRAIGHT or plain else 1.0
            before, last = last, found
            plane = self._plane(before, last, growth * step.step)
        yield from (None for _ in targets)

    def _at(self, value, plane, on_way=False):
        """Return the state at a value of the parameter, from the line's end on, or None."""
        balance, guess = self.balance, plane.field + plane.step * plane.along
        setattr(balance, self.parameter, value)
        if on_way:
            full = balance.harmonics
            balance.resolve(min(FEW, full))
            U = solved(balance, guess[:, : balance.harmonics + 1].copy(), WAY)
            balance.resolve(full)
            U = U if U is None else balance.padded(U)
        else:
            U = solved(balance, guess, self.tolerance)
        near = U is not None and balance.norm(U - guess) <= FAR * balance.norm(U)
        return U if near else None

    def _on(self, plane, tolerance=CURVE, guess=None):
        """Return the state on a plane, or None; the parameter becomes that of the state."""
        setattr(self.balance, self.parameter, plane.value + plane.step * plane.rate)
        guess = plane.field + plane.step * plane.along if guess is None else guess
        return solved(self.balance, guess, tolerance, plane)

    def _longest(self, state):
        return LONGEST[self.parameter] * (self.span or abs(state[1]))

    def _plane(self, before, last, most=None):
        """Return the plane ahead of two states, as far as they are apart, or as is allowed."""
        scale, norm = self.span or abs(last[1]), self.balance.norm
        weight = WEIGHT[self.parameter] * (scale / norm(last[0])) ** 2
        dU, change = last[0] - before[0], last[1] - before[1]
        length = np.sqrt(weight * norm(dU) ** 2 + change**2)
        step = min(most or length, self._longest(last))
        return Plane(self.parameter, dU / length, change / length, weight, *last, step)

    def _fold(self, states):
        """Return the value of the parameter at a fold between three states on the branch.

        By parabolas through three values, along the line from the first state to the third.
        """
        plane = self._plane(states[0], states[2], 1.0)
        plane = plane._replace(field=states[0][0], value=states[0][1])
        s = [plane.height(self.balance, U - plane.field, p - plane.value) for U, p in states]
        for _ in range(LOOKS):
            a, b, c = np.polyfit(s, [p - plane.value for _, p in states], 2)
            top, best = -b / (2 * a), plane.value + c - b * b / (4 * a)
            guess = through(s, [U for U, _ in states], top)
            U = self._on(plane._replace(step=top), self.tolerance, guess)
            if U is None or min(abs(top - x) for x in s) < NEAR * s[2]:
                break
            # the fold is beside the state that is the farthest now
            s, states = [*s, top], [*states, (U, getattr(self.balance, self.parameter))]
            order = np.argsort(s)
            first = np.argmin([np.sign(a) * states[n][1] for n in order[1:-1]])
            kept = order[first : first + 3]
            s, states = [s[n] for n in kept], [states[n] for n in kept]
        return float(best)


def through(places, values, place):
    """Return the value at a place of the polynomial through values at others."""
    weights = [np.prod([(place - x) / (here - x) for x in places if x != here]) for here in places]
    return sum(weight * value for weight, value in zip(weights, values, strict=True))
