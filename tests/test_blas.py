"""One thread for linear algebra, unless the user has chosen; the kernel that runs is named."""

import os
import re
import sys
from pathlib import Path

import h5py
import pytest

from pgran.run import machine

ASKED = "; import scipy.linalg as s; from pgran.run.machine import ask_blas as ask; "
ASKED += "print(*ask('get_num_threads'))"
FREE = [word for name in machine.THREADS for word in ("-u", name)]  # nothing is chosen


@pytest.mark.parametrize("imports", ["import pgran, numpy", "import numpy, pgran"])
@pytest.mark.parametrize("chosen", ["", "OMP_NUM_THREADS=2", "OPENBLAS_NUM_THREADS=2"])
def test_threads(start, imports, chosen):
    """Of every OpenBLAS that is loaded by then, whatever is imported first."""
    if not machine.ask_blas("get_num_threads"):
        pytest.skip("no OpenBLAS here")
    done = start(program=["env", *FREE, *chosen.split(), sys.executable, "-c", imports + ASKED])
    found = {int(number) for number in done.stdout.split()}
    assert found == {min(2 if chosen else 1, os.cpu_count())}, done.stderr


def test_a_result_names_the_kernel(start, shared_path):
    """That which was asked for."""
    if " avx2 " not in Path("/proc/cpuinfo").read_text():
        pytest.skip("this processor cannot run it")
    done = start("run", "a.opts", "-output_file", "a.h5", OPENBLAS_CORETYPE="Haswell")
    assert done.returncode == 0, done.stderr
    with h5py.File(shared_path / "a.h5") as file:
        named = file.attrs["blas_kernel"]
    assert re.search("haswell|unknown", named, re.IGNORECASE)
