"""Bond constants: a pure function of seed and bond, with the distribution that its law promises."""

import math
from decimal import Decimal, getcontext

import numpy as np
import pytest
from reference import bonds

from pgran import InputError, Lattice
from pgran.command.resolve import resolve
from pgran.medium.law import LAWS, BondLaw, unit_numbers
from pgran.medium.sample import make_lattice
from pgran.run.options import read_words

MASK = 2**64 - 1
PARAMETERS = {"kmin": 0.05, "kmax": 0.25, "fraction": 0.3, "force": 2.0, "hertz": 3.0}


def philox(key, counter):
    """Philox4x64-10 of Salmon et al., Parallel random numbers: as easy as 1, 2, 3 (SC 2011)."""
    x, (k0, k1) = list(counter), key
    for _ in range(10):
        a, b = 0xD2E7470EE14C6C93 * x[0], 0xCA5A826395121157 * x[2]
        x = [(b >> 64) ^ x[1] ^ k0, b & MASK, (a >> 64) ^ x[3] ^ k1, a & MASK]
        k0, k1 = (k0 + 0x9E3779B97F4A7C15) & MASK, (k1 + 0xBB67AE8584CAA73B) & MASK
    return x


@pytest.mark.parametrize(
    ("seed", "generation", "first"), [(0, 0, 0), (1993, 1, 3), (1, 77, 8191), (2**64 - 1, 2, 2**42)]
)
def test_numbers_are_philox_from_any_place_of_the_stream(seed, generation, first):
    """Four numbers a counter, which NumPy raises before it draws; the upper 53 bits of each."""
    block, skip = divmod(first, 4)
    counters = range(block + 1, block + 5)
    words = [word for n in counters for word in philox((seed, 0), (n, 0, generation, 0))]
    expected = [(word >> 11) * 2.0**-53 for word in words[skip:]]
    for count in (0, 1, 5, 12):
        assert unit_numbers(seed, first, count, generation).tolist() == expected[:count]


def own(name):
    """The parameters of a law among PARAMETERS."""
    return {key: PARAMETERS[key] for key in LAWS[name][1]}


def test_exact_values():
    u = np.array([0.0, 0.5, 1 - 2.0**-53])
    np.testing.assert_allclose(BondLaw("uniform")(u), [0.0, 0.125, 0.25], rtol=2.0**-52)  # paper's
    assert BondLaw("constant")(u).tolist() == [0.25] * 3
    assert BondLaw("bimodal", kmin=0.1)(u).tolist() == [0.25, 0.1, 0.1]
    assert np.all(np.isfinite(BondLaw("hertz")(u)))


def test_loguniform_keeps_its_bounds_without_extended_precision(monkeypatch):
    monkeypatch.setattr(np, "longdouble", float)
    for k in (0.1, 0.3, 7.7):
        assert BondLaw("loguniform", kmin=k, kmax=k)(np.zeros(1)) == k


def test_elementary_functions_are_rounded_once():
    """Uniform log k, and k = 3/2 c^(2/3) F^(1/3) with F exponential, from decimals."""
    getcontext().prec = 40
    u = unit_numbers(8, 0, 100)
    low, high = (Decimal(PARAMETERS[end]).ln() for end in ("kmin", "kmax"))
    exact = {"loguniform": [(low + (high - low) * Decimal(float(x))).exp() for x in u]}
    forces = [-2 * (1 - Decimal(float(x))).ln() for x in u]
    exact["hertz"] = [Decimal("1.5") * ((9 * force).ln() / 3).exp() for force in forces]
    for name, values in exact.items():
        found = BondLaw(name, **own(name))(u)
        assert np.count_nonzero(found != [float(value) for value in values]) <= 1  # a tie


@pytest.mark.parametrize("name", LAWS)
def test_bond_b_of_a_random_lattice_has_the_bth_number_on_all_ranks(name, world):
    """Axis after axis, each in C order, for every law."""
    law, shape = BondLaw(name, **own(name)), [4, 1, 3]
    lattice = Lattice.random(shape, 7, name, mass=2.0, damping=0.1, **own(name))
    for number, (axis, index, *_) in enumerate(bonds(shape)):
        assert lattice.stiffness[axis][index] == law(unit_numbers(7, number, 1))[0]
    assert len(set(world.allgather(lattice.bonds_sha256))) == 1
    assert (lattice.mass, lattice.damping) == (2.0, 0.1)
    assert lattice.kmax == (lattice.constants.max() if name == "hertz" else 0.25)
    for same in (law, lambda u: law(u)):  # any function that draws the same
        again = Lattice.random(tuple(shape), np.int64(7), same)
        assert again.bonds_sha256 == lattice.bonds_sha256


def test_a_random_lattice_is_that_of_the_options(world):
    text = "-scene response -bonds_law hertz -bonds_force 2 -bonds_seed 5"
    found = make_lattice(resolve(read_words(text.split())), world)
    assert found == Lattice.random((20, 20), seed=5, law="hertz", force=2.0)


@pytest.mark.parametrize(
    ("choices", "key"),
    [
        *(({"shape": bad}, "lattice_shape") for bad in ((), (2, 0), (2,) * 4, 5, (2.5,), "ab")),
        *(({"seed": bad}, "bonds_seed") for bad in (-1, 2**64, 1.5)),
        ({"law": "file"}, "bonds_law"), ({"law": BondLaw("uniform"), "kmax": 1.0}, "bonds_law"),
        ({"law": "loguniform"}, "bonds_kmin"), ({"mass": 0.0}, "lattice_mass"),
        *(({"kmin": bad}, "bonds_kmin") for bad in (-0.1, 0.3, math.nan)),
        *(({"law": "constant", "kmax": bad}, "bonds_kmax") for bad in (0.0, -1.0, math.inf)),
        *(({"law": "bimodal", "fraction": bad}, "bonds_fraction") for bad in (1.5, -0.1, math.nan)),
        ({"law": "hertz", "force": math.inf}, "bonds_force"),
        ({"law": "hertz", "hertz": 0.0}, "bonds_hertz"),
        ({"law": np.negative}, "law: .*not neg"), ({"law": np.sqrt, "gravity": 1.0}, "_gravity"),
    ],
)  # fmt: skip
def test_impossible_random_lattices(choices, key):
    with pytest.raises(InputError, match=key):
        Lattice.random(**{"shape": (3, 2)} | choices)


@pytest.mark.parametrize("name", LAWS)
def test_a_law_has_only_its_own_parameters(name):
    for key in PARAMETERS.keys() - own(name).keys():
        with pytest.raises(InputError, match=f"bonds_{key}: no parameter of the law {name}"):
            BondLaw(name, **{key: PARAMETERS[key]})
