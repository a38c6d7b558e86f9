"""What drives a medium: pushes, parts of walls, directions; sides without a wall; gravity."""

import dataclasses

import numpy as np
import pytest
from reference import uniform_field
from samples import listened, random_lattice, relaxed, swept, uniform_lattice

import pgran
from pgran import InputError, Lattice, Network, with_source
from pgran.medium.base import record_of
from pgran.medium.springs import stiffness_matrix

OMEGAS = np.array([0.11, 0.42, 0.9])
SITES = [(1, 2), (4, 1)]
CHAIN = Network([[0, 1], [1, 2], [2, 3]], np.ones(3), [1, 0, 0, 2], position=[[0], [1], [2], [3]])
DISCS = Network(
    [[0, 1], [1, 2], [0, 2]], np.ones(3), [1, 0, 2], position=[[0, 0], [1, 0], [0.5, 0.8]],
    displacement="vector",
)  # fmt: skip
BONDS = random_lattice((3, 3))


def test_a_part_of_a_wall_by_the_closed_series(alone):
    """Equal springs, each place of the wall with a motion of its own: a sum over sine waves."""
    lattice, moved = uniform_lattice((7, 6), damping=0.02), np.array([0, 1, 1, -2, 0.5, 0])
    found = swept(dataclasses.replace(lattice, wall=moved), OMEGAS, SITES, alone)
    for omega, row in zip(OMEGAS, found.displacement, strict=True):
        exact = uniform_field((7, 6), 0.25, 1.0, 0.02, omega, moved)
        assert np.allclose(row, [complex(exact[site]) for site in SITES], rtol=1e-11)


@pytest.mark.parametrize("medium", [random_lattice((6, 5), damping=0.02, mass=2.0), DISCS])
def test_the_power_of_a_push_is_what_dashpots_take(medium, alone):
    """Its balls move by f^T A over its size on the mean, under a force of that size."""
    balls = (2, 3) if medium.is_grid else [1]
    pushed = with_source(medium, balls=balls, force="drive" if medium.is_grid else "y")
    assert pushed.drive_size == pytest.approx(1)
    found = swept(pushed, OMEGAS, balls, alone, fields=True)
    springs = pushed.springs
    weights = 1.0 if medium.is_grid else pushed.weights
    for n, omega in enumerate(OMEGAS):
        stretch = springs.B @ (found.field[n].ravel() / weights)
        loss = 0.5 * omega**2 * medium.damping * np.sum(springs.damped * np.abs(stretch) ** 2)
        assert found.power[n] == pytest.approx(loss, rel=1e-9)
    point = found.displacement[:, 0] / medium.kmax  # displacement for a force of 1
    assert np.allclose(found.force, 1 / point, rtol=1e-9)
    assert np.all(np.abs(found.force - 1 / point) <= 1.1 * found.force_bound + 1e-12)


@pytest.mark.parametrize("shape", [(5,), (4, 3), (3, 2, 2)])
def test_the_least_damping_of_any_free_sides_in_closed_form(shape):
    """Half waves between walls, quarters to a free side; a lattice without walls floats."""
    sides = [f"{axis}{end}" for axis in "xyz"[: len(shape)] for end in "-+"]
    for count in range(len(sides) + 1):
        free = sides[-count:] if count else []
        lattice = dataclasses.replace(uniform_lattice(shape, 1.0), free=free)
        assert lattice.free == tuple(free)
        least = np.linalg.eigvalsh(stiffness_matrix(lattice).toarray())[0]
        assert lattice.least_damping == pytest.approx(least, abs=1e-14)
        assert len(lattice.existing) == lattice.bonds - sum(
            np.prod(shape) // shape["xyz".index(side[0])] for side in free
        )


def test_pulses_of_a_push_balance(alone):
    """Work, energy and losses by the transform; the integration gives the same signals."""
    lattice = dataclasses.replace(random_lattice((6, 5), damping=0.02), free=("y+",))
    pushed = with_source(lattice, balls=(2, 3))
    by = [
        listened(pushed, [(4, 1)], alone, method=method, time=120.0)
        for method in ("laplace", "moments")
    ]
    proven = by[0]
    assert np.abs(proven.work - proven.energy - proven.dissipated).max() < 1e-9 * proven.work.max()
    for name in ("displacement", "work", "force"):
        values = [getattr(signals, name) for signals in by]
        assert np.abs(values[0] - values[1]).max() <= 1e-5 * np.abs(values[0]).max()


def test_bonds_at_free_sides_do_not_exist(alone):
    """They are never redrawn, amplitudes do not depend on them, and a result keeps the source."""
    lattice = dataclasses.replace(random_lattice((4, 3), damping=0.02), free=("x-", "y+"))
    pushed = with_source(lattice, balls=(1, 1, 2, 0))
    steps = relaxed(pushed, [(3, 2)], alone, steps=60)
    where = [tuple(index) for index in steps.bond_index[0][steps.bond_axis[0] == 0].tolist()]
    assert min(index[0] for index in where) == 1
    slopes = pgran.sensitivity(pushed, [0.3], (3, 2)).by_stiffness[0, 0]
    assert np.array_equal(slopes != 0, pushed.exists == 1)
    for medium in (pushed, with_source(lattice, part="y<2"), with_source(DISCS, balls=[1])):
        assert record_of(medium).built == medium


def test_gravity_makes_contacts_stiffer_with_depth():
    """By Hertz's law: k^3 grows like the mean force, from ball to ball along the last axis."""
    plain, deep = (
        Lattice.random((3, 4), 5, "hertz", force=2.0, gravity=weight) for weight in (0.0, 0.5)
    )
    x, y = ((b / a) ** 3 for a, b in zip(plain.stiffness, deep.stiffness, strict=True))
    assert np.allclose(x, 1 + 0.25 * (3.5 - np.arange(4)))
    assert np.allclose(y, 1 + 0.25 * (4.0 - np.arange(5)))
    with pytest.raises(InputError, match="bonds_law hertz only"):
        Lattice.random((3, 3), gravity=1.0)


def test_parts_and_directions_of_held_balls():
    """A condition says which held balls move; all others are at rest."""
    assert with_source(CHAIN, part="x<1").held.tolist() == [2, 0, 0, 1]
    assert with_source(DISCS, direction=(0, 2)).direction.tolist() == [0, 1]
    pushed = with_source(DISCS, balls=[1], force="y")
    assert pushed.push.tolist() == [[0, 0], [0, 1], [0, 0]]
    assert pushed.held.tolist() == [1, 0, 1]
    assert with_source(random_lattice((6, 5)), part="y>=1 and y<3").wall.tolist() == [0, 1, 1, 0, 0]


FREE = ("x-", "x+", "y-", "y+")
ON_HELD, ONE = [[1.0, 0]] * 3, [[0, 0], [1, 0], [0, 0]]


@pytest.mark.parametrize(
    ("medium", "source", "change", "said"),
    [
        (DISCS, {"part": "x<1", "balls": [1]}, {}, "give one, a wall or a force drives"),
        (DISCS, {"force": "x"}, {}, "-drive_force: points the force on -drive_balls"),
        (DISCS, {"part": "q<1"}, {}, "there is no q along what is held; coordinates are: x, y"),
        (DISCS, {"part": "x>9"}, {}, "-drive_part: 'x>9' chooses no ball"),
        (CHAIN, {"balls": [0]}, {}, "drive_balls: ball 0 is held"),
        (CHAIN, {"direction": (0, 1)}, {}, "-drive_direction: balls of this medium have one displ"),
        (DISCS, {"direction": "z"}, {}, "-drive_direction: choose drive, x, y, or 2 components"),
        (BONDS, {"balls": (3, 3)}, {}, "drive_balls: ball .3, 3. is outside"),
        (BONDS, {}, {"free": ("w+",)}, "-lattice_free: 'w.' is none of x-, x., y-, y."),
        (BONDS, {}, {"free": ("x+",)}, "x. is the wall that drives"),
        (BONDS, {}, {"free": FREE}, "without any wall the lattice floats"),
        (BONDS, {}, {"wall": [1, 2]}, "lattice: wall: finite numbers of the shape"),
        (BONDS, {}, {"wall": [1, 0, 0], "push": np.ones((3, 3))}, "either a wall moves or a push"),
        (DISCS, {}, {"push": ON_HELD}, "forces on free balls"),
        (DISCS, {}, {"push": ONE}, "either held balls are driven"),
        (DISCS, {}, {"held": [1, 0, 1]}, "no ball is driven"),
    ],
)
def test_impossible_sources_are_refused(medium, source, change, said):
    """In a line that says what is wrong, when they are made or are to drive."""
    with pytest.raises(InputError, match=said):
        dataclasses.replace(with_source(medium, **source), **change).check_driven()


def test_ranks_that_share_a_pushed_lattice_agree(comm, alone):
    """With a free side, as a curve, too."""
    lattice = dataclasses.replace(random_lattice((8, 6), damping=0.02), free=("y+",))
    for medium in (with_source(lattice, balls=(2, 3)), with_source(lattice, part="y<2")):
        expected = swept(medium, OMEGAS, SITES, alone)
        found = swept(medium, OMEGAS, SITES, comm, comm.size)
        assert np.allclose(found.displacement, expected.displacement, rtol=1e-9)
        assert np.allclose(found.force, expected.force, rtol=1e-9)
