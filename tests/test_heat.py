"""Warm balls and cut bonds: as if all were solved anew; and what is refused."""

import dataclasses

import numpy as np
import pytest
from mpmath import mp
from samples import assert_same, random_lattice, swept
from sensitivity_samples import TOUCH, Exact, derived, heated, missed, packing

from pgran.command.resolve import resolve
from pgran.errors import InputError
from pgran.medium.bonds import bond_ends
from pgran.medium.lattice import Lattice
from pgran.run.reading import read_words

OMEGAS = np.array([0.15, 0.6, 1.0])


def with_constants(lattice, constants):
    """A lattice with other constants."""
    stops = np.cumsum([k.size for k in lattice.stiffness])[:-1]
    arrays = (
        part.reshape(k.shape)
        for part, k in zip(np.split(constants, stops), lattice.stiffness, strict=True)
    )
    return Lattice(tuple(arrays), lattice.mass, lattice.damping, lattice.kmax)


def warm(medium, ball, stiffer):
    """A medium whose contacts with a ball have constants `stiffer(k, F)`, tangential ones alike."""
    if isinstance(medium, Lattice):
        ends = bond_ends(np.arange(medium.balls).reshape(medium.shape))
        k = medium.constants
        return with_constants(medium, np.where(np.any(ends == ball, axis=1), stiffer(k, None), k))
    touched, k = np.any(medium.bond == ball, axis=1), medium.stiffness
    given = {"stiffness": np.where(touched, stiffer(k, medium.force), k)}
    if medium.tangential is not None:
        given["tangential"] = medium.tangential * given["stiffness"] / k
    return dataclasses.replace(medium, **given)


def by_hertz(overlap, c):
    """The law F = c h^(3/2), c known or from the force."""

    def stiffer(k, force):
        if force is None:
            return np.sqrt(k**2 + 9 / 4 * c**2 * overlap)
        h = 3 * force / (2 * k)
        return 3 / 2 * force / h**1.5 * np.sqrt(h + overlap)

    return stiffer


MEDIA = {
    "1d": (random_lattice((6,), 1, 0.02), [[2], [5]]),
    "2d": (random_lattice((4, 3), 2, 0.0), [[0, 1], [3, 2]]),
    "3d": (random_lattice((2, 2, 3), 3), [[0, 0, 0], [1, 1, 2]]),
    "scalar": (packing("scalar", unit=1e6), [1, 2]),
    "vector": (packing("vector", unit=1e-6), [3]),
    "rotations": (packing("rotations", 3, damping=0.0), [1, 2]),
}


@pytest.mark.parametrize("name", MEDIA)
@pytest.mark.parametrize(
    ("by", "stiffer"),
    [
        ({"factor": 1.7}, lambda k, force: 1.7 * k),
        ({"factor": 0.0}, lambda k, force: 0.0 * k),
        ({"overlap": 0.03, "hertz": 0.4}, by_hertz(0.03, 0.4)),
        ({"overlap": -1e-3, "hertz": 1e-3}, by_hertz(-1e-3, 1e-3)),
    ],
)
def test_a_warm_ball_is_a_new_lattice(name, by, stiffer):
    medium, sites = MEDIA[name]
    found = heated(medium, OMEGAS, sites, **by)
    assert np.all(found.converged_reason > 0)
    for place, ball in enumerate(found.ball):
        other = swept(warm(medium, ball, stiffer), OMEGAS, sites, error_tolerance=1e-9)
        close(found.warmed[..., place], found.warmed_bound[..., place], other)
    assert len(found.ball) == len(medium.ball_numbers)


def close(after, bound, other):
    """Amplitudes are those of another sweep, to 1e-10 unless they are marked there."""
    differences = np.abs(after - other.displacement)
    assert np.all(differences <= bound + other.error_bound)
    good = other.converged_reason > 0
    assert np.mean(good) > 0.5
    assert np.all(differences[good] <= 1e-10 * np.abs(after[good]).max())


@pytest.mark.parametrize("name", ["scalar", "vector", "rotations"])
def test_a_cut_contact_is_gone(name):
    medium, sites = MEDIA[name]
    found = heated(medium, OMEGAS, sites, cut=True)
    assert found.warmed is found.heard is None
    assert found.cut.shape == (len(OMEGAS), len(sites), len(TOUCH))
    for contact in range(len(TOUCH)):
        kept = {
            key: np.delete(getattr(medium, key), contact, axis=0)
            for key in ("bond", "stiffness", "normal", "distance", "force", "tangential")
            if getattr(medium, key) is not None
        }
        other = swept(dataclasses.replace(medium, **kept), OMEGAS, sites, error_tolerance=1e-9)
        close(found.cut[..., contact], found.cut_bound[..., contact], other)


def test_a_cut_bond_of_a_lattice_has_no_dashpot():
    """Against elimination; at beta = 0 the same as one whose constant vanishes."""
    lattice, sites = random_lattice((3, 2), 4, 0.1), [[1, 1]]
    found = heated(lattice, OMEGAS, sites, cut=True)
    with mp.workdps(40):
        exact = Exact(lattice)
        for n, omega in enumerate(OMEGAS):
            right = np.array([exact.cut(1j * omega, [3], bond) for bond in range(lattice.bonds)]).T
            assert not missed(found.cut[n], right, found.cut_bound[n])[0].any()
            assert np.all(found.cut_bound[n] <= 1e-10 * np.abs(found.cut[n]))
    still = Lattice(lattice.stiffness, lattice.mass, 0.0)
    found = heated(still, OMEGAS, sites, cut=True)
    for bond in range(still.bonds):
        constants = still.constants
        constants[bond] = 0.0
        other = swept(with_constants(still, constants), OMEGAS, sites, error_tolerance=1e-9)
        close(found.cut[..., bond], found.cut_bound[..., bond], other)


@pytest.mark.parametrize("name", ["2d", "rotations"])
def test_a_little_heat_is_the_derivative(name):
    """To second order: what is left falls with the square of the factor less 1."""
    medium, sites = MEDIA[name]
    slopes = derived(medium, OMEGAS, sites, error_tolerance=1e-9)
    springs, left = medium.springs, []
    if isinstance(medium, Lattice):
        ends, total = bond_ends(np.arange(medium.balls).reshape(medium.shape)), medium.constants
        total = total * slopes.by_stiffness
    else:
        ends, total = medium.bond, medium.stiffness * slopes.by_stiffness
        total = total + medium.tangential * slopes.by_tangential
    assert springs.blocks[0] == "normal"
    for small in (1e-4, 1e-6):
        found = heated(medium, OMEGAS, sites, factor=1 + small)
        touched = np.any(ends[:, :, None] == found.ball, axis=1)
        linear = found.displacement[..., None] + (found.factor - 1) * total @ touched
        left.append(np.abs(found.warmed - linear))
    size = np.abs(total).max()
    assert left[0].max() <= 1e-4 * size
    assert np.all(left[1] <= 2e-4 * left[0].max() + 1e-12 * size)


def test_some_balls_are_those_of_all():
    for medium, sites in (MEDIA["2d"], MEDIA["rotations"]):
        every = heated(medium, OMEGAS, sites, factor=2)
        chosen = every.ball[[2, 0, 2]]
        balls = chosen
        if isinstance(medium, Lattice):
            balls = np.stack(np.unravel_index(chosen, medium.shape), axis=1)
        some = heated(medium, OMEGAS, sites, factor=2, balls=balls)
        assert some.ball.tolist() == every.ball[[0, 2]].tolist()
        difference = np.abs(some.warmed - every.warmed[..., [0, 2]])
        assert np.all(difference <= 1e-13 * np.abs(some.warmed))
        assert not np.any(heated(medium, OMEGAS, sites, factor=1).heard)
    moved = np.abs(every.warmed / every.displacement[..., None] - 1)
    assert 0 < every.heard.mean() < 1
    assert np.array_equal(every.heard, np.mean(moved >= 0.25, axis=-1))


@pytest.mark.parametrize("name", ["2d", "1d", "rotations"])
def test_any_number_of_ranks(world, name):
    """Bit for bit, or to rounding where ranks share a lattice; without damping they refuse."""
    medium, sites = MEDIA[name]
    choices = {"factor": 1.3, "cut": True}
    alone = heated(medium, OMEGAS, sites, **choices)
    assert_same(heated(medium, OMEGAS, sites, world, **choices), alone)
    if world.size > 1 and not medium.damping:
        with pytest.raises(InputError, match="that ranks share"):
            heated(medium, OMEGAS, sites, world, world.size, **choices)
        return
    shared = heated(medium, OMEGAS, sites, world, world.size, **choices)
    for kind in ("warmed", "cut", "displacement"):
        difference = np.abs(getattr(alone, kind) - getattr(shared, kind))
        assert difference.max() <= 1e-10 * np.abs(getattr(alone, kind)).max()


# What is refused


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("-heat_factor 2 -heat_overlap .1", "-heat_factor, -heat_overlap: .* one of these ways"),
        ("-heat_balls 1,1", "-heat_balls: by how much"),
        ("-heat_balls 1,1 -heat_cut", "-heat_balls: by how much"),
        ("-heat_factor -1", "-heat_factor -1"),
    ],
)
def test_options_that_contradict_each_other(words, said):
    with pytest.raises(InputError, match=said) as caught:
        resolve(read_words(f"-scene sensitivity {words}".split()))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("choices", "said"),
    [
        ({}, "give a factor or an overlap, or cut=True"),
        ({"factor": -1}, "-heat_factor -1"),
        ({"factor": 2, "overlap": 1}, "one of these ways"),
        ({"cut": True, "balls": [[0, 0]]}, "-heat_balls: by how much"),
        ({"factor": 2, "balls": [[4, 0]]}, r"-heat_balls: ball \(4, 0\) is outside"),
        ({"factor": 2, "balls": [1, 1, 1]}, "-heat_balls: a ball .* has 2 indices"),
        ({"overlap": 1, "hertz": -1.0}, "-bonds_hertz -1"),
    ],
)
def test_impossible_values(choices, said):
    with pytest.raises(InputError, match=said) as caught:
        heated(MEDIA["2d"][0], OMEGAS, [[0, 0]], **choices)
    assert "\n" not in str(caught.value)


def test_what_hertz_does_not_know():
    """Negative constants, contacts without a force, and balls of a network that are held."""
    network, stiffness = packing("vector"), packing("vector").stiffness.copy()
    with pytest.raises(InputError, match=r"-heat_overlap: contact 0 .* not Hertz's law"):
        heated(dataclasses.replace(network, force=0 * stiffness), OMEGAS, [1], overlap=0.1)
    stiffness[3] *= -0.01
    with pytest.raises(InputError, match=r"-heat_overlap: contact 3 .* not Hertz's law"):
        heated(dataclasses.replace(network, stiffness=stiffness), OMEGAS, [1], overlap=0.1)
    with pytest.raises(InputError, match="-heat_balls: ball 4 is held"):
        heated(network, OMEGAS, [1], factor=2, balls=[4])
    with pytest.raises(InputError, match="-heat_balls: no ball 5 among 5"):
        heated(network, OMEGAS, [1], factor=2, balls=[5])


def test_contacts_of_no_normal_stiffness_are_warmed():
    """Their tangential springs, by the factor."""
    network = packing("vector")
    stiffness = network.stiffness.copy()
    stiffness[1] = 0.0
    network = dataclasses.replace(network, stiffness=stiffness)
    found = heated(network, [0.6], [1], factor=3)
    with mp.workdps(40):
        exact = Exact(network)
        right = np.array([exact.warmed(0.6j, [1], ball, factor=3) for ball in found.ball]).T
    assert not missed(found.warmed[0], right, found.warmed_bound[0])[0].any()
