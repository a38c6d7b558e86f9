"""What is false of the drives that open contacts, against a loop over these in many digits."""

import dataclasses
import math

import mpmath
import numpy as np
from law_samples import lawful_network
from mpi4py import MPI
from mpmath import mp, mpf
from network_samples import NetworkReference, eliminated, exactly
from samples import SOLVERS, option_values, steady
from source_faults import random_source

from pgran.driven.opening import Openings
from pgran.medium.overlaps import overlaps_of
from pgran.run.petsc import holding

PART = 0.4  # of few contacts


def random_overlaps(seed):
    """A random network whose contacts bear forces by a law, driven by balls or by a push."""
    case, rng = lawful_network(seed), np.random.default_rng([47, seed])
    if rng.random() < 0.3 and hasattr(source := random_source(seed), "network"):
        case = source
    network = case.network
    stiffness = np.abs(network.stiffness)
    force = stiffness * 10 ** rng.uniform(-3, 0, len(stiffness))
    law = {"power": rng.choice([1.0, 1.5, 2.0]), "distance": 1 + rng.random(len(stiffness))}
    network = dataclasses.replace(network, stiffness=stiffness, force=force, **law)
    return dataclasses.replace(case, network=network)


def exact_openings(network, s):
    """The drive that opens each contact, h / |n . (u_j - u_i)|, ascending; None: S is singular."""
    whole, s = NetworkReference(network), mpmath.mpmathify(complex(s))
    force = whole.drive_K + s * mpf(float(network.damping)) * whole.drive_C
    if network.loss is not None:
        force = force + mpmath.mpc(0, 1) * whole.drive_L
    u = eliminated(whole.system(s), force)
    if u is None:
        return None
    moved = whole.motion + 0
    moved[whole.free] = u
    moved, openings = moved.reshape(len(network.held), -1)[:, : whole.axes], []
    for b, (i, j) in enumerate(network.bond):
        normal = exactly(network.normal[b]) if whole.axes > 1 else exactly(np.ones(1))
        overlap = mpf(network.power) * mpf(network.force[b]) / mpf(network.stiffness[b])
        stretch = abs(normal @ (moved[j] - moved[i])) / mp.sqrt(normal @ normal)
        openings.append(overlap / stretch if stretch else mp.inf)
    return sorted(openings)


def opening_faults(case, seen, comm=MPI.COMM_SELF):
    """Yield bounds, of the first contact and of a part, which the drive is not within."""
    network = case.network
    with (
        mp.workdps(60),
        holding(option_values(SOLVERS[case.solver])),
        steady(network, case.sites, comm, case.tolerance) as (operators, solver),
    ):
        openings = Openings(operators, overlaps_of(network), PART)
        for s in case.points:
            state, exact = solver.solve(s), exact_openings(network, s)
            error = solver.bounds.field_error
            if exact is None or not state.converged_reason > 0 or np.isnan(error):
                continue
            first, part, _ = openings.at(solver.field, error)
            drives = exact[0], exact[math.ceil(PART * len(exact)) - 1]
            for (low, high), drive in zip((first, part), drives, strict=True):
                seen["drives"] += 1
                seen["sharp"] += high <= 1.01 * low
                if not low <= drive <= high:
                    yield f"BROKEN case {case.seed}, {s=}: {low:.17g} {high:.17g}, not {drive}"
