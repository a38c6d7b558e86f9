"""Scene `continuum`: the exact response of the homogeneous box, without PETSc."""

import numpy as np

from pgran.parallel.agreement import on_root
from pgran.physics.continuum import Continuum
from pgran.results import ContinuumResponse
from pgran.scenes.common import driving_frequencies, phase_of_sign


def run(options, world, journal=None):
    """Return the response of the box on rank 0; None on the others. Collective."""
    return on_root(world, lambda: [respond(options)], keep=True)


def respond(options):
    """Return the response that the options ask for (paper: axysol, exactpl). Not collective."""
    box, omegas = make_box(options), driving_frequencies(options)
    displacement = box.response(omegas, options.continuum_point)
    return ContinuumResponse(
        point=options.continuum_point,
        size=options.continuum_size,
        mass=options.continuum_mass,
        stiffness=options.continuum_stiffness,
        damping=options.continuum_damping,
        omega=omegas,
        displacement=displacement,
        amplitude=np.abs(displacement),
        phase=(
            np.unwrap(np.angle(displacement))
            if options.continuum_damping
            else phase_of_sign(displacement)
        ),
        resonance=box.resonances(omegas[-1]),
    )


def make_box(options):
    """Return the box that the options describe. Not collective."""
    return Continuum(
        options.continuum_size,
        options.continuum_mass,
        options.continuum_stiffness,
        options.continuum_damping,
    )


def summary(records):
    """Return in words what a run found. Not collective."""
    (continuum,) = records
    yield (
        f"{len(continuum.omega)} frequencies, {len(continuum.resonance)} driven resonances up to "
        f"{continuum.omega[-1]:g}"
    )
