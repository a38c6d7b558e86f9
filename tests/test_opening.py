"""Up to which drive contacts stay closed: closed forms, what is unknown, words, other units."""

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from samples import swept

import pgran
from pgran.medium.overlaps import overlaps_of
from pgran.store.text import table_of

PACKING = pgran.pack(30, law="hertz", pressure=1e-3, walls="x", seed=2)


def test_a_chain_shares_a_slow_motion_among_its_contacts(world):
    """Each of n + 1 opens where the wall has moved by n + 1 overlaps, of which k and c tell."""
    chain = pgran.Lattice.random((7,), law="constant", kmax=0.6, hertz=2.0)
    found = swept(chain, [1e-4, 2e-4], [[3]], world, world.size, method="points")
    overlap = (0.6 / (1.5 * 2.0)) ** 2
    for bounds in found.opening, found.opening_part:
        assert bounds == pytest.approx(8 * overlap, rel=1e-5)
        assert np.all(bounds[:, 0] <= bounds[:, 1])


@pytest.mark.parametrize("push", [False, True])
def test_first_contacts_of_a_packing(world, push):
    """As the stored fields say, contact by contact; the same on any ranks and in other units."""
    packing, site = PACKING, [[int(PACKING.free[5])]]
    if push:
        packing = replace(packing, **packing.pushed_by(np.eye(len(packing.free))[3]))
    omegas = packing.omega_mx * np.array([0.1, 0.4, 0.9])
    found = swept(packing, omegas, site, world, world.size, method="points", fields=True)
    alone = swept(packing, omegas, site, MPI.COMM_SELF, method="points")
    np.testing.assert_allclose(found.opening, alone.opening, rtol=1e-5)
    assert np.array_equal(found.opening_contact, alone.opening_contact)
    assert np.array_equal(table_of(alone)["opening_1"], alone.opening[:, 1])
    units = {"stiffness": 1e6 * packing.stiffness, "force": 1e6 * packing.force, "kmax": None}
    units |= {"damping": 1e6 * packing.damping, "masses": 1e6 * packing.masses, "median_mass": None}
    units |= {"push": 1e6 * packing.push} if push else {}
    other = swept(replace(packing, **units), omegas, site, MPI.COMM_SELF, method="points")
    np.testing.assert_allclose(other.opening, alone.opening, rtol=1e-5)
    moved = np.zeros((len(omegas), len(packing.held), packing.axes), complex)
    moved[:, packing.held == 2] = packing.direction
    moved[:, packing.free] = found.field.reshape(len(omegas), -1, packing.axes)
    for n, u in enumerate(moved):
        drives = []
        for b, (i, j) in enumerate(packing.bond):
            drives.append(packing.overlap[b] / abs(packing.normal[b] @ (u[j] - u[i])))
        assert alone.opening[n] == pytest.approx(min(drives), rel=1e-6)
        assert found.opening_contact[n] == np.argmin(drives)
        part = sorted(drives)[int(np.ceil(0.01 * len(drives))) - 1]
        assert alone.opening_part[n] == pytest.approx(part, rel=1e-6)


def test_what_is_not_known_is_marked():
    """Where a frequency fails, of models, of series, of contacts without a law."""
    ball = pgran.Lattice.random((1, 1), law="constant", hertz=1.0, damping=0.0)
    found = pgran.sweep(ball, [0.5, 1.0], [[0, 0]], method="points")
    assert np.isnan(found.opening[found.converged_reason <= 0]).all()
    assert found.opening_contact.tolist()[1] == -1 < found.opening_contact[0]
    lattice = pgran.Lattice.random((5, 4), hertz=1.0)
    models = pgran.sweep(lattice, np.linspace(0.3, 0.4, 5), [[2, 2]], method="curve")
    assert np.isnan(models.opening[models.modelled > 0]).all()
    series = pgran.sweep(replace(lattice, damping=0.1), [0.5], [[2, 2]], method="moments")
    assert series.moments
    assert np.isnan(series.opening).all()
    assert pgran.sweep(replace(lattice, hertz=None), [0.3], [[2, 2]]).opening is None
    pulled = replace(PACKING, force=-PACKING.force)
    with pytest.raises(pgran.PgranError, match="contact 0 bears no repulsive force"):
        overlaps_of(pulled)
