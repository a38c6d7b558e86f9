"""Laws of damping: what solves S for one of them from another, in time, along steps, in files."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from law_samples import with_laws
from network_samples import random_network
from samples import steady
from sensitivity_samples import packing
from small import OPTIONS

import pgran
from pgran.command.resolve import resolve
from pgran.driven.counting import smallest_damping
from pgran.medium.base import record_of
from pgran.medium.network_file import parts_of, read_network, write_network
from pgran.medium.sample import make_lattice
from pgran.medium.springs import quadratic
from pgran.run.crew import Crew
from pgran.run.options import read_words

ETA, ALPHA, BETA = 0.02, 0.03, 0.005
UNDAMPED = pgran.Lattice.random((6, 5), damping=0.0)
MEAN = UNDAMPED.constants.mean()


@pytest.mark.parametrize(
    ("law", "s_of"),
    [  # S(s) of the law is that of no damping at another s, but for a factor that A does not feel
        ({"loss": ETA}, lambda s: s / np.sqrt(1 + 1j * ETA)),
        ({"damping": BETA, "damping_power": 1}, lambda s: s / np.sqrt(1 + s * BETA / MEAN)),
        ({"drag": ALPHA}, lambda s: np.sqrt(s * s + ALPHA * s)),
    ],
)
@pytest.mark.parametrize("s", [0.2j, 0.7j, 0.05 + 0.9j, 1.3j])
def test_amplitudes_are_those_without_damping_elsewhere(law, s_of, s):
    sites, elsewhere = [(2, 2), (4, 1)], complex(s_of(s))
    elsewhere *= np.sign(elsewhere.real) or 1.0
    states = []
    for medium, at in ((dataclasses.replace(UNDAMPED, **law), s), (UNDAMPED, elsewhere)):
        with steady(medium, sites, tolerance=1e-10) as (_, solver):
            states.append(solver.solve(at))
    damped, undamped = states
    assert damped.converged_reason > 0
    error = np.abs(damped.displacement - undamped.displacement)
    assert np.all(error <= damped.error_bound + undamped.error_bound)
    assert np.all(error <= 1e-9 * np.abs(damped.displacement))


@pytest.mark.parametrize("law", [{"damping_power": 1.0}, {"damping_power": -0.5, "loss": 0.01}])
def test_each_step_of_a_relaxation_has_the_dashpots_of_its_bonds(law, world):
    """C changes with every bond, and so does its smallest eigenvalue; ranks share the lattice."""
    lattice, steps = pgran.Lattice.random((5, 4), damping=0.02, **law), 30
    asked = {"omega": 0.5, "detectors": [(2, 1)], "steps": steps, "error_tolerance": 1e-8}
    with Crew(world, world.size) as crew:
        ways = [
            world.bcast(pgran.relax(lattice, None, crew=crew, method=method, **asked))
            for method in ("window", "direct")
        ]
    for step in (0, 1, 7, steps):
        changed = pgran.redrawn(lattice, step)
        eigenvalues = np.linalg.eigvalsh(quadratic(changed)[1].toarray())
        assert 0.4 * eigenvalues[0] <= 0.02 * smallest_damping(changed) <= eigenvalues[0]
        exact = pgran.sweep(changed, [0.5], [(2, 1)], error_tolerance=1e-11).displacement[0, 0]
        for found in ways:
            error = abs(found.displacement[0, step, 0] - exact)
            assert error <= found.error_bound[0, step, 0] + 1e-11 * abs(exact)
    changed = lattice.with_constants(lattice.constants[::-1])
    assert changed.damping_reference == lattice.damping_reference


@pytest.mark.parametrize("law", [{"damping_power": 1.0}, {"drag": 0.05, "damping": 0.0}])
def test_pulses_are_alike_by_both_methods(law):
    lattice = pgran.Lattice.random((3, 2), **{"damping": 0.01} | law)
    asked = {"time": 40.0, "omega": 0.5, "width": 0.4, "points": 41, "fields": True}
    one, other = (
        pgran.pulse(lattice, [(1, 1)], method=method, error_tolerance=1e-4, **asked)
        for method in ("laplace", "moments")
    )
    assert np.all(np.abs(one.displacement - other.displacement) <= 2e-4)
    balance = one.work - one.energy - one.dissipated
    assert np.abs(balance).max() <= 1e-6 * one.work.max()
    assert one.dissipated[-1] > 0.1 * one.work[-1]


def test_options_make_the_laws(world, place):
    words = ["-damping_power", "0.5", "-damping_mass", "0.1", "-damping_loss", "0.2"]
    lattice = make_lattice(resolve(read_words(["-scene", "response", *words])), world)
    assert (lattice.damping_power, lattice.drag, lattice.loss) == (0.5, 0.1, 0.2)
    path = place("n.h5", write_network, *parts_of(packing("vector")))
    words += ["-network_file", str(path), "-damping_part", "normal"]
    network = make_lattice(resolve(read_words(["-scene", "response", *words])), world)
    assert (network.damping_power, network.damped) == (0.5, "normal")
    assert np.all(network.drag == 0.1)
    assert np.all(network.loss == 0.2)


def test_what_makes_no_law_is_refused():
    lossy = dataclasses.replace(UNDAMPED, loss=ETA)
    with pytest.raises(pgran.InputError, match="-damping_loss: only for steady states"):
        pgran.pulse(lossy, detectors=[(1, 2)], time=300.0, omega=0.5, points=201)
    with pytest.raises(pgran.InputError, match="is too large; take p nearer"):
        dataclasses.replace(UNDAMPED, damping=1.0, damping_power=-1e6)
    for name in ("drag", "loss"):
        with pytest.raises(pgran.InputError, match="0 or more"):
            dataclasses.replace(UNDAMPED, **{name: -1.0})
    network = random_network(3).network
    for name, count in (("drag", len(network.held)), ("loss", len(network.bond))):
        with pytest.raises(pgran.InputError, match="0 or more"):
            dataclasses.replace(network, **{name: -np.ones(count)})
    across = np.ones(len(network.bond))
    with pytest.raises(pgran.InputError, match="contradicts damped = normal"):
        dataclasses.replace(network, damped="normal", tangential_dashpot=across)


def test_widths_to_first_order():
    lossy = dataclasses.replace(UNDAMPED, drag=ALPHA, loss=ETA)
    modes = pgran.find_modes(lossy)
    np.testing.assert_allclose(modes.width, ALPHA + ETA * modes.omega, rtol=1e-12)
    assert np.all(pgran.structure(lossy, 1, [0.2, 0.3, 0.4]).dashpots > ALPHA)
    pair = pgran.Network([(0, 1), (2, 3)], [1, -0.2], [0, 1, 0, 1], 1, 0.0, drag=ALPHA, loss=ETA)
    np.testing.assert_allclose(pgran.find_modes(pair).width, [ALPHA, ALPHA + ETA])  # s < 0 is real


def test_contacts_made_anew_have_the_dashpots_of_the_old_ones():
    discs = Path(__file__).parents[1] / "options" / "packings" / "discs.h5"
    packed = read_network(discs, damping=0.01)
    contacts = len(packed.bond)
    weak = dataclasses.replace(packed, dashpot=0.25, loss=0.1, drag=0.2)
    for made in (pgran.equilibrate(weak), pgran.ordered(weak)):
        found = made.dashpot, made.loss, made.drag
        assert [set(values) for values in found] == [{0.25}, {0.1}, {0.2}]
    varied = dataclasses.replace(packed, dashpot=np.linspace(0, 1, contacts))
    with pytest.raises(pgran.InputError, match=r"dashpot differs.*heat_relax false"):
        pgran.heat(varied, [0.9], [193], radius=1e-9, balls=[200])


def test_drag_holds_what_floats():
    """Bounds of parts that no contact leads to a held ball take no count."""
    chain = pgran.Network([[0, 1], [2, 3]], [1.0, 2.0], [2, 0, 0, 0], drag=0.1, damping=0.0)
    assert smallest_damping(chain) == pytest.approx(0.1)
    found = pgran.sweep(chain, [0.3, 2.0], [1])
    assert found.failures == 0
    with pytest.raises(pgran.InputError, match="1 of the balls float, ball 3"):
        pgran.sweep(dataclasses.replace(chain, drag=[0.1, 0.1, 0.1, 0.0]), [0.3], [1])


@pytest.mark.parametrize("seed", range(3))
def test_laws_go_through_records_and_files(seed, tmp_path):
    network = with_laws(random_network(seed).network, seed)
    lattice = pgran.Lattice.random((3, 2), damping_power=0.5, drag=0.1, loss=0.2)
    write_network(tmp_path / "n.h5", *parts_of(network))
    again = record_of(network).built, record_of(lattice).built, read_network(tmp_path / "n.h5")
    for medium, made in zip((network, lattice, network), again, strict=True):
        for one, other in zip(quadratic(medium)[:2], quadratic(made)[:2], strict=True):
            assert abs(one - other).max() <= 1e-14 * abs(one).max()


def test_bounds_of_turning_balls_are_counted():
    """Dashpots along normals leave rotations undamped: C is singular, S is not."""
    network = dataclasses.replace(packing("rotations"), damped="normal", force=None)
    assert smallest_damping(network) == 0
    sites = np.flatnonzero(network.held == 0)[:1]
    with steady(network, sites[:, None]) as (_, solver):
        states = [solver.solve(1j * omega) for omega in (0.3, 0.8, 1.1)]
    assert all(np.isfinite(state.error_bound).all() for state in states)


def test_a_default_damping_of_other_units_is_told(call, place, here):
    """With the beta that damps modes as the default does where m and omega_mx are about 1."""
    packed = pgran.pack(30, law="hertz", pressure=1e-3)
    beta = 0.003 * packed.mass * packed.omega_mx
    modes = pgran.find_modes(dataclasses.replace(packed, damping=beta))
    usual = np.nanmedian(modes.quality)
    options = str(OPTIONS / "packing_modes.opts")
    for mass, told in (1.0, None), (1e-14, "overdamped"), (1e9, "omega_mx here; "):
        parts = {name: getattr(packed, name) * mass for name in ("masses", "stiffness", "force")}
        heavy = dataclasses.replace(packed, **parts, kmax=None, median_mass=None)
        place(f"{mass}.h5", write_network, *parts_of(heavy))
        words = "run", options, "-network_file", f"{mass}.h5", "-output_file"
        done = call(*words, f"a{mass}.h5").stderr
        default = np.nanmedian(pgran.load(f"a{mass}.h5").modes.quality)
        assert (default < 0.5) == (told == "overdamped")
        if told is None:
            assert "the damping" not in done
            continue
        assert "warning: the damping" in done
        assert told in done
        found = re.search(r"-network_damping (\S+) would be 0.003", done)[1]
        assert "the damping" not in call(*words, f"b{mass}.h5", "-network_damping", found).stderr
        better = np.nanmedian(pgran.load(f"b{mass}.h5").modes.quality)
        assert better == pytest.approx(usual, rel=0.01)
    soft = call("pack", "--balls", "30", "--pressure", "1e-10", "--law", "hertz", "-o", "p.h5")
    assert "; -network_damping" in soft.stderr
