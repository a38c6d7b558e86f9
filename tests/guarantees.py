"""What is guaranteed of numbers, by name: random cases from seeds, and what is false of them.

`GUARANTEES` has, for each kind of numbers, what makes a case from a seed, and what solves it and
yields its faults: bounds below errors, numbers that are wrong and pass, what ranks or neighbours
change. It counts what was seen. tests/test_guarantees.py tries some cases of each,
tests/campaigns/guarantees.py as many as are asked for. References are those of tests/reference.py
and its likes.
"""

import dataclasses
from collections.abc import Callable, Iterable

from amplitude_faults import (
    curve_faults,
    dependence_faults,
    force_faults,
    network_faults,
    pulse_faults,
    relaxation_faults,
    sweep_faults,
)
from change_faults import sensitivity_faults
from growth_faults import growth_faults, random_growth
from law_samples import lawful_network
from mode_faults import count_faults, mode_faults, nearest_faults
from network_samples import random_network, small_network, unstable_network
from opening_faults import opening_faults, random_overlaps
from packing_faults import packing_faults, random_packing
from pattern_faults import pattern_faults, random_patterns
from samples import (
    long_relaxation,
    random_case,
    random_curve,
    random_points,
    random_pulse,
    random_relaxation,
)
from sensitivity_samples import lawful_sensitivity, random_sensitivity
from source_faults import random_source, source_faults


@dataclasses.dataclass(frozen=True)
class Guarantee:
    """A case from a seed, the faults of a case, and what the tests try of it.

    They try `few` seeds, of cases `changed`; `most` tells of what was seen which is at least which
    part of which. `shared` are the seeds of cases that all ranks solve together.
    """

    case: Callable
    faults: Callable
    few: int
    most: tuple = ()
    changed: dict = dataclasses.field(default_factory=dict)
    shared: Iterable = ()


def good(part, of="amplitudes"):
    """Return that so large a part is good."""
    return (("good", part, of),)


GUARANTEES = {
    "sweeps": Guarantee(
        random_case, sweep_faults, 28, good(0.6), shared=(5, 6, 16, 22, 33, 39, 41, 50)
    ),
    "frequencies alone": Guarantee(random_case, dependence_faults, 12, good(0.5, "frequencies")),
    "sources": Guarantee(random_source, source_faults, 10, good(0.5)),
    "networks": Guarantee(random_network, network_faults, 12, good(0.5), shared=range(100, 106)),
    "laws": Guarantee(lawful_network, network_faults, 6, good(0.5), shared=range(2)),
    "laws, forces": Guarantee(lawful_network, force_faults, 3, (("bounded", 0.5, "forces"),)),
    "forces": Guarantee(small_network, force_faults, 9, (("bounded", 0.5, "forces"),)),
    "green": Guarantee(random_patterns, pattern_faults, 6, good(0.5, "pairs"), shared=range(3)),
    "curves": Guarantee(random_curve, curve_faults, 1, (("accurate", 1, "points"),), {"count": 9}),
    "points": Guarantee(random_points, curve_faults, 1, (), {"count": 9}),
    "relaxations": Guarantee(random_relaxation, relaxation_faults, 6, good(0.9)),
    "long relaxations": Guarantee(
        long_relaxation, relaxation_faults, 8, good(1), {"steps": 8, "count": 1}
    ),
    "pulses": Guarantee(random_pulse, pulse_faults, 3, (("bounded", 1, "numbers"),)),
    "derivatives": Guarantee(
        random_sensitivity, sensitivity_faults, 5,
        (*good(0.5, "points"), ("warmed bounded", 0.5, "warmed"), ("cut bounded", 0.5, "cut")),
    ),
    "laws, derivatives": Guarantee(lawful_sensitivity, sensitivity_faults, 3),
    "growing balls": Guarantee(
        random_growth, growth_faults, 2,
        (("warmed bounded", 0.5, "warmed"), ("by_radius bounded", 0.5, "by_radius")),
    ),
    "openings": Guarantee(
        random_overlaps, opening_faults, 8, (("sharp", 0.5, "drives"),), shared=range(100, 104)
    ),
    "modes": Guarantee(random_network, mode_faults, 12, (("certified", 1, "networks"),)),
    "packings": Guarantee(random_packing, packing_faults, 2),
    "nearest modes": Guarantee(random_network, nearest_faults, 14, (("proven", 0.2, "targets"),)),
    "counts": Guarantee(unstable_network, count_faults, 10, (("certified", 1, "counts"),)),
}  # fmt: skip


def carry_out(name, seeds, seen, changed=None):
    """Yield what is false of the cases of some seeds, errors among it; count what was `seen`."""
    guarantee = GUARANTEES[name]
    for seed in seeds:
        try:
            case = dataclasses.replace(guarantee.case(seed), **changed or {})
            yield from guarantee.faults(case, seen)
        except Exception as error:
            yield f"RAISED case {seed}: {type(error).__name__}: {error}"
