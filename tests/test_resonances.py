"""How modes resound: against dense algebra, closed sums of residues, and what is at rest."""

import dataclasses

import numpy as np
import pytest
from figure_reading import labels
from figure_results import result_of
from network_samples import NetworkReference
from samples import random_lattice, uniform_lattice

import pgran
from pgran.draw import pages
from pgran.errors import FileError, InputError
from pgran.experiments.modes import figures_density, scene
from pgran.medium import crystals
from pgran.store.si import SI


def test_widths_sources_and_readings_of_a_network():
    """Of balls of any mass, moved and read in oblique directions."""
    rng = np.random.default_rng(4)
    network = crystals.random_geometric(
        30, 2, 6.0, masses=10 ** rng.uniform(-1, 1, 30), direction=[3.0, 4.0], damping=0.2,
        component="y", stiffness=lambda u: 0.5 + u / 2, seed=5
    )  # fmt: skip
    found = pgran.find_modes(network, shapes=True, detectors=network.free[7:8])
    exact = NetworkReference(network)
    f = found.vector / np.sqrt(exact.M.astype(float) / network.mass)  # displacements
    C = exact.C.astype(float)
    widths = 0.2 * np.einsum("np,pq,nq->n", f, C, f) / network.mass
    np.testing.assert_allclose(found.width, widths, rtol=1e-10)
    trace = 0.2 * np.trace(C / exact.M.astype(float)[:, None])
    assert found.width.sum() == pytest.approx(trace, rel=1e-12)
    np.testing.assert_allclose(found.source, f @ exact.drive_K.astype(float), atol=1e-12)
    np.testing.assert_allclose(found.reading[:, 0], f[:, 2 * 7 + 1], atol=1e-12)
    np.testing.assert_allclose(found.quality, found.omega / widths)


def sum_over_modes(modes, omegas):
    """The amplitude that the residues make."""
    w, gamma, at = modes.omega[:, None], modes.width[:, None], omegas[None]
    terms = 2 * w * modes.residue / (w**2 - at**2 + 1j * at * gamma)
    return terms.sum(axis=0), np.abs(terms).sum(axis=0)


@pytest.mark.parametrize(("damping", "source"), [(0, {}), (0.02, {}), (0, {"balls": [(4, 1)]})])
def test_residues_sum_to_the_amplitude(damping, source):
    """Without damping, driven by a force, too; where C is like K, with the drive's dashpots."""
    lattice = pgran.with_source(random_lattice((6, 5), 4, damping=0.0, mass=1.7), **source)
    if damping:
        lattice = uniform_lattice((6, 5), damping=damping, mass=1.7)
    modes = pgran.find_modes(lattice, detectors=[(2, 3)])
    omegas = np.linspace(0.05, 0.9, 9)
    found = pgran.sweep(lattice, omegas, [(2, 3)], method="points", error_tolerance=1e-10)
    amplitude, size = sum_over_modes(modes, omegas)
    if damping:
        amplitude *= 1 + 1j * omegas * damping / lattice.constants[0]
    exact = found.displacement[:, 0]
    assert np.all(np.abs(amplitude - exact) <= 1e-11 * size + found.error_bound[:, 0])


def test_a_peak_of_a_mode_alone_is_that_of_the_response():
    lattice = random_lattice((8, 7), 4, damping=1e-4)
    modes = pgran.find_modes(lattice, detectors=[(3, 3)])
    found = pgran.sweep(lattice, modes.omega[:1], [(3, 3)], method="points")
    assert found.amplitude[0, 0] == pytest.approx(modes.peak[0, 0], rel=1e-3)
    said = " ".join(scene.summary(result_of(modes, lattice)))
    assert f"quality omega / width: median {np.median(modes.quality):.3g}" in said
    first = np.argmax(modes.peak[:, 0])
    told = f"at omega = {modes.omega[first]:.6g} with |A| = {modes.peak[first, 0]:.3g}"
    assert f"ball (3, 3): the strongest modes, each alone, are {told}" in said


def test_modes_at_rest_are_set_aside_by_name():
    """Both translations of a periodic crystal, and a ball that hangs on a single contact."""
    network = crystals.triangular((6, 4), periodic=True)
    result = result_of(pgran.find_modes(network, shapes=True), network)
    (line,) = (line for line in scene.summary(result) if "at rest" in line)
    assert line.endswith("2 translations of the whole, which nothing holds")
    made = pages.make(result)
    for name in ("participation", "density", "reduced"):
        assert "Left out: 2 modes at rest" in made[name].caption
        assert "NOT" not in "".join(made[name].heading)
    assert len(made["participation"].panels[0].get_lines()[0].get_xdata()) == 94
    cut = np.flatnonzero(np.any(network.bond == 20, axis=1))[1:]
    loose = crystals.subnetwork(network, contacts=np.setdiff1d(np.arange(network.bonds), cut))
    result = result_of(pgran.find_modes(loose), loose)
    assert "3 modes at rest" in (said := " ".join(scene.summary(result)))
    assert "which nothing holds and balls that are loose" in said
    none = pgran.Lattice.random((3, 2), law="bimodal", fraction=0.0)
    still = result_of(pgran.find_modes(none), none)
    assert list(scene.summary(still))[-1].startswith("6 modes at rest")
    with pytest.raises(FileError, match="no modes that move"):
        pages.make(still)
    bare = dataclasses.replace(result.modes, width=None, source=None)  # of an older file
    assert "quality" not in " ".join(scene.summary(result_of(bare, loose)))


def test_density_over_that_of_long_waves():
    """Debye's line is that of the statics; none where walls forbid it; bins hold all modes."""
    lattice = random_lattice((12, 11), 5, mass=0.25)
    modes = pgran.find_modes(lattice)
    edges, counts = figures_density.log_bins(modes.omega / lattice.omega_mx).values()
    assert counts.sum() == 132
    np.testing.assert_allclose(np.diff(np.log(edges)), np.log(edges[1] / edges[0]))
    made = pages.make(result_of(modes, lattice))
    speed = pgran.sound(lattice).longitudinal.speed / lattice.omega_mx
    for name in ("density", "reduced"):
        ax = made[name].panels[0]
        (line,) = (line for line in ax.get_lines() if "Debye" in str(line.get_label()))
        waves = np.asarray(line.get_ydata()) / (line.get_xdata() if name == "density" else 1)
        assert waves == pytest.approx(1 / (2 * np.pi * speed**2))
    (bars,) = made["density"].panels[0].collections[:1]
    size = np.ptp(np.array(bars.get_segments())[:, :, 1], axis=1)
    values, bins, _ = made["density"].panels[0].patches[0].get_data()
    share = 132 * np.diff(bins)
    np.testing.assert_allclose(size, 2 * np.sqrt(values * share) / share)
    values, bins, _ = ax.patches[0].get_data()
    np.testing.assert_allclose(values * np.diff(edges**2) / 2 * 132, counts)
    network = crystals.triangular((6, 4))
    made = pages.make(result_of(pgran.find_modes(network), network))
    assert not labels(made["reduced"].panels[0])


def test_detectors_of_modes_are_checked():
    lattice = random_lattice((4, 3))
    with pytest.raises(InputError, match="modes_detectors: ball"):
        pgran.find_modes(lattice, detectors=[(4, 1)])
    with pytest.raises(InputError, match="detectors cannot be kept of each sample"):
        pgran.ensemble("modes", 2, lattice={"shape": (4, 3)}, detectors=[(1, 1)])
    still = pgran.find_modes(dataclasses.replace(lattice, damping=0.0), detectors=[(1, 1)])
    assert np.all(np.isinf(still.quality))
    assert not list(scene.resonances(still, SI()))
