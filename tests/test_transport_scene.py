"""Transport of an ensemble: against the same means by hand, and where there is none."""

import numpy as np
import pytest

import pgran
from pgran.errors import InputError
from pgran.experiments.ensemble.transport import is_line
from pgran.medium.lattice import Lattice

OMEGAS = np.linspace(0.3, 1.6, 14)
LINE = [(4, 1), (3, 1), (2, 1), (0, 1)]
SHAPE = {"shape": (6, 3), "damping": 0.1}


@pytest.fixture(scope="module")
def ensemble():
    choices = {"omegas": OMEGAS, "detectors": LINE}
    return pgran.ensemble("response", 10, lattice=SHAPE, keep="curves", **choices)


def test_profiles_are_means_over_the_samples(ensemble):
    found = pgran.transport(Lattice.random(**SHAPE), ensemble)
    order = [0, 1, 2, 3]  # depths 2, 3, 4, 6
    assert found.depth.tolist() == [2, 3, 4, 6]
    A = ensemble.displacement[:, :, order]
    assert found.ln_amplitude == pytest.approx(np.log(np.abs(A)).mean(axis=0))
    assert found.intensity == pytest.approx(np.mean(np.abs(A) ** 2, axis=0))
    error = np.log(np.abs(A)).std(axis=0, ddof=1) / np.sqrt(10)
    assert found.ln_amplitude_error == pytest.approx(error)


def test_above_all_modes_amplitudes_fall_as_bonds_say():
    """Far above them a ball moves as k / (m omega^2) of the one before it."""
    omegas, constant = [40.0, 50.0], {"shape": (8, 1), "damping": 0.0, "law": "constant"}

    def chain(seed):
        return Lattice.random(**constant, seed=seed)

    choices = {"omegas": omegas, "detectors": [(6, 0), (5, 0), (4, 0)]}
    found = pgran.ensemble("response", 8, lattice=chain, keep="curves", **choices)
    line = pgran.transport(chain(1), found)
    # of equal samples the line has no error; the balls' own springs correct m omega^2
    exact = [np.log((w * w - 4 * 0.25) / 0.25) for w in omegas]
    assert line.rate == pytest.approx(exact, rel=1e-3)


def test_where_there_is_no_transport(ensemble):
    lattice = Lattice.random(**SHAPE)
    assert is_line(lattice, lattice.sites(LINE))
    assert not is_line(lattice, lattice.sites(LINE[:2]))
    few = pgran.ensemble("response", 8, lattice=SHAPE, omegas=OMEGAS, detectors=LINE)
    with pytest.raises(InputError, match="no curves"):
        pgran.transport(lattice, few)
    two = pgran.ensemble("response", 3, lattice=SHAPE, omegas=OMEGAS, detectors=LINE, keep="curves")
    with pytest.raises(InputError, match="too few"):
        pgran.transport(lattice, two)
