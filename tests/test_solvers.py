"""What PETSc's own keys show and change on the default path, and what a summary counts."""

import re
from functools import partial

import numpy as np
import pytest
from samples import random_lattice

import pgran
from pgran.run import petsc

LATTICE, OMEGAS = random_lattice((6, 5), 3), np.linspace(0.1, 1.0, 40)
PRINTING = "-steady_ksp_view -steady_ksp_monitor -steady_ksp_converged_reason -log_view"


@pytest.mark.parametrize(
    ("ranks", "kind", "keys", "parts"),
    [(0, "bcgs", "", "models"), (2, "gmres", "-steady_ksp_type gmres -sweep_method points", "")],
)
def test_a_ksp_can_be_watched(start, shared_path, ranks, kind, keys, parts):
    """Without the guess by the preconditioner it takes one iteration for each right-hand side."""
    done = start("run", "a.opts", *f"{PRINTING} {keys} -steady_ksp_knoll 0".split(), ranks=ranks)
    assert done.returncode == 0, done.stderr
    said = re.search(rf"KSP {kind}, PC cholesky \(petsc\): (\d+) .*, (\d+) iter", done.stderr)
    assert int(said[1]) == pgran.load(shared_path / "results" / "a.h5").response.factorizations
    for printed in ("KSP Object: (steady_)", f"  type: {kind}", "CONVERGED_RTOL iterations 1"):
        assert 0 <= int(said[2]) - done.stdout.count(printed) <= 8 * ranks  # mpirun cuts lines
    assert re.search(r"\n +1 KSP Residual norm", done.stdout)
    for rank in range(ranks or 1):
        assert re.search(rf"rank {rank}, .*, adjoint of ball \(2, 3\): .*fresh", done.stdout)
    for part in ("assembly", "factors", "states", "bounds", *parts.split()):
        assert re.search(rf"\n \d+: +{part}: \d.*\npgran:{part} +\d", done.stdout, re.DOTALL)
    assert ("by -sweep_method points at each" in done.stderr) == bool(parts)


@pytest.mark.parametrize("method", ["points", "curve"])
def test_keys_of_the_ksp_act(world, method, caplog):
    """It solves where factors alone would do, and bounds hold; all that ranks did is counted."""
    petsc.work.clear()
    keys = {"steady_ksp_type": "gmres", "steady_ksp_knoll": "false"}
    sweep = partial(pgran.sweep, LATTICE, OMEGAS, [3, 2], method=method, resolve=0)
    one, other = sweep(), sweep(solver=keys)
    bound = one.error_bound + other.error_bound
    assert np.all(np.abs(other.displacement - one.displacement) <= bound)
    done = petsc.work_done(world)[1]
    assert f"KSP gmres, PC cholesky (petsc): {other.factorizations} factorizations, " in done
    assert method == "curve" or f" {other.iterations.sum()} iterations" in done
    assert "not used" not in caplog.text


@pytest.mark.parametrize(("kind", "keys"), [("EPS", ""), ("PEP", "-modes_damped true")])
def test_searches_for_modes_can_be_watched(start, place, kind, keys):
    """Also of a lattice so small that LAPACK would be faster."""
    name = "damped_pep" if keys else "normal_eps"
    place("m.opts", f"-scene modes -lattice_shape 6,5 -modes_target .5 -modes_count 3 {keys}")
    done = start("run", "m.opts", *(f"-{name}_{key}" for key in ("view", "monitor")))
    assert f"{kind} Object: ({name[:6]}_)" in done.stdout, done.stderr
    assert f"  1 {kind} nconv=" in done.stdout
    assert re.search(rf"{kind} \w+, ST sinvert: \d+ solve.*, \d+ iter.*, \d+ pairs", done.stderr)
