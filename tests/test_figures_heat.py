"""Figures of warm balls and cut bonds, read off the axes."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from figure_reading import curves, draw, gaps, lines, note
from map_samples import LATTICE, bond_lines, discs, heated, joined, result_of, title
from small import OPTIONS

import pgran
from pgran.draw import pages as figures
from pgran.draw.view import BARRED
from pgran.errors import FileError
from pgran.experiments.sensitivity import figures_heat as heat
from pgran.experiments.sensitivity import maps
from pgran.medium.base import record_of


def test_the_heaters_map():
    """Balls that make the amplitude fall have bars; those that were not warmed are grey."""
    balls = np.array([(0, 0), (2, 1), (2, 2), (3, 2)])
    found = heated(balls=balls, cut=False)
    ax = draw(heat.warm, found, record_of(LATTICE), 1)
    colours = discs(ax).get_array()
    assert np.array_equal(np.flatnonzero(~np.ma.getmaskarray(colours)), found.ball)
    grown = np.abs(found.warmed[1, 0]) / np.abs(found.displacement[1, 0]) - 1
    largest = np.abs(grown).max()
    assert largest * colours.compressed() == pytest.approx(grown)
    assert f"largest {100 * largest:.3g} %" in title(ax)
    below = grown < -BARRED * largest
    assert 0 < np.count_nonzero(below) < 4
    (bars,) = lines(ax, label="negative")
    assert np.transpose(bars.get_data()) == pytest.approx(balls[below])


def test_cut_bonds_in_decibels_and_what_is_not_known():
    found = heated(factor=None)
    found.cut_bound[1, 0, 3] = np.inf
    ax = draw(heat.cut, found, record_of(LATTICE), 1)
    coloured, _ = bond_lines(ax)
    level = 20 * np.log10(np.abs(found.cut[1, 0]) / np.abs(found.displacement[1, 0]))
    level = np.delete(level, 3)
    assert len(coloured.get_segments()) == len(level)
    largest = np.abs(level).max()
    assert f"largest {largest:.3g} dB" in title(ax)
    assert sorted(coloured.get_array() * largest) == pytest.approx(sorted(level))
    found.cut[1, 0, 4] = 0.0
    assert heat.decibels(found, 1, 0)[4] == -60


def test_means_where_cut_bonds_are_too_many(monkeypatch):
    monkeypatch.setattr(maps, "CLEAR", 10)
    found = heated(factor=None)
    found.cut_bound[1, 0, 3] = np.inf
    level = heat.decibels(found, 1, 0)
    ends, expected = joined((4, 3)), []
    for site in product(range(4), range(3)):
        own = (ends == np.array(site)).all(axis=2).any(axis=1)
        expected.append(np.nanmean(level[own]))
    colours = np.array(discs(draw(heat.cut, found, record_of(LATTICE), 1)).get_array())
    assert colours * np.abs(expected).max() == pytest.approx(expected)
    made = figures.make(result_of(found))
    assert "mean over its bonds" in note(made["cut"]).replace("\n", " ")


def test_changes_over_frequency():
    warm = heated(omegas=np.linspace(0.2, 1.2, 8))
    warm.converged_reason[3] = 0
    ax = draw(heat.over_frequency, warm, record_of(LATTICE))
    moved = 100 * np.abs(warm.warmed / warm.displacement[..., None] - 1)[:, 0]
    median, largest = curves(ax)[:2]
    assert gaps(median) == gaps(largest) == [3]
    good = warm.converged_reason > 0
    assert median.get_ydata().compressed() == pytest.approx(np.median(moved, axis=1)[good])
    assert largest.get_ydata().compressed() == pytest.approx(moved.max(axis=1)[good])
    (cross,) = lines(ax, marker="x")
    assert cross.get_xdata() == pytest.approx(warm.omega[3:4] / LATTICE.omega_mx)


def test_balls_that_grow_in_a_packing():
    """Maps with neighbours at a new rest and frozen; changes by the nearest image's distance."""
    discs_of = replace(pgran.load(OPTIONS / "packings" / "discs.h5"), power=1.5)
    balls = discs_of.free[::30]
    growth = {"radius": 0.05 * discs_of.overlap.mean(), "balls": balls}
    found = pgran.heat(discs_of, [0.3, 0.5], [balls[0]], **growth)
    medium = record_of(discs_of)
    for name in ("warmed", "frozen"):
        colours = discs(draw(heat.warm, found, medium, 1, name=name)).get_array().compressed()
        part = np.abs(getattr(found, name)[1, 0]) / np.abs(found.displacement[1, 0]) - 1
        assert colours == pytest.approx(part / np.abs(part).max(), abs=1e-6)
    ax = draw(heat.over_distance, found, medium)
    points, median = ax.get_lines()[:2]
    away = discs_of.position[balls] - discs_of.position[balls[0]]
    images = away + np.array([[0, n * discs_of.box[1]] for n in (-1, 0, 1)])[:, None]
    distance = np.linalg.norm(images, axis=2).min(axis=0)
    assert points.get_xdata() == pytest.approx(np.tile(distance, 2))
    moved = 100 * np.abs(found.warmed / found.displacement[..., None] - 1)[:, 0]
    assert points.get_ydata() == pytest.approx(moved.ravel())
    groups = np.array_split(np.argsort(distance), 8)
    assert median.get_ydata() == pytest.approx([np.median(moved[:, group]) for group in groups])
    made = figures.make(result_of(found, discs_of))
    assert {"warmed", "frozen", "changes"} <= made.keys()
    assert "rest frozen" in note(made["frozen"])
    assert "all at a new rest" in note(made["warmed"])


def test_balls_that_grow_in_several_results():
    """A point of each: its growth, the changes of |A|, and how often these are a quarter."""
    network = pgran.pack(50, law="hertz", pressure=1e-3, walls="x")
    seen, results = [], []
    for growth in np.repeat([0.002, 0.004], 4):  # more than are told apart by their looks
        words = {"radius": growth, "balls": network.free[len(results) :: 8]}
        found = pgran.heat(network, [0.3], network.free[:1], **words)
        moved = np.abs(np.abs(found.warmed / found.displacement[..., None]) - 1).ravel()
        quantiles = np.median(moved), np.quantile(moved, 0.9)
        seen.append([growth / network.overlap.mean(), *quantiles, np.mean(moved >= 0.25)])
        results.append(result_of(found, network))
        results[-1].scene = "sensitivity"
    figure = figures.compare(results, ["" for _ in results])["growth"]
    drawn = {"full": [], "none": []}
    for panel in figure.panels:
        for line in lines(panel, linestyle="None"):
            drawn[line.get_fillstyle()].append(np.transpose(line.get_data()))
    both, seen = np.concatenate(drawn["full"]), np.array(seen)
    for found, column in ((both[:8], 1), (np.concatenate(drawn["none"]), 2), (both[8:], 3)):
        right = np.column_stack([seen[:, 0], 100 * seen[:, column]])
        assert found[np.lexsort(found.T[::-1])] == pytest.approx(right[np.lexsort(right.T[::-1])])
    results[3].heat.converged_reason[0] = 0
    with pytest.raises(FileError, match="if balls of packings grow"):
        figures.compare([*results, result_of(heated())], [""] * 9)
