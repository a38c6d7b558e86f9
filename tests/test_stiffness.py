"""Bond constants: a pure function of seed and bond, with the distribution that its law promises."""

import math
from decimal import Decimal, getcontext

import numpy as np
import pytest
from reference import bonds
from scipy.stats import kstest

from pgran.errors import InputError
from pgran.physics.bondlaw import LAWS, BondLaw, unit_numbers
from pgran.physics.lattice import Lattice, bond_count

MASK = 2**64 - 1


def philox(key, counter):
    """Philox4x64-10 of Salmon et al., Parallel random numbers: as easy as 1, 2, 3 (SC 2011)."""
    x, (k0, k1) = list(counter), key
    for _ in range(10):
        a, b = 0xD2E7470EE14C6C93 * x[0], 0xCA5A826395121157 * x[2]
        x = [(b >> 64) ^ x[1] ^ k0, b & MASK, (a >> 64) ^ x[3] ^ k1, a & MASK]
        k0, k1 = (k0 + 0x9E3779B97F4A7C15) & MASK, (k1 + 0xBB67AE8584CAA73B) & MASK
    return x


def test_philox_of_the_test_is_the_published_one():
    """Known answer of Random123's kat_vectors for philox4x64 10, all zeros."""
    assert philox((0, 0), (0, 0, 0, 0)) == [
        0x16554D9ECA36314C,
        0xDB20FE9D672D0FDC,
        0xD7E772CEE186176B,
        0x7E68B68AEC7BA23B,
    ]


@pytest.mark.parametrize("seed", [0, 1993, 2**63 - 1, 2**64 - 1])
@pytest.mark.parametrize("generation", [0, 1, 77])
def test_numbers_are_philox(seed, generation):
    """Four numbers a counter, which NumPy raises before it draws; the upper 53 bits of each."""
    found = unit_numbers(seed, 0, 22, generation)
    expected = [
        (word >> 11) * 2.0**-53
        for block in range(1, 7)
        for word in philox((seed, 0), (block, 0, generation, 0))
    ]
    assert found.tolist() == expected[:22]


@pytest.mark.parametrize("first", [0, 1, 2, 3, 4, 5, 7, 100, 8191])
def test_any_part_of_the_stream(first):
    whole = unit_numbers(5, 0, 8300)
    for count in (0, 1, 3, 4, 5, 100):
        part = unit_numbers(5, first, count)
        assert np.array_equal(part, whole[first : first + count])


def test_far_along_the_stream():
    first = 4 * (2**40) + 3
    expected = philox((5, 0), (2**40 + 1, 0, 0, 0))[3]
    assert unit_numbers(5, first, 1)[0] == (expected >> 11) * 2.0**-53


def test_seeds_and_generations_differ():
    streams = [
        unit_numbers(seed, 0, 100, generation) for seed in (0, 1, 2) for generation in (0, 1)
    ]
    for i, a in enumerate(streams):
        for b in streams[:i]:
            assert not np.intersect1d(a, b).size


def test_numbers_are_uniform():
    """A test at the level 1e-3 for each of three seeds fixed beforehand; never 1, below 2**-53."""
    for seed in (1, 2, 3):
        u = unit_numbers(seed, 0, 100_000)
        assert kstest(u, "uniform").pvalue > 1e-3
        assert 0 <= u.min() < 1e-3
        assert 1 - 1e-3 < u.max() < 1
        # neighbours are uncorrelated: 4 standard errors
        assert abs(np.corrcoef(u[1:], u[:-1])[0, 1]) < 4 / math.sqrt(len(u))
        assert np.array_equal(u * 2**53, np.rint(u * 2**53))


# Laws


PARAMETERS = {"kmin": 0.05, "kmax": 0.25, "fraction": 0.3, "force": 2.0, "hertz": 3.0}
N = 200_000


def sample(name, seed=4, **parameters):
    return BondLaw(name, **(PARAMETERS | parameters))(unit_numbers(seed, 0, N))


def distribution(name):
    """The distribution function that a law promises."""
    kmin, kmax = PARAMETERS["kmin"], PARAMETERS["kmax"]
    force, hertz = PARAMETERS["force"], PARAMETERS["hertz"]
    return {
        "uniform": lambda k: np.clip((k - kmin) / (kmax - kmin), 0, 1),
        "loguniform": lambda k: np.clip(np.log(k / kmin) / np.log(kmax / kmin), 0, 1),
        # k = 3/2 c^(2/3) F^(1/3), so F = (2k/3)^3 / c^2, exponential with mean `force`
        "hertz": lambda k: -np.expm1(-((2 * k / 3) ** 3) / hertz**2 / force),
    }[name]


@pytest.mark.parametrize("name", ["uniform", "loguniform", "hertz"])
def test_continuous_laws(name):
    for seed in (4, 5):
        k = sample(name, seed)
        assert kstest(k, distribution(name)).pvalue > 1e-3
        assert k.dtype == float
        assert np.all(np.isfinite(k))


@pytest.mark.parametrize("name", ["uniform", "loguniform", "bimodal"])
def test_bounds(name):
    k = sample(name)
    assert k.min() >= 0.05
    assert k.max() <= 0.25
    ends = BondLaw(name, **PARAMETERS)(np.array([0.0, 1 - 2.0**-53]))
    assert sorted(ends)[0] == pytest.approx(0.05, rel=1e-15)
    assert sorted(ends)[1] == pytest.approx(0.25, rel=1e-15)
    assert ends.min() >= 0.05
    assert ends.max() <= 0.25


def test_hertz_is_positive_and_finite_at_the_ends():
    ends = BondLaw("hertz", **PARAMETERS)(np.array([0.0, 2.0**-53, 1 - 2.0**-53]))
    assert ends[0] == 0.0
    assert np.all(np.diff(ends) > 0)
    assert np.all(np.isfinite(ends))


def test_hertz_mean():
    """E k = 3/2 c^(2/3) Gamma(4/3) mean^(1/3); the paper's k = 3/2 c h^(1/2) at F = c h^(3/2)."""
    k = sample("hertz")
    expected = 1.5 * 3.0 ** (2 / 3) * math.gamma(4 / 3) * 2.0 ** (1 / 3)
    assert abs(k.mean() - expected) < 4 * k.std() / math.sqrt(N)
    u = np.array([0.3, 0.8])
    forces = -2.0 * np.log1p(-u)
    h = (forces / 3.0) ** (2 / 3)
    assert BondLaw("hertz", **PARAMETERS)(u) == pytest.approx(1.5 * 3.0 * np.sqrt(h), rel=1e-14)


def test_bimodal():
    k = sample("bimodal")
    assert set(k) == {0.05, 0.25}
    assert abs(np.mean(k == 0.25) - 0.3) < 4 * math.sqrt(0.3 * 0.7 / N)
    assert np.all(sample("bimodal", fraction=1.0) == 0.25)
    assert np.all(sample("bimodal", fraction=0.0) == 0.05)
    assert BondLaw("bimodal", **PARAMETERS | {"fraction": 0.0})(np.zeros(1)) == 0.05


def test_constant():
    assert np.all(sample("constant") == 0.25)


@pytest.mark.parametrize("name", ["uniform", "loguniform", "bimodal"])
def test_equal_ends(name):
    assert np.all(sample(name, kmin=0.1, kmax=0.1) == 0.1)


def test_paper_law_starts_at_zero():
    k = BondLaw("uniform")(np.array([0.0, 0.5]))
    assert k.tolist() == [0.0, 0.125]


def test_elementary_functions_are_rounded_once():
    """The exact values, from decimals, rounded to the nearest double but for rare ties."""
    getcontext().prec = 40
    u = unit_numbers(8, 0, 300)
    low, high = (Decimal(PARAMETERS[end]).ln() for end in ("kmin", "kmax"))
    exact = [float((low + (high - low) * Decimal(float(x))).exp()) for x in u]
    found = BondLaw("loguniform", **PARAMETERS)(u)
    assert np.count_nonzero(found != exact) <= 1
    exact = []
    for x in u:
        force = -2 * (1 - Decimal(float(x))).ln()
        exact.append(float(Decimal("1.5") * ((9 * force).ln() / 3).exp()))
    found = BondLaw("hertz", **PARAMETERS)(u)
    assert np.count_nonzero(found != exact) <= 1


# Lattices


@pytest.mark.parametrize("shape", [(9,), (4, 5), (2, 3, 4), (1, 1)])
@pytest.mark.parametrize("name", LAWS)
def test_bond_b_has_the_bth_number(shape, name):
    """Axis after axis, each in C order, for every law."""
    law = BondLaw(name, **PARAMETERS)
    arrays = law.draw(shape, 7)
    u = unit_numbers(7, 0, bond_count(shape))
    for number, (axis, index, *_) in enumerate(bonds(shape)):
        assert arrays[axis][index] == law(unit_numbers(7, number, 1))[0]
        assert arrays[axis][index] == law(u[number : number + 1])[0]
    assert Lattice(arrays).shape == shape


@pytest.mark.parametrize("name", LAWS)
def test_the_same_on_all_ranks(world, name):
    arrays = BondLaw(name, **PARAMETERS).draw((7, 6), 3)
    everyone = world.allgather(b"".join(k.tobytes() for k in arrays))
    assert len(set(everyone)) == 1


def test_seeds_give_different_lattices():
    seeds = (0, 1, 2, 1993, 2**63 - 1)
    sums = {Lattice(BondLaw("uniform").draw((5, 6), seed)).bonds_sha256 for seed in seeds}
    assert len(sums) == len(seeds)


# Refusals


@pytest.mark.parametrize(
    ("name", "parameters", "key"),
    [
        ("normal", {}, "bonds_law"),
        ("file", {}, "bonds_law"),
        ("uniform", {"kmin": -0.1}, "bonds_kmin"),
        ("uniform", {"kmin": 0.3}, "bonds_kmin"),
        ("uniform", {"kmin": math.nan}, "bonds_kmin"),
        ("uniform", {"kmax": 0.0}, "bonds_kmax"),
        ("uniform", {"kmax": math.inf}, "bonds_kmax"),
        ("constant", {"kmax": -1.0}, "bonds_kmax"),
        ("constant", {"kmax": math.nan}, "bonds_kmax"),
        ("loguniform", {"kmin": 0.0}, "bonds_kmin"),
        ("loguniform", {"kmin": 0.3}, "bonds_kmin"),
        ("bimodal", {"kmin": 0.3}, "bonds_kmin"),
        ("bimodal", {"fraction": 1.5}, "bonds_fraction"),
        ("bimodal", {"fraction": -0.1}, "bonds_fraction"),
        ("bimodal", {"fraction": math.nan}, "bonds_fraction"),
        ("hertz", {"force": 0.0}, "bonds_force"),
        ("hertz", {"force": math.inf}, "bonds_force"),
        ("hertz", {"hertz": 0.0}, "bonds_hertz"),
        ("hertz", {"hertz": -1.0}, "bonds_hertz"),
    ],
)
def test_impossible_parameters(name, parameters, key):
    with pytest.raises(InputError, match=key):
        BondLaw(name, **parameters)


def test_a_law_ignores_what_it_does_not_use():
    BondLaw("constant", kmin=9.0, fraction=7.0, force=-1.0)
    BondLaw("hertz", kmin=9.0, kmax=-1.0)
    BondLaw("uniform", hertz=0.0)


def test_kmax_of_a_law():
    assert BondLaw("uniform", kmax=0.5).kmax == 0.5
    assert BondLaw("hertz").kmax is None
