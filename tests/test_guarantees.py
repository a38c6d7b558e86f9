"""A few random cases of all that is guaranteed, and that each fault is noticed."""

from collections import Counter
from dataclasses import replace

import amplitude_faults
import growth_faults
import mode_faults
import numpy as np
import opening_faults
import packing_faults
import pattern_faults
import pytest
from guarantees import GUARANTEES, carry_out

from pgran.driven import accuracy
from pgran.experiments.modes import density


@pytest.mark.parametrize("name", GUARANTEES)
def test_random_cases(world, name):
    """On each rank others: nothing is false, and enough is good."""
    guarantee, seen = GUARANTEES[name], Counter()
    mine = range(world.rank, guarantee.few, world.size)
    assert list(carry_out(name, mine, seen, guarantee.changed)) == []
    seen = sum(world.allgather(seen), Counter())
    for name, part, of in guarantee.most:
        assert seen[name] >= part * seen[of] > 0, seen


@pytest.mark.parametrize("name", [name for name in GUARANTEES if GUARANTEES[name].shared])
def test_random_cases_that_ranks_share(world, name):
    if world.size == 1:
        pytest.skip("one rank alone has tried others")
    guarantee = GUARANTEES[name]
    for seed in guarantee.shared:
        assert list(guarantee.faults(guarantee.case(seed), Counter(), world)) == []


def too_small(state):
    """Bounds and numbers as they must not be."""
    state.displacement[:] *= 1 + 1e-9
    state.error_bound[:] *= 1e-9
    return state


ASSESSED = accuracy.Accuracy, "assess", too_small
SPOILT = {  # of each kind of numbers what is computed, and how it is spoilt; or `ASSESSED`
    "frequencies alone": (
        amplitude_faults, "response_of",
        lambda run: replace(run, displacement=run.displacement * (1 + 1e-15 * len(run.omega))),
    ),
    "laws, forces": (amplitude_faults, "exact_network_force", lambda force: 1.01 * force),
    "forces": (amplitude_faults, "exact_network_force", lambda force: 1.01 * force),
    "green": (
        pattern_faults.PatternSolver, "products", lambda found: ((1 + 1e-9) * found[0], found[1])
    ),
    "curves": (
        amplitude_faults, "swept", lambda run: replace(run, displacement=1.02 * run.displacement)
    ),
    "points": (
        amplitude_faults, "swept",
        lambda run: replace(run, line_error=np.zeros_like(run.line_error)),
    ),
    "relaxations": (amplitude_faults, "relaxed", too_small),
    "long relaxations": (amplitude_faults, "relaxed", too_small),
    "pulses": (
        amplitude_faults, "listened", lambda run: replace(run, displacement=1.01 * run.displacement)
    ),
    "growing balls": (
        growth_faults, "heated", lambda run: replace(run, warmed=(1 + 1e-7) * run.warmed)
    ),
    "packings": (
        packing_faults, "packed_network",
        lambda made: (replace(made[0], force=(1 + 1e-10) * made[0].force), made[1]),
    ),
    "nearest modes": (
        mode_faults, "nearest_modes", lambda found: found and (*found[:2], found[2][:-1]),
    ),
    "openings": (
        opening_faults.Openings, "at", lambda found: ([1.02 * end for end in found[0]], *found[1:])
    ),
    "modes": (mode_faults, "find_modes", lambda modes: replace(modes, omega=modes.omega[1:])),
    "counts": (density, "count_below", lambda found: (found[0] + 1, 0.0)),
}  # fmt: skip


@pytest.mark.parametrize("name", GUARANTEES)
def test_what_is_wrong_is_noticed(monkeypatch, name):
    place, attribute, spoil = SPOILT.get(name, ASSESSED)
    right = getattr(place, attribute)
    monkeypatch.setattr(place, attribute, lambda *given, **by: spoil(right(*given, **by)))
    fault = next(carry_out(name, range(9), Counter(), GUARANTEES[name].changed))
    assert not fault.startswith("RAISED")
