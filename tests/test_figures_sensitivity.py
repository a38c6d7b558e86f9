"""Figures of what a signal depends on, read off the axes: bonds, flux; pages with warm balls."""

import logging
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from figure_reading import draw, labels, lay_out, lines, note, page_of
from map_samples import (
    LATTICE,
    OMEGAS,
    bond_lines,
    depends,
    discs,
    heated,
    joined,
    result_of,
    strip,
    title,
    wedges,
)
from samples import random_lattice

import pgran
from pgran.draw import balls, captions, style
from pgran.draw import pages as figures
from pgran.draw.view import BARRED
from pgran.errors import FileError
from pgran.experiments.sensitivity import figures as sensitivity
from pgran.experiments.sensitivity import figures_heat as heat
from pgran.experiments.sensitivity import maps
from pgran.medium.base import record_of
from pgran.medium.space import as_network


@pytest.mark.parametrize(
    ("shape", "site"), [((4, 3), (1, 1)), ((4, 3, 5), (2, 1, 3)), ((9,), (2,))]
)
def test_derivatives_are_lines_on_the_bonds(shape, site):
    """As wide as the root, of three dimensions those in the detector's plane, negative hollow."""
    lattice = random_lattice(shape, seed=5, damping=0.05)
    found, ends = depends(lattice, [site]), joined(shape)
    ax = draw(sensitivity.derivatives, found, record_of(lattice), 1)
    seen = (ends[:, :, 2:] == np.array(site[2:])).all(axis=(1, 2))
    expected = {
        tuple(np.pad(end, [(0, 0), (0, 2)])[:, :2].ravel()): value
        for end, value in zip(ends[seen], found.log_amplitude[1, 0][seen], strict=True)
    }
    largest = max(map(abs, expected.values()))
    coloured, hollow = bond_lines(ax)
    assert len(coloured.get_segments()) == np.count_nonzero(seen)
    drawn = {
        tuple(np.round(segment).astype(int).ravel()): value
        for segment, value in zip(coloured.get_segments(), coloured.get_array(), strict=True)
    }
    assert {k: v * largest for k, v in drawn.items()} == pytest.approx(expected)
    widths = np.array(coloured.get_linewidths())
    assert (widths / widths.max()) ** 2 == pytest.approx(np.abs(coloured.get_array()))
    negative = sum(v < -BARRED * largest for v in expected.values())
    assert len(hollow.get_segments()) == negative
    assert negative or len(shape) == 1
    assert f"largest {largest:.3g}" in title(ax)
    (dot,) = lines(ax, label="detector")
    assert [*dot.get_xdata(), *dot.get_ydata()] == [*site, 0][:2]
    (wall,) = lines(ax, label="driven wall")
    assert set(wall.get_xdata()) == {shape[0]}


def test_only_bonds_that_are_kept_are_drawn():
    found, all_of_them = depends(most=5), depends()
    coloured, _ = bond_lines(draw(sensitivity.derivatives, found, record_of(LATTICE), 2))
    assert len(coloured.get_segments()) == 5
    shown = {tuple(map(tuple, np.round(s).astype(int))) for s in coloured.get_segments()}
    ends = joined((4, 3))[found.bond[2, 0]]
    assert shown == {tuple(map(tuple, end.tolist())) for end in ends}
    whole = found.on_bonds(2, 0)
    assert np.count_nonzero(np.isfinite(whole)) == 5
    kept = np.isfinite(whole)
    assert whole[kept] == pytest.approx(all_of_them.log_amplitude[2, 0][kept])


@pytest.mark.parametrize("make", [lambda: LATTICE, strip])
def test_sums_where_bonds_are_too_many(make, monkeypatch):
    """Each ball's sum is the derivative of ln|A| by its warmth."""
    medium = make()
    site = [(1, 1)] if medium is LATTICE else [int(medium.free[4])]
    monkeypatch.setattr(maps, "CLEAR", 10)
    found = depends(medium, site)
    ax = draw(sensitivity.derivatives, found, record_of(medium), 1)
    network = as_network(record_of(medium))
    total = np.zeros(len(network.held))
    for pair, slope in zip(network.bond, found.on_bonds(1, 0), strict=True):
        total[pair] += slope
    total = total[network.held == 0]
    largest = np.abs(total).max()
    assert largest * np.array(discs(ax).get_array()) == pytest.approx(total)
    assert f"largest {largest:.3g}" in title(ax)


@pytest.mark.parametrize("make", [lambda: LATTICE, strip])
def test_what_flows_into_a_ball_is_lost_there(make, monkeypatch):
    """Power is conserved, read off the widths, the points and the colours."""
    monkeypatch.setattr(maps, "FAINT", 0.0)
    medium = make()
    site = [(1, 1)] if medium is LATTICE else [int(medium.free[4])]
    found = depends(medium, site)
    network = as_network(record_of(medium))
    ax = draw(sensitivity.flux, found, record_of(medium), 1)
    start, end, width = wedges(ax)
    power = width**2
    power *= np.abs(found.flux[1]).max() / power.max()
    balance = np.zeros(len(network.held))
    ends = np.append(start, end, axis=0)
    where = np.linalg.norm(ends[:, None] - network.position[None, :, :2], axis=2)
    at = where.argmin(axis=1)
    on_balls = where.min(axis=1) < 1e-9  # not the middle of a contact across the box
    change = np.append(-power, power)
    np.add.at(balance, at[on_balls], change[on_balls])
    lost = np.zeros(len(network.held))
    for b, pair in enumerate(network.bond):
        lost[pair] += 0.5 * found.loss[1, b]
    free = network.held == 0
    assert balance[free] == pytest.approx(lost[free], abs=1e-6 * power.max())
    assert np.array(discs(ax).get_array()) == pytest.approx(lost[free] / lost[free].max())
    assert np.all(balance[network.held == 2] < 0)
    ball = np.ravel_multi_index(site[0], LATTICE.shape) if medium is LATTICE else site[0]
    near = np.abs(found.flux[1][(network.bond == ball).any(axis=1)]).max()
    assert [text.get_text() for text in ax.texts] == [captions.number(near, 1)]


def test_many_fluxes_are_summed_in_cells(monkeypatch):
    """Each cell's wedge points along the sum of its bonds' fluxes, the largest the broadest."""
    monkeypatch.setattr(maps, "CLEAR", 10)
    monkeypatch.setattr(maps, "CELLS", 1)
    found = depends()
    start, end, width = wedges(draw(sensitivity.flux, found, record_of(LATTICE), 1))
    ends = joined((4, 3))
    total = (found.flux[1][:, None] * (ends[:, 1] - ends[:, 0])).sum(axis=0)
    assert len(width) == 1
    along = (end - start)[0]
    assert along / np.linalg.norm(along) == pytest.approx(total / np.linalg.norm(total))


def test_shares_of_bonds_and_balls():
    found, warm = depends(detectors=[(1, 1), (3, 2)]), heated(detectors=[(1, 1), (3, 2)])
    ax = draw(sensitivity.distribution, found, record_of(LATTICE))
    for curve, (n, d) in zip(ax.get_lines(), product(sensitivity.few(found), (0, 1)), strict=True):
        size = np.abs(found.log_amplitude[n, d])
        for x, share in curve.get_xydata():
            assert share == pytest.approx(np.mean(size >= x))
    ax = draw(heat.distribution, warm)
    (mark,) = lines(ax, color=style.UNRESOLVED)
    assert set(mark.get_xdata()) == {25.0}
    assert ax.get_xlim()[1] > 25
    moved = np.abs(warm.warmed / warm.displacement[..., None] - 1)[:, 1]
    quarter = np.mean(moved >= 0.25)
    assert f"ball (3, 2), ball warmed: {100 * quarter:.3g} %" in labels(ax)
    assert quarter == pytest.approx(warm.heard[:, 1].mean())


@pytest.mark.parametrize(
    ("good", "chosen"),
    [([1], [0]), ([0, 1, 1], [1, 2]), ([1] * 3, [0, 1, 2]), ([1] * 9, [1, 4, 7]), ([0], [])],
)
def test_a_few_of_the_good_frequencies(good, chosen):
    record = pgran.experiments.sensitivity.record.Sensitivity
    names = dict.fromkeys(record.__dataclass_fields__)
    assert sensitivity.few(record(**names | {"converged_reason": np.array(good)})) == chosen


def test_pages():
    both = result_of(depends())
    both.heat = heated()
    made = figures.make(both)
    maps_of = ["warmed", "cut", "sensitivity", "flux"]
    assert set(made) == {*maps_of, "changes", "distribution", "bonds"}
    for name in maps_of:
        shown = zip("abc", sensitivity.few(both.heat), made[name].panels, strict=True)
        for letter, n, ax in shown:
            x = OMEGAS[n] / LATTICE.omega_mx
            assert title(ax).startswith(f"({letter}) {x:.4g} ")
        assert "circle: ball (1, 1); green: what drives" in note(made[name])
    assert len([ax for ax in made["changes"].axes if ax.lines]) == 2


def test_pages_of_networks_and_of_several_detectors(caplog):
    net = strip()
    sites = net.free[:4].tolist()
    with caplog.at_level(logging.WARNING, logger="pgran"):
        made = figures.make(result_of(depends(net, sites, [0.3]), net))
    assert "the first 3 of 4 detectors" in caplog.text
    names = [f"sensitivity_{ball}" for ball in sites[:3]]
    assert list(made) == ["network", *names, "flux", "distribution"]
    assert "dark: at rest; green: driven" in note(made["flux"])
    assert f"ball {sites[3]}" in labels(made["network"].axes[0])


def test_without_positions_the_distributions_alone():
    net = replace(strip(), position=None)
    made = figures.make(result_of(depends(net, net.free[:1], [0.3]), net))
    assert list(made) == ["distribution"]
    assert list(figures.make(result_of(heated(net, net.free[:1], [0.3]), net))) == ["changes"]


@pytest.mark.parametrize("compute", [depends, heated])
def test_failed_frequencies_are_said_and_not_drawn(compute, caplog):
    found = compute()
    found.converged_reason[[0, 2]] = 0
    for figure in figures.make(result_of(found)).values():
        if "frequencies" in note(figure):
            assert "2 of 4 frequencies that missed" in note(figure).replace("\n", " ")
            assert figure._suptitle.get_color() == style.FAILED
            x = f"{OMEGAS[0] / LATTICE.omega_mx:.4g} "
            assert not any(x in title(ax) for ax in figure.axes)
        else:
            assert not note(figure)
            assert "bond constant" in figure.axes[-1].get_xlabel()
    found.converged_reason[:] = 0
    with (
        caplog.at_level(logging.WARNING, logger="pgran"),
        pytest.raises(FileError, match="nothing to draw"),
    ):
        figures.make(result_of(found))
    assert "is as accurate as asked: none is drawn" in caplog.text


def test_a_few_sums_beyond_the_colours(monkeypatch):
    monkeypatch.setattr(maps, "CLEAR", 10)
    monkeypatch.setattr(balls, "MANY_BALLS", 5)
    figure = page_of(result_of(depends()), "sensitivity")
    *panels, bar = figure.axes
    assert all("99 % within" in title(ax) for ax in panels)
    assert bar.get_ylabel() == "derivative / 99th percentile"


def test_a_few_bonds_of_a_large_lattice_can_be_seen(monkeypatch):
    """Longer than a bond, about its middle."""
    monkeypatch.setattr(maps, "CLEAR", 10)
    lattice = random_lattice((60, 40), damping=0.1)
    found = depends(lattice, [(50, 20)], [0.3], most=5)
    figure = page_of(result_of(found, lattice), "sensitivity")
    coloured, _ = bond_lines(figure.axes[0])
    ends = np.array(coloured.get_segments())
    middles = joined((60, 40))[found.bond[0, 0]].mean(axis=1)
    order = np.argsort(np.abs(found.log_amplitude[0, 0]))
    assert ends.mean(axis=1) == pytest.approx(middles[order])
    lay_out(figure)
    on_paper = figure.axes[0].transData.transform(ends.reshape(-1, 2)).reshape(-1, 2, 2)
    length = np.linalg.norm(on_paper[:, 1] - on_paper[:, 0], axis=1) * 72 / figure.dpi
    assert np.all(length > 2)
    assert "hollow" in note(figure)
