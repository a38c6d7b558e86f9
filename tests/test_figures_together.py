"""Results over each other, labelled by what tells them apart, and measurements over responses."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from figure_reading import curves, labels, lay_out, legend, lines, note, saving
from figure_results import (
    UNIT,
    count_modes,
    find_modes,
    listen,
    relax,
    respond,
    respond_box,
    result_of,
)
from matplotlib.colors import to_rgba
from samples import random_lattice

import pgran
from pgran import errors
from pgran.command.plot import run as plot
from pgran.command.resolve import resolve
from pgran.draw import pages as figures
from pgran.draw import style, together
from pgran.errors import FileError, InputError
from pgran.experiments.relaxation.fluctuations import power_spectrum
from pgran.medium.differences import labels_of
from pgran.run.options import options_in, read_words

BETAS = (0.001, 0.003, 0.01)
X = np.linspace(0.1, 1.2, 111)  # in units of omega_mx


def told(words):
    """A result that knows its options only."""
    options = resolve(read_words(["-scene", "response", *words.split()]))
    return SimpleNamespace(options=options.text(), scene="response")


def with_options(result, words):
    result.options = told(words).options
    return result


@pytest.fixture(scope="module")
def damped():
    """Responses of one lattice with three dampings."""
    lattices = [random_lattice((4, 3), seed=5, mass=0.25, damping=beta) for beta in BETAS]
    made = zip(lattices, BETAS, strict=True)
    return [with_options(respond(X, lattice=x), f"-lattice_damping {beta}") for x, beta in made]


@pytest.fixture(scope="module")
def compared(damped):
    """Their figures over each other."""
    return pgran.plot(damped)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("-lattice_damping .001", "", "-lattice_damping .01"),
         ["beta = 0.001", "beta = 0.003", "beta = 0.01"]),
        (("-lattice_shape 20,20", "-lattice_shape 9,8 -bonds_seed 7"),
         ["20 x 20 balls, seed 1993", "9 x 8 balls, seed 7"]),
        (("-output_file a.h5 -output_fields", "-ranks_per_lattice 2 -bonds_seed 7"),
         ["seed 1993", "seed 7"]),  # not what a run keeps, and how
        (("", "-steady_pc_type lu"), ["by default", "pc type lu"]),
        (("-network_file a.h5", "-network_file c.h5 -detectors 8,10"),
         ["network a.h5", "network c.h5"]),
        (("", "-bonds_law constant -sweep_points 9", "-bonds_kmin .2 -damping_loss 1e-5"),
         ["bonds uniform on [0, 0.25], seed 1993", "bonds all 0.25",
          "bonds uniform on [0.2, 0.25], seed 1993, eta = 1e-05"]),
        (("-sweep_points 9", "-sweep_points 99"), ["9 points", "99 points"]),
        (("-drive_part y>2", "-drive_balls 1,1 -bonds_redrawn 3", "-bonds_redrawn 3"),
         ["driven at 'y>2', 0 redrawn", "3 redrawn, force on 1,1", "3 redrawn"]),
    ],
)  # fmt: skip
def test_labels_are_the_options_that_differ(words, expected, caplog):
    shown = [told(each) for each in words]
    assert labels_of(shown, list("abc")[: len(shown)]) == expected
    assert not caplog.text


def test_results_that_no_short_words_tell_apart_are_named(caplog):
    shown = [told("-bonds_seed 7"), told("-bonds_seed 8"), told("-bonds_seed 7 -output_file b.h5")]
    many = SimpleNamespace(options="".join(f"-solver_key_{n} {n}\n" for n in range(20)))
    with caplog.at_level("WARNING", logger="pgran"):
        found = labels_of(shown, ["a.h5", "b.h5", "c.h5"])
        assert found == ["file a.h5", "seed 8", "file c.h5"]
        assert labels_of([many, SimpleNamespace()], ["a.h5", "b.h5"]) == ["file a.h5", "by default"]
        assert labels_of(2 * [many], ["d.h5", "e.h5"]) == ["file d.h5", "file e.h5"]
    for said in ("c.h5 is named by its file: no short words tell it apart: seed 7",
                 "a.h5 is named by its file: no short words tell it apart: key 0 0, key",
                 "e.h5 is named by its file: no option differs"):  # fmt: skip
        assert said in caplog.text


def test_what_a_result_says_of_its_options_is_read_back():
    options = resolve(read_words(["-scene", "response", "-steady_pc_type", "lu"]))
    plain = {k: v for k, v in options.identity().items() if not k.startswith("output_")}
    assert options_in(options.text()) == plain


def test_results_of_other_units_say_so(damped, compared):
    """Each curve is in units of its own omega_mx, which its label has."""
    lattice = random_lattice((4, 3), seed=5, mass=0.25)
    other = with_options(respond(X, lattice=replace(lattice, kmax=0.49)), "-bonds_seed 7")
    made = pgran.plot([damped[0], other])
    for result, label in zip((damped[0], other), legend(made["phase"]), strict=True):
        assert label.endswith(rf", $\omega_{{mx}}$ = {result.medium.omega_mx:.6g}")
    assert all("units of its own" in figure.caption for figure in made.values())
    assert all("units of its own" not in figure.caption for figure in compared.values())


def test_responses_over_each_other(damped, compared):
    """Each curve has the numbers of its result, and colour, line style and label of its own."""
    assert list(compared) == ["amplitude", "phase"]
    expected = [rf"$\beta$ = {beta}" for beta in BETAS]
    for result, label in zip(damped, expected, strict=True):
        seen = []
        for ax in compared["amplitude"].axes:
            (line,) = (line for line in curves(ax) if line.get_label() == label)
            seen.append(line.get_ydata(orig=True))
        assert np.array_equal(seen[0].data, result.response.amplitude[:, 0])
        assert sum(np.ma.count(values) for values in seen) == len(X)
    drawn = curves(compared["phase"].axes[0])
    for line, result, label in zip(drawn, damped, expected, strict=True):
        assert np.array_equal(line.get_ydata(), result.response.phase[:, 0])
        assert line.get_label() == label
    assert len({line.get_color() for line in drawn}) == 3
    assert len({str(line._unscaled_dash_pattern) for line in drawn}) == 3
    assert [legend(figure) for figure in compared.values()] == [expected] * 2


def test_of_several_detectors_colours_are_balls_and_styles_are_results():
    lattices = [random_lattice((4, 3), seed=seed, mass=0.25) for seed in (1, 2)]
    shown = [respond(X, [(1, 1), (3, 0)], lattice) for lattice in lattices]
    made = figures.compare(shown, ["one $", "two"])
    drawn = curves(made["amplitude"].axes[0])
    styles = [(line.get_color(), line.get_linestyle()) for line in drawn]
    assert len(set(styles)) == 4
    assert len({colour for colour, _ in styles}) == len({style for _, style in styles}) == 2
    assert labels(made["amplitude"].axes[0])[1:3] == [r"one \$, ball (3, 0)", "two, ball (1, 1)"]
    lay_out(made["amplitude"])  # a $ of a file's name begins no formula


@pytest.mark.parametrize("key", ["lattice_damping", "relax_steps", "bonds_seed"])
def test_many_results_have_a_scale_of_colours(key):
    """Over the number in which they differ, logarithmic over decades; samples are all alike."""
    values = np.array([1, 2, 3, 5, 10 if key == "lattice_damping" else 9, 7, 8])
    shown = [respond(X) for _ in values]
    for result, value in zip(shown, values, strict=True):
        result.options = f"-{key} {value}\n"
    page = pgran.plot(shown)["phase"]
    seen = np.array([to_rgba(line.get_color()) for line in curves(page.panels[0])])
    place = np.log10(values) if key == "lattice_damping" else (values - 1) / 8
    expected = style.colours(256)[np.minimum(256 * place, 255).astype(int)]
    alike = key == "bonds_seed"
    assert np.abs(seen - (seen[0] if alike else expected)).max() < 0.02
    assert legend(page) == ["7 seeds"] * alike
    assert len(page.axes) == 2 - alike
    assert alike or f"Colours: {page.axes[1].get_ylabel()}, from 1 to {max(values)}" in page.caption
    lay_out(page)
    shown[0].response = respond(X, [(1, 1), (3, 0)]).response
    with pytest.raises(FileError, match="7 results: so many are drawn of one detector each"):
        pgran.plot(shown)


def test_labels_of_the_user(damped, monkeypatch):
    """One for each result, in their order; what is between dollars is a formula if it is one."""
    given = ["loose, $P$ = .02" + 4 * " and packed", r"$\nonsense$", "1e-5"]
    expected = [
        "loose, $P$ = .02 and packed and packed and\npacked and packed",
        r"\$\nonsense\$",
        "$10^{-5}$",
    ]
    for words, read in ((given, expected), (["_a", "b", "c"], [" _a", "b", "c"])):
        made = pgran.plot(damped, labels=words)
        assert [legend(figure) for figure in made.values()] == [read] * 2
    monkeypatch.setattr(pgran, "load", dict(zip(["a.h5", "b.h5"], damped, strict=False)).get)
    saved = saving(monkeypatch)
    plot(["a.h5", "b.h5", "-label", "one", "--label", "two"])
    assert legend(saved[0]["phase"]) == ["one", "two"]
    with pytest.raises(InputError, match="-label: 1 label for 2 results; of several over"):
        plot(["a.h5", "b.h5", "-label", "one"])
    for shown, words, said in (
        (damped[0], ["one"], "-label: 1 label for 1 result; of"),
        (damped * 3, list("abcdefghi"), "-label: more than 6 results are told apart by their col"),
        (damped, ["one", "one", "b"], "a label of its own, which is not empty"),
        (damped, ["one", " ", "b"], "a label of its own, which is not empty"),
    ):
        with pytest.raises(InputError, match=said):
            pgran.plot(shown, labels=words)


def test_sweeps_of_different_ranges():
    """Each panel is as wide as all sweeps that reach it, and draws no other."""
    made = figures.compare([respond(X[X < 0.5]), respond(X[X > 0.4])], ["low", "high"])
    panels = made["amplitude"].axes
    assert [labels(ax) for ax in panels] == [["low"], ["low", "high"], ["high"]]
    assert panels[1].get_xlim() == pytest.approx((0.3, 1.0), abs=0.002)
    low, high = made["phase"].axes[0].get_xlim()
    assert low < 0.11 < 1.19 < high


def test_modes_over_each_other():
    shown = [find_modes((6, 5)), find_modes((7, 6))]
    made = figures.compare(shown, ["small", "large"])
    drawn = lines(made["participation"].axes[0], linestyle="None")
    for line, result in zip(drawn, shown, strict=True):
        assert np.array_equal(line.get_xdata(), result.modes.omega / result.medium.omega_mx)
        assert np.array_equal(line.get_ydata(), result.modes.participation)
    assert len({line.get_marker() for line in drawn}) == 2
    steps = [patch.get_data() for patch in made["density"].axes[0].patches]
    assert np.array_equal(steps[0].edges, steps[1].edges)
    for step in steps:
        area = np.sum(step.values * np.diff(step.edges))
        assert area == pytest.approx(1, rel=1e-12)  # per ball
    for step, result in zip(made["reduced"].axes[0].patches, shown, strict=True):
        values, edges, _ = step.get_data()
        modes = result.medium.free_balls * np.sum(values * np.diff(edges**2)) / 2  # over omega
        assert modes == pytest.approx(len(result.modes.omega), rel=1e-12)
    assert labels(made["density"].axes[0]) == labels(made["reduced"].axes[0]) == ["small", "large"]
    modes = shown[1].modes
    narrow = result_of(replace(modes, omega=0.5 + 0.1 * modes.omega))
    for pair in ([shown[1], narrow], [narrow, shown[1]]):  # whichever comes first, none is cut off
        ax = figures.compare(pair, ["a", "b"])["density"].axes[0]
        assert max(patch.get_data().values.max() for patch in ax.patches) < ax.get_ylim()[1]
    loose = result_of(replace(modes, omega=modes.omega - 0.5))
    made = figures.compare([loose, shown[1]], ["a", "b"])
    assert note(made["reduced"]) == "NOT SHOWN: unstable modes"
    assert not note(made["density"])
    few = [find_modes(), result_of(replace(find_modes().modes, count_certified=False))]
    made = figures.compare(few, ["a", "b"])
    assert list(made) == ["participation"]
    assert note(made["participation"]) == "NOT CERTIFIED: modes of 1 of 2 results"


def test_spectra_of_relaxations_over_each_other():
    shown = [relax(), relax()]
    with pytest.raises(FileError, match="too short"):
        figures.compare(shown, ["a", "b"])
    rng = np.random.default_rng(1)
    for result in shown:
        walk = np.cumsum(rng.standard_normal((1, 4000)), axis=1)
        result.spectrum = power_spectrum(walk, 0.01, 0.3)
    (ax,) = figures.compare(shown, ["a", "b"])["spectrum"].axes
    for n, (result, name) in enumerate(zip(shown, "ab", strict=True)):
        power, law = ax.get_lines()[2 * n : 2 * n + 2]
        assert np.array_equal(power.get_ydata(), result.spectrum.power)
        assert np.array_equal(law.get_ydata(), result.spectrum.power_law(law.get_xdata()))
        assert law.get_label().startswith(f"{name}:\n$\\psi = {result.spectrum.exponent:.3f}")


def test_signals_over_each_other():
    shown = [listen([(1, 1)]), listen([(1, 1)], time=100.0)]
    (ax,) = figures.compare(shown, ["long", "short"])["signals"].axes
    for line, result in zip(ax.get_lines(), shown, strict=True):
        assert np.array_equal(line.get_xdata(), result.pulse.time * UNIT)
        assert np.array_equal(line.get_ydata(), result.pulse.displacement[:, 0])
    assert ax.get_xlim() == (0, 200.0 * UNIT)
    assert ax.get_title(loc="left") == "ball (1, 1)"
    shown[1] = result_of(replace(listen([(2, 1)]).pulse, error_bound=np.ones((801, 1))))
    (ax,) = figures.compare(shown, ["a", "b"])["signals"].axes
    assert labels(ax) == ["a", "b: below its error"]
    assert np.isnan(ax.get_lines()[1].get_ydata()).all()
    assert ax.get_title(loc="left") == "first detectors"


def test_results_that_are_not_laid_over_each_other():
    assert len(together.LINES) == len(style.COLOURS) == len(together.MARKS) == together.MOST
    result, still = respond([0.5]), respond([0.5])
    still.medium = replace(still.medium, omega_mx=0.0)
    counts = SimpleNamespace(**vars(count_modes()) | {"scene": "modes"})
    for shown, said in (
        ([respond_box()] * 2, "scene continuum are not laid over each other, but of r"),
        ([result] * 7, "7 results: at most 6 are told apart by labels, .* differ: none"),
        ([still] * 2, "omega_mx is 0"),
        ([counts] * 2, "normal modes alone are laid over each other"),
        ([find_modes(interval=(50.0, 51.0))] * 2, "no modes"),
    ):
        with pytest.raises(FileError, match=said):
            figures.compare(shown, list("abcdefg")[: len(shown)])
    with pytest.raises(InputError, match="over one result only"):
        pgran.plot([result, result], modes=[1.0])


@pytest.mark.parametrize("several", [False, True])
def test_what_was_measured_lies_over_a_response(written, damped, several, caplog):
    path = written("0.4 2.0 -1\n0.8 0.5 -2\n8.0 1e-3 -3\n", "measured$.csv")
    with caplog.at_level("WARNING", logger="pgran"):
        made = pgran.plot(damped if several else damped[0], measured=path)
    assert "1 frequencies are beyond the sweep" in caplog.text
    for name, values in (("amplitude", [2.0, 0.5]), ("phase", [-1.0, -2.0])):
        dots = [line for ax in made[name].axes for line in lines(ax, marker="o")]
        assert np.concatenate([d.get_xdata() for d in dots]) == pytest.approx([0.2, 0.4])
        assert np.concatenate([d.get_ydata() for d in dots]).tolist() == values
        assert legend(made[name]).count(r"measured\$.csv") == 1


@pytest.mark.parametrize(("unit", "omega"), [("Hz", 2e-3 * math.pi), ("omega_mx", 2.0)])
def test_what_was_measured_in_other_units(written, damped, unit, omega):
    """Frequencies in Hz where the unit of time is known; amplitudes by the volt."""
    path = written(f"Frequency;amplitude\n{0.4 / omega};4000\n", "a.csv")
    look = {"measured": path, "measured_unit": unit, "measured_scale": 5e-4}
    made = pgran.plot(damped[0], units=(None, 1e-3), **look)
    (dots,) = lines(made["amplitude"].axes[0], marker="o")
    assert dots.get_xydata()[0] == pytest.approx([0.2, 2.0])
    assert r"measured (a.csv) $\times$ 0.0005." in made["amplitude"].caption
    assert not lines(made["phase"].axes[0], marker="o")  # none was measured


def test_measurements_that_fit_no_figure(written, damped):
    path, far = written("0.4 2\n", "a.csv"), written("40 2\n", "b.csv")
    other = respond(X, lattice=random_lattice((4, 3), seed=5, mass=1.0))
    pair = [damped[0], with_options(other, "-lattice_mass 4")]
    for shown, look, said in (
        (find_modes(), {}, r"a\.csv: .* laid over responses only"),
        (pair, {}, r"a\.csv: the results have different omega_mx"),
        (damped[0], {"measured": far}, r"b\.csv: none of its frequencies is within"),
        (damped[0], {"measured_unit": "Hz"}, "-plot_unit Hz: the result has no unit of time"),
        (damped[0], {"measured_unit": "kHz"}, "-plot_unit kHz: ch"),
        (damped[0], {"measured_scale": -1}, "scale -1:"),
        (damped[0], {"measured_scale": 1e99}, "cannot be drawn; -plot_scale"),
        (damped[0], {"measured": None, "measured_unit": "Hz"}, "-plot_with, which is missing"),
    ):
        with pytest.raises((FileError, InputError), match=said):
            pgran.plot(shown, **{"measured": path} | look)


def test_the_command(written, damped, monkeypatch, capsys):
    saved, path = saving(monkeypatch), written("0.4 2\n", "a.csv")
    monkeypatch.setattr(pgran, "load", dict(zip(["a.h5", "b.h5"], damped, strict=False)).get)
    assert plot(["a.h5", "b.h5", "-plot_with", str(path)]) == errors.DONE
    assert capsys.readouterr().out == "a-compared.png\n"
    assert len(lines(saved[0]["amplitude"].axes[0], marker="o")) == 1
    assert plot(["b.h5", "-plot_with", str(path), "-o", "c.pdf"]) == errors.DONE
    assert capsys.readouterr().out == "c.pdf\n"
    assert "delay" in saved[1]
    with pytest.raises(InputError, match=r"plot: .* required: RESULT; see pgran plot --help"):
        plot([])
