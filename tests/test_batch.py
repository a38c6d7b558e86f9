"""The batch script of a cluster, with stubs in place of Slurm and mpirun. Serial run only."""

import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

JOBS = Path(__file__).resolve().parents[1] / "jobs" / "slurm"
STUDY = {"script": "study", "steps": ("1000", "3000"), "SLURM_ARRAY_TASK_ID": "2"}
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

    def start(script="pgran", steps=("3000",), **variables):
        environment = clean_environment | variables
        environment |= {"PATH": f"{tmp_path}/bin:{environment['PATH']}", "SLURM_JOB_ID": "17"}
        environment |= {"SLURM_SUBMIT_DIR": str(tmp_path), "SLURM_NTASKS": "1"}
        return subprocess.Popen(
            ["bash", JOBS / f"{script}.sbatch", "a.opts", "-output_file", "b.h5",
             "-relax_steps", *steps],
            env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip

    return start


def ended(job):
    """What it said in all, once it has ended."""
    return job.communicate(timeout=60)[0]


@pytest.mark.parametrize(("asked", "result"), [({}, "b.h5"), (STUDY, "b-steps_3000.h5")])
def test_a_batch_job_goes_back_into_the_queue_and_goes_on(batch, tmp_path, asked, result):
    job, journal = batch(**asked), tmp_path / f"{result}.unfinished"
    deadline = time.monotonic() + 30
    while not (journal.exists() and journal.stat().st_size > 5000):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    job.send_signal(signal.SIGUSR1)
    assert "stopped by SIGUSR1" in ended(job)
    assert job.returncode == 75
    assert (tmp_path / "requeued").read_text() == "requeue 17\n"
    assert not (tmp_path / result).exists()

    job = batch(PGRAN_LAUNCH="srun", **asked)
    said = ended(job)
    assert "going on from there" in said
    assert re.search("solved by .*iterations, since it went on\n", said)
    assert job.returncode == 0
    assert not journal.exists()

    job = batch(**asked)
    assert re.fullmatch(rf".*{result}:? is there already(: nothing to do)?\n", ended(job))
    assert job.returncode == 0
    assert (tmp_path / "requeued").read_text() == "requeue 17\n"


@pytest.mark.parametrize(("code", "said"), [(75, "needs a longer --time"), (2, "")])
def test_a_batch_job_that_gets_nowhere_is_not_put_back(batch, tmp_path, code, said):
    (tmp_path / "bin" / "pgran").write_text(f"#!/usr/bin/env bash\nexit {code}\n")
    job = batch()
    assert said in ended(job)
    assert job.returncode == code
    assert not (tmp_path / "requeued").exists()
