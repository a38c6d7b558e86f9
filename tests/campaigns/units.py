"""The same problem in other units of mass, length and time: every public function, alike to 1e-9.

    python tests/campaigns/units.py FIRST LAST [SYSTEMS]

tries lattices, networks and packings of these seeds in each of so many systems of units, and prints
what has FAILED. Units are powers of 4, so that not even their roots are rounded: bounds and
decisions must be alike as well. Each function of `pgran.__all__` that computes has its `ROWS`.
"""

import dataclasses
import logging
import re
import sys
import warnings
from collections import Counter
from math import log, sqrt
from pathlib import Path
from types import SimpleNamespace

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))  # before this script's folder

from law_samples import lawful_network, with_laws

import pgran
from pgran.errors import PgranError
from pgran.medium.checks import OF_DAMPING

ALIKE = 1e-9
# BLAS rounds by where arrays lie: what errors, and the difference of two large numbers, may vary by
VARYING, VARIED = re.compile("error|bound|estimate|residual|radius|dissipated"), 0.02
# Decades of the units of mass, length and time; that of stiffness follows.
DECADES = (
    (-30, -9, -12), (20, 6, 9), (-14, -5, 4), (-30, 3, 8), (-6, -3, -9), (9, 0, 9), (20, 4, -9),
    (-12, -10, 8),
)  # fmt: skip
# Units of what media and tuples hold; records declare theirs.
UNITS = {
    "k": "stiffness tangential kmax push damping_reference",
    "m": "mass masses median_mass",
    "sqrt(k m)": "damping",
    "sqrt(k/m)": "drag omega omega_mx",
    "sqrt(m/k)": "derivative derivative_bound",
    "length": "position distance radius box overlap",
    "force": "force",
    "force/m": "gravity",
    "length length": "volume",  # packings have two dimensions
    "m/length/length": "density",
    "length sqrt(k/m)": "speed affine slowest fastest",
}  # fmt: skip
UNIT = {name: words for words, names in UNITS.items() for name in names.split()}
SAME = {"K0": "k", "spacing": "length", "force": "(k length)", "^": "**"}
SAME |= dict.fromkeys((" x omega_mx", " per omega_mx"), "")
LEFT_OUT = {"solve_seconds", "bonds_sha256", "models"}  # models are in a unit of their own
NOT_COMPUTING = {
    "BondLaw", "InputError", "Lattice", "Network", "PgranError", "export", "load", "plot", "save",
    "table",
}  # fmt: skip


def factor(words, units):
    """Return the size of a unit such as `sqrt(k/m)/length`; 1 of `rad` or `steps`."""
    for name, meant in SAME.items():
        words = words.replace(name, meant)
    words = re.sub(r"\b(rad|dB|s|K|omega_mx|cycles per step|steps per cycle|steps)\b", "1", words)
    return eval(re.sub(r"(?<=[\w)]) (?=\w)", "*", words.split(";")[0]), {"sqrt": sqrt, **units})


def in_units(medium, units):
    """Return a medium whose numbers are so many times as large."""
    changed = {}
    for name in UNIT.keys() & medium.__dataclass_fields__.keys():
        times, value = factor(UNIT[name], units), getattr(medium, name)
        if value is not None:
            each = isinstance(value, tuple)  # of the axes of a lattice
            changed[name] = tuple(times * k for k in value) if each else times * value
    return dataclasses.replace(medium, **changed)


def numbers(found, units, name="", words=None):
    """Yield by names all values in what a function returned, numbers in the first units."""
    parts = ()
    if dataclasses.is_dataclass(found):
        declared = {item.name: item.metadata.get("units") for item in dataclasses.fields(found)}
        parts = [(key, getattr(found, key), words) for key, words in declared.items()]
    elif hasattr(found, "_asdict"):
        parts = [(key, value, None) for key, value in found._asdict().items()]
    elif isinstance(found, (tuple, list)):
        parts = [(name, value, words) for value in found]
    elif found is not None:
        value, words = np.asarray(found), words or UNIT.get(name, "1")
        yield name, value / factor(words, units) if value.dtype.kind in "fc" else value
    for key, value, words in parts:
        if key not in LEFT_OUT:
            yield from numbers(value, units, key, words)


def differences(found, expected):
    """Yield what is not alike in two lists of values by names."""
    if [name for name, _ in found] != [name for name, _ in expected]:
        yield "other values"
    for (name, one), (_, other) in zip(found, expected, strict=False):
        off = 0.0 if np.array_equal(one, other) else np.inf
        if off and one.dtype.kind in "fc" and one.shape == other.shape:
            with np.errstate(invalid="ignore"):
                same = (one == other) | (np.isnan(one) & np.isnan(other))
                size = np.abs(other[np.isfinite(other)]).max(initial=0.0) or 1.0
                size = max(size, 1e-7) if "estimate" in name else size  # where integrals are exact
                off = np.where(same, 0.0, np.abs(one - other) / size).max(initial=0.0)
        if not off <= (VARIED if VARYING.search(name) else ALIKE):
            yield f"{name} {off:.1e}"


def media(seed):
    """Return a lattice, a network and a packing by their names, with any laws of damping."""
    rng = np.random.default_rng([51, seed])
    lattice = pgran.Lattice.random(
        [(5, 4), (16,), (3, 2, 3)][seed % 3], seed, ("uniform", "loguniform")[seed % 2], kmin=0.01,
        kmax=1.0, mass=10 ** rng.uniform(-1, 1), damping=10 ** rng.uniform(-3, -1),
        damping_power=rng.choice([0, 0.5]), drag=rng.choice([0, 0.02]), loss=rng.choice([0, 0.03]),
    )  # fmt: skip
    packing = pgran.pack(
        int(rng.integers(30, 40)), law=("harmonic", "hertz", 2.0)[seed % 3], seed=seed,
        pressure=10 ** rng.uniform(-3, -1), walls=("x", None)[rng.integers(2)],
    )  # fmt: skip
    packing = with_laws(dataclasses.replace(packing, damping=10 ** rng.uniform(-3, -1)), seed)
    if not np.any(packing.held):
        packing = pgran.with_source(packing, balls=packing.free[:2])
    network = lawful_network(seed).network
    network = dataclasses.replace(network, damping=1e-3 * network.damping)  # steps can be long
    return {"lattice": lattice, "network": network, "packing": packing}


def case(start, units):
    """Return what rows take: a medium in some units, and times, frequencies, balls to ask for."""
    top, length = factor("sqrt(k/m)", units) * start.omega_mx, units["length"]
    balls = np.argwhere(np.ones(start.shape)) if start.is_grid else start.free[:, None]
    # pulses know no loss, and contacts made anew are all alike
    off = {"loss": 0.0} if start.is_grid else dict.fromkeys(OF_DAMPING)
    plain = dataclasses.replace(start, **off)
    pushed = in_units(pgran.with_source(plain, balls=balls[:1]), units)
    law = lambda u: units["k"] * start.kmax * (0.05 + u / 2)  # noqa: E731
    return SimpleNamespace(
        fields=not getattr(start, "turns", 0),  # angles have a unit of their own
        units=units, length=length, top=top, law=law, balls=balls,
        medium=in_units(start, units), plain=in_units(plain, units),
        pushed=dataclasses.replace(pushed, push=length * pushed.push),
        sample=lambda seed: in_units(pgran.redrawn(start, 40, seed), units),
        plain_sample=lambda seed: in_units(pgran.redrawn(plain, 40, seed), units),
        omegas=top * np.linspace(0.05, 1.1, 12), dense=top * np.linspace(0.05, 1.1, 60),
        heard=balls[[len(balls) // 3, -1]], line=balls[:: max(1, len(balls) // 9)],
        changes={"law": law, "omega": 0.4 * top, "steps": 9},
        sent={"omega": 0.4 * top, "width": 6 / top, "time": 90 / top, "points": 121},
    )  # fmt: skip


def pulse(c, medium=None, **given):
    """Return the signals of a pulse."""
    return pgran.pulse(c.plain if medium is None else medium, c.heard, **c.sent | given)


def moved(c, **given):
    """Return what a push of so many units of length moves."""
    return pulse(c, c.pushed, **given).displacement / c.length


def crossed(c, of, **given):
    """Return an ensemble along a line of balls, and what is measured of it."""
    found = pgran.ensemble(of, 8, detectors=c.line, keep="curves", **given)
    return found, pgran.transport(c.medium, found)


def noise(c):
    """Return the noise of an ensemble."""
    found, _ = crossed(c, "response", lattice=c.sample, omegas=c.dense)
    return pgran.statistics(found, (0.2 * c.top, 0.8 * c.top))


def box(c, damping):
    """Return the response of a continuum."""
    units, size = c.units, c.length
    rate = sqrt(units["k"] / units["m"]) / size
    return pgran.continuum(
        rate * np.linspace(0.1, 20, 30), (0.4 * size, 0.6 * size), size=(size, 0.9 * size),
        mass=units["m"], stiffness=units["k"], damping=damping * units["k"] / rate,
    )  # fmt: skip


def curve(c):
    """Return a curve, and what it is between its frequencies."""
    found = pgran.sweep(c.medium, c.dense, c.heard, method="curve", keep_models=True)
    return found, found.at(0.5 * (c.dense[10:50] + c.dense[11:51]))


def modes(**given):
    """Return a row of modes, frequencies given in units of omega_mx."""

    def row(c):
        asked = {
            key: c.top * np.array(given[key]) for key in {"interval", "targets"} & given.keys()
        }
        return pgran.find_modes(c.medium, detectors=c.heard, **given | asked)

    return row


def warm(c, **given):
    """Return what warm balls change."""
    return pgran.heat(c.medium, c.omegas[::4], c.heard, **given)


def relaxed(method):
    """Return a row of a relaxation."""
    return lambda c: pgran.relax(c.medium, detectors=c.heard, method=method, **c.changes)


ITERATIVE = {"steady_ksp_type": "gmres", "steady_pc_type": "ilu"}
# fmt: off
ROWS = {
    "compare": (
        lambda c: pgran.compare(*(pgran.sweep(c.sample(n), c.dense, c.heard) for n in (1, 2))),
        lambda c: pgran.compare(pulse(c), pulse(c, points=201)),
    ),
    "continuum": (lambda c: box(c, 0.02), lambda c: box(c, 0.0)),
    "count_modes": (lambda c: pgran.count_modes(c.medium, c.omegas),),
    "ensemble": (
        lambda c: pgran.ensemble("modes", 3, lattice=c.sample, damped=True),
        lambda c: pgran.ensemble("relaxation", 3, lattice=c.sample, detectors=c.heard, **c.changes),
    ),
    "equilibrate": (
        lambda c: pgran.equilibrate(c.plain),
        lambda c: pgran.equilibrate(c.plain, c.plain.radius * (1 - 1e-4 * (c.plain.held == 0))),
    ),
    "find_modes": (
        modes(method="dense", shapes=True), modes(method="eps"), modes(interval=(0.2, 0.5)),
        modes(targets=[0.3], count=3), modes(damped=True, shapes=True),
        modes(damped=True, targets=[0.3], count=2, method="eps", certificate="proven"),
        modes(damped=True, targets=[0.0], count=2, method="eps"),
    ),
    "green": (lambda c: pgran.green(c.medium, c.omegas, c.heard),),
    "heat": (
        lambda c: warm(c, factor=1.1, cut=True),
        lambda c: warm(c, overlap=0.1 * c.length, hertz=c.units["k"] / sqrt(c.length)),
        lambda c: pgran.heat(c.plain, c.omegas[::4], c.heard, samples=3,
                             radius=1e-2 * c.plain.overlap.mean()),
    ),
    "loud": (
        lambda c: pgran.loud(c.medium, c.omegas[:2], c.heard, [0.3, 1.0], unit="opening"),
        lambda c: pgran.loud(c.plain, c.omegas[:1], c.heard, [0.1], unit="overlap", harmonics=3),
    ),
    "matrices": (lambda c: c.fields and pgran.matrices(c.medium).K.toarray() / c.units["k"],),
    "ordered": (lambda c: pgran.ordered(c.plain),),
    "pack": (lambda c: in_units(
        pgran.pack(20, pressure=0.01, sizes=c.length * np.linspace(1, 2, 20)), c.units),),
    "project": (lambda c: pgran.project(c.medium, c.omegas[::3]),),
    "pulse": (
        lambda c: pulse(c, method="laplace", fields=c.fields),
        lambda c: pulse(c, method="moments", fields=c.fields),
        lambda c: pulse(c, wall=c.length * np.hanning(99)).velocity / (c.length * c.top),
        lambda c: moved(c, method="laplace"), lambda c: moved(c, method="moments"),
    ),
    "redrawn": (lambda c: pgran.redrawn(c.medium, 9, law=c.law),),
    "relax": (relaxed("window"), relaxed("direct"), relaxed("krylov")),
    "sensitivity": (lambda c: pgran.sensitivity(c.medium, c.omegas[::4], c.heard),),
    "sound": (lambda c: pgran.sound(c.medium),),
    "statistics": (noise,),
    "structure": (lambda c: pgran.structure(c.medium, 2, c.dense[::3]),),
    "sweep": (
        lambda c: pgran.sweep(c.medium, c.omegas, c.heard, method="points", fields=c.fields), curve,
        lambda c: pgran.sweep(c.medium, c.omegas, c.heard, solver=ITERATIVE),
        lambda c: pgran.sweep(c.pushed, c.omegas, c.heard).displacement / c.length,
    ),
    "transport": (
        lambda c: crossed(c, "response", lattice=c.sample, omegas=c.dense),
        lambda c: crossed(c, "pulse", lattice=c.plain_sample,
                          **c.sent | {"time": 200 / c.top, "points": 201}),
    ),
    "with_source": (lambda c: pgran.with_source(c.medium, balls=c.balls[:2]),),
    "without_rattlers": (lambda c: pgran.without_rattlers(c.medium),),
}
# fmt: on


def called(row, start, units):
    """Return by names what a row computes, or None, and in words why it computes nothing."""
    try:
        return list(numbers(row(case(start, units)), units)), ""
    except (PgranError, AttributeError, TypeError) as error:  # another kind of medium is needed
        return None, f"{type(error).__name__}: {error}"


def faults(row, start, decades, expected, refused):
    """Yield what is other in some units."""
    mass, time, length = (4.0 ** round(d / log(4, 10)) for d in decades)
    length = 1.0 if start.is_grid else length  # the spacing
    found, why = called(row, start, {"k": mass / time**2, "m": mass, "length": length})
    if found and expected:
        yield from differences(found, expected)
    elif found or expected:
        yield why or f"computed, and refused before: {refused}"


def main(first, last, systems=8):
    """Try the seeds; return the number of faults."""
    logging.disable()
    warnings.simplefilter("ignore")
    computing, computed, wrong = set(pgran.__all__) - NOT_COMPUTING, Counter(), 0
    for seed in range(int(first), int(last)):
        for kind, start in media(seed).items():
            for name, number, row in ((n, i, r) for n in ROWS for i, r in enumerate(ROWS[n])):
                alone = called(row, start, {"k": 1.0, "m": 1.0, "length": 1.0})
                computed[name] += alone[0] is not None
                for decades in DECADES[: int(systems)]:
                    for fault in faults(row, start, decades, *alone):
                        where = f"{name} {number} of {kind} {seed} in decades {decades}"
                        print(f"FAILED {where}: {fault}"[:300], flush=True)
                        wrong += 1
    print(f"seeds {first} to {last} in {systems} systems; computed:", dict(computed))
    for name in computing ^ {name for name, count in computed.items() if count}:
        print(f"FAILED: {name} has never computed anything, or is no function that does")
        wrong += 1
    return wrong


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]) > 0)
