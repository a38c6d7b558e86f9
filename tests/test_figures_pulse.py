"""Figures of pulses, read off the axes: signals, fields, energy, spectra."""

from dataclasses import replace

import numpy as np
import pytest
from figure_reading import curves, draw, gaps, labels, legend, lines, page_of
from figure_results import UNIT, listen, respond
from samples import random_lattice

from pgran.draw import pages as figures
from pgran.draw import style
from pgran.errors import FileError
from pgran.experiments.pulse import figures as pulse


@pytest.mark.parametrize("method", ["laplace", "moments"])
def test_signals_above_each_other_by_distance(method):
    """Each scaled to its largest, with its envelope; the fronts; nothing below its error."""
    result = listen([(1, 1), (3, 2), (0, 0)], method=method)
    shown = result.pulse
    ax = draw(pulse.seismogram, shown, result.lattice)
    names = [text.get_text().split("\n")[0] for text in ax.get_yticklabels()]
    assert names == ["driven wall", "ball (3, 2)", "ball (1, 1)", "ball (0, 0)"]
    (wall,), signals = lines(ax, color=style.DRIVEN), lines(ax, color="black")
    assert wall.get_ydata() == pytest.approx(0.45 * shown.wall / np.abs(shown.wall).max())
    assert wall.get_xdata() == pytest.approx(shown.time * UNIT)
    for row, (d, signal, above) in enumerate(
        zip((1, 0, 2), signals, lines(ax, color="#aaaaaa"), strict=True), 1
    ):
        scale = 0.45 / np.abs(shown.displacement[:, d]).max()
        assert signal.get_ydata() == pytest.approx(row + scale * shown.displacement[:, d])
        assert above.get_ydata() == pytest.approx(row + scale * shown.envelope[:, d])
    (fronts,) = ax.collections
    at = [ends[0, 0] for ends in fronts.get_segments()]
    expected = [shown.wall_arrival, *shown.arrival[[1, 0, 2]]]
    assert at == pytest.approx(np.array(expected) * UNIT)
    shown.error[:, 1] = np.inf
    assert len(lines(draw(pulse.seismogram, shown, result.lattice), color="black")) == 2
    step = listen(shape="step", width=3.0, omega=0.6).pulse  # ends elsewhere than it began
    assert "envelope" not in labels(draw(pulse.seismogram, step, result.lattice))


@pytest.mark.parametrize(
    ("shape", "sites"), [((9,), [(2,), (7,)]), ((4, 3), [(1, 1), (3, 0)]), ((4, 3, 5), [(1, 1, 2)])]
)
def test_the_field_at_four_times(shape, sites):
    """In units of its largest or the wall's, with the detectors where their own signals are."""
    lattice = random_lattice(shape, seed=5, mass=0.25)
    result = listen(sites, lattice, method="laplace", shape="step" if len(shape) == 1 else "burst")
    shown = result.pulse
    panels = page_of(result, "field").panels
    for number, ax in enumerate(panels):
        values = shown.field[(number, ..., *sites[0][2:])]
        wall = np.interp(shown.field_time[number], shown.time, shown.wall)
        largest = max(np.abs(values).max(), wall)
        (dots,) = lines(ax, marker="o")
        assert list(dots.get_xdata()) == [site[0] for site in sites]
        if len(shape) == 1:
            (line,) = lines(ax, color="black", linestyle="-")
            assert line.get_ydata() == pytest.approx(np.array([0, *values, wall]) / largest)
            heard = [
                np.interp(shown.field_time[number], shown.time, u) for u in shown.displacement.T
            ]
            assert largest * dots.get_ydata() == pytest.approx(heard, abs=0.02)
        else:
            assert np.array_equal(ax.images[0].get_array(), (values / largest).T)
            assert list(dots.get_ydata()) == [site[1] for site in sites]
        title = ax.get_title(loc="left")
        assert f"{shown.field_time[number] * lattice.omega_mx:.4g}" in title
        assert f"largest {largest:.2g}" in title
    assert number == 3


@pytest.mark.parametrize(("loud", "edge", "few"), [(20, 50, True), (40, 50, False), (1, 16, False)])
def test_a_few_balls_that_move_far_do_not_make_a_large_field_pale(loud, edge, few):
    """Where many move, a hundredth of these are beyond the colours, and that is said."""
    result, rng = listen(), np.random.default_rng(6)
    field = np.zeros((4, 80, 60))
    field[:, :60, :edge] = rng.uniform(0.1, 0.2, (4, 60, edge))
    field[:, 7, :loud] = -5.0
    result.pulse = replace(result.pulse, field=field, wall=1e-4 * result.pulse.wall)
    *panels, bar = page_of(result, "field").axes
    for values, ax in zip(np.abs(field), panels, strict=True):
        scale = np.quantile(values[values > 0], 0.99) if few else 5.0
        assert scale < 0.2 or not few
        (image,) = ax.images
        assert np.abs(image.get_array().data) == pytest.approx((values / scale).T)
        assert f"{'99 % within' if few else 'largest'} {scale:.2g}" in ax.get_title(loc="left")
    said = "99th percentile\nof balls that move" if few else "largest"
    assert bar.get_ylabel() == f"displacement / {said}"
    assert bar._colorbar.extend == ("both" if few else "neither")


@pytest.mark.parametrize("shape", ["burst", "step"])
def test_the_spectrum_of_a_signal_that_has_ended_is_the_steady_response(shape):
    lattice = random_lattice((4, 3), seed=5, mass=0.25, damping=0.1)
    sent = {"shape": shape, "width": 3.0, "omega": 0.6 * UNIT, "method": "laplace"}
    shown = listen([(1, 1)], lattice, error_tolerance=1e-7, **sent).pulse
    omega, size, good = pulse.ratio(shown, 0)
    good = np.flatnonzero(good)[1::3]  # omega = 0 is no driving frequency
    response = respond(omega[good] / UNIT, lattice=lattice).response
    assert len(good) > 33
    assert size[good] == pytest.approx(response.amplitude[:, 0], rel=2e-3)


def test_spectra_and_what_is_left_of_their_signals():
    result = listen([(1, 1), (3, 0)])
    shown = result.pulse
    omega, size, good = pulse.ratio(shown, 1)
    ax = draw(pulse.spectrum, shown, result.lattice, 1)
    (curve,), speed = curves(ax), np.abs(shown.velocity[:, 1])
    assert curve.get_xdata() == pytest.approx(omega / UNIT)
    assert gaps(curve) == list(np.flatnonzero(~good))
    assert np.array_equal(curve.get_ydata(orig=True).data, size, equal_nan=True)
    title = f"ball (3, 0), depth 1; {100 * speed[601:].max() / speed.max():.3g} % left"
    assert ax.get_title(loc="center") == title
    shown.error[0, 1] = np.inf
    assert not draw(pulse.spectrum, shown, result.lattice, 1).yaxis.get_visible()


def test_what_may_be_nothing_but_error_has_no_spectrum():
    """However the error lies below its bound; three times a swing of it has one."""
    shown, omega = listen(method="laplace").pulse, 1.0
    swing = np.cos(omega * shown.time)[:, None]
    for worst in (swing, np.sign(swing), np.ones_like(swing), shown.time[:, None] > 180):
        error = shown.error * worst
        assert not pulse.ratio(replace(shown, displacement=error), 0)[2].any()
    assert pulse.ratio(replace(shown, displacement=3 * shown.error * swing), 0)[2].any()


def test_a_steady_response_is_laid_over_the_detectors_that_it_shares():
    result = listen([(1, 1), (3, 0)], fields=False)
    other = respond(detectors=[(2, 2), (3, 0)])
    other.response.converged_reason[[120, 130]] = -3
    made = figures.make(result, response=other.response)
    near, deep = made["spectrum"].axes
    (steady,) = lines(near, linewidth=2.5)
    assert not lines(deep, linewidth=2.5)
    assert steady.get_xdata() == pytest.approx(other.response.omega / UNIT)
    values = steady.get_ydata(orig=True)
    assert np.array_equal(values.data, other.response.amplitude[:, 1])
    low, high = near.get_xlim()
    outside = np.flatnonzero((steady.get_xdata() < low) | (steady.get_xdata() > high))
    assert set(gaps(steady)) == {120, 130, *outside}
    assert sorted(legend(made["spectrum"])) == ["signal/drive", "steady response"]
    with pytest.raises(FileError, match="no detector in common"):
        figures.make(result, response=respond(detectors=[(2, 2)]).response)
