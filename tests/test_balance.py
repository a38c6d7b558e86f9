"""Balls under a contact law: their rest, held against exact solutions and sums done otherwise."""

import dataclasses
import itertools
from pathlib import Path

import numpy as np
import pytest
from packing_samples import cells, pairs_in, pushes
from scipy.linalg import null_space
from scipy.sparse import identity

import pgran
from pgran.balance import equilibrium
from pgran.balance.equilibrium import Factors, NotBalancedError, at_rest, factored, newton
from pgran.balance.motion import Balls, Motion, listed
from pgran.balance.networks import balls_of, contact_changes, grown
from pgran.balance.pack import packed_network
from pgran.medium.graph import loose_balls, subnetwork
from pgran.medium.network_file import read_network
from pgran.medium.packing import ContactLaw, near_pairs

PACKINGS = Path(__file__).parents[1] / "options" / "packings"
INFINITE = np.full(2, np.inf)


def left_over(network):
    """The largest total force on a free ball, in mean forces."""
    return np.linalg.norm(pushes(network)[network.free], axis=1).max() / network.force.mean()


def row(count, overlap, law, kink=0.0):
    """A row of discs of radius 1/2 between two held ones, each contact with the same overlap."""
    position = np.zeros((count, 2))
    position[:, 0] = (1 - overlap) * np.arange(count)
    position[1:-1:2, 1] = kink
    held = np.isin(np.arange(count), (0, count - 1))
    return Balls(position, np.full(count, 0.5), held, INFINITE, law)


@pytest.fixture(scope="module")
def spheres():
    return read_network(PACKINGS / "spheres.h5")


@pytest.mark.parametrize("power", [1.0, 2.5])
def test_a_ball_that_grows_in_a_row_presses_alike_on_all(power):
    """The balls between the ends share 2 dR: dF = 2 dR / sum(1/k), the same in all contacts."""
    law, dR = ContactLaw(power, 3.0), 1e-7
    before = at_rest(row(7, 0.02, law))
    radius = before.balls.radius.copy()
    radius[2] += dR
    after = grown(before.balls, before.contacts, radius)
    each = [rest.contacts.of(rest.contacts.overlap > 0) for rest in (before, after)]
    force = [law.force(contacts.constants, contacts.overlap) for contacts in each]
    assert np.ptp(force[1]) < 5e-12 * force[1].mean()  # 1e-12 is left on each of 5 balls
    change = force[1].mean() - force[0].mean()
    curved = np.diff([contacts.constants for contacts in each], axis=0)  # c of a rounder ball
    stiffness = law.stiffness(each[0].constants, each[0].overlap)
    bent = np.sum(curved[0] * each[0].overlap ** power / stiffness)
    expected = (2 * dR + bent) / np.sum(1 / stiffness)
    assert change == pytest.approx(expected, rel=1e-4)


def test_what_finds_no_rest():
    """A straight row is held in its direction alone: any kink grows. Two balls fly apart."""
    assert at_rest(row(4, 0.02, ContactLaw(1.0))).saddle
    alone = row(2, 0.1, ContactLaw(1.5))
    for balls in (
        row(4, 0.02, ContactLaw(1.0), kink=1e-3),
        dataclasses.replace(alone, held=~alone.held),  # the force on each would be zero
    ):
        with pytest.raises(NotBalancedError, match=r"flown apart|rigidity|no rest"):
            at_rest(balls)


def test_pairs_are_those_of_all_images():
    rng = np.random.default_rng(3)
    box = np.array([6.0, np.inf, 7.0])
    inside, radius = rng.uniform(0, 6, (60, 3)), rng.uniform(0.3, 0.7, 60)
    position = inside + rng.integers(-2, 3, (60, 3)) * [6.0, 0.0, 7.0]
    pairs, away, _ = near_pairs(position, radius, box, 0.2)
    expected = pairs_in(inside, radius, [6.0, 0.0, 7.0], 0.2)
    assert {*map(tuple, pairs)} == {*map(tuple, expected[:, :2])}
    assert np.allclose(np.sort(np.linalg.norm(away, axis=1)), np.sort(expected[:, -1]))
    with pytest.raises(pgran.InputError, match="more balls"):
        near_pairs(position, radius, np.full(3, 3.0), 0.2)


def test_rattlers_are_found_one_after_the_other():
    """A chain that hangs on a triangle of held balls falls off, its end first."""
    pairs = np.array([[0, 1], [1, 2], [2, 0], [2, 3], [3, 4]])
    held = np.array([True, True, True, False, False])
    assert loose_balls(pairs, held, 2).tolist() == [False, False, False, True, True]


def test_newton_converges_quadratically(spheres):
    """Its residuals square from step to step, until rounding."""
    balls, contacts = balls_of(spheres)
    radius = balls.radius.copy()
    radius[184] += 0.02 * spheres.overlap.mean()
    contacts = contacts.grown(balls.law, balls.radius, radius)
    balls = dataclasses.replace(balls, radius=radius)
    motion, residuals = Motion(balls, listed(balls, contacts, reach=0.1)), []
    measured = motion.residual
    motion.residual = lambda *words: residuals.append(measured(*words)) or residuals[-1]
    newton(motion, 0.1, 1e-13)
    constants = [b / a**2 for a, b in itertools.pairwise(residuals) if b > 1e-12]
    assert len(constants) >= 2
    assert max(constants) < 10 * max(min(constants), 0.1)


@pytest.mark.parametrize(
    ("ball", "contacts", "energy"), [(184, 951, 5.391802e-3), (259, 946, 5.397666e-3)]
)
def test_a_grown_ball_in_a_packing(spheres, ball, contacts, energy):
    """The known rest; |force| alone leads the second one's packing to fly apart."""
    balls, reference = balls_of(spheres)
    radius = balls.radius.copy()
    radius[ball] += 0.3 * spheres.overlap.mean()
    for growth in (0.5, 0.1):  # the same rest on a path of smaller steps
        rest = grown(balls, reference, radius, growth)
        overlap = np.maximum(rest.contacts.overlap, 0)
        assert np.count_nonzero(overlap) == contacts
        assert rest.contacts.constants @ overlap**2.5 / 2.5 == pytest.approx(energy, rel=2e-7)
        assert rest.residual < 1e-12


def test_a_network_at_rest_stays_and_comes_back(spheres):
    """Contacts, forces, positions: after a ball has grown a little and shrunk again, too."""
    rest = pgran.equilibrate(spheres)
    assert contact_changes(spheres, rest) == (0, 0)
    assert left_over(rest) < 1e-12
    np.testing.assert_allclose(rest.force, spheres.force, rtol=1e-8)
    radius = rest.radius.copy()
    radius[100] += 0.1 * rest.overlap.mean()
    larger = pgran.equilibrate(rest, radius)
    assert left_over(larger) < 1e-12
    back = pgran.equilibrate(larger, rest.radius)
    order = [np.lexsort(np.sort(net.bond, axis=1).T) for net in (rest, back)]
    np.testing.assert_allclose(back.force[order[1]], rest.force[order[0]], rtol=1e-8)
    np.testing.assert_allclose(back.position, rest.position, rtol=0, atol=1e-10)


def test_held_balls_and_numbers_stay_when_contacts_change(spheres):
    radius = spheres.radius.copy()
    radius[184] += 0.3 * spheres.overlap.mean()
    after = pgran.equilibrate(spheres, radius)
    opened, closed = contact_changes(spheres, after)
    assert closed - opened == 951 - 948
    assert np.array_equal(after.held, spheres.held)
    held = spheres.held > 0
    assert np.array_equal(after.position[held], spheres.position[held])
    assert np.array_equal(after.radius, radius)
    overlap = after.radius[after.bond].sum(axis=1) - after.distance
    np.testing.assert_allclose(after.overlap, overlap, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"power": None}, "does not know its contact law"),
        ({"force": None}, "does not know its contact law"),
        ({"radius": None}, "radii"),
        ({"force": 0.0}, "nothing to balance"),
        ({"tangential": 1.0}, "no friction"),
        ({"stiffness": 0.0}, "a contact under a law has a positive stiffness"),
        ({"box": None}, "contact .* periods of the box missing"),
        (np.ones(1), "319 positive numbers"),
        (-np.ones(319), "319 positive numbers"),
        (np.full(319, np.nan), r"319 positive numbers|finite"),
    ],
)
def test_what_is_refused(spheres, change, message):
    """A network without a law, or impossible radii."""
    radius, changed = (None, change) if isinstance(change, dict) else (change, {})
    for name, value in changed.items():
        changed[name] = np.full(spheres.bonds, value) if isinstance(value, float) else value
    with pytest.raises(pgran.InputError, match=message) as refused:
        pgran.equilibrate(dataclasses.replace(spheres, **changed), radius)
    assert "\n" not in str(refused.value)


def test_one_state_of_self_stress():
    """With one contact more than isostatic all forces change in the proportion s that balances.

    dF = s (s . e) / |s|^2, e = dR in the contacts of the ball that grows, all of one stiffness; but
    for the pre-stress, which moves the balls by a part of the pressure.
    """
    wrong = []
    for pressure in (1e-5, 1e-6):
        network, packed = packed_network(30, pressure=pressure, seed=0)
        assert packed.excess == 0
        stretches = np.zeros((network.bonds, *network.position.shape))
        for end, sign in zip(network.bond.T, (-1, 1), strict=True):
            stretches[np.arange(network.bonds), end] += sign * network.normal
        (s,) = null_space(stretches.reshape(network.bonds, -1).T).T
        assert abs(s @ network.force) == pytest.approx(np.linalg.norm(network.force), rel=1e-12)
        balls, contacts = balls_of(network)
        dR = 1e-4 * network.overlap.mean()
        radius = balls.radius + dR * (np.arange(len(balls.radius)) == 3)
        overlap = grown(balls, contacts, radius).contacts.overlap
        change = overlap[overlap > 0] - network.force
        expected = s * (s @ np.any(network.bond == 3, axis=1)) * dR
        wrong.append(np.linalg.norm(change - expected) / np.linalg.norm(change))
    assert wrong[1] < 1e-3
    assert wrong[1] == pytest.approx(wrong[0] / 10, rel=0.05)


def test_what_floats_comes_to_rest():
    """A periodic packing of another power that nothing holds, whose balls can all move together."""
    network = pgran.pack(60, law=1.25, pressure=1e-3, seed=2)
    assert network.power == 1.25
    larger = pgran.equilibrate(network, network.radius * 1.0001)
    assert larger.force.mean() > network.force.mean()
    assert left_over(larger) < 1e-12


def test_rattlers_are_left_without_contacts_that_bear_what_rounding_left(caplog):
    """Two contacts hold no disc; whether three of 1e-13 of the mean force do cannot be told."""
    caplog.set_level("INFO", "pgran")
    whole = cells(0.01, 0.01, 1e-15)
    apart = whole.position - 0.1 * (np.arange(12) == 11)[:, None]
    two = dataclasses.replace(subnetwork(whole, contacts=range(8)), position=apart)
    for network, undecided in ((two, 0), (whole, 1)):
        caplog.clear()
        rest = pgran.equilibrate(network)
        assert rest.bond.tolist() == whole.bond[:6].tolist()
        assert rest.held.tolist() == [0, 2, 1, 1, 0, 2, 1, 1, 1, 2, 1, 1]
        assert "rattlers: 1 more" in caplog.text
        assert ("rounding decides" in caplog.text) == undecided


def test_an_obstacle_that_bears_what_rounding_left_is_warned_of(caplog):
    """A held disc, as a rattler of before, on a disc that bears forces: is that contact closed?"""
    cell, h = cells(0.01), 1e-14
    more = {
        "bond": [[0, 4]], "stiffness": [1.0], "held": [1], "masses": [1.0], "force": [h],
        "normal": [[-1.0, 0.0]], "distance": [1 - h], "radius": [0.5], "position": [[h - 1, 0.0]],
    }  # fmt: skip
    both = {name: np.concatenate([getattr(cell, name), values]) for name, values in more.items()}
    rest = pgran.equilibrate(dataclasses.replace(cell, **both))
    assert rest.bond.tolist() == cell.bond.tolist()
    assert "of 1 contacts or balls rounding decides" in caplog.text


def test_what_is_out_of_balance_moves_until_it_balances(spheres):
    """An import whose forces do not cancel: nothing is taken for granted."""
    force = spheres.force * np.random.default_rng(5).uniform(0.8, 1.25, spheres.bonds)
    shaken = dataclasses.replace(spheres, force=force)
    assert left_over(shaken) > 0.05
    assert left_over(pgran.equilibrate(shaken)) < 1e-12


def test_factors_are_reused(spheres, monkeypatch):
    """They solve with matrices near their own, and give up where those are far or indefinite."""
    monkeypatch.setattr(equilibrium, "FEWEST_SOLVES", 1)
    balls, contacts = balls_of(spheres)
    start = Motion(balls, contacts)
    K, _, _ = start.matrix(start.state(np.zeros_like(balls.position), 0.0))
    right, kept = np.sin(np.arange(K.shape[0])), Factors()
    assert kept.solve(K, right) is None
    kept.keep(factored(K))
    kept.solves = 20
    near = K.copy()
    near[5, 5] *= 1.5
    near[70, 70] *= 0.97
    x = kept.solve(near, right)
    assert np.abs(near @ x - right).max() < 1e-4
    for far in (K @ K, K - K.diagonal().max() * identity(K.shape[0])):
        kept.keep(factored(K))
        assert kept.solve(far, right) is None
        assert kept.factors is None
    larger = spheres.radius.copy()
    larger[spheres.free[7]] += 0.1 * spheres.overlap.mean()
    few = grown(balls, contacts, larger)
    monkeypatch.setattr(equilibrium, "FEWEST_SOLVES", np.inf)
    each = grown(balls, contacts, larger)
    assert few.factorizations < each.factorizations
    assert np.abs(few.balls.position - each.balls.position).max() < 1e-12
