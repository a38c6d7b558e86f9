"""The figures of the box, of modes, projections and relaxations, read off their axes; pairs."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from pgran import __main__ as command_line
from pgran import errors, figures, results
from pgran.errors import FileError
from pgran.files import store
from pgran.physics.lattice import Lattice
from pgran.physics.spectrum import power_spectrum

pytest.importorskip("matplotlib")

from pgran.figures import continuum, modes, projection, relaxation, response, style

UNIT = 2.0  # omega_mx
RNG = np.random.default_rng(8)


@pytest.fixture(autouse=True)
def _style():
    with style.applied():
        yield


def make_lattice(shape=(6, 5)):
    names = [f"stiffness_{name}" for name in "xyz"[: len(shape)]]
    sizes = [[n + (a == axis) for a, n in enumerate(shape)] for axis in range(len(shape))]
    stiffness = {name: RNG.uniform(size=size) for name, size in zip(names, sizes, strict=True)}
    return SimpleNamespace(shape=np.array(shape), mass=1.0, omega_mx=UNIT, **stiffness)


def make_continuum(damping=0.003, scale=1.0, count=300):
    """A made-up box response, whose frequencies are `scale` times those of a unit box."""
    x = np.linspace(0.1, 12, count)
    displacement = 2.0 * np.exp(-1j * (x if damping else np.pi * np.floor(x / 3)))
    box = SimpleNamespace(
        point=np.array([0.47, 0.52]),
        size=np.array([1 / scale, 1.0]),
        mass=1.0,
        stiffness=1.0,
        damping=damping,
        omega=x * scale,
        displacement=displacement,
        amplitude=np.abs(displacement),
        phase=np.unwrap(np.angle(displacement)),
        resonance=np.array([4.4, 7.0, 9.9]) * scale,
    )
    return SimpleNamespace(scene="continuum", continuum=box)


def make_modes(shape=(6, 5), omega=None, certified=True):
    """Modes of frequencies `omega` in units of omega_mx, their shapes the columns of a matrix."""
    balls = int(np.prod(shape))
    omega = np.linspace(0.05, 1.2, balls) if omega is None else np.asarray(omega, dtype=float)
    vector, _ = np.linalg.qr(RNG.normal(size=(balls, balls)))
    vector *= np.sign(np.take_along_axis(vector, np.abs(vector).argmax(0)[None], 0))
    vector = vector.T[: len(omega)]
    found = SimpleNamespace(
        omega=omega * UNIT,
        participation=1 / np.sum(vector**4, axis=1),
        residual=np.zeros(len(omega)),
        vector=vector.reshape(-1, *shape),
        count_expected=len(omega),
        count_certified=certified,
    )
    return SimpleNamespace(scene="modes", lattice=make_lattice(shape), modes=found)


def make_projection(x=None, mode_omega=None):
    """A projection of Lorentzians, frequencies in units of omega_mx."""
    x = np.linspace(0.1, 1.1, 401) if x is None else np.asarray(x, dtype=float)
    mode_omega = np.linspace(0.05, 1.15, 45) if mode_omega is None else np.asarray(mode_omega)
    coefficient = 1 / (x[:, None] ** 2 - mode_omega**2 + 0.01j)
    result = SimpleNamespace(
        omega=x * UNIT,
        mode_omega=mode_omega * UNIT,
        coefficient=coefficient,
        dominant=np.abs(coefficient).argmax(axis=1),
        error_bound=np.zeros(len(x)),
        converged_reason=np.ones(len(x), dtype=int),
        count_expected=len(mode_omega),
        count_certified=True,
    )
    return SimpleNamespace(scene="projection", lattice=make_lattice(), projection=result)


def make_relaxation(steps=4000, spectrum=True, trajectories=1):
    """A random walk: its spectrum falls like f^-2."""
    walk = 100 + np.cumsum(RNG.normal(size=(trajectories, steps + 1)), axis=1)
    result = SimpleNamespace(
        scene="relaxation",
        lattice=make_lattice(),
        relaxation=SimpleNamespace(
            omega=0.6 * UNIT,
            detector=np.array([(1, 2)]),
            displacement=(walk * np.exp(0.3j))[:, :, None],
        ),
    )
    if spectrum:
        result.spectrum = power_spectrum(walk)
    return result


def data(ax, **wanted):
    """Data of the lines of one panel that have these properties, x and y."""
    lines = ax.get_lines()
    for name, value in wanted.items():
        lines = [line for line in lines if getattr(line, f"get_{name}")() == value]
    return [(line.get_xdata(), line.get_ydata()) for line in lines]


def curves(ax):
    """The lines that are data: not the fits, not the marks."""
    return [line for line in ax.get_lines() if np.ma.isMaskedArray(line.get_ydata(orig=True))]


def masked(line):
    return np.flatnonzero(np.ma.getmaskarray(line.get_ydata(orig=True)))


def legend(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()] if ax.get_legend() else []


def note(figure):
    return figure._suptitle.get_text() if figure._suptitle else ""


def names(module, result):
    return [name for name, _ in module.figures(result)]


# The box


@pytest.mark.parametrize("scale", [1.0, 3.0])
def test_the_box_has_amplitude_above_phase_and_its_resonances(scale):
    result = make_continuum(scale=scale)
    upper, lower = continuum.draw_response(result.continuum).axes
    assert (upper.get_yscale(), lower.get_yscale()) == ("log", "linear")
    for ax, values in ((upper, result.continuum.amplitude), (lower, result.continuum.phase)):
        (curve,) = curves(ax)
        assert curve.get_xdata() == pytest.approx(result.continuum.omega / scale)
        assert np.array_equal(curve.get_ydata(), values)
        ((pluses, _),) = data(ax, marker="+")
        assert pluses == pytest.approx([4.4, 7.0, 9.9])
    assert legend(upper) == [continuum.RESONANCES]
    assert "0.003" in upper.get_title(loc="left")
    assert "rad" in lower.get_ylabel()


def test_without_damping_the_phase_is_0_or_pi():
    result = make_continuum(damping=0.0).continuum
    result.phase[100:] += 2 * np.pi  # rounding decides by which way an unwrapped phase jumps
    lower = continuum.draw_response(result).axes[1]
    (curve,) = curves(lower)
    assert curve.get_drawstyle() == "steps-mid"
    assert set(curve.get_ydata()) == {0.0, np.pi}
    assert np.array_equal(curve.get_ydata() > 0, np.floor(result.omega / 3) % 2 == 1)
    assert list(lower.get_yticks()) == [0, np.pi]


def test_a_point_at_rest_has_no_amplitude_on_a_log_axis():
    result = make_continuum()
    result.continuum.amplitude[7] = 0.0
    assert masked(curves(continuum.draw_response(result.continuum).axes[0])[0]) == [7]
    result.continuum.amplitude[:] = 0.0
    figure = continuum.draw_response(result.continuum)
    figure.draw_without_rendering()
    assert not figure.axes[0].yaxis.get_visible()


def test_the_box_needs_no_lattice(tmp_path):
    (written,) = figures.draw(make_continuum(), tmp_path / "a.pdf")
    assert written.name == "a-exactpl.pdf"
    with pytest.raises(FileError, match="no frequencies"):
        figures.draw(make_continuum(count=0), tmp_path / "a.pdf")


# Modes


def test_the_modes_pictured():
    assert modes.pick(np.array([0.1, 0.2, 0.59, 0.61, 0.98, 1.1])) == [1, 3, 4]
    assert modes.pick(np.array([0.1, 0.6, 0.7, 0.8])) == [1, 3]
    assert modes.pick(np.array([0.6, 0.61])) == [0, 1]


@pytest.mark.parametrize("shape", [(6, 5), (20, 4), (4, 20), (4, 3, 5)])
def test_a_mode_is_an_image_symmetric_about_0(shape):
    result = make_modes(shape)
    figure = modes.draw_shapes(result)
    panels = [ax for ax in figure.axes if ax.images]
    for mode, ax in zip(modes.pick(modes.in_units(result)), panels, strict=True):
        vector = result.modes.vector[mode]
        largest = np.unravel_index(vector.argmax(), shape)
        (image,) = ax.images
        plane = vector[(..., *largest[2:])]
        assert np.allclose(image.get_array(), plane.T / vector.max())
        assert image.get_clim() == (-1.0, 1.0)
        assert image.get_cmap()(0.5)[:3] == pytest.approx(np.ones(3), abs=0.05)
        assert f"= {result.modes.omega[mode] / UNIT:.4f}" in ax.get_title(loc="left")
        assert f"$P_i$ = {result.modes.participation[mode]:.3g} balls" in ax.get_title(loc="left")
        assert ("plane $z$" in ax.get_title(loc="left")) == (len(shape) == 3)
    assert len(panels) == 3
    titles_apart(figure, panels)


def titles_apart(figure, panels):
    figure.draw_without_rendering()
    boxes = [ax._left_title.get_window_extent() for ax in panels]
    for one, other in pairwise(boxes):
        assert not one.overlaps(other)
    assert all(box.x1 <= figure.bbox.x1 and box.y1 <= figure.bbox.y1 for box in boxes)


def test_a_mode_of_a_chain_is_a_line_from_wall_to_wall():
    result = make_modes((30,))
    panels = modes.draw_shapes(result).axes
    for mode, ax in zip(modes.pick(modes.in_units(result)), panels, strict=True):
        x, y = data(ax, color="black")[0]
        assert list(x) == list(range(-1, 31))
        assert y[[0, -1]] == pytest.approx([0, 0])
        vector = result.modes.vector[mode]
        assert y[1:-1] == pytest.approx(vector / vector.max())
        assert ax.get_ylim() == (-1.1, 1.1)


def test_participation_against_frequency():
    result = make_modes()
    ax = modes.draw_participation(result).axes[0]
    ((x, y),) = data(ax)
    assert x == pytest.approx(result.modes.omega / UNIT)
    assert np.array_equal(y, result.modes.participation)
    assert ax.get_yscale() == "log"
    assert ax.get_ylim() == (1, 30)


def test_the_area_of_the_density_is_the_number_of_modes():
    result = make_modes((20, 20))
    ax = modes.draw_density(result).axes[0]
    density, edges, _ = ax.patches[0].get_data()
    assert np.sum(density * np.diff(edges)) == pytest.approx(400)
    assert edges[[0, -1]] == pytest.approx([0.05, 1.2])


def test_what_modes_show_depends_on_what_there_is():
    assert names(modes, make_modes()) == ["shapes", "participation", "density"]
    assert names(modes, make_modes(omega=[0.4, 0.5])) == ["shapes", "participation"]
    result = make_modes(omega=np.full(30, 0.5))
    del result.modes.vector
    assert names(modes, result) == ["participation"]
    with pytest.raises(FileError, match="no modes"):
        names(modes, make_modes(omega=[]))


def test_missing_modes_are_said_in_every_figure():
    result = make_modes(certified=False)
    result.modes.count_expected = 31
    for _, figure in modes.figures(result):
        assert note(figure) == "NOT ALL MODES: 30 of 31 found"
    result.modes.count_expected = 30
    for _, figure in modes.figures(result):
        assert "NOT CERTIFIED" in note(figure)
    assert not any(note(figure) for _, figure in modes.figures(make_modes()))


# Projections


@pytest.mark.parametrize(
    ("x", "mode_omega", "expected"),
    [
        ([0.6], None, ["onefreq"]),
        ([0.6], [0.5, 0.6], ["onefreq"]),
        ([0.5, 0.6, 0.7], None, ["onefreq"]),
        (None, None, ["onefreq", "maxci", "cifreq"]),
        (None, [0.59, 0.6, 0.62], ["cifreq"]),
    ],
)
def test_what_a_projection_shows(x, mode_omega, expected):
    assert names(projection, make_projection(x, mode_omega)) == expected


def test_coefficients_at_one_frequency():
    result = make_projection()
    result.projection.converged_reason[200] = 0  # .6 itself
    ax = projection.draw_one_frequency(result).axes[0]
    (curve,) = curves(ax)
    x, unit = result.projection.omega / UNIT, 0.0025
    shown = np.flatnonzero(np.isclose(np.abs(x - 0.6), unit))[0]
    assert curve.get_xdata() == pytest.approx(result.projection.mode_omega / UNIT)
    assert np.array_equal(curve.get_ydata(), np.abs(result.projection.coefficient[shown]))
    assert ax.get_yscale() == "log"
    assert data(ax, color=style.ACCENT)[0][0] == [x[shown]] * 2
    assert f"{x[shown]:.4g} " in legend(ax)[0]


def test_a_single_frequency_that_failed_is_not_drawn():
    result = make_projection([0.6])
    result.projection.converged_reason[:] = -3
    figure = projection.draw_one_frequency(result)
    figure.draw_without_rendering()
    assert not curves(figure.axes[0])
    assert "missed the accuracy" in note(figure)


def test_the_dominant_mode_and_a_line_of_slope_1():
    result = make_projection()
    result.projection.converged_reason[50] = -1
    ax = projection.draw_dominant(result).axes[0]
    (curve,) = curves(ax)
    dominant = result.projection.mode_omega[result.projection.dominant] / UNIT
    assert curve.get_xdata() == pytest.approx(result.projection.omega / UNIT)
    assert np.array_equal(curve.get_ydata(orig=True).data, dominant)
    assert masked(curve) == [50]
    assert curve.get_marker() == "."
    (line,) = (line for line in ax.get_lines() if line.get_linewidth() == 2.5)
    assert np.array_equal(line.get_xdata(), line.get_ydata())
    assert line.get_xdata() == pytest.approx([0.1, 1.1])
    assert legend(ax) == ["slope 1", "missed the accuracy asked for"]


def test_three_successive_modes():
    modes_at = np.array([0.2, 0.4, 0.58, 0.61, 0.7, 0.9])
    assert projection.successive(modes_at, 0.6) == [2, 3, 4]
    assert projection.successive(modes_at, 2.0) == [3, 4, 5]
    assert projection.successive(modes_at[:2], 0.6) == [0, 1]


@pytest.mark.parametrize(("x", "centre"), [(None, 0.6), (np.linspace(0.2, 0.4, 81), 0.3)])
def test_coefficients_of_three_modes(x, centre):
    result = make_projection(x)
    ax = projection.draw_three_modes(result).axes[0]
    chosen = projection.successive(result.projection.mode_omega / UNIT, centre)
    x = result.projection.omega / UNIT
    for mode, curve in zip(chosen, curves(ax), strict=True):
        near = np.isin(x, curve.get_xdata())
        assert np.array_equal(curve.get_ydata(), np.abs(result.projection.coefficient[near, mode]))
        own = result.projection.mode_omega[mode] / UNIT
        assert x[near][curve.get_ydata().argmax()] == pytest.approx(own, abs=0.003)
        assert any(f"{own:.5f}" in label for label in legend(ax))
    assert len({curve.get_color() for curve in curves(ax)}) == 3
    assert np.ptp(curves(ax)[0].get_xdata()) == pytest.approx(0.15, abs=0.01)


def test_failed_frequencies_and_missing_modes_of_a_projection():
    result = make_projection()
    result.projection.converged_reason[[199, 200]] = -3
    result.projection.coefficient[199] = np.nan
    result.projection.count_certified, result.projection.count_expected = False, 46
    for draw in (projection.draw_dominant, projection.draw_three_modes):
        figure = draw(result)
        (ax,) = figure.axes
        assert data(ax, marker="x")[0][0] == pytest.approx([0.5975, 0.6])
        assert "missed the accuracy asked for" in legend(ax)
        assert note(figure) == "NOT ALL MODES: 45 of 46 found"


# Relaxation


def test_a_stretch_of_the_series():
    result = make_relaxation(trajectories=2)
    ax = relaxation.draw_relaxation(result).axes[0]
    (curve,) = curves(ax)
    amplitude = np.abs(result.relaxation.displacement[0, :2001, 0])
    assert np.array_equal(curve.get_xdata(), np.arange(2001))
    assert np.array_equal(curve.get_ydata(), amplitude)
    assert legend(ax) == ["ball (1, 2)"]
    assert "step" in ax.get_xlabel()


def test_the_spectrum_its_fit_and_slope_2():
    result = make_relaxation(20000)
    ax = relaxation.draw_relaxation(result).axes[1]
    spectrum = result.spectrum
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
    (power, fit, slope) = data(ax)
    assert np.array_equal(power, (spectrum.frequency, spectrum.power))
    assert fit[0][[0, -1]] == pytest.approx([0.01, 0.3])
    assert fit[1] == pytest.approx(spectrum.power_law(fit[0]))
    window = (spectrum.frequency >= 0.01) & (spectrum.frequency <= 0.3)
    through = np.interp(spectrum.frequency[window], *fit)
    assert np.mean(spectrum.power[window] / through) == pytest.approx(1, abs=0.15)
    assert np.diff(np.log(slope[1])) == pytest.approx(-2 * np.diff(np.log(slope[0])))
    assert np.all(slope[1] > fit[1])
    value = rf"\psi = {spectrum.exponent:.3f} \pm {spectrum.exponent_error:.3f}"
    assert value in legend(ax)[0]
    assert legend(ax)[1] == r"slope $-2$"


def test_failed_steps_and_no_spectrum():
    result = make_relaxation(300, spectrum=False)
    result.relaxation.displacement[0, [5, 6, 9]] = np.nan
    figure = relaxation.draw_relaxation(result)
    (ax,) = figure.axes
    assert list(masked(curves(ax)[0])) == [5, 6, 9]
    assert list(data(ax, marker="x")[0][0]) == [5, 6, 9]
    assert note(figure) == "3 of 301 amplitudes missed the accuracy asked for"
    result.relaxation.displacement[:] = np.nan
    relaxation.draw_relaxation(result).draw_without_rendering()


def test_upper_limits_of_amplitudes_at_the_floor():
    """In the place of an amplitude that is not known stands what it cannot exceed."""
    result = make_relaxation(300, spectrum=False)
    relaxed = result.relaxation
    relaxed.error_bound = np.full(relaxed.displacement.shape, 0.5)
    relaxed.at_floor = np.zeros(relaxed.displacement.shape, np.int8)
    relaxed.at_floor[0, [5, 7, 200], 0] = 1
    (ax,) = relaxation.draw_relaxation(result).axes
    assert list(masked(curves(ax)[0])) == [5, 7, 200]
    ((x, y),) = ((x, y) for x, y in data(ax, marker="v") if np.isfinite(y).any())
    limits = np.abs(relaxed.displacement[0, :, 0]) + 0.5
    assert np.array_equal(x[np.isfinite(y)], [5, 7, 200])
    assert np.array_equal(y[np.isfinite(y)], limits[[5, 7, 200]])
    assert "upper limit, at the floor" in legend(ax)


# Files


@pytest.mark.parametrize(
    ("make", "missing"),
    [
        (make_continuum, "continuum/resonance"),
        (make_modes, "modes/participation"),
        (make_modes, "lattice/omega_mx"),
        (make_projection, "projection/dominant"),
        (make_relaxation, "relaxation/displacement"),
        (make_relaxation, "lattice/stiffness_y"),
        (make_relaxation, "spectrum/scale"),
    ],
)
def test_an_incomplete_result(tmp_path, make, missing):
    result = make()
    group, name = missing.split("/")
    if group == "spectrum":
        result.spectrum = SimpleNamespace(**vars(result.spectrum))
    delattr(getattr(result, group), name)
    with pytest.raises(FileError, match=f"{missing} is missing"):
        figures.draw(result, tmp_path / "a.png")


@pytest.mark.parametrize("make", [make_modes, make_projection, make_relaxation])
def test_every_figure_can_be_written(tmp_path, make):
    written = figures.draw(make(), tmp_path / "a.png")
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in written)


# Two results


def write_pair(folder, seed=1, mass=1.0, certified=True):
    """Write a response and modes of one lattice; return what `pgran plot` takes."""
    rng = np.random.default_rng(seed)
    stiffness = rng.uniform(size=(5, 3)), rng.uniform(size=(4, 4))
    record = results.LatticeRecord.of(Lattice(stiffness, mass, 0.1))
    x, one = np.linspace(0.1, 2.4, 40), np.ones(40)
    sweep = results.Response(
        *(1, 0.0, np.array([-2.0]), np.array([1.0]), np.array([0.0]), 0.3, 1.0),
        *(x, np.array([[1, 1]]), one[:, None] + 0j, one[:, None], -2 * x[:, None]),
        *(one, one[:, None], np.zeros((40, 1), np.int8), one.astype(int), one.astype(int)),
    )
    found = results.Modes(3, certified, 0.0, np.array([0.4, 0.9, 2.0]), np.zeros(3), np.ones(3))
    paths = folder / "response.h5", folder / "modes.h5"
    for path, scene, group in zip(paths, ("response", "modes"), (sweep, found), strict=True):
        store.write(path, {"scene": scene}, [record, group])
    return list(map(str, paths))


@pytest.mark.parametrize("swapped", [False, True])
def test_modes_are_marked_in_a_response(tmp_path, capsys, monkeypatch, swapped):
    seen = []
    monkeypatch.setattr(figures, "draw", lambda *given: seen.append(given) or ["drawn.png"])
    pair = write_pair(tmp_path)
    assert command_line.main(["plot", *(pair[::-1] if swapped else pair)]) == errors.DONE
    ((shown, output, marked),) = seen
    assert hasattr(shown, "response")
    assert output == str(tmp_path / "response.png")
    assert np.array_equal(marked, [0.4, 0.9, 2.0])
    assert capsys.readouterr().out == "drawn.png\n"


def test_the_pluses_of_a_pair_and_its_name(tmp_path, capsys):
    one, other = write_pair(tmp_path)
    assert command_line.main(["plot", one, "-o", str(tmp_path / "b.pdf"), other]) == errors.DONE
    assert len(capsys.readouterr().out.splitlines()) == 3
    assert (tmp_path / "b-amplitude.pdf").exists()
    shown, marked, swapped = figures.pair(store.load(other), store.load(one))
    assert swapped
    ax = response.draw_phase(shown, marked.modes.omega).axes[0]
    ((x, _),) = data(ax, marker="+")
    assert x == pytest.approx(np.array([0.4, 0.9, 2.0]) / shown.lattice.omega_mx)


def test_modes_that_are_not_certified_are_warned_of(tmp_path, caplog, monkeypatch):
    monkeypatch.setattr(figures, "draw", lambda *given: [])
    pair = write_pair(tmp_path, certified=False)
    with caplog.at_level("WARNING", logger="pgran"):
        command_line.main(["plot", *pair])
    assert "missing or inaccurate" in caplog.text


@pytest.mark.parametrize("other", [{"seed": 2}, {"mass": 2.0}])
def test_modes_of_another_lattice(tmp_path, other):
    (tmp_path / "other").mkdir()
    one, _ = write_pair(tmp_path)
    _, modes_file = write_pair(tmp_path / "other", **other)
    with pytest.raises(FileError, match="different lattices"):
        command_line.main(["plot", one, modes_file])


def test_two_results_that_are_no_pair(tmp_path):
    one, other = write_pair(tmp_path)
    for pair, scene in (([one, one], "response"), ([other, other], "modes")):
        with pytest.raises(FileError, match=f"not {scene} and {scene}"):
            command_line.main(["plot", *pair])
    result = store.load(other)
    del result.attributes["bonds_sha256"]
    with pytest.raises(FileError, match="different lattices"):
        figures.pair(store.load(one), result)
