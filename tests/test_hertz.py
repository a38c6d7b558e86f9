"""Hertzian contacts in physical units, and the lattice that has them."""

import math
import re
import shlex
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import eigh
from small import OPTIONS

import pgran
from pgran.__main__ import main
from pgran.command import units
from pgran.command.resolve import resolve
from pgran.errors import DONE, InputError
from pgran.medium import hertz
from pgran.medium.hertz import MATERIALS, Material, Scale
from pgran.run.options import read_file, read_words

GLASS = MATERIALS["glass"]
BEAD = Scale(GLASS, 5e-3, 1e-3)  # the diameter of Liu and Nagel's beads
GIVEN = "--diameter 5e-3 --material glass --load 1e-3"


@pytest.mark.parametrize("material", MATERIALS.values(), ids=MATERIALS)
def test_stiffness_is_the_slope_of_the_force(material):
    for force in (1e-6, 1e-3, 10.0):
        scale = Scale(material, 2e-3, force)
        h, step = scale.overlap, 1e-5 * scale.overlap
        assert scale.constant * h**1.5 == pytest.approx(force, rel=1e-13)
        ends = [scale.constant * (h + side * step) ** 1.5 for side in (-1, 1)]
        assert np.diff(ends)[0] / (2 * step) == pytest.approx(scale.stiffness, rel=1e-9)
        back = hertz.force_of_stiffness(scale.constant, scale.stiffness)
        assert back == pytest.approx(force, rel=1e-13)


def test_the_contact_against_landau_and_lifshitz():
    """Of two balls: F = h^(3/2)/D sqrt(R R'/(R + R')); and k = 2 E* a, a the contact's radius."""
    d = 2 * 0.75 * (1 - GLASS.poisson**2) / GLASS.modulus
    radius = BEAD.diameter / 2
    force = BEAD.overlap**1.5 / d * math.sqrt(radius / 2)
    assert force == pytest.approx(BEAD.force, rel=1e-13)
    effective = 1 / (2 * (1 - GLASS.poisson**2) / GLASS.modulus)
    a = (3 * BEAD.force * (radius / 2) / (4 * effective)) ** (1 / 3)
    assert BEAD.stiffness == pytest.approx(2 * effective * a, rel=1e-13)
    assert BEAD.contact_radius == pytest.approx(a / radius, rel=1e-13)


def test_units_of_length_mass_and_time_may_be_any():
    """All results scale as their dimensions say."""
    length, mass, time = 8.0, 0.5, 4.0
    stress, force = mass / length / time**2, mass * length / time**2
    same = Material(GLASS.modulus * stress, GLASS.poisson, GLASS.density * mass / length**3)
    other = Scale(same, BEAD.diameter * length, BEAD.force * force)
    scales = {"mass": mass, "overlap": length, "stiffness": mass / time**2, "omega_mx": 1 / time}
    for name, factor in (scales | {"velocity": length / time, "contact_radius": 1}).items():
        assert getattr(other, name) == pytest.approx(factor * getattr(BEAD, name), rel=1e-13)
    for damping in (
        lambda scale, t: hertz.damping_of_quality(scale.stiffness, 30.0, 2e4 / t),
        lambda scale, t: hertz.damping_of_restitution(scale.stiffness, scale.mass, 0.8),
    ):
        ratio = damping(other, time) / damping(BEAD, 1.0)
        assert ratio == pytest.approx(mass / time, rel=1e-13)
        own = [scale.own_damping(damping(scale, t)) for scale, t in ((other, time), (BEAD, 1.0))]
        assert own[0] == pytest.approx(own[1], rel=1e-13)


def test_how_sound_depends_on_pressure_size_and_modulus():
    """At the same pressure its speed is that of any size of balls, p^(1/6) E^(1/3)."""

    def bed(pressure, diameter=5e-3, modulus=GLASS.modulus):
        force = pressure / hertz.pressure_of_force(1.0, diameter)
        return Scale(replace(GLASS, modulus=modulus), diameter, force)

    first = bed(1e3)
    assert bed(1e3, 1e-2).velocity == pytest.approx(first.velocity, rel=1e-13)
    assert bed(1e3, 1e-2).omega_mx == pytest.approx(first.omega_mx / 2, rel=1e-13)
    assert bed(64e3).velocity == pytest.approx(2 * first.velocity, rel=1e-13)
    stiffer = bed(1e3, modulus=8 * GLASS.modulus)
    assert stiffer.velocity == pytest.approx(2 * first.velocity, rel=1e-13)
    cubic = 1e3 / hertz.pressure_of_force(1.0, 5e-3, math.pi / 6, 6.0)
    assert cubic == pytest.approx(1e3 * 5e-3**2, rel=1e-13)  # a contact in each square d x d


@pytest.mark.parametrize("restitution", [0.999, 0.3])
def test_restitution_against_a_collision(restitution):
    """Two balls that meet: (m/2) x'' + beta x' + k x = 0 until x = 0 again."""
    k, m = 3.0, 0.7
    beta = hertz.damping_of_restitution(k, m, restitution)
    apart = lambda t, y: y[0] - 1e-14  # noqa: E731 (they touch at the beginning)
    apart.terminal, apart.direction = True, 1
    motion = lambda t, y: [y[1], -(k * y[0] + beta * y[1]) / (m / 2)]  # noqa: E731
    run = solve_ivp(motion, (0, 20), [0.0, -1.0], events=apart, rtol=1e-11, atol=1e-13)
    assert run.y_events[0][0, 1] == pytest.approx(restitution, rel=1e-8)
    assert hertz.restitution_of_damping(k, m, beta) == pytest.approx(restitution, rel=1e-12)
    assert hertz.restitution_of_damping(k, m, 2 * math.sqrt(k * m / 2)) == 0
    assert hertz.damping_of_restitution(k, m, 1.0) == 0


def test_quality_factor_against_a_damped_mode():
    """Omega over the width of a mode, of m s^2 + (k + s beta) c = 0 with any eigenvalue c of C."""
    k, m, c = 3.0, 0.7, 1.3
    omega = math.sqrt(k * c / m)
    beta = hertz.damping_of_quality(k, 40.0, omega)
    s = np.roots([m, beta * c, k * c])[0]
    assert abs(s) == pytest.approx(omega, rel=1e-12)
    assert abs(s) / (-2 * s.real) == pytest.approx(40.0, rel=1e-12)


@pytest.mark.parametrize("dimensions", [1, 2, 3])
def test_the_options_make_that_lattice(capsys, dimensions):
    """Its omega_mx is 1, and numbers without a unit are those of the balls."""
    words = f"{GIVEN} --restitution .9 --dimensions {dimensions}"
    assert main(["units", *words.split()]) == DONE
    told = capsys.readouterr().out.splitlines()[-2]
    shape = ",".join(["4"] * dimensions)
    given = ["-scene", "modes", "-lattice_shape", shape, *shlex.split(told)]
    options = resolve(read_words(given))
    facts = {"mass": options.lattice_mass, "damping": options.lattice_damping}
    lattice = pgran.Lattice.random((4,) * dimensions, seed=1, kmax=options.bonds_kmax, **facts)
    assert lattice.omega_mx == pytest.approx(1.0, rel=1e-15)
    scale = Scale(BEAD.material, BEAD.diameter, BEAD.force, dimensions)
    beta = hertz.damping_of_restitution(scale.stiffness, scale.mass, 0.9)
    assert lattice.damping / lattice.kmax == pytest.approx(
        beta * scale.omega_mx / scale.stiffness, rel=1e-13
    )
    own = math.sqrt(lattice.kmax / lattice.mass) * scale.diameter * scale.omega_mx
    assert own == pytest.approx(scale.velocity, rel=1e-13)


def value(out, name):
    """The number in SI units of a row of the table."""
    return float(re.search(rf"^{re.escape(name)}.*? {{2,}}(\S+)", out, re.MULTILINE)[1])


def say(capsys, words):
    assert main(["units", *words.split()]) == DONE
    return capsys.readouterr().out


def test_a_packing_of_these_balls(call, place):
    """What is printed packs balls under the mean force, and runs: they oscillate as glass does."""
    given = "units --diameter 5e-3 --material glass --restitution .9"
    given, pressure = f"{given} --load 8", f"{given} --pressure {0.64 * 6 * 2 / math.pi / 25e-6!r}"
    by_pressure = re.findall(r"--pressure (\S+)", call(*pressure.split()).stdout)
    out = call(*given.split()).stdout
    by_load = re.findall(r"--pressure (\S+)", out)
    assert [float(x) for x in by_load] == pytest.approx([float(x) for x in by_pressure], rel=1e-9)
    folder = place("options", lambda path: path.symlink_to(OPTIONS)).parent
    for command in out.splitlines()[-1].split(" && "):
        done = call(*shlex.split(command)[1:])
        assert done.returncode == DONE, done.stderr
    result = pgran.load(folder / "results" / "packing_modes.h5")
    packing, metre, second = result.medium.built, result.units_length, result.units_time
    newton = BEAD.mass * metre / second**2
    assert packing.force.mean() * newton == pytest.approx(2, rel=0.1)
    virial = np.sum(packing.force * packing.distance) / 3 / np.prod(packing.box)
    pascal = newton / metre**2
    assert virial * pascal == pytest.approx(hertz.pressure_of_force(2, 5e-3), rel=1e-6)
    stiffest = 1.5 * BEAD.constant ** (2 / 3) * (packing.force.max() * newton) ** (1 / 3)
    omega_mx = math.sqrt(6 * stiffest / BEAD.mass)
    assert packing.omega_mx / second == pytest.approx(omega_mx, rel=1e-9)
    assert packing.damping * BEAD.mass / second == pytest.approx(value(out, "damping"), rel=1e-3)
    heater = call(*given.split(), "--growth", "1e-7").stdout.split(" && pgran run ")[1]
    path, *words = heater.split()
    options = resolve(read_file(folder / path) + read_words(words))
    assert options.heat_radius * metre == pytest.approx(1e-7)


CUBIC = f"--diameter 5e-3 --material sand --density 2600 --fraction {math.pi / 6} --contacts 6"


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (  # beta omega = k/Q: so the quality factor falls like 1/omega
            f"{GIVEN} --quality 50 --frequency 4e3",
            {
                "mass": BEAD.mass, "overlap": BEAD.overlap, "stiffness": BEAD.stiffness,
                "omega_mx": BEAD.omega_mx, "frequency": BEAD.omega_mx / (2 * math.pi),
                "time": 1 / BEAD.omega_mx, "long waves": BEAD.velocity,
                "damping": BEAD.stiffness / (50 * 8e3 * math.pi),
                "quality": 50 * 8e3 * math.pi / BEAD.omega_mx,
            },
        ),
        (  # a ball that grows between neighbours that stay: k = (3/2) c h^(1/2)
            f"{GIVEN} --growth 1e-7",
            {
                "dR/h": 1e-7 / BEAD.overlap,
                "dk/k": 1.5 * BEAD.constant * math.sqrt(BEAD.overlap + 1e-7) / BEAD.stiffness - 1,
            },
        ),
        (
            f"--diameter 5e-3 --material steel --omega_mx {BEAD.omega_mx!r}",
            {"omega_mx": BEAD.omega_mx},
        ),
        (
            f"{CUBIC} --pressure 40",
            {"mean force": 1e-3, "force of the strongest": 4e-3, "density": 2600},
        ),
    ],
)  # fmt: skip
def test_the_table(capsys, words, expected):
    out = say(capsys, words)
    for name, number in expected.items():
        assert value(out, name) == pytest.approx(number, rel=1e-3), name
    assert ("damping" in out) == ("quality" in words)


def test_the_mean_force_where_stiffness_is_uniform():
    """F ~ k^3: k = 3/2 c^(2/3) F^(1/3)."""
    k = (np.arange(10_000) + 0.5) / 10_000 * BEAD.stiffness
    forces = [hertz.force_of_stiffness(BEAD.constant, each) for each in k]
    assert BEAD.force / np.mean(forces) == pytest.approx(hertz.STRONGEST, rel=1e-6)


@pytest.mark.parametrize(("dimensions", "size", "samples"), [(2, 16, 4), (3, 7, 3)])
def test_long_waves_where_bonds_are_random(dimensions, size, samples):
    """Against the lowest modes between walls, omega = c pi sqrt(d) / (N + 1) of long waves."""
    shape, found = (size,) * dimensions, []
    for seed in range(samples):
        lattice = pgran.Lattice.random(shape, seed, kmax=1.0)
        K = lattice.restoring_forces(np.eye(lattice.size).reshape(-1, *shape))
        lowest = eigh(K.reshape(lattice.size, -1), eigvals_only=True, subset_by_index=(0, 0))
        found.append(lowest[0] / (dimensions * (2 * np.sin(np.pi / 2 / (size + 1))) ** 2))
    assert np.mean(found) == pytest.approx(hertz.effective_stiffness(dimensions), rel=0.05)
    scale = Scale(BEAD.material, BEAD.diameter, BEAD.force, dimensions)
    ratio = (scale.random_velocity / scale.velocity) ** 2
    assert ratio == pytest.approx(hertz.effective_stiffness(dimensions), rel=1e-12)


def test_the_frequencies_that_the_paper_estimates(capsys):
    """Beads of .5 cm: omxest, omega_mx > 45 kHz; velobs and expomx, 2e5/s from 57 m/s.

    The paper gives no modulus and no density; glass under the weight of one bead, its load, lies
    above 45e3/s. Its velocity of .03 cm omega_mx takes contacts under a few hundred weights.
    """
    weight = hertz.ball_mass(GLASS, 5e-3) * units.GRAVITY
    single = Scale(GLASS, 5e-3, weight)
    assert 45e3 < single.omega_mx < 2 * 45e3
    omega_mx = 57.0 / 0.03e-2
    assert omega_mx == pytest.approx(2e5, rel=0.06)  # the paper rounds
    out = say(capsys, f"--diameter 5e-3 --material glass --omega_mx {omega_mx}")
    expected = weight * (omega_mx / single.omega_mx) ** 6
    assert value(out, "force") == pytest.approx(expected, rel=1e-3)
    assert 100 < expected / weight < 500


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--material glass --load 1", "required: --diameter"),
        ("--diameter 1e-3 --material glass", "--load --pressure --omega_mx is required"),
        (f"{GIVEN} --pressure 3", "--pressure: not allowed with argument --load"),
        ("--diameter 0 --material glass --load 1", "--diameter: 0 is no positive number"),
        ("--diameter 1 --material glass --load inf", "--load: inf is no positive number"),
        ("--diameter 1 --load 1 --poisson .2", "is needed, or else --modulus, --density"),
        (f"{GIVEN} --poisson .6", "poisson: must lie above -1 and up to 0.5, not 0.6"),
        (f"{GIVEN} --fraction 1.1", "--fraction 1.1: is a part of the volume"),
        (f"{GIVEN} --quality 3", "--quality and --frequency go together"),
        (f"{GIVEN} --restitution 1.5", "--restitution 1.5: is at most 1"),
        ("--diameter 1e-200 --material glass --load 1", "too far apart to compute with"),
        (f"{GIVEN} --quality 1e-300 --frequency 1e-300", "too far apart to compute with"),
    ],
)
def test_words_that_are_refused(words, said):
    with pytest.raises(InputError) as refused:
        main(["units", *words.split()])
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)
    for wrong in ({"modulus": 0.0}, {"density": math.inf}, {"poisson": -1.0}):
        with pytest.raises(InputError, match=next(iter(wrong))):
            replace(GLASS, **wrong)


def test_large_contacts_are_told(capsys, caplog):
    with caplog.at_level("WARNING", logger="pgran"):
        say(capsys, GIVEN)
        assert not caplog.text
        say(capsys, "--diameter 5e-3 --material acrylic --load 1e4")
    assert "Hertz's law is for small contacts" in caplog.text
