"""Results to draw, of small lattices."""

import functools
import pickle
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
from samples import random_lattice

import pgran
from pgran import results
from pgran.medium.base import record_of

LATTICE = random_lattice((4, 3), seed=5, mass=0.25)
UNIT = LATTICE.omega_mx  # 2
SWEEP = np.linspace(0.005, 1.3, 260)  # in units of omega_mx, as all frequencies here


def result_of(record, lattice=LATTICE):
    """A result of one record."""
    medium = record_of(lattice)
    records = {medium.group: medium, record.group: record}
    return SimpleNamespace(scene=record.group, medium=medium, **records)


def computed_once(make):
    """Let a function compute each result once, and return a copy, which tests may change."""
    results_of = {}

    @functools.wraps(make)
    def copied(*words, **choices):
        key = pickle.dumps((words, choices))
        if key not in results_of:
            results_of[key] = pickle.dumps(make(*words, **choices))
        return pickle.loads(results_of[key])

    return copied


@computed_once
def respond(x=SWEEP, detectors=((1, 1),), lattice=LATTICE):
    omegas = np.array(x) * lattice.omega_mx
    response = pgran.sweep(lattice, omegas, detectors, method="points")
    response.line_error[1:] = 0  # as if resolved
    return result_of(response, lattice)


@computed_once
def respond_box(damping=0.003):
    box = {"point": (0.15, 0.52), "size": (1 / 3, 1.0), "damping": damping}
    return result_of(pgran.continuum(np.linspace(0.3, 36, 300), **box))


@computed_once
def find_modes(shape=(4, 3), **wanted):
    lattice = random_lattice(shape, seed=5, mass=0.25)
    return result_of(pgran.find_modes(lattice, shapes=True, **wanted), lattice)


@computed_once
def count_modes(lattice=LATTICE, points=30, **choices):
    omegas = np.linspace(0, 1.5 * UNIT, points)
    return result_of(pgran.count_modes(lattice, omegas, **choices), lattice)


@computed_once
def project(x, shape=(4, 3)):
    lattice = random_lattice(shape, seed=5, mass=0.25)
    return result_of(pgran.project(lattice, np.array(x) * lattice.omega_mx), lattice)


@computed_once
def relax(steps=300):
    law = pgran.BondLaw("uniform")
    return result_of(pgran.relax(LATTICE, law, 0.6 * UNIT, [(1, 2)], steps=steps))


@computed_once
def listen(sites=((1, 1),), lattice=LATTICE, **sent):
    sent = {"width": 3.0, "omega": 0.6 * UNIT, "time": 200.0, "points": 801, "fields": True} | sent
    return result_of(pgran.pulse(lattice, np.ravel(sites), **sent), lattice)


@computed_once
def shout(amplitudes=(0.05, 0.2, 1.0, 3.0, 5.0), balls=24, power=1):
    """States of a packing along a ladder, in amplitudes that open a contact."""
    shape = {"walls": "x", "seed": 3, "pressure": 1e-4}
    net = pgran.pack(balls, 2, "hertz", **shape)
    omega = 0.3 * net.omega_mx
    net = replace(net, damping=net.stiffness.mean() / (8 * omega), damping_power=power)
    found = pgran.loud(net, [omega], net.free[:1], amplitudes, unit="opening", harmonics=3)
    return result_of(found, net)


@computed_once
def lean(points=31):
    """The resonance of a ball between two contacts, up and down in frequency."""
    ball = pgran.Lattice.random((1,), law="constant", kmax=0.25, hertz=1.0, damping=0.003)
    omegas = np.linspace(0.9, 1.02, points) * ball.omega_mx
    wanted = {"unit": "overlap", "follow": "frequency", "harmonics": 3}
    return result_of(pgran.loud(ball, omegas, [0], [0.003, 0.02], **wanted), ball)


@computed_once
def ensemble():
    """Responses, with what they say of transport and of noise."""
    lattice = {"shape": (6, 3), "mass": 0.25, "damping": 0.05}
    omegas = UNIT * np.linspace(0.2, 1.2, 201)
    drawn = {"omegas": omegas, "detectors": [(4, 1), (2, 1), (0, 1)]}
    found = pgran.ensemble("response", 10, lattice=lattice, keep="curves", **drawn)
    first = pgran.Lattice.random(**lattice)
    result = result_of(found, first)
    result.transport = pgran.transport(first, found)
    result.statistics = pgran.statistics(found, [(0.5 * UNIT, 0.9 * UNIT)])
    return result


def diffusing():
    """Squares of pulses and a fit."""
    numbers = "speed diffusivity absorption length free_path misfit"
    numbers += " diffusivity_error absorption_error length_error free_path_error"
    depth, time = np.arange(2.0, 12.0), np.linspace(100.0, 500.0, 24)
    fit = np.exp(-0.01 * time[:, None] - 0.1 * depth)
    arrays = {"mean_square": 1.1 * fit, "mean_square_error": 0.1 * fit, "fit": fit}
    facts = dict.fromkeys(numbers.split(), 1.0)
    return result_of(results.Diffusion(samples=8, depth=depth, time=time, **arrays, **facts))


def compare(errors):
    """An accuracy study: configurations of one solver each, slower and slower."""
    seconds = np.arange(1.0, len(errors) + 1)
    arrays = {"error_max": np.array(errors), "error_bound_max": np.ones(len(errors))}
    arrays |= {"seconds": seconds, "seconds_min": 0.9 * seconds, "seconds_max": 1.1 * seconds}
    arrays |= {"failures": np.where(seconds == 4, 4, 0), "on_front": seconds < 3}
    arrays["solver"] = np.array([f"solver{n}" for n in range(len(errors))])
    arrays["label"] = arrays["solver"]
    unseen = dict.fromkeys(["tolerance", "error_median", "iterations"])
    study = {"experiment": "response", "repeats": 3, "values": 1, "compared": 1}
    return result_of(results.Accuracy(reference_bound=1e-14, **study, **arrays, **unseen))
