"""What Python hands in: plain numbers, calls that fit, laws that are laws, and what is equal."""

import dataclasses

import numpy as np
import pytest
from samples import random_lattice

import pgran
from pgran.arguments import whole_number
from pgran.run.numbers import number, numbers

LATTICE = random_lattice((5, 4), 3)
NETWORK = pgran.Network([[0, 1], [1, 2]], [1.0, 2.0], [1, 0, 2])
OMEGAS = [0.2, 0.5]


@pytest.mark.parametrize(
    "value",
    [
        True, [1.0, True], (np.True_, 2), 1j, np.array([1 + 0j]), "1", ["1"], None, [1, None],
        [[1], [2, 3]], {1.0}, np.array([1, 2], dtype=object), np.ma.masked_array([1, 2], [0, 1]),
        np.datetime64("2020"),
    ],
)  # fmt: skip
def test_what_is_no_number_is_refused(value):
    with pytest.raises(pgran.InputError, match="x: real numbers are needed, not "):
        numbers("x", value)


@pytest.mark.parametrize("value", [2.5, [1, 2.5], np.nan, np.inf, 1e300, 2.0**63, np.uint64(2**63)])
def test_what_is_no_whole_number_is_refused(value):
    with pytest.raises(pgran.InputError, match="x: whole numbers are needed, not "):
        numbers("x", value, whole=True)


def test_endless_numbers_are_told_of_by_their_type():
    endless, within = 10**5000, []
    within.append(within)
    for value, shown in ((endless, "a int"), (within, r"\[\[\[")):
        with pytest.raises(pgran.InputError, match=f"needed, not {shown}"):
            numbers("x", value)
        with pytest.raises(pgran.InputError, match="relax_steps"):
            pgran.relax(LATTICE, None, 0.5, [2, 1], steps=value)


def test_numbers_come_as_they_like():
    pair = [8, 10]
    for value in (pair, (8.0, 10.0), np.uint8(pair), np.float32(pair), range(8, 11, 2)):
        assert numbers("x", value).tolist() == [8.0, 10.0]
        assert numbers("x", value, whole=True).dtype == np.int64
    assert number("x", np.float64(0.5)) == 0.5
    assert whole_number("x", np.uint64(2**64 - 1)) == 2**64 - 1
    for value in (True, np.True_, 1.0, "1", None, np.array([1, 2])):
        with pytest.raises(pgran.InputError, match="a whole number is needed"):
            whole_number("x", value)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: pgran.sweep(LATTICE), "sweep: missing .* 'omegas'; it takes lattice, omegas, det"),
        (lambda: pgran.sweep(LATTICE, OMEGAS, [2, 1], tol=1), "'tol'; it takes .*error_t"),
        (lambda: pgran.sweep(LATTICE, OMEGAS, [2, 1], methd="curve"), "did you mean method?"),
        (lambda: pgran.sweep(LATTICE, [], [2, 1]), "frequencies must"),
        (lambda: pgran.sweep(LATTICE, [-1.0, 1.0], [2, 1]), "frequencies must"),
        (lambda: pgran.sweep(LATTICE, [np.nan], [2, 1]), "frequencies must"),
        (lambda: pgran.sweep(LATTICE, [[0.1, 0.2]], [2, 1]), "frequencies must"),
        (lambda: pgran.project(LATTICE, OMEGAS, which={"nearest": 3}), "which: a dict of"),
        (lambda: pgran.find_modes(LATTICE, targets=[0.5]), "belong together"),
        (lambda: pgran.sweep(LATTICE.stiffness, OMEGAS, [2, 1]), "lattice: a pgran.Lattice or"),
        (lambda: pgran.sweep(LATTICE, OMEGAS, [2, 1], crew=3), "crew is no"),
        (lambda: pgran.sweep(LATTICE, OMEGAS, [2, 1], progress="loud"), "did you mean|choose auto"),
        (lambda: pgran.sweep(LATTICE, OMEGAS, [2, 1], solver=3), "solver: a dict"),
        (lambda: pgran.Lattice(), "Lattice: missing .* 'stiffness'"),
        (lambda: pgran.Lattice([k + 1j for k in LATTICE.stiffness]), "stiffness: real numbers"),
        (lambda: pgran.Lattice(LATTICE.stiffness, kmax=-1), "bonds_kmax"),
        (lambda: pgran.Lattice.random((3, 2), tall=1), r"Lattice|BondLaw: .* 'tall'"),
        (lambda: pgran.Lattice.random((3, True)), "lattice_shape: whole numbers"),
        (lambda: pgran.Lattice.random((3, 2), law="uniform", force=3), "bonds_force: no param"),
        (lambda: pgran.Lattice.random((10**9, 10**9)), "-lattice_shape: too much"),
        (lambda: pgran.BondLaw(), "BondLaw: missing .* 'name'"),
        (lambda: pgran.Network([[0, 1]]), "Network: missing .* 'stiffness'"),
        (lambda: pgran.Network([[0, 1]], None, [1, 0]), "network: stiffness"),
        (lambda: pgran.Network([[0, 1]], [1], [True, False]), "network: held: whole numbers"),
        (lambda: pgran.statistics(LATTICE, [0.1, 0.2]), "no curves"),
        (lambda: pgran.statistics(), "statistics: missing"),
        (lambda: pgran.transport(LATTICE, LATTICE), "no curves"),
        (lambda: pgran.load(), "load: missing"),
        (lambda: pgran.plot(3), "a result or its path is needed, not 3"),
        (lambda: pgran.plot(OMEGAS), "a result or its path is needed"),
        (lambda: pgran.plot("a.h5", colour="red"), "'colour'; it takes result, output"),
        (lambda: pgran.export(3, "a.csv"), "a result or its path is needed"),
        (lambda: pgran.export("a.h5", 5), "no path of a file"),
    ],
)  # fmt: skip
def test_calls_that_misfit_say_what_would_do(call, said):
    with pytest.raises(pgran.InputError, match=said):
        call()


def test_what_is_no_path_is_no_file():
    for path in (None, 3, True, ["a.h5"], "a\0b"):
        with pytest.raises(pgran.PgranError, match="no name of a file"):
            pgran.load(path)


@pytest.mark.parametrize(
    ("medium", "detectors"),
    [
        (LATTICE, [(2.9, 2.0)]), (LATTICE, [(True, True)]), (LATTICE, (2 + 0j, 1)), (LATTICE, None),
        (LATTICE, [(2, 1, 3), (4, 0, 1)]), (LATTICE, [[[2, 1]]]),
        (LATTICE, [(5, 0)]), (LATTICE, [3]), (LATTICE, []), (LATTICE, [(1, -1)]),
        (NETWORK, [1.9]), (NETWORK, [True]), (NETWORK, [(1, 1)]),
    ],
)  # fmt: skip
def test_no_ball_is_guessed(medium, detectors):
    with pytest.raises(pgran.InputError, match="detectors: "):
        pgran.sweep(medium, OMEGAS, detectors)


@pytest.mark.parametrize(
    ("law", "said"),
    [
        (lambda u: -u, "not negative, and it returns -"),
        (lambda u: u * np.nan, "finite"),
        (lambda u: 0.5, r"shape \(\) for"),
        (lambda u: u[1:], "of the shape"),
        (lambda u: u * 1j, "real numbers"),
        (lambda u: u["x"], "law: fails: IndexError"),
        (lambda u: u / u.max(), "its own number alone"),
        (lambda u: np.random.default_rng().random(u.shape), "another source of chance"),
        ("uniform", "pgran.BondLaw makes one"),
    ],
)
def test_laws_of_changes_are_tried_first(law, said):
    with pytest.raises(pgran.InputError, match=said):
        pgran.relax(LATTICE, law, 0.5, [2, 1], steps=3)


def test_a_law_that_goes_wrong_only_later_is_noticed():
    """Beyond the numbers that it is tried with."""
    with pytest.raises(pgran.InputError, match="not negative"):
        pgran.relax(LATTICE, lambda u: np.where(u < 0.004, -1.0, u), 0.5, [2, 1], steps=2000)


def test_media_are_equal_if_all_that_they_are_made_of_is():
    for medium in (LATTICE, NETWORK):
        again = dataclasses.replace(medium)
        assert again is not medium
        assert again == medium
        assert {medium: 1}[again] == 1
        for change in ({"damping": 0.1}, {"stiffness": medium.in_own_unit()[0].stiffness}):
            other = dataclasses.replace(medium, **change)
            assert other != medium
            assert len({other, medium, again}) == 2
    assert LATTICE != NETWORK
    assert LATTICE != "lattice"


def test_frequencies_above_all_modes_are_told_once(caplog):
    """As where Hz are taken for angular frequencies; by many samples once, too."""
    choices = {"omegas": [5.0, 6.0], "detectors": [2, 1]}
    pgran.ensemble("response", 3, lattice={"shape": (5, 4)}, **choices)
    assert caplog.text.count("omega = 5, the lowest asked for, is above all modes (omega_mx") == 1
    caplog.clear()
    pgran.sweep(LATTICE, [1.0, 6.0], [2, 1])
    pgran.relax(LATTICE, None, 0.5, [2, 1], steps=3)
    assert not caplog.text
    for asked in (
        lambda: pgran.relax(LATTICE, None, 5.0, [2, 1], steps=3),
        lambda: pgran.find_modes(LATTICE, interval=(5.0, 6.0)),
        lambda: pgran.pulse(LATTICE, [2, 1], omega=50.0, width=2.0, time=30.0, points=601),
    ):
        caplog.clear()
        asked()
        assert caplog.text.count("omega = 2 pi f") == 1
