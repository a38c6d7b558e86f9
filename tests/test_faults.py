"""A short form of the fault campaign (jobs/faults.py), and the batch script of a cluster."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc

from pgran.__main__ import explain
from pgran.parallel.agreement import who_reports
from pgran.parallel.journal import Journal

HERE = Path(__file__).resolve().parent.parent / "jobs"


# Which rank reports


@pytest.mark.parametrize("same", [True, False])
def test_one_rank_reports_what_several_meet(world, same):
    comm = world.Dup()
    first, alike = who_reports(comm, "no such file" if same else f"rank {comm.rank}")
    assert len(set(world.allgather(first))) == 1
    assert alike == (same or world.size == 1)
    comm.Free()


def test_a_rank_that_fails_alone_does_not_wait_for_ever(world):
    comm, last = world.Dup(), world.size - 1
    if world.rank == last:
        assert who_reports(comm, "mine") == (last, world.size == 1)
    world.Barrier()
    if world.rank != last:  # who fails later leaves the word to the first
        first, alike = who_reports(comm, "mine too")
        assert first == last
        assert not alike
    world.Barrier()
    comm.Free()


# What is said


def test_an_error_in_a_callback_is_told():
    """Newer PETSc raises an error of its own, with Python's as its cause."""
    error = PETSc.Error(101)
    error.__cause__ = RuntimeError("planted")
    code, text = explain(error)
    assert code == 1
    assert "RuntimeError: planted" in text


# Trials of the campaign


@pytest.fixture
def faults(clean_environment, tmp_path, monkeypatch):
    """Return the module of the campaign, and a campaign of its own folder."""
    monkeypatch.syspath_prepend(str(HERE))
    for name in set(os.environ) - set(clean_environment):
        monkeypatch.delenv(name)
    for name, value in clean_environment.items():
        monkeypatch.setenv(name, value)
    import campaign
    import faults

    return faults, campaign.Campaign(tmp_path, short=True)


@pytest.mark.parametrize("kind", ["exception", "segfault", "journal", "writing"])
def test_a_fault_of_one_rank(faults, kind):
    module, campaign = faults
    module.one_kind(campaign, (kind, 2, 0))
    assert campaign.failures == 0


def test_a_killed_run_goes_on(faults):
    module, campaign = faults
    campaign.make_reference("krylov", module.SCENES["krylov"])
    module.one_kill(campaign, list(module.SCENES).index("krylov"))
    assert campaign.failures == 0


def test_the_campaign_notices_what_is_wrong(faults, tmp_path):
    """A result with another bit, and a journal that was cut off."""
    module, _ = faults
    for name in "ab":
        with h5py.File(tmp_path / name, "w") as file:
            file["x"] = [1.0, 2.0 if name == "a" else 2.0 + 2**-51]
            file.attrs["seconds"] = ord(name)
    assert module.differences(tmp_path / "a", tmp_path / "b") == ["x"]
    assert module.differences(tmp_path / "a", tmp_path / "a") == []
    journal = tmp_path / "c"
    with Journal(MPI.COMM_SELF, tmp_path / "c", {}) as it:
        for position in range(3):
            it.write(1, position, np.arange(4))
        whole = it.path.read_bytes()
    for cut, units in ((0, 3), (1, 2), (1000, 0)):
        journal.write_bytes(whole[: max(0, len(whole) - cut)])
        assert module.held(journal) == units
    journal.write_bytes(b"something else")
    assert module.held(journal) == -1


# The batch script


STUBS = {
    "jobs/setup.sh": "",
    "bin/mpirun": 'shift 2\nexec "$@"\n',
    "bin/srun": 'exec "$@"\n',
    "bin/pgran": f'exec {sys.executable} -m pgran "$@"\n',
    "bin/scontrol": 'echo "$@" >>requeued\n',
}
LONG = "-scene relaxation\n-lattice_damping .01\n-relax_method krylov\n-relax_window 16\n"


@pytest.fixture
def batch(clean_environment, tmp_path):
    """Return what starts the batch script as Slurm would."""
    for name, text in STUBS.items():
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(f"#!/usr/bin/env bash\n{text}")
        path.chmod(0o755)
    (tmp_path / "a.opts").write_text(LONG)

    def start(*words, **variables):
        environment = clean_environment | variables
        environment |= {"PATH": f"{tmp_path}/bin:{environment['PATH']}", "SLURM_JOB_ID": "17"}
        environment |= {"SLURM_SUBMIT_DIR": str(tmp_path), "SLURM_NTASKS": "1"}
        return subprocess.Popen(
            ["bash", HERE / "slurm" / "pgran.sbatch", "a.opts", *words],
            env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip

    return start


def wait_for(path, size):
    deadline = time.monotonic() + 30
    while time.monotonic() < deadline:
        if path.exists() and path.stat().st_size > size:
            return
        time.sleep(0.01)
    pytest.fail(f"no {path}")


def test_a_batch_job_goes_back_into_the_queue_and_goes_on(batch, tmp_path):
    words = ["-relax_steps", "4000", "-output_file", "b.h5"]
    job = batch(*words)
    wait_for(tmp_path / "b.h5.unfinished", 5000)
    job.send_signal(signal.SIGUSR1)
    said = job.communicate(timeout=60)[0]
    assert job.returncode == 75, said
    assert "stopped by SIGUSR1" in said
    assert (tmp_path / "requeued").read_text() == "requeue 17\n"
    assert not (tmp_path / "b.h5").exists()

    job = batch(*words, PGRAN_LAUNCH="srun")
    said = job.communicate(timeout=60)[0]
    assert job.returncode == 0, said
    assert "going on from there" in said
    assert (tmp_path / "b.h5").exists()
    assert not (tmp_path / "b.h5.unfinished").exists()

    job = batch(*words)
    assert job.communicate(timeout=60)[0] == "b.h5 is there already: nothing to do\n"
    assert job.returncode == 0
    assert (tmp_path / "requeued").read_text() == "requeue 17\n"


def test_a_batch_job_that_gets_nowhere_is_not_put_back(batch, tmp_path):
    (tmp_path / "bin" / "pgran").write_text("#!/usr/bin/env bash\nexit 75\n")
    job = batch()
    assert "needs a longer --time" in job.communicate(timeout=60)[0]
    assert job.returncode == 75
    assert not (tmp_path / "requeued").exists()


def test_a_batch_job_that_fails_says_so(batch, tmp_path):
    job = batch("-relax_step", "5000")
    said = job.communicate(timeout=60)[0]
    assert job.returncode == 2
    assert "did you mean -relax_steps?" in said
    assert not (tmp_path / "requeued").exists()
