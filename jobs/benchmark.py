"""The program against what a user would write with SciPy, in one run: ratios and errors.

Started by jobs/benchmark.sh on 2 ranks. While one rank measures, the other waits.
"""

import statistics
import sys
import time

import petsc4py

petsc4py.init(["benchmark", "-skip_petscrc"])

import numpy as np  # noqa: E402
import scipy.sparse as sp  # noqa: E402
from mpi4py import MPI  # noqa: E402
from scipy.sparse.linalg import splu  # noqa: E402

from pgran.lattice import Lattice  # noqa: E402
from pgran.scenes.response import sweep  # noqa: E402
from pgran.sharing import Crew  # noqa: E402
from pgran.stiffness import BondLaw  # noqa: E402

WORLD = MPI.COMM_WORLD
REPEATS = 5


def laplacian(stiffness):
    """Return the weighted Laplacian in SciPy, a diagonal for each kind of neighbour."""
    kx, ky = stiffness
    ball = np.arange(kx[1:].size).reshape(kx.shape[0] - 1, -1)
    main = (kx[:-1] + kx[1:] + ky[:, :-1] + ky[:, 1:]).ravel()
    triples = [(ball.ravel(), ball.ravel(), main)]
    for a, b, k in (
        (ball[:-1], ball[1:], kx[1:-1]),
        (ball[:, :-1], ball[:, 1:], ky[:, 1:-1]),
    ):
        triples += [(a.ravel(), b.ravel(), -k.ravel()), (b.ravel(), a.ravel(), -k.ravel())]
    rows, columns, values = map(np.concatenate, zip(*triples, strict=True))
    return sp.csc_matrix((values, (rows, columns)))


def scipy_sweep(lattice, omegas, site):
    """Return the amplitudes as a careful user of SciPy computes them, and the seconds it took."""
    started = time.perf_counter()
    K, C = laplacian(lattice.stiffness), laplacian([np.ones_like(k) for k in lattice.stiffness])
    identity = sp.identity(lattice.balls, format="csc")
    wall = np.zeros(lattice.shape, dtype=complex)
    detector = np.ravel_multi_index(site, lattice.shape)
    amplitudes = []
    for omega in omegas:
        S = K + (1j * omega * lattice.damping) * C - (lattice.mass * omega**2) * identity
        wall[-1] = lattice.stiffness[0][-1] + 1j * omega * lattice.damping
        # No pivoting: with it SymmetricMode fills in completely on these matrices.
        factor = splu(
            S, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )
        amplitudes.append(factor.solve(wall.ravel())[detector])
    return np.array(amplitudes), time.perf_counter() - started


def pgran_sweep(lattice, omegas, site, comm):
    """Return the response and the seconds it took, on rank 0 of `comm`."""
    with Crew(comm, 1) as crew:
        started = time.perf_counter()
        response = sweep(lattice, omegas, site, crew)
        return response, time.perf_counter() - started


def compare(label, side, omegas, repeats):
    """Measure one sweep in turns: SciPy, one rank, all ranks."""
    lattice = Lattice(BondLaw("uniform").draw((side, side), 1993), kmax=0.25)
    site = (side * 2 // 5, side // 2)
    seconds = {"SciPy": [], "1 rank": [], f"{WORLD.size} ranks": []}
    for _ in range(repeats):
        if WORLD.rank == 0:
            reference, took = scipy_sweep(lattice, omegas, site)
            seconds["SciPy"].append(took)
            response, took = pgran_sweep(lattice, omegas, site, MPI.COMM_SELF)
            seconds["1 rank"].append(took)
        WORLD.Barrier()
        _, took = pgran_sweep(lattice, omegas, site, WORLD)
        seconds[f"{WORLD.size} ranks"].append(took)
    if WORLD.rank > 0:
        return
    peer, alone, shared = (statistics.median(s) for s in seconds.values())
    error = np.max(np.abs(response.displacement[:, 0] - reference) / np.abs(reference))
    print(
        f"{label:34} {peer:8.3f} {alone:8.3f} {shared:8.3f}   {peer / alone:6.2f} "
        f"{alone / shared:6.2f}   {error:.1e}  {response.failures}",
        flush=True,
    )


def main():
    """Print the table."""
    if WORLD.rank == 0:
        print(
            f"medians of {REPEATS} interleaved repeats, seconds\n"
            f"{'sweep':34} {'SciPy':>8} {'1 rank':>8} {f'{WORLD.size} ranks':>8}   "
            f"{'SciPy/1':>6} {'1/all':>6}   largest difference, failures"
        )
    paper = np.linspace(0.01, 1.3, 1291)
    compare("20 x 20, the paper's 1291 points", 20, paper, REPEATS)
    compare("60 x 60, 128 points to omega_mx", 60, np.linspace(0.01, 1.0, 128), REPEATS)
    compare("200 x 200, 16 points to .5 omega_mx", 200, np.linspace(0.05, 0.5, 16), REPEATS)


if __name__ == "__main__":
    sys.exit(main())
