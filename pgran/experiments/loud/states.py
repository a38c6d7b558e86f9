"""The states of a medium at all frequencies and amplitudes, as a task."""

import contextlib

import numpy as np

from pgran.errors import InputError
from pgran.experiments.loud.contacts import contacts_of
from pgran.experiments.loud.measures import measured, read
from pgran.experiments.loud.record import FOLDS, Loud
from pgran.medium.base import check_frequency
from pgran.medium.overlaps import overlaps_of
from pgran.run.agreement import on_root
from pgran.run.machine import check_memory
from pgran.run.task import Task
from pgran.store.record import columns_of, row_of

GOOD, MISSED, MISSING = 1, 0, -1  # reasons of states
LINEAR = 1e-7  # accuracy asked of linear fields, which new factors exceed by far
DOUBLED = 3  # times that harmonics and samples are doubled for the accuracy asked for
SOLVED, LEAST = 1e-4, 1e-11  # of the accuracy asked for, and of a field: how well it is solved
ESTIMATED = 0.05  # to which part the Newton step that tells the error is solved
NEAR = 1e-3  # of the range, or of the frequency: how far before the first one a branch starts
NEARLY = 0.3  # of what opens a hundredth of the contacts: where ladders start at most
UNTRIED = -1  # a proof
CERTIFICATE = "certificate", "certificate_bound", "certificate_radius"
PROVEN = 16  # harmonics, at least, of the motion near which a state is proven
SOFTER, TRIES = 4, 6  # by how much, how often, a first amplitude is reduced that is too large


class LoudStates(Task):
    """Periodic states; a unit is a frequency with its ladder of amplitudes.

    Or an amplitude with all frequencies, up or down, where these are followed.
    """

    items = "states"

    def __init__(
        self, lattice, omegas, detectors, amplitudes, choices, stability, certificate, tolerance
    ):
        self.lattice, self.omegas, self.choices = lattice, np.asarray(omegas), choices
        self.stability, self.certificate, self.tolerance = stability, certificate, tolerance
        self.solved = max(SOLVED * tolerance, LEAST)
        self.harmonics, self.swept = choices["harmonics"], choices["follow"] == "frequency"
        if self.swept and (choices["unit"] == "opening" or len(omegas) < 2):
            raise InputError(
                "-loud_follow frequency: takes two frequencies at least, and amplitudes that are "
                "the same at all of them, -loud_unit overlap or length"
            )
        self.scaled, self.unit = lattice.in_own_unit()
        self.contacts = contacts_of(self.scaled, choices["reach"])
        self.sites = lattice.sites(detectors)
        check_frequency(self.scaled, (self.harmonics << 1 + DOUBLED) * self.omegas[-1])
        self.overlaps = overlaps_of(self.scaled)
        self.overlap = float(self.overlaps.overlap.mean())
        self.amplitudes, self.directions = np.asarray(amplitudes), ["rising"] * len(amplitudes)
        self.shape = len(omegas), len(amplitudes)
        if self.swept:
            self.amplitudes = np.repeat(amplitudes, 2)
            self.directions = ["up", "down"] * len(amplitudes)
            self.shape = len(self.amplitudes), len(omegas)
        lengths = {"detector_number": len(self.sites), "harmonic_number": self.harmonics + 1}
        lengths |= {"contact_number": len(self.overlaps.contact), "fold_number": FOLDS}
        without = () if certificate else CERTIFICATE
        lengths = {name: (n,) for name, n in lengths.items()}
        row = row_of(Loud, without, amplitude=(), **lengths)
        self.row = np.dtype([*row, ("opening", float, (2,)), ("opening_part", float, (2,))])
        check_memory("loud_amplitudes", np.prod(self.shape) * self.row.itemsize)
        count, inner = self.shape
        self.units = [range(n * inner, (n + 1) * inner) for n in range(count)]

    @contextlib.contextmanager
    def open(self, group):
        """See `Task`."""
        from pgran.driven.opening import Openings
        from pgran.driven.operators import Operators
        from pgran.driven.steady import SteadySolver
        from pgran.experiments.loud.balance import Balance

        steady = {"error_tolerance": max(self.tolerance, LINEAR), "whole_field": True}
        with (
            Operators(self.scaled, group) as operators,
            SteadySolver(operators, self.sites, **steady) as solver,
            Balance(operators, self.contacts, self.harmonics) as balance,
        ):
            openings = Openings(operators, self.overlaps)

            def linear(omega):
                """Return the linear field, None if it fails, and what it opens contacts at."""
                solver.restart()  # new factors: the field is as good as they can make it
                if solver.solve(1j * omega).converged_reason <= 0:
                    return None, (np.full(2, np.nan), np.full(2, np.nan), -1)
                field = solver.field.getArray().copy()
                return field, openings.at(solver.field, solver.bounds.field_error)

            yield lambda unit: self._work(unit, balance, linear)

    def _work(self, unit, balance, linear):
        """Return the rows of a unit, or of its first states."""
        place, rows = unit.start // self.shape[1], np.zeros(len(unit), self.row)
        omegas, amplitudes = self.omegas[[place % len(self.omegas)]], self.amplitudes[: len(unit)]
        if self.swept:
            amplitudes, omegas = self.amplitudes[[place]], self.omegas
            omegas = omegas[:: 1 if self.directions[place] == "up" else -1][: len(unit)]
        fields, openings = zip(*map(linear, omegas), strict=True)
        scale = {"length": 1.0, "overlap": self.overlap, "opening": openings[0][0][0]}
        amplitudes = scale[self.choices["unit"]] * amplitudes
        for name in self.row.names:
            if self.row[name].base.kind in "fc":
                rows[name] = np.nan
        rows["converged_reason"], rows["drive"] = MISSING, amplitudes
        if self.certificate:
            rows["certificate"] = UNTRIED
        rows["opening"], rows["opening_part"] = ([x[n] for x in openings] for n in (0, 1))
        done = balance.products, balance.factorizations
        known = fields[0] is not None
        found = self._states(balance, omegas, amplitudes, fields[0], openings[0]) if known else ()
        for row, field, (U, folds) in zip(rows, fields * len(rows), found, strict=False):
            if U is not None and field is not None:
                row["folds"], row["fold"][: len(folds)] = len(folds), folds[:FOLDS]
                self._keep(row, balance, U, field)
            now = balance.products, balance.factorizations
            row["products"], row["factorizations"] = np.subtract(now, done)
            done = now
        return rows if not self.swept or self.directions[place] == "up" else rows[::-1]

    def _states(self, balance, omegas, amplitudes, field, opening):
        """Yield the states along a unit, None where none is reached, and the folds before each."""
        from pgran.experiments.loud.follow import Branch
        from pgran.experiments.loud.newton import solved

        balance.omega = omegas[0]
        balance.factor(False)
        ladder = self._ladder(balance, amplitudes, field, opening)
        if not self.swept:
            yield from ladder
            return
        U, _ = next(ladder, (None, None))
        yield U, []
        step = NEAR * (omegas[-1] - omegas[0])
        balance.omega = omegas[0] - np.sign(step) * min(abs(step), NEAR * omegas[0])
        before = None if U is None else solved(balance, U, self.solved)
        if before is None:
            return
        branch = Branch(balance, "omega", self.solved, abs(omegas[-1] - omegas[0]))
        ends = (before, balance.omega), (U, omegas[0])
        for state in branch.states(*ends, omegas[1:]):
            yield state, list(branch.folds)

    def _ladder(self, balance, amplitudes, field, opening):
        """Yield the states at increasing amplitudes, as `_states`."""
        from pgran.experiments.loud.follow import Branch
        from pgran.experiments.loud.newton import solved

        # below what opens a contact states are near the linear field, or are that itself
        quiet = amplitudes[amplitudes <= opening[0][0]]
        for amplitude in [*quiet] or [min(amplitudes[0], NEARLY * opening[1][0])]:
            for balance.amplitude in amplitude / SOFTER ** np.arange(TRIES):
                guess = balance.padded(balance.amplitude * field[:, None], 1)
                U = solved(balance, guess, self.solved)
                if U is not None:
                    break
            else:
                return
            first = balance.amplitude
            if first in amplitudes:
                yield U, []
        branch = Branch(balance, "amplitude", self.solved)
        ends = (-2 * U, -2 * first), (U, first)
        for state in branch.states(*ends, amplitudes[amplitudes > first]):
            yield state, list(branch.folds)

    def _keep(self, row, balance, U, field):
        """Put into a row what is wanted of a state, once it is as accurate as asked, if ever."""
        from pgran.experiments.loud.newton import newton_step, solved

        shown = slice(self.harmonics + 1)
        for doubling in range(DOUBLED + 1):
            row["harmonics"], row["samples"] = balance.harmonics, balance.samples
            balance.resolve(2 * balance.harmonics)
            U = balance.padded(U)
            works = balance.factor()
            step = newton_step(balance, U, ESTIMATED)[0] if works else None
            row["harmonic"] = read(balance, U, self.sites)[:, shown]
            if step is not None:
                row["harmonic_error"] = np.abs(read(balance, step, self.sites)[:, shown])
            good = np.all(row["harmonic_error"] <= self.tolerance * np.abs(row["harmonic"][:, 1:2]))
            if good or step is None or doubling == DOUBLED:
                break
            better = solved(balance, U + step, self.solved)
            if better is None:
                break
            U = better
        row["converged_reason"] = GOOD if good else MISSED
        for name, value in measured(balance, U, field, self.overlaps.contact).items():
            row[name] = value
        if self.stability:
            from pgran.experiments.loud.stability import multipliers

            row["multiplier"] = next(iter(multipliers(balance, U)), np.nan)
        if self.certificate:
            self._prove(row, balance, U)
        balance.resolve(self.harmonics)

    def _prove(self, row, balance, U):
        """Put into a row what is proven of a state, by one of more harmonics near it."""
        from pgran.experiments.loud.newton import solved
        from pgran.experiments.loud.proof import proof_of

        balance.resolve(max(PROVEN, balance.harmonics))
        U = balance.padded(U)
        finer = solved(balance, U, LEAST)
        order = balance.operators.layout.numbers.ravel()
        motion = balance.everyone(U if finer is None else finer)[order]
        of = self.scaled, self.contacts, balance.omega, balance.amplitude, motion
        found = on_root(balance.comm, lambda: proof_of(*of, self.sites, row["harmonic"]))
        if found is not None:
            row["certificate"], row["certificate_bound"] = found.proven, found.bound
            row["certificate_radius"] = found.radius

    def collect(self, rows, seconds):
        """See `Task`."""
        columns = columns_of(Loud, rows) | {n: rows[n] for n in ("opening", "opening_part")}
        for name, values in columns.items():
            values = values.reshape(*self.shape, *values.shape[1:])
            columns[name] = (values.swapaxes(0, 1) if self.swept else values).copy()
        for name in ("power_in", "power_lost"):
            columns[name] *= self.unit
        for name in ("opening", "opening_part"):
            columns[name] = columns[name][:, 0].copy()
        distance = None if self.lattice.axes == 1 or self.lattice.is_grid else self.lattice.distance
        return Loud(
            **columns,
            **{name: self.choices[name] for name in ("unit", "follow", "reach")},
            error_kind="estimated",
            near=int(np.count_nonzero(self.contacts.number < 0)),
            overlap=self.overlap,
            turning=np.nan if distance is None else self.overlap / float(np.mean(distance)),
            solve_seconds=seconds,
            omega=self.omegas,
            amplitude=self.amplitudes,
            direction=np.array(self.directions),
            detector=self.sites,
            contact=self.overlaps.contact,
        )
