"""What the frequencies of a sweep are given in, and what omega_mx belongs to."""

import math

import h5py
import numpy as np
import pytest
from mpi4py import MPI

from pgran.command.resolve import resolve
from pgran.errors import InputError
from pgran.medium.sample import make_lattice
from pgran.run.frequencies import driving_frequencies
from pgran.run.options import read_file, read_words


def lattice_of(words):
    options = resolve(read_words(f"-scene response {words}".split()))
    lattice = make_lattice(options, MPI.COMM_SELF)
    return lattice, driving_frequencies(options, lattice)


@pytest.fixture
def bonds_file(tmp_path):
    """Bonds of 3 x 2 balls without a word of a unit, the largest .5."""
    with h5py.File(tmp_path / "bonds.h5", "w") as file:
        file["lattice/stiffness_x"] = np.full((4, 2), 0.25)
        file["lattice/stiffness_y"] = np.linspace(0.1, 0.5, 9).reshape(3, 3)
    return f"-bonds_law file -bonds_file {tmp_path / 'bonds.h5'}"


@pytest.mark.parametrize("shape", ["5", "4,3", "3,2,2"])
def test_frequencies_in_omega_mx(shape):
    """The same sweep of frequencies omega / omega_mx, whatever mass and springs are."""
    words = f"-lattice_shape {shape} -lattice_mass 3"
    unit = math.sqrt(2 * len(shape.split(",")) * 0.25 / 3)
    for asked, expected in (
        ("-sweep_min .1 -sweep_max .9 -sweep_points 9", np.linspace(0.1, 0.9, 9)),
        ("-sweep_omega .3,.5,2", np.array([0.3, 0.5, 2])),
    ):
        assert np.array_equal(lattice_of(f"{words} {asked}")[1], expected)
        found = lattice_of(f"{words} {asked} -sweep_unit omega_mx")[1]
        assert found == pytest.approx(unit * expected, rel=1e-15)


@pytest.mark.parametrize("asked", ["-sweep_min 100 -sweep_max 900", "-sweep_omega 100,900"])
def test_frequencies_in_hertz(asked):
    """They are 2 pi f in units of 1 over that of time, for whatever omega_mx."""
    points = " -sweep_points 2" * ("min" in asked)
    found = lattice_of(f"-units_time 1e-5 -sweep_unit Hz -lattice_mass 3 {asked}{points}")[1]
    assert found == pytest.approx(2e-5 * math.pi * np.array([100, 900]), rel=1e-15)


def test_hertz_that_are_none(tmp_path):
    """Without a unit of time; and frequencies of a file that knows nothing of Hz."""
    with pytest.raises(InputError, match="sweep_unit Hz: -units_time is needed"):
        lattice_of("-sweep_unit Hz -sweep_omega 100")
    path = tmp_path / "run.opts"
    path.write_text("-scene response -sweep_max 2 -units_time 1e-5")
    for words, missing in (("", "min"), ("-sweep_min 100", "max")):
        with pytest.raises(InputError, match=f"sweep_unit Hz: give -sweep_{missing} in Hz"):
            resolve(read_file(path) + read_words(["-sweep_unit", "Hz", *words.split()]))


def test_largest_bond_or_kmax_of_a_file(bonds_file):
    """Without a word on it omega_mx jumps with the largest bond; kmax fixes it."""
    assert lattice_of(bonds_file)[0].omega_mx == pytest.approx(math.sqrt(4 * 0.5))
    fixed, omegas = lattice_of(f"{bonds_file} -bonds_kmax .25 -sweep_unit omega_mx -sweep_omega 2")
    assert (fixed.omega_mx, omegas.tolist()) == (1.0, [2.0])


def test_kmax_of_hertz():
    """All samples then have one omega_mx; the bonds are the same."""
    found = [lattice_of(f"-bonds_law hertz -bonds_seed {seed}")[0] for seed in (1, 2)]
    assert found[0].omega_mx != found[1].omega_mx
    fixed = [lattice_of(f"-bonds_law hertz -bonds_seed {s} -bonds_kmax .25")[0] for s in (1, 2)]
    assert [lattice.omega_mx for lattice in fixed] == [1.0, 1.0]
    assert [a.bonds_sha256 for a in fixed] == [a.bonds_sha256 for a in found]


def test_kmax_of_another_law(tmp_path, bonds_file):
    """The options file's kmax was that of its own law, not of the file given after it."""
    path = tmp_path / "run.opts"
    path.write_text("-scene response -bonds_kmax .125")
    options = resolve(read_file(path) + read_words(bonds_file.split()))
    assert make_lattice(options, MPI.COMM_SELF).kmax == 0.5
    options = resolve(read_file(path) + read_words([*bonds_file.split(), "-bonds_kmax", ".25"]))
    assert make_lattice(options, MPI.COMM_SELF).kmax == 0.25


def test_no_omega_mx_to_measure_in(bonds_file, tmp_path):
    with h5py.File(tmp_path / "bonds.h5", "a") as file:
        for name in ("stiffness_x", "stiffness_y"):
            file[f"lattice/{name}"][...] = 0.0
    with pytest.raises(InputError, match="sweep_unit omega_mx: without stiff bonds"):
        lattice_of(f"{bonds_file} -sweep_unit omega_mx")
