"""Moments: closed forms, factorizations, guards; tests/campaigns/moments.py has 60 digits."""

import dataclasses
import re

import numpy as np
import pytest
from mpmath import ellipk, mp
from network_samples import NetworkReference, as_network
from samples import random_lattice, uniform_lattice
from sensitivity_samples import packing

import pgran
from pgran.driven import moment_sweep
from pgran.driven.ellipse import Ellipse
from pgran.driven.moment_sweep import series_of
from pgran.driven.moments import law_of
from pgran.driven.recurrence import Recurrence, Rows
from pgran.errors import InputError, PgranError
from pgran.experiments.response.quicker import by_moments
from pgran.run.crew import Crew

OMEGA = np.array([0.6, 1.2])
LATTICE = random_lattice((6, 5), 3, damping=0.1)
PRE_STRESSED = packing("vector", damping=0.0, tangential=None)
VECTORS, ROTATIONS = (packing(kind, damping=0.2, force=None) for kind in ("vector", "rotations"))
MEDIA = {
    "lattice": LATTICE,
    "law": dataclasses.replace(LATTICE, damping_power=1.0, loss=0.1, drag=0.02),
    "scalar": packing("scalar", damping=0.2),
    "vectors": VECTORS,
    "rotations, drag": dataclasses.replace(ROTATIONS, drag=np.linspace(0, 0.1, 5)),
    "pre-stress": dataclasses.replace(PRE_STRESSED, drag=0.2),
}


def green(method, medium=LATTICE, crew=None, **choices):
    """Green's functions of two balls at sigma = 0."""
    omegas, balls = OMEGA, [(1, 2), (4, 4)]
    if not medium.is_grid:
        omegas, balls = 2 * OMEGA, medium.free[:2]
    return pgran.green(medium, omegas, balls, None, crew, method=method, **choices)


def apart(one, other):
    """How far they are apart, in units of both bounds."""
    return np.abs(one.green - other.green) / (one.error_bound + other.error_bound)


@pytest.mark.parametrize(("shape", "squares"), [((121,), 6), ((101, 101), 20)])
def test_closed_forms_and_sum_rules(shape, squares, comm):
    """An infinite chain and square of springs 1, whose walls are too far away to be heard."""
    s, middle = 0.3 + 2j * OMEGA, np.zeros(shape)
    medium, middle[tuple(n // 2 for n in shape)] = uniform_lattice(shape, 1.0, 0.0), 1.0
    exact = 1 / (s * np.sqrt(s * s + 4))
    if len(shape) == 2:
        exact = [complex(2 / (mp.pi * z) * ellipk((4 / z) ** 2)) for z in 4 + s * s]
    with Rows(medium, comm) as rows:
        series = series_of(rows, medium, s)
        terms = series.terms(*series.read(rows.layout.free_values(middle), None, 200), None)
    for point, expected in zip(s, exact, strict=True):
        series.at(point, 200)
        (value,), (bound,) = series.values(terms)
        assert abs(value - expected) <= bound < 1e-9
    a, b, (m0, m1, m2) = series.a, series.b, terms.readings[:3, 0]  # X = (a K - b) / 2
    assert (2 * m1 + b * m0) / a == pytest.approx(2 * len(shape), rel=1e-13)  # f K f
    assert (2 * (m2 + m0) + 4 * b * m1 + b * b * m0) / a**2 == pytest.approx(squares, rel=1e-13)


@pytest.mark.parametrize("name", MEDIA)
def test_agreement_with_factorizations(name, world):
    """Within both bounds, whether ranks share a medium or not; of structure factors, too."""
    medium = MEDIA[name]
    exact = green("factor", medium)
    for ranks in {1, world.size}:
        with Crew(world, ranks) as crew:
            found = world.bcast(green("moments", medium, crew))
        assert np.all(apart(found, exact) <= 1)
        assert np.all(found.error_bound < 1e-5 * np.abs(exact.green).max())
    for each in (medium, medium.undamped()) if medium.is_grid else ():
        a, b = (pgran.structure(each, 3, OMEGA, width=0.1, method=m) for m in ("factor", "moments"))
        far = np.abs(a.structure_factor - b.structure_factor)
        assert np.all(far <= a.error_bound + b.error_bound)
        assert not b.failures


@pytest.mark.parametrize("name", ["lattice", "scalar", "vectors", "pre-stress"])
def test_the_enclosure_holds_the_spectrum(name, comm):
    medium = dataclasses.replace(MEDIA[name], damping=0.0)
    whole = NetworkReference(as_network(medium) if medium.is_grid else medium)
    with Rows(medium, comm) as rows:
        series = series_of(rows, medium, np.array([0.1 + 1j]))
    assert 0.6 < np.abs(series.a * whole.eigenvalues() - series.b).max() / 2 <= 1 + 1e-14


@pytest.mark.parametrize("name", ["lattice", "law"])
def test_a_wrong_product_breaks_the_bound(name, monkeypatch):
    """By 1e-9 of it, which no figure would show."""
    exact, right = (green(m, MEDIA[name], error_tolerance=1e-8) for m in ("factor", "moments"))
    made = Recurrence.__init__
    spoilt = lambda self, rows, H, *back: made(self, rows, H * (1 + 1e-9), *back)  # noqa: E731
    monkeypatch.setattr(Recurrence, "__init__", spoilt)
    assert np.all(apart(right, exact) <= 1)
    assert np.any(apart(green("moments", MEDIA[name], error_tolerance=1e-8), exact) > 1)


def test_too_few_terms_are_marked_or_factored(monkeypatch):
    monkeypatch.setattr(moment_sweep, "MARGIN", 1e-3)
    mended, exact = map(green, ("moments", "factor"))
    assert mended.moments > 0
    assert mended.factorizations > 0
    assert np.array_equal(mended.green[0], exact.green[0])
    assert not mended.failures


def test_parts_of_unlike_series_do_not_fit_together(monkeypatch):
    """As of a journal of another machine, whose search for an ellipse has ended elsewhere."""
    monkeypatch.setattr(moment_sweep.MomentSweep, "blank", lambda self, _: np.zeros(1, self.row))
    with pytest.raises(PgranError, match="round differently"):
        green("moments")


def test_groups_that_round_differently_choose_alike(monkeypatch, world):
    needed, rank = moment_sweep.needed_moments, world.rank
    monkeypatch.setattr(moment_sweep, "needed_moments", lambda *of: needed(*of) / (1 + 9 * rank))
    with Crew(world, 1) as crew:
        found = world.bcast(green("moments", crew=crew))
    assert found.moments > 0
    assert np.all(apart(found, green("factor")) <= 1)


def test_readings_that_fill_the_memory_are_refused(monkeypatch):
    monkeypatch.setattr(moment_sweep, "LARGEST", 1000)
    with pytest.raises(InputError, match="moments, of 31 at most; take auto"):
        green("moments")


def test_an_ellipse_next_to_the_range(alone):
    """Dashpots so weak that the search ends where b is Omega but for a few digits."""
    s = 0.30265489 + 1j * np.array([0.41717229, 1.0947462, 0.3351522, 0.95638348, 0.72307459])
    ellipse = Ellipse(1.0, 3.171767125553547e-12, 0.1483889093287721, s, alone)
    assert 0 < ellipse.a < 1e-3
    assert 0 < ellipse.b - 1 < 1e-3


REFUSED = [
    (LATTICE, {"damping": 9.0}, "overdamped"),
    (LATTICE, {"damping": 1e-6}, "the nearest takes .* moments, of 100000 at most"),
    (LATTICE, {"loss": 0.1}, "loss angles beside other damping"),
    (PRE_STRESSED, {"damping": 0.1}, "pre-stress beside other damping"),
    (uniform_lattice((6, 5), 0.0), {}, "a medium without stiff springs"),
]


@pytest.mark.parametrize(("medium", "changes", "said"), REFUSED)
def test_what_has_no_series_is_refused(medium, changes, said):
    with pytest.raises(InputError, match=f"-green_method moments: .*{said}.*; take auto"):
        green("moments", dataclasses.replace(medium, **changes))


def test_where_no_spring_is_stiff_all_that_moments_give_is_refused():
    limp, chosen = uniform_lattice((6, 5), 0.0), {"method": "moments"}
    with pytest.raises(InputError, match="method moments: no spring is stiff; take count"):
        pgran.count_modes(limp, OMEGA, **chosen)
    with pytest.raises(InputError, match="without stiff springs; take laplace"):
        pgran.pulse(limp, [(1, 1)], time=300.0, **chosen)


@pytest.mark.filterwarnings("error")
def test_terms_so_many_that_their_weights_vanish():
    """Next to a frequency that takes many moments one that takes few; nothing is said of it."""
    found = pgran.structure(LATTICE.undamped(), 2, [0.3, 9.0], width=0.02, method="moments")
    assert not found.factorizations
    assert np.all(np.isfinite(found.error_bound))


def test_a_dashpot_without_a_spring_is_no_function_of_the_stiffness():
    network, first = packing("scalar"), np.arange(11) == 0
    stiffness = np.where(first, 0.0, network.stiffness)
    assert law_of(dataclasses.replace(network, stiffness=stiffness, dashpot=1.0 * first)) is None
    assert law_of(dataclasses.replace(network, dashpot=0.0 * first)) == (0.0, 0.0, 0.0)
    turned = dataclasses.replace(network, stiffness=-network.stiffness, damping_power=1.0)
    assert law_of(turned) is None  # d = -k tau, and 1 + s tau may vanish


SAID = {  # in the first line of a summary
    "structure -structure_method moments -sweep_points 9": r"9 frequencies with \d+ moments of",
    "green -green_sources 1,1 -green_method moments -sweep_points 9 -sweep_min .01 "
    "-lattice_damping .1": r"\d+ moments of each source, but [1-8] which these miss with [1-8] fac",
    "response -detectors 1,1 -sweep_method moments -sweep_omega 1,1.1 -lattice_damping .1":
        r"2 frequencies with \d+ moments of each source in",
    "pulse -detectors 1,1 -pulse_method moments": r"1201 times by moments, one recurrence of \d+",
    "pulse -detectors 1,1 -pulse_method laplace": r"1201 times by laplace, \d+ points of the line",
    "modes -modes_density 9 -modes_density_method moments": r"estimated by \d+ moments of 8 random",
}  # fmt: skip


@pytest.mark.parametrize("words", SAID)
def test_the_first_line_says_by_what(words, call, place):
    place("b.opts", "")
    keys = "-lattice_shape 6,5 -output_file b.h5 -output_overwrite -output_progress none"
    said = call("run", "b.opts", *f"-scene {words} {keys}".split())
    _, first, *_ = [line for line in said.stderr.splitlines() if "warning" not in line]
    assert re.search(SAID[words], first)


def test_a_sweep_says_where_moments_are_ten_times_cheaper():
    """Not of low frequencies, weak signals, loss angles, high accuracy, nor few seconds."""
    lattice, omegas = dataclasses.replace(LATTICE, damping=0.1), np.linspace(0.5, 1.0, 9)
    slow = dataclasses.replace(pgran.sweep(lattice, omegas, (4, 2)), solve_seconds=1e3)
    assert "-sweep_method moments would take" in next(by_moments(slow, lattice, ""))
    weak = {"omega": 1e-3 * slow.omega}, {"amplitude": 1e-3 * slow.amplitude}
    for changes in (*weak, {"solve_seconds": 1.0}):
        assert not list(by_moments(dataclasses.replace(slow, **changes), lattice, ""))
    assert not list(by_moments(slow, dataclasses.replace(lattice, loss=0.1), ""))
    assert not list(by_moments(slow, lattice, "-error_tolerance 1e-9"))
