"""Loud packings, integrated in time by SciPy contact by contact, and oscillations of one ball."""

import dataclasses

import numpy as np
from mpi4py import MPI
from scipy.integrate import quad, solve_ivp
from scipy.optimize import fsolve

import pgran
from pgran.driven.operators import Operators
from pgran.experiments.loud.balance import Balance
from pgran.experiments.loud.contacts import contacts_of


def packing(balls, dimension, law, seed, quality, frequency, power, **others):
    """A small packing between walls, the left one driven, damped along normals, and omega."""
    others = {"pressure": 1e-4, "walls": "x", "seed": seed} | others
    network = pgran.pack(balls, dimension=dimension, law=law, **others)
    omega = frequency * network.omega_mx
    damping = float(network.stiffness.mean() / (quality * omega))
    values = {"damping": damping, "damping_power": power, "damped": "normal"}
    return dataclasses.replace(network, **values), omega


def chain(stiffness, force, power, damping=1e-30, damping_power=0.0):
    """Balls between a wall at rest and a driven one, in one dimension."""
    n = len(stiffness)
    return pgran.Network(
        np.c_[np.arange(n), np.arange(1, n + 1)], np.asarray(stiffness, float),
        [1, *[0] * (n - 1), 2], 1.0, damping, force=np.asarray(force, float), distance=np.ones(n),
        power=power, damping_power=damping_power,
    )  # fmt: skip


def free_oscillation(network, size, omega, harmonics, contacts=(0, 1)):
    """The frequency of a ball without a drive whose fundamental has a size, and its motion."""
    with Operators(network, MPI.COMM_SELF) as operators:
        balance = Balance(operators, contacts_of(network).of([*contacts]), harmonics)

        def missed(x):
            balance.omega = x[-1]
            field = np.array([[x[0], size, *x[1:-1]]], complex)
            return balance.residual(field)[0].real

        found = fsolve(missed, [*np.zeros(harmonics), omega], xtol=1e-12)
        balance.destroy()
    angle = np.outer(np.linspace(0, np.pi, 20001), np.arange(harmonics + 1))
    return found[-1], np.cos(angle) @ [found[0], size, *found[1:-1]]


def period(potential, low, high):
    """By quadrature, of a ball of mass 1 between two turning points."""
    middle, half, energy = (low + high) / 2, (high - low) / 2, potential(high)

    def time(t):
        left = max(energy - potential(middle + half * np.sin(t)), 1e-300)
        return half * np.cos(t) / np.sqrt(2 * left)

    return 2 * quad(time, -np.pi / 2, np.pi / 2, epsabs=1e-12, limit=400)[0]


class Motion:
    """m u'' = the sum of all tensions, of contacts that bear nothing where they are open."""

    def __init__(self, network, reach):
        """`reach` is that of near pairs, in mean overlaps."""
        h, a, p, springs = network.overlap, network.power, network.damping_power, network.springs
        self.network, self.a, self.p = network, a, p
        count, known = len(network.bond), {frozenset(pair) for pair in network.bond.tolist()}
        self.B, self.w = springs.B[:count].toarray(), springs.drive[:count].copy()
        rest = springs.B[count:].toarray()
        self.rest = rest.T @ (springs.constants[count:, None] * rest)
        self.rest_drive = rest.T @ (springs.constants[count:] * springs.drive[count:])
        self.h, self.C = h.copy(), network.force / h**a
        self.modulus = np.median(self.C / self._reduced(*network.radius[network.bond].T))
        self.beta = network.damping / (network.stiffness.mean() ** p)
        self.stays = np.full(count, p == 0)
        for i in range(len(network.held)):
            for j in range(i):
                away, gap = self._gap(i, j)
                held = network.held[[i, j]]
                if gap < reach * h.mean() and frozenset((i, j)) not in known and not held.all():
                    self._add(j, i, away, gap)

    def _gap(self, i, j):
        network = self.network
        away = network.position[i] - network.position[j]
        box = network.box
        away = away - np.where(box > 0, box, 0) * np.rint(away / np.where(box > 0, box, np.inf))
        return away, np.linalg.norm(away) - network.radius[[i, j]].sum()

    def _add(self, first, second, away, gap):
        network, d = self.network, self.network.axes
        normal, row, drive = away / np.linalg.norm(away), np.zeros(network.size), 0.0
        for ball, sign in ((first, -1), (second, 1)):
            if network.held[ball] == 0:
                at = d * np.searchsorted(network.free, ball) + np.arange(d)
                row[at] = sign * normal * network.weights[at]
            elif network.held[ball] == 2:
                drive += sign * normal @ network.direction
        R = network.radius[[first, second]]
        self.B, self.w = np.vstack([self.B, row]), np.append(self.w, drive)
        self.h, self.C = (
            np.append(self.h, -gap),
            np.append(self.C, self.modulus * self._reduced(*R)),
        )
        self.stays = np.append(self.stays, False)

    def _reduced(self, one, other):
        return (one * other / (one + other)) ** (self.a - 1)

    def tension(self, e, speed):
        """Beyond that at rest."""
        x, rest = np.maximum(self.h - e, 0), np.maximum(self.h, 0)
        k = self.a * self.C * x ** (self.a - 1) * (x > 0)
        c = self.beta * np.where(self.stays, 1.0, k if self.p else 0.0)
        return self.C * (rest**self.a - x**self.a) + c * speed

    def acceleration(self, t, u, v, omega, amplitude):
        """u'' at a time."""
        wall, moving = amplitude * np.cos(omega * t), -amplitude * omega * np.sin(omega * t)
        pull = self.B.T @ self.tension(self.B @ u + wall * self.w, self.B @ v + moving * self.w)
        return -(pull + self.rest @ u + wall * self.rest_drive) / self.network.mass

    def period(self, omega, amplitude, state, rtol):
        """u, v after a period from u, v in one vector, and the harmonics 0 to 9 in between."""
        n, T, samples = self.network.size, 2 * np.pi / omega, 256

        def rate(t, y):
            return np.r_[y[n:], self.acceleration(t, y[:n], y[n:], omega, amplitude)]

        times = T * np.arange(samples + 1) / samples
        settings = {"method": "DOP853", "rtol": rtol, "atol": rtol * amplitude * 1e-2}
        found = solve_ivp(rate, (0, times[-1]), state, t_eval=times, **settings).y
        values = np.fft.rfft(found[:n, :-1], axis=1)[:, :10] * 2 / samples
        values[:, 0] /= 2
        return found[:, -1], values

    def periodic(self, omega, amplitude, periods=20, rounds=5, steps=400, rtol=1e-10):
        """The harmonics of the periodic motion, and the monodromy matrix.

        From rest, then by Newton's method: a state that a period brings back to itself.
        """
        state = np.zeros(2 * self.network.size)
        for _ in range(periods):
            state, fields = self.period(omega, amplitude, state, 1e-6)
        n = self.network.size
        for _ in range(rounds):
            matrix = self.monodromy(fields, omega, amplitude, steps)
            after, fields = self.period(omega, amplitude, state, rtol)
            # the matrix is of u and of m v + B^T c B u, the same c at both ends
            _, c = self.tangents(fields, 0.0, omega, amplitude)
            momentum = self.network.mass * np.eye(2 * n)
            momentum[:n, :n] = np.eye(n)
            momentum[n:, :n] = self.B.T @ (c[:, None] * self.B)
            of_state = np.linalg.solve(momentum, matrix @ momentum)
            missed = np.linalg.norm(after - state)
            state = state + np.linalg.solve(np.eye(2 * n) - of_state, after - state)
        return fields, matrix, missed / np.linalg.norm(state)

    def tangents(self, fields, t, omega, amplitude):
        """The stiffness and the dashpot of each contact at a time."""
        wave = np.exp(1j * omega * t * np.arange(fields.shape[1]))
        e = self.B @ (fields @ wave).real + amplitude * np.cos(omega * t) * self.w
        x = np.maximum(self.h - e, 0)
        k = self.a * self.C * x ** (self.a - 1) * (x > 0)
        return k, self.beta * np.where(self.stays, 1.0, k if self.p else 0.0)

    def monodromy(self, fields, omega, amplitude, steps):
        """The matrix of one period of small deviations from a motion of some harmonics."""
        m, n, h = self.network.mass, self.network.size, 2 * np.pi / omega / steps

        def rate(t, Y):
            k, c = self.tangents(fields, t, omega, amplitude)
            longer = self.B @ Y[:n]
            d = (Y[n:] - self.B.T @ (c[:, None] * longer)) / m
            return np.vstack([d, -self.B.T @ (k[:, None] * longer) - self.rest @ Y[:n]])

        Y = np.eye(2 * n)
        for step in range(steps):
            t = step * h
            a = rate(t, Y)
            b = rate(t + h / 2, Y + h / 2 * a)
            c = rate(t + h / 2, Y + h / 2 * b)
            Y = Y + h / 6 * (a + 2 * b + 2 * c + rate(t + h, Y + h * c))
        return Y
