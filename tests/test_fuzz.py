"""Short campaigns of jobs/fuzz.py: damaged and malicious files. Serial run only."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = Path(__file__).resolve().parent.parent / "jobs" / "fuzz.py"


@pytest.mark.parametrize(("campaign", "cases"), [("options", 40), ("hdf5", 30)])
def test_no_file_does_harm(clean_environment, tmp_path, campaign, cases):
    done = subprocess.run(
        [sys.executable, str(PROGRAM), campaign, str(cases)],
        cwd=tmp_path,
        env=clean_environment | {"PYTHONPATH": str(PROGRAM.parent.parent)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert len(done.stdout.splitlines()) == 1
    said = re.fullmatch(
        r"(\w+): (\d+) cases, seed 1: (\d+) refused.*, (\d+) accepted.*", done.stdout.strip()
    )
    name, made, refused, accepted = said.groups()
    assert (name, int(made)) == (campaign, cases)
    assert int(refused) + int(accepted) == cases
    assert int(refused) > cases // 3
    assert int(accepted) > 0
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize(
    ("sabotage", "cases", "said"),
    [
        ("store.check_seal = lambda path: None", 6, "wrongly accepted"),
        ("store.load = lambda path: os.kill(os.getpid(), 11)", 2, "crashes"),
        ("store.load = lambda path: 1 / 0", 2, "tracebacks"),
        ("store.load = lambda path: bytearray(6 * 10**8)", 1, "too large"),
    ],
)
def test_a_campaign_notices(clean_environment, tmp_path, sabotage, cases, said):
    program = (
        f"import os, runpy, sys; from pgran.files import store; {sabotage}; "
        f"sys.argv = ['fuzz.py', 'hdf5', '{cases}', '3']; "
        f"runpy.run_path({str(PROGRAM)!r}, run_name='__main__')"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=tmp_path,
        env=clean_environment | {"PYTHONPATH": str(PROGRAM.parent.parent)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 1
    assert int(re.search(rf"(\d+) {said}", done.stdout).group(1)) > 0
    assert list((tmp_path / "results" / "fuzz").glob("hdf5-3-*.h5"))
