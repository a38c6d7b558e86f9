"""Every option of a scene counts: whoever changes it gets another result."""

import dataclasses
import re

import numpy as np
import pytest
from mpi4py import MPI
from samples import run_scene

from pgran.command.resolve import SCENES, options_of, resolve
from pgran.experiments.continuum.series import Continuum
from pgran.experiments.ensemble.scene import ENSEMBLE, KEPT
from pgran.experiments.sensitivity.scene import joins
from pgran.medium.base import record_of
from pgran.medium.lattice import Lattice
from pgran.medium.space import as_network
from pgran.run.options import RUN, read_words
from pgran.run.petsc import holding
from pgran.store.record import Record, Result

BASE = {
    "response": "-lattice_shape 5,4 -detectors 2,2 -sweep_points 9",
    "continuum": "-sweep_points 9",
    "modes": "-lattice_shape 5,4",
    "projection": "-lattice_shape 5,4 -sweep_points 9",
    "pulse": "-lattice_shape 5,4 -detectors 2,2 -pulse_width 5 -pulse_time 100 -pulse_points 60",
    "sensitivity": "-lattice_shape 5,4 -detectors 2,2 -sweep_points 9",
    "green": "-lattice_shape 5,4 -green_sources 2,2 -sweep_points 9",
    "structure": "-lattice_shape 5,4 -sweep_points 9 -structure_count 2",
    "loud": "-lattice_shape 5,4 -detectors 2,2 -sweep_points 2 -sweep_min .5 "
    "-lattice_damping .1 -bonds_hertz 1 -loud_amplitudes .01,.03 -loud_unit overlap "
    "-loud_harmonics 2 -loud_stability false",
    "ensemble response": "-lattice_shape 5,4 -detectors 2,2 -sweep_points 150 "
    "-lattice_damping .05 -sweep_method points -ensemble_samples 3 -ensemble_keep curves",
    "ensemble modes": "-lattice_shape 5,4 -ensemble_samples 3 -ensemble_keep curves",
    "relaxation": "-lattice_shape 5,4 -detectors 2,2 -relax_steps 150 -spectrum_fit_min .14",
}
# Units of two frequencies: the second differs.
PAIRS = "-sweep_points 128 -sweep_method points -relax_method krylov"
HERTZ, NEAREST = "-bonds_law hertz", "-modes_target .1 -modes_count 3"
INTERVAL = "-modes_omega_min .2 -modes_omega_max .6"
# Another value of each option, and what it is to be seen with. Keys a scene has not are left out.
CHANGES = {
    "lattice_shape": "4,5",
    "lattice_mass": "2",
    "lattice_damping": ".01",
    "bonds_law": "constant",
    "bonds_kmin": ".1",
    "bonds_kmax": ".5",
    "bonds_fraction": (".2", "-bonds_law bimodal"),
    "bonds_force": ("2", HERTZ),
    "bonds_hertz": ("2", HERTZ),
    "lattice_free": "y+",
    "drive_part": "y<2",
    "drive_balls": "1,1",
    "bonds_seed": "7",
    "bonds_redrawn": ("3", "-bonds_redrawn_seed 5"),
    "bonds_redrawn_seed": ("5", "-bonds_redrawn 3 -bonds_redrawn_seed 6"),
    "detectors": "1,3",
    "sweep_min": ".2",
    "sweep_max": ".9",
    "sweep_points": "8",
    "damping_power": "1",
    "damping_mass": ".1",
    "sweep_omega": (".3,.4", "-sweep_omega .3,.5"),
    "sweep_unit": ("omega_mx", "-lattice_mass 2"),
    "sweep_method": "curve",
    "sweep_resolve": (".1", "-sweep_method curve"),
    "error_tolerance": ("1e-12", f"{PAIRS} -steady_pc_type jacobi"),
    "error_floor": (".1", "-error_tolerance 1e-17"),
    "steady_refresh_iterations": ("50", PAIRS),
    "phase_fit_min": ".5",
    "phase_fit_max": ".8",
    "output_fields": "true",
    "output_models": ("false", "-sweep_method curve"),
    "continuum_point": ".3,.4",
    "continuum_size": "1,2",
    "continuum_mass": "2",
    "continuum_stiffness": "2",
    "continuum_damping": ".1",
    "pulse_shape": "gauss",
    "pulse_omega": ".5",
    "pulse_width": "6",
    "pulse_time": "110",
    "pulse_points": "61",
    "pulse_method": "moments",
    "relax_steps": "151",
    "relax_omega": ".5",
    "relax_seed": "2",
    "relax_time": ("3", "-relax_time 2"),
    "relax_method": "direct",
    "relax_window": "7",
    "relax_trajectories": "2",
    "spectrum_fit_min": ".15",
    "spectrum_fit_max": ".4",
    "modes_omega_min": (".4", INTERVAL),
    "modes_omega_max": (".5", INTERVAL),
    "modes_target": (".5", NEAREST),
    "modes_count": ("4", NEAREST),
    "modes_method": "dense",
    "modes_detectors": "1,3",
    "modes_damped": "true",
    "modes_density": ("7", "-modes_density 8"),
    "modes_density_method": ("moments", "-modes_density 8"),
    "modes_density_vectors": ("3", "-modes_density 8 -modes_density_method moments"),
    "modes_density_moments": ("40", "-modes_density 8 -modes_density_method moments"),
    "modes_density_diffusivity": ("x", "-modes_density 8 -modes_density_method moments"),
    "sensitivity_most": "7",
    "green_sources": "1,3",
    "green_receivers": "1,3",
    "green_method": "moments",
    "heat_factor": ("1.1", "-heat_factor 1.01"),
    "heat_overlap": (".02", f"{HERTZ} -heat_overlap .01"),
    "heat_balls": ("2,2,3,3", "-heat_factor 1.01"),
    "heat_samples": ("3", "-heat_factor 1.01"),
    "heat_cut": "true",
    "loud_amplitudes": ".01,.02",
    "loud_unit": "opening",
    "loud_harmonics": "3",
    "loud_follow": "frequency",
    "loud_stability": "true",
    "loud_certificate": "true",
    "structure_count": "3",
    "structure_direction": "y",
    "structure_width": ".3",
    "structure_method": "moments",
    "ensemble_samples": "4",
    "ensemble_keep": "measures",
    "transport_depths": ("1,4", "-ensemble_samples 8 -detectors 4,2,3,2,2,2,1,2,0,2"),
}
# test_command_line.py, test_motion.py, test_network.py, test_ensemble_networks.py, test_radii.py,
# test_sound.py, test_damping.py
SEEN_ELSEWHERE = {
    *("bonds_file", "pulse_file", "network_file", "network_damping", "network_rattlers"),
    *("detectors_at", "detectors_component", "ensemble_of", "statistics_windows"),
    *("green_direction", "modes_certificate", "loud_reach"),
    *("bonds_gravity", "drive_direction", "drive_force", "damping_loss", "damping_part"),
    *("heat_radius", "heat_kelvin", "heat_expansion", "heat_relax"),
}
# Waves and forces on single balls ask for no drive, and modes of many samples have no sources.
DRIVE = ["drive_part", "drive_balls"]
IDLE = {"green": DRIVE, "structure": DRIVE, "ensemble modes": DRIVE}


def own_options(scene):
    return [option for option in options_of(scene).values() if option not in RUN]


def options_in(scene):
    """The options of a scene, of an ensemble those of its experiment."""
    scene, _, repeated = scene.partition(" ")
    if not repeated:
        return own_options(scene)
    return [
        option
        for option in own_options(scene)
        if option.name in {o.name for o in (*ENSEMBLE, *own_options(repeated))}
        and (option.name != "ensemble_keep" or repeated in KEPT)
        and (option.name != "transport_depths" or repeated == "response")
    ]


def result(scene, text, world):
    """What a scene computes: the bytes of its records, their times and the lattice left out."""
    known = {option.name for option in options_in(scene)}
    pairs = zip(text.split()[::2], text.split()[1::2], strict=True)
    words = [w for pair in pairs for w in pair if pair[0][1:] in known or "_pc_" in pair[0]]
    scene, _, repeated = scene.partition(" ")
    words += ["-ensemble_of", repeated] if repeated else []
    options = resolve(read_words(["-scene", scene, "-output_progress", "none", *words]))
    with holding(options.solver):
        records = run_scene(options, world)
    return [bytes_of(record) for record in records or [] if record.group != "lattice"]


def bytes_of(record):
    """Each value of a record by its name, but for the time that it took."""
    found = {}
    for item in dataclasses.fields(record):
        value = getattr(record, item.name)
        if isinstance(value, Record):
            found[item.name] = bytes_of(value)
        elif item.name != "solve_seconds":
            value = np.asarray(value)
            found[item.name] = value.dtype, value.shape, value.tobytes()
    return found


@pytest.mark.parametrize("damping", ["0", ".003"])
def test_the_record_of_the_continuum(damping):
    """The series at the options' box and point; a phase without jumps, or of 0 and pi."""
    words = f"-scene continuum -sweep_points 400 -sweep_max 12 -continuum_damping {damping}"
    (found,) = run_scene(resolve(read_words(words.split())), MPI.COMM_SELF)
    box = Continuum((1.0, 1.0), 1.0, 1.0, float(damping))
    assert np.array_equal(found.displacement, box.response(found.omega, found.point))
    assert np.array_equal(found.resonance, box.resonances(12.0))
    turned = found.amplitude * np.exp(1j * found.phase)
    assert np.abs(turned - found.displacement).max() <= 1e-12 * found.amplitude.max()
    assert damping != "0" or set(found.phase) == {0.0, np.pi}
    assert damping == "0" or np.abs(np.diff(found.phase)).max() < np.pi


@pytest.mark.parametrize("scene", BASE)
def test_every_option_counts(scene, world):
    """And how many ranks there are does not: bit for bit, which is what several are there for."""
    idle, plain = [], {}
    for option in options_in(scene):
        if option.name in SEEN_ELSEWHERE:
            continue
        change = CHANGES[option.name]
        value, needed = change if isinstance(change, tuple) else (change, "")
        base = f"{BASE[scene]} {needed}"
        if option.name == "sweep_omega":
            base = re.sub("-sweep_(points|min) \\S+", "", base)
        if base not in plain:
            plain[base] = result(scene, base, world)
        changed = f"{base} -{option.name} {value}"
        if world.size == 1 and plain[base] == result(scene, changed, world):
            idle.append(option.name)
    if world.size == 1:
        assert idle == IDLE.get(scene, [])
    elif world.rank == 0:
        assert plain == {base: result(scene, base, MPI.COMM_SELF) for base in plain}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("-heat_factor 1.1 -heat_cut", ("one warm ball", "one cut bond", "by all 49 bonds")),
        ("-sensitivity_most 7", ("by the largest 7 of 49 bonds",)),
        ("-error_tolerance 1e-17 -heat_cut", ("9 of 9 frequencies failed", "of the heater failed")),
    ],
)
def test_what_a_sensitivity_says(words, said):
    """The bond that matters most by its balls, which is the largest derivative of all."""
    options = resolve(read_words(f"-scene sensitivity {BASE['sensitivity']} {words}".split()))
    result = Result(run_scene(options, MPI.COMM_SELF))
    lines = list(SCENES["sensitivity"].summary(result))
    assert all(any(text in line for line in lines) for text in said)
    found = result.sensitivity
    if not found.failures:
        (line,) = (line for line in lines if "depends most" in line)
        number = int(line.split("bond ")[1].split(",")[0])
        size = np.abs([found.on_bonds(n, 0) for n in range(9)])
        at, bond = np.unravel_index(np.nanargmax(size), size.shape)
        assert bond == number
        assert f"omega = {found.omega[at]:.6g}: d ln|A| / d ln k" in line
        network = as_network(result.medium)
        for ball in network.bond[number]:
            site = tuple(network.position[ball].astype(int).tolist())
            assert ("the wall" if network.held[ball] else str(site)) in line


def test_how_a_bond_is_called():
    lattice = record_of(Lattice.random((5, 4)))
    network = as_network(lattice)
    names = [
        "the wall" if held else str(tuple(site))
        for held, site in zip(network.held, network.position.astype(int).tolist(), strict=True)
    ]
    assert len(network.bond) == 49
    for bond, (i, j) in enumerate(network.bond.tolist()):
        assert joins(lattice, bond) == f"{names[i]} to {names[j]}"
        assert joins(network, bond) == f"balls {i} and {j}"
