"""Numbers of results in SI units: summaries, axes of figures, files."""

import functools
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from figure_results import UNIT, count_modes, ensemble, find_modes, listen, respond
from matplotlib.figure import Figure
from mpi4py import MPI
from samples import run_scene

import pgran
from pgran.command.resolve import SCENES, resolve
from pgran.draw import scales
from pgran.medium.base import record_of
from pgran.run.options import read_words
from pgran.store.record import Result
from pgran.store.si import PREFIXES, SI, prefix_of

BEADS = SI(length=5e-3, time=1e-5)


def test_factors():
    """Of each unit, and in words."""
    for unit, expected in {
        "Hz": 1e5 / (2 * math.pi), "1/Hz": 2e-5 * math.pi, "s": 1e-5, "1/s": 1e5,
        "m": 5e-3, "m/s": 500.0,
    }.items():  # fmt: skip
        assert BEADS.factor(unit) == pytest.approx(expected, rel=1e-15)
        assert SI().factor(unit) is None
        assert SI().say(unit, 1.0) == ""
    assert SI(time=1.0).factor("m/s") is None
    assert BEADS.say("Hz", 1.0, 0.01) == " (15.92 kHz to 159.2 Hz)"
    assert BEADS.say("m/s", 0.06) == " (30 m/s)"


@pytest.mark.parametrize("unit", ["Hz", "1/Hz", "m/s"])
def test_prefixes_keep_the_value(unit):
    """Number times prefix is the value, and the number lies between 1 and 1000."""
    powers = {prefix: 1000.0**step for step, prefix in PREFIXES.items()}
    for value in np.geomspace(2e-12, 3e14, 100) * np.array([1, -1] * 50):
        shift, name = prefix_of(value, unit)
        base, inverse = unit.removeprefix("1/"), unit.startswith("1/")
        prefix = name.removeprefix("1/")[: -len(base)]
        power = powers[prefix] ** (-1 if inverse else 1)
        assert value * shift * power == pytest.approx(value, rel=1e-12)
        assert 1 - 1e-8 <= abs(value * shift) < 1000
    for value in (990.0, 0.0, math.nan, math.inf):
        assert prefix_of(value, unit) == (1.0, unit)
    assert prefix_of(5e4, "1/s") == (1.0, "1/s")


HEARD = "-detectors 2,2"
SWEPT = f"{HEARD} -sweep_points 150 -lattice_damping .05"
PULSE = f"{HEARD} -pulse_width 5 -pulse_time 99 -pulse_points 60"
CASES = {
    "response": (SWEPT, "m/s"),
    "response opening": (f"{HEARD} -sweep_points 5 -sweep_method points -bonds_hertz .8", "m"),
    "modes": ("", "Hz"),
    "modes density": ("-modes_density 9", "Hz"),
    "pulse": (PULSE, "s"),
    "ensemble": (f"{SWEPT} -ensemble_samples 3", "m/s"),
    "ensemble pulse": (f"{PULSE} -ensemble_of pulse -ensemble_samples 2", "s"),
    "sensitivity": (f"{HEARD} -sweep_omega .3", "Hz"),
}


@pytest.mark.parametrize("name", CASES)
def test_summaries(name):
    """Beside each number of the program stands its own in SI, which is nowhere without a unit."""
    words, unit = CASES[name]
    scene = name.split()[0]
    words = f"-scene {scene} -lattice_shape 5,4 {words} -output_progress none"
    records = run_scene(resolve(read_words(words.split())), MPI.COMM_SELF)
    units = {"units_length": BEADS.length, "units_time": BEADS.time}
    plain, said = (
        "\n".join(SCENES[scene].summary(Result(records, **known))) for known in ({}, units)
    )
    added = re.findall(rf" \([^()]* [mkµ]?{unit}\)", said)
    assert added
    assert not re.findall(rf"[mkµ]?{unit}\)", plain)
    for text in re.findall(r" \([^()]* (?:[mkµnpM]?(?:Hz|s|m|m/s)|1/s)\)", said):
        said = said.replace(text, "")
    assert said == plain
    if name == "modes":
        ends = records[1].omega[[0, -1]] / (2 * math.pi * BEADS.time)
        numbers = [float(each) for each in re.findall(r"[\d.]+(?= k?Hz)", added[0])]
        assert np.array(numbers) * 1e3 == pytest.approx(ends, rel=1e-3)


def at_ticks(axis, unit):
    """What the ticks say, in the unit without its prefix, and where on the axis they stand."""
    low, high = sorted(axis.get_view_interval())
    there = axis.get_majorticklocs()
    there = there[(low <= there) & (there <= high)]
    said = [float(text.strip("$")) for text in axis.get_major_formatter().format_ticks(there)]
    powers = {prefix: 1000.0**step for step, prefix in PREFIXES.items()}
    inverse, base = unit.startswith("1/"), re.search("(Hz|m/s|s|m)$", unit).group()
    power = powers[unit[2 * inverse :].removesuffix(base)]
    return np.array(said) * power ** (-1 if inverse else 1), there


def transport():
    """What an ensemble says of transport, without its curves and their noise."""
    result = ensemble()
    del result.statistics
    result.ensemble = replace(result.ensemble, omega=None)
    return result


@functools.cache
def drawn(make, *units):
    """The figures of a result, without units or with those of the beads, each drawn once."""
    return pgran.plot(make(), units=units or None)


HERTZ = UNIT / (2e-5 * math.pi)  # omega_mx


@pytest.mark.parametrize(
    ("make", "name", "axis", "quantity", "factor"),
    [
        (respond, "amplitude", "x", "driving frequency", HERTZ),
        (respond, "phase", "x", "driving frequency", HERTZ),
        (respond, "delay", "y", "group delay", 1e-5 / UNIT),
        (respond, "wall", "x", "driving frequency", HERTZ),
        (find_modes, "participation", "x", "mode frequency", HERTZ),
        (count_modes, "density", "y", "density of modes per ball", 1 / HERTZ),
        (count_modes, "staircase", "x", "frequency", HERTZ),
        (listen, "signals", "x", "time", 1e-5 / UNIT),
        (listen, "energy", "x", "time", 1e-5 / UNIT),
        (listen, "spectrum", "x", "frequency", HERTZ),
        (transport, "velocity", "x", "phase velocity", 500 * UNIT),
        (transport, "transport", "y", "attenuation length", 5e-3),
    ],
)  # fmt: skip
def test_axes(make, name, axis, quantity, factor):
    """A tick that says 12 kHz stands at that frequency; curves and limits stay where they were."""
    plain, made = drawn(make)[name], drawn(make, 5e-3, 1e-5)[name]
    labels = {ax.xaxis.get_label_text() if axis == "x" else ax.get_ylabel() for ax in made.axes}
    (label,) = {label for label in labels if label.startswith(f"{quantity} (")}
    unit, seen = label.rpartition("(")[2].rstrip(")"), 0
    for ax, before in zip(made.axes, plain.axes, strict=True):
        assert (ax.get_xlim(), ax.get_ylim()) == (before.get_xlim(), before.get_ylim())
        for line, same in zip(ax.lines, before.lines, strict=True):
            assert np.array_equal(line.get_xdata(), same.get_xdata())
        shown = getattr(ax, f"{axis}axis")
        if shown.get_label_text() in (label, "" if axis == "x" else label):  # "": as that below
            assert isinstance(shown.get_major_locator(), scales.Ticks)
            said, there = at_ticks(shown, unit)
            assert len(said) >= 2
            assert said == pytest.approx(factor * there, rel=1e-3)
            seen += 1
    assert seen


@pytest.mark.parametrize(
    ("scale", "high"),
    [("linear", 70.0), ("symlog", 70.0), ("log", 2e3), ("log", 70.0), ("log", 6.0), ("log", 1.3)],
)
def test_ticks_of_any_scale(scale, high):
    """They stand at round numbers of the other unit, and within the axis."""
    ax = Figure().subplots()
    ax.plot([1.0, high], [1.0, 2.0])
    ax.set_xscale(scale)
    scales.convert(ax.xaxis, 0.37)
    said, there = at_ticks(ax.xaxis, "Hz")
    assert len(said) >= 2
    assert said == pytest.approx(0.37 * there, rel=1e-3)
    digits = {f"{abs(number):e}".partition("e")[0].rstrip("0.") for number in said if number}
    assert max(map(len, digits)) <= 3
    assert not any(ax.xaxis.get_minor_formatter().format_ticks(ax.xaxis.get_minorticklocs()))


@pytest.mark.parametrize("power", np.linspace(-6, 1, 5).tolist())
def test_ticks_on_both_sides_of_zero_are_apart(power):
    """Whatever the unit is: none but 0 stands where the axis is linear, and there are few."""
    ax = Figure().subplots()
    values = np.array([-1e4, 0.3, 20.0, 40.0, 40.0, 50.0, 3e4])
    ax.plot(values)
    scales.delays(ax, values)
    scales.convert(ax.yaxis, 10**power)
    places = ax.yaxis.get_majorticklocs()
    assert np.count_nonzero(places == 0) == 1
    assert np.abs(places[places != 0]).min() >= 40.0
    assert len(places) <= 7


def test_a_run_says_it(call, place, shared_path):
    """In its file, for later figures; other units may be given to these."""
    place("m.opts", "-scene modes -lattice_shape 5,4 -units_length 5e-3 -units_time 1e-5")
    assert call("run", "m.opts").returncode == 0
    path = shared_path / "results" / "m.h5"
    result = pgran.load(path)
    assert SI.of(result) == BEADS
    assert result.options.count("-units_") == 2
    assert pgran.plot(result)["density"].axes[0].get_xlabel() == "mode frequency (kHz)"
    assert call("plot", str(path), "-units_time", "1").returncode == 0
    assert "(mHz)" in pgran.plot(result, units=(None, 1.0))["density"].axes[0].get_xlabel()


def test_results_with_different_units(caplog):
    """Laid over each other they have none."""
    lattice = pgran.Lattice.random((5, 4))
    records = [record_of(lattice), pgran.find_modes(lattice)]
    several = [Result(records, scene="modes", units_time=t) for t in (1.0, 2.0)]
    figures = pgran.plot(several)
    assert "different units" in caplog.text
    assert all("Hz" not in ax.get_xlabel() for f in figures.values() for ax in f.axes)
    alike = [Result(records, scene="modes", units_time=1.0)] * 2
    assert "mHz" in pgran.plot(alike)["participation"].axes[0].get_xlabel()


BOUNDS = "-units_length: a unit lies between 1e-99 and 1e+99"


def test_impossible_units(call, place):
    """Whoever gives them is told so, before a run begins."""
    for words, said in (
        ("continuum -units_time 1", "the box has units by"),
        ("response -units_time 0", "units_time 0"),
        ("response -units_length -1", "units_length -1"),
        ("modes -units_length 5e-324", BOUNDS),
        ("modes -units_length 1.7e308", BOUNDS),
    ):
        place("m.opts", f"-scene {words}")
        done = call("run", "m.opts")
        assert (done.returncode, said in done.stderr) == (2, True), done.stderr
    with pytest.raises(pgran.InputError, match="-units_time: a unit lies between"):
        SI(time=math.nan)
