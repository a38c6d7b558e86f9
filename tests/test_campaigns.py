"""The campaigns in short, and that they notice what is wrong. Serial run only.

`bash jobs/faults.sh` and `bash jobs/stability.sh` carry part of them out in full.
"""

import copy
import dataclasses
import logging
import os
import re
import runpy
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest
from campaigns import abuse, changes, estimates, faults, fuzz, stability, units
from mpi4py import MPI

import pgran
from pgran.command.resolve import SCENES
from pgran.run.journal import Journal
from pgran.store.estimate import Estimate

FOLDER = Path(__file__).parent / "campaigns"
# How little each of them can do, in words of its own; the others are called by the tests below, and
# by those of jobs/.
SHORT = {
    "comparison": "400 9,11",
    "damped": "13 15",
    "guarantees": "sweeps 1 2",
    "jamming": "2 80 2 1",
    "moments": "0 12",
    "loud": "0 2 40 44",
    "slopes": "1 1",
    "units": "7 8 1",
}
CALLED = {"abuse", "changes", "estimates", "faults", "fuzz", "inject", "stability"}


@pytest.fixture(autouse=True)
def own_environment(clean_environment, monkeypatch):
    """Let programs start as if from a shell: what MPI has put into the environment is not there."""
    for name in set(os.environ) - set(clean_environment):
        monkeypatch.delenv(name)
    for name, value in clean_environment.items():
        monkeypatch.setenv(name, value)


def test_no_campaign_is_forgotten():
    assert {path.stem for path in FOLDER.glob("*.py")} == {*SHORT, *CALLED}
    assert fuzz.TINY.keys() == SCENES.keys()  # each can be run


@pytest.mark.parametrize("name", SHORT)
def test_a_campaign_in_short(name, monkeypatch, capsys):
    """As a program, which says what it has found, and nothing false."""
    monkeypatch.setattr(sys, "argv", [f"{name}.py", *SHORT[name].split()])
    monkeypatch.setattr(logging.root.manager, "disable", logging.NOTSET)  # some disable it
    code = 0
    try:
        runpy.run_path(str(FOLDER / f"{name}.py"), run_name="__main__")
    except SystemExit as ended:
        code = int(ended.code or 0)
    said = capsys.readouterr().out
    assert code == 0, said
    assert re.search(r"\d", said)
    assert not re.search("BROKEN|WRONG|RAISED|FAILED|differs", said), said


def test_faults_do_no_harm(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    # both of one scene, whose run that nothing disturbs serves them
    failed = faults.carry_out(faults.plant, [43]) + faults.carry_out(faults.stop, [67])
    said = capsys.readouterr().out
    assert failed == 0, said
    assert "1 kill" in said
    assert "SIGTERM" in said


def test_a_file_that_changes_does_no_harm(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert faults.carry_out(changes.change, [13]) == 0, capsys.readouterr().out
    assert "network_file, " in capsys.readouterr().out


def test_the_fault_campaign_notices_what_is_wrong(tmp_path, monkeypatch, capsys):
    """A result with another bit, a journal that was cut off, and one that is not gone on with."""
    monkeypatch.chdir(tmp_path)
    for name, last in (("a", 2.0), ("b", 2.0), ("c", 2.0 + 2**-51)):
        with h5py.File(name, "w") as file:
            file["x"] = [1.0, last]
            file.attrs["seconds"] = ord(name)
    assert faults.contents("a") == faults.contents("b") != faults.contents("c")

    folder = faults.make_folder("response")
    with Journal(MPI.COMM_SELF, folder / faults.RESULT, {}) as journal:
        for position in range(3):
            journal.write(1, position, np.arange(4))
        whole = journal.path.read_bytes()
    for cut, left in ((1, 2), (1000, 0), (0, 3)):
        (folder / faults.JOURNAL).write_bytes(whole[: max(0, len(whole) - cut)])
        assert faults.units_kept(folder) == left
    assert faults.carry_out(lambda number: faults.go_on(folder, "response", 1), [7]) == 1
    assert "exit code 2 when going on" in capsys.readouterr().out
    (folder / faults.JOURNAL).write_bytes(b"something else")
    with pytest.raises(AssertionError, match="unreadable"):
        faults.units_kept(folder)


def test_no_file_does_harm(tmp_path):
    tests = str(Path(__file__).parent)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([tests, str(fuzz.FOLDER)])}
    done = subprocess.run(
        [sys.executable, "-m", "campaigns.fuzz", "7"],
        cwd=tmp_path, env=environment, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    found = re.findall(r"7 cases, seed 1: (\d+) refused, (\d+) accepted", done.stdout)
    assert len(found) == 2
    refused, accepted = ([int(count) for count in counts] for counts in zip(*found, strict=True))
    assert all(refused)
    assert any(accepted)
    assert not (tmp_path / "results").exists()


@pytest.mark.filterwarnings("ignore:.*fork")  # the child does not wait for MPI's threads
@pytest.mark.parametrize(
    ("read", "verdict", "seconds"),
    [
        (lambda path: os.kill(os.getpid(), 9), "ended", 30),
        (lambda path: time.sleep(99), "ended", 1),
        (lambda path: 1 / 0, "untidy", 30),
        (lambda path: ([len(6 * 10**8 * b"x") * np.zeros(2)], None), "memory", 30),
        (lambda path: ([np.array([1.0, -1.0])], None), "wrong", 30),
    ],
)
def test_fuzzing_notices(tmp_path, monkeypatch, capsys, read, verdict, seconds):
    def make(folder, rng):
        (folder / "case.h5").write_bytes(b"no HDF5")
        return folder / "case.h5", False, (1,)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(fuzz, "SECONDS", seconds)
    monkeypatch.setattr(fuzz, "read_bonds", read)
    assert fuzz.campaign("bonds", make, fuzz.check_bonds, 1, 3) == 1
    assert f" 1 {verdict}" in capsys.readouterr().out
    assert (tmp_path / "results" / "fuzz" / "bonds-3-0.h5").read_bytes() == b"no HDF5"


def test_what_depends_on_units_is_noticed(monkeypatch, capsys):
    """And a function that has no row, or computes nothing."""
    monkeypatch.setattr(logging.root.manager, "disable", logging.NOTSET)
    monkeypatch.setattr(units, "ROWS", {"sound": (lambda c: c.top,), "pack": (lambda c: [],)})
    others = set(pgran.__all__) - units.NOT_COMPUTING - {"sound", "pack"}
    assert units.main(1, 2, 1) == 3 + len(others)  # of three media
    assert "green has never computed anything" in capsys.readouterr().out


@pytest.mark.parametrize("ranks", [0, 2])
def test_no_call_does_harm(start, ranks):
    words, calls = (sys.executable, "-m", "campaigns.abuse"), 40 if ranks else 160
    done = start(
        str(calls), "25", ranks=ranks, program=words, PYTHONPATH=str(Path(__file__).parent)
    )
    assert done.returncode == 0, done.stdout + done.stderr
    refused, accepted = map(int, re.findall(r"(\d+) (?:refused|accepted)", done.stdout))
    assert refused + accepted == calls
    assert ranks or 20 < accepted < refused


@pytest.mark.parametrize(
    "function",
    [
        lambda **given: 1 / 0,
        lambda **given: pgran.find_modes(abuse.cases()["sweep"]["lattice"][1]),
        lambda **given: abuse.Odd(),
    ],
)
def test_abuse_notices(monkeypatch, capsys, function):
    """Another error, and what a wrong call computes."""
    monkeypatch.setattr(abuse, "function_of", lambda name: function)
    assert abuse.main(["8"]) == 1
    assert re.search("0 refused, [0-3] accepted, [5-8] wrong", capsys.readouterr().out)


def test_estimates_are_judged(monkeypatch, capsys):
    """From end to end in small, with an exit code; and what is wrong is noticed."""
    monkeypatch.setattr(sys, "argv", ["estimates.py", "2"])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(estimates.__file__, run_name="__main__")
    said = capsys.readouterr().out
    assert ended.value.code in (0, 1)  # two repeats tell nothing more
    assert bool(ended.value.code) == (not said.endswith("\n0 fail\n"))
    assert said.count("withheld") == 7  # of 8, 20, 40 samples 3, 2, 2

    rng = np.random.default_rng(1)
    for bias, claim, failures in ((0, 1, 0), (0.6, 1, 1), (0, 0.6, 1), (0, 2, 1)):
        made = [Estimate(1 + bias + x, claim) for x in rng.standard_normal(400)]
        assert estimates.judge("", {"x": made}, {"x": 1.0}) == failures


def test_every_extreme_case_says_what_must_come_out():
    for path in stability.FILES.values():
        assert stability.options_of(path).scene in stability.SCENES, path
        assert set() < stability.musts(path) <= {"accurate", "marked", "refused"}, path


@pytest.mark.parametrize("name", ["modes_interval_ends", "overflow", "resonance_undamped"])
def test_an_extreme_case_comes_out_as_it_must(name):
    path = stability.FILES[name]
    assert stability.judge(path, stability.start(path))[2] == []


def test_judging_finds_every_fault():
    path = stability.FILES["ball_2d"]
    run = stability.start(path)
    assert stability.judge(path, run)[2] == []
    for change, fault in (
        (lambda r: r.displacement.__imul__(1 + 1e-3), "above bound"),
        (lambda r: (r.displacement.__imul__(2), r.error_bound.fill(9)), "not marked"),
        (lambda r: r.displacement.__imul__(np.nan), "not marked"),
        (lambda r: (r.at_floor.fill(True), r.error_bound.fill(1.0)), "bound of"),
        (lambda r: r.converged_reason.fill(0), "came out {'marked'}"),
        (lambda r: r.converged_reason.__setitem__(0, 0), "nothing said"),
    ):
        result = copy.deepcopy(run.result)
        change(result.response)
        faults = stability.judge(path, dataclasses.replace(run, result=result))[2]
        assert any(fault in said for said in faults), (fault, faults)
    for said, fault in (
        ({"code": 3}, "exit code 3"),
        ({"code": 124, "result": None}, "nothing, code 124"),
        ({"said": "RuntimeWarning"}, "RuntimeWarning"),
    ):
        faults = stability.judge(path, dataclasses.replace(run, **said))[2]
        assert any(fault in said for said in faults), (fault, faults)
