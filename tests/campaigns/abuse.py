"""Wrong calls from Python: each raises InputError, and right ones in other clothes change no bit.

    PYTHONPATH=tests python -m campaigns.abuse CALLS [SEED]
    PYTHONPATH=tests mpirun -n 2 python -m campaigns.abuse CALLS [SEED]

So many calls, each a good one of which an argument is replaced, a pure function of the seed and its
number. On several ranks one of them hands in something else, wrong or only other, and all must
raise InputError. A call that takes longer than SECONDS ends the process; the exit code is 1 if one
fails.
"""

import dataclasses
import signal
import sys
from collections import Counter
from dataclasses import dataclass
from decimal import Decimal

import numpy as np
from mpi4py import MPI

import pgran
from pgran import arguments

SECONDS = 60
VERDICTS = ("refused", "accepted", "wrong")


@dataclass(frozen=True)
class Kind:
    """What an argument is: wrong values, what a good value may come as, and other good ones."""

    wrong: list
    clothes: list = ()
    other: object = None


class Odd:
    """What no conversion takes."""

    def __array__(self, *_):
        """Refuse."""
        raise RuntimeError("no array")


def kinds():
    """Return the kinds of arguments by name, and a lattice."""
    lattice = pgran.Lattice.random((5, 4), seed=3, damping=0.01)
    k, bonds, recursive = lattice.stiffness, np.array([1.0, 2.0, 1.5]), []
    recursive.append(recursive)
    masked = np.ma.masked_array([0.2, 0.5], [0, 1])
    bad = [
        "loud", b"x", {"a": 1}, {1, 2}, Odd(), object, len, 1j, np.nan, np.inf, "0.5", recursive,
        np.array([1, None]), Decimal("0.5"), 10**5000, [[1], [2, 3]], range(0), np.ma.masked,
        np.datetime64("2020"), np.float64, lambda: 3, "", "\n", "\udcff", [True], np.array(["a"]),
        np.array(object()), np.zeros((0, 3)), masked,
    ]  # fmt: skip
    some = [*bad, {}, True, np.True_, np.array([True, False]), ["a", 1], [1, None], [0.2, 1j]]
    real = [*some, [0.5, 0.6], np.array([0.5]), -1, -0.5, -(10**30)]
    omegas = [
        *some, None, [], [0.5, 0.2], [0.2, 0.2], [[0.2, 0.5]], [-0.2, 0.5], [0.2, np.nan],
        [0.2, True], np.array([0.2 + 0j, 1]), [0.2, 10**400], [0.2, 1e200], [0.2, np.inf],
    ]  # fmt: skip
    balls = [
        *some, [(2.9, 2.0)], [(True, True)], [(2, True)], (1j, 2), [], [(2,)], [(5, 0)], [(0, -1)],
        [(2, 1, 0)], [(2, 1, 0), (1, 1, 1)], [[[2, 1]]], 2, [np.nan, 1], 1e300, [(2**63, 0)],
        [(10**30, 1)], [("2", "1")], np.array([2, 1], dtype=object),
        np.array([(2, 1)], dtype=complex), np.array([2**64 - 1, 1], dtype=np.uint64),
    ]  # fmt: skip
    laws = [
        *bad, 3, "uniform", lambda u: -u, lambda u: u + np.nan, lambda u: u[:-1], lambda u: 0.5,
        lambda u: u * 1j, lambda u: u > 0.5, lambda u: None, lambda u: u / u.max(),
        lambda u: 1 / (0 * u), lambda u: np.random.default_rng().random(u.shape), lambda u: u["x"],
        lambda u: u.astype(object), lambda u: u[:, None], lambda u: 1 / 0, np.sort, pgran.BondLaw,
    ]  # fmt: skip
    keys = [
        *bad, 3, {"ksp_type": "gmres"}, {"steady_": 1}, {"steady_ksp_type gmres": ""}, {5: 5},
        {"steady_ksp_type": "a\nb"}, {None: 1}, [("steady_ksp_type", "cg")],
        {"steady_ksp_type": "\udcff"},
    ]  # fmt: skip
    samples = [
        *some, 3, None, lattice, {"shape": (5, 4), "seed": 3}, {"shape": (5, 4), "kmin": True},
        lambda seed: {}["x"], lambda seed: 3, lambda seed: pgran.Lattice.random((5, seed)),
    ]  # fmt: skip
    return lattice, {
        "real": Kind(real, [np.float64, np.array], lambda x: x / 2),
        "whole": Kind(
            [*real, None, 2.5, np.float64(3.5), 1e300, 10**30, 2**64], [np.int64, np.array],
            lambda n: n + 1,
        ),
        "flag": Kind([*bad, None, 2, 0.5, "no"], [np.bool_, int, np.array], lambda x: not x),
        "choice": Kind([*some, None, 3, ["none"], "Points"], [np.str_], str.upper),
        "omegas": Kind(omegas, [np.array, tuple, np.longdouble], lambda omegas: omegas[:2]),
        "balls": Kind(balls, [np.array, np.ravel, np.float64, np.int8, tuple], lambda b: b[:1]),
        "medium": Kind(
            [*some, None, 3, k, (5, 4), "lattice.h5", pgran.Lattice, [lattice]],
            [dataclasses.replace], lambda medium: dataclasses.replace(medium, damping=0.02),
        ),
        "law": Kind(laws, [lambda law: lambda u: law(u)], lambda law: lambda u: 0.5 * law(u)),
        "window": Kind(
            [*some, 0.5, [0.5], [0.8, 0.3], [0.3, 0.3], [0.3, np.nan], [0.1, 0.2, 0.3]],
            [np.array, list], lambda ends: (ends[0], 2.0),
        ),
        "point": Kind([*some, 0.5, [0.5], [0.1, 0.2, 0.3], (0.3, 2)], [np.array, list], np.sqrt),
        "keys": Kind(keys, [dict], lambda keys: {"steady_ksp_type": "cg"}),
        "steady_keys": Kind(
            [*keys, {"steady_ksp_type": "none of them"}, {"steady_ksp_rtol": "one"}], [dict],
            lambda keys: {"steady_ksp_type": "cg"},
        ),
        "samples": Kind(
            samples, [dict, lambda keys: lambda seed: pgran.Lattice.random(seed=seed, **keys)],
            lambda keys: keys | {"damping": 0.02},
        ),
        "shape": Kind([*some, None, (5, 0), (2.5, 2), 5, (5, True), (10**9,) * 3], [list]),
        "bonds": Kind(
            [*some, None, k[:1], [-x for x in k], k * 2, [x + 0j for x in k], [None, None]],
            [list, lambda given: [x.tolist() for x in given]],
        ),
        "constants": Kind(
            [*some, None, bonds + 0j, bonds > 0, bonds[:2], bonds[None], bonds * np.nan, "abc"],
            [np.array, tuple, np.float32],
        ),
        "contacts": Kind(
            [*some, None, [[0, 1.5], [1, 2], [2, 3]], [[0, 1], [1, 2], [2, 4]], [[0, 1], [1, 1]]],
            [np.array, np.float64],
        ),
    }  # fmt: skip


def cases():
    """Return the functions, and of their arguments kinds and good values."""
    lattice, known = kinds()
    omegas, balls = [0.2, 0.5, 0.8], [(2, 1), (4, 3)]
    always = {"progress": ("choice", "none")}
    on = always | {"lattice": ("medium", lattice), "solver": ("keys", {})}
    swept, heard = on | {"omegas": ("omegas", omegas)}, {"detectors": ("balls", balls)}
    steady = {
        "error_tolerance": ("real", 1e-5), "error_floor": ("real", 1e-18),
        "refresh_iterations": ("whole", 3), "solver": ("steady_keys", {}),
    }  # fmt: skip
    found = {
        "sweep": swept | heard | steady | {
            "method": ("choice", "points"), "fields": ("flag", True),
            "phase_window": ("window", (0, 1)),
        },
        "find_modes": on | {"interval": ("window", (0.2, 0.7)), "shapes": ("flag", True)},
        "count_modes": swept,
        "project": swept | steady,
        "relax": on | heard | steady | {
            "law": ("law", pgran.BondLaw("uniform")), "omega": ("real", 0.5), "steps": ("whole", 5),
            "trajectories": ("whole", 2), "seed": ("whole", 4), "window": ("whole", 4),
            "method": ("choice", "krylov"),
        },
        "pulse": on | heard | {
            "shape": ("choice", "gauss"), "width": ("real", 8.0), "time": ("real", 120.0),
            "points": ("whole", 61), "method": ("choice", "laplace"), "fields": ("flag", True),
            "error_tolerance": ("real", 1e-3),
        },
        "sensitivity": swept | heard | {"most": ("whole", 3), "error_tolerance": ("real", 1e-5)},
        "heat": swept | heard | {
            "factor": ("real", 1.5), "balls": ("balls", balls), "cut": ("flag", True),
        },
        "loud": on | heard | {
            "lattice": ("medium", dataclasses.replace(lattice, hertz=1.0)),
            "amplitudes": ("omegas", [0.1, 0.2]), "omegas": ("omegas", omegas),
            "unit": ("choice", "overlap"), "reach": ("real", 2.0),
            "harmonics": ("whole", 3), "stability": ("flag", True), "certificate": ("flag", True),
        },
        "continuum": always | {
            "omegas": ("omegas", omegas), "point": ("point", (0.3, 0.6)), "mass": ("real", 2.0),
            "size": ("window", (0.8, 0.9)), "stiffness": ("real", 0.5),
        },
        "ensemble": always | heard | {
            "omegas": ("omegas", omegas), "lattice": ("samples", {"shape": (5, 4)}),
            "of": ("choice", "response"), "samples": ("whole", 3), "seed": ("whole", 7),
            "keep": ("choice", "curves"),
        },
        "Lattice": {
            "stiffness": ("bonds", lattice.stiffness), "mass": ("real", 2.0), "kmax": ("real", 0.2),
        },
        "Lattice.random": {
            "shape": ("shape", (5, 4)), "seed": ("whole", 4), "law": ("choice", "uniform"),
            "kmin": ("real", 0.1),
        },
        "Network": {
            "bond": ("contacts", [[0, 1], [1, 2], [2, 3]]), "held": ("contacts", [1, 0, 0, 2]),
            "stiffness": ("constants", [1.0, 2.0, 1.5]), "damping": ("real", 0.01),
            "displacement": ("choice", "scalar"),
        },
    }  # fmt: skip
    return {
        name: {key: (known[kind], value) for key, (kind, value) in given.items()}
        for name, given in found.items()
    }


def function_of(name):
    """Return what a name in pgran stands for."""
    found = pgran
    for part in name.split("."):
        found = getattr(found, part)
    return found


def called(name, arguments):
    """Return what a call gives, or raises."""
    signal.alarm(SECONDS)
    try:
        return function_of(name)(**arguments)
    except Exception as error:
        return error
    finally:
        signal.alarm(0)


def same(one, other):
    """Return whether two records hold the same, but for the time it took."""
    arrays = [
        {n: v.tobytes() for n, v in vars(record).items() if isinstance(v, np.ndarray)}
        for record in (one, other)
    ]
    return type(one) is type(other) and arrays[0] == arrays[1]


def case(number, seed, world, functions, known):
    """Carry out a call; return a verdict, and what to say of it."""
    rng = np.random.default_rng([seed, number])

    def pick(values):
        return values[rng.integers(len(values))]

    name = pick([n for n, given in functions.items() if world.size == 1 or "progress" in given])
    good = {key: value for key, (_, value) in functions[name].items()}
    key = (
        pick([*good, "unknown"]) if world.size == 1 else pick([k for k in good if k != "progress"])
    )
    kind = functions[name].get(key, (Kind([1]),))[0]
    changed, allowed = dict(good), False
    if world.size > 1:
        value = kind.other(good[key]) if rng.random() < 0.5 else pick(kind.wrong)
        if world.rank == number % world.size:
            changed[key] = value
    elif kind.clothes and rng.random() < 0.3:
        allowed, changed[key] = True, pick(kind.clothes)(good[key])
        value = changed[key]
    else:
        value = changed[key] = pick(kind.wrong)
    said = f"case {number}: {name}({key}={arguments.shown(value)})"
    found = called(name, changed)
    if allowed and name not in known:
        known[name] = called(name, good)
    if isinstance(found, pgran.InputError) and not allowed:
        return "refused", f"{said}: {found}"
    if allowed and not isinstance(found, Exception) and same(found, known[name]):
        return "accepted", said
    return "wrong", f"{said}: {type(found).__name__}: {found}"


def main(words):
    """Carry out a campaign; print a line for what is wrong, and one for all. Collective."""
    count, seed = int(words[0]), int(words[1]) if words[1:] else 1
    world, functions, known, tally = MPI.COMM_WORLD, cases(), {}, Counter()
    for number in range(count):
        everyone = world.allgather(case(number, seed, world, functions, known))
        verdict, said = max(everyone, key=lambda found: VERDICTS.index(found[0]))
        tally[verdict] += 1
        if world.rank == 0 and (verdict == "wrong" or "-v" in words):
            print(f"{verdict}: {said}", flush=True)
    if world.rank == 0:
        found = ", ".join(f"{tally[verdict]} {verdict}" for verdict in VERDICTS)
        print(f"{count} calls, seed {seed}, {world.size} ranks: {found}", flush=True)
    return int(tally["wrong"] > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
