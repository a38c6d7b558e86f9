"""The extreme cases of options/extreme: each file, the quickest runs, and the judging itself.

`bash jobs/stability.sh` runs all of them on one and two ranks with several solvers.
"""

import copy
import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[1] / "jobs"))

import stability

OUTCOMES = {"accurate", "marked", "refused"}
QUICK = (
    "bonds_zero_undamped", "continuum_resonance", "modes_interval_ends",
    "relaxation_resonance", "resonance_undamped",
)  # fmt: skip


def named(name):
    (path,) = (path for path in stability.FILES if path.stem == name)
    return path


@pytest.mark.parametrize("path", stability.FILES, ids=lambda path: path.stem)
def test_every_file_resolves_and_says_what_must_come_out(path):
    assert stability.options_of(path).scene in stability.SCENES
    outcomes, other = stability.musts(path)
    assert outcomes
    assert outcomes <= OUTCOMES
    assert other is None or (path.parent / other).exists()
    assert path.read_text().startswith("# ")


@pytest.mark.parametrize("name", QUICK)
def test_comes_out_as_it_must(name, clean_environment, tmp_path):
    run = stability.start(named(name), "default", 1, [], tmp_path, clean_environment)
    assert stability.judge(named(name), run).faults == []


def spoilt(change):
    """Return what carries out a change on a copy of a run's response."""

    def spoil(run):
        result = copy.deepcopy(run.result)
        change(result.response)
        return dataclasses.replace(run, result=result)

    return spoil


def test_judging_finds_every_fault(clean_environment, tmp_path):
    path = named("ball_2d")
    run = stability.start(path, "default", 1, [], tmp_path, clean_environment)
    assert stability.judge(path, run).faults == []
    for spoil, fault in (
        (spoilt(lambda r: r.displacement.__imul__(1 + 1e-3)), "not marked"),
        (spoilt(lambda r: r.displacement.__imul__(np.nan)), "not marked"),
        (spoilt(lambda r: r.displacement.__imul__(1 + 1e-9)), "above bound"),
        (spoilt(lambda r: r.error_bound.fill(0.0)), "above bound"),
        (spoilt(lambda r: r.converged_reason.fill(0)), "came out marked"),
        (spoilt(lambda r: r.converged_reason.__setitem__(0, 0)), "nothing said"),
        (lambda run: dataclasses.replace(run, code=3), "exit code 3, not 0"),
        (lambda run: dataclasses.replace(run, code=stability.TIMED_OUT), "not done"),
        (lambda run: dataclasses.replace(run, said="RuntimeWarning"), "RuntimeWarning"),
        (lambda run: dataclasses.replace(run, code=2, result=None), "exit code 2, no result"),
    ):
        faults = stability.judge(path, spoil(run)).faults
        assert any(fault in said for said in faults), (fault, faults)
