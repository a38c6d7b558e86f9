"""Options that cannot be, alone or together: each is refused in a line that names it.

And says what was meant, where that can be guessed.
"""

import re

import pytest

from pgran.command.resolve import resolve
from pgran.errors import InputError
from pgran.run.options import read_words

MEANT = r"{}: unknown option; did you mean -{}\? \(pgran options response lists all\)$"
REFUSED = {  # of each scene, words and what is said of them
    "respons": {"": "did you mean response?"},
    "response": {
        "-n 2": "-n: ranks are started by mpirun -n N pgran run",
        "-latice_shape 1": MEANT.format("-latice_shape", "lattice_shape"),
        "-detector 1": MEANT.format("-detector", "detectors"),
        "-o 1": MEANT.format("-o", "output_file"),
        "-pc_mg_levels 1": MEANT.format("-pc_mg_levels", "steady_pc_mg_levels"),
        "-eps_tol 1": MEANT.format("-eps_tol", "normal_eps_tol"),
        "-qqqqqqq 1": r"-qqqqqqq: unknown option \(pgran options response lists all\)$",
        "-steady_ 1": r"-steady_: unknown option \(pgran options response lists all\)$",
        # numbers that are written otherwise
        "-lattice_shape 20x30": r"did you mean 20,30\?$",
        "-detectors (1,2)": r"did you mean 1,2\?$",
        "-detectors 1,2;3,4": r"did you mean 1,2,3,4\?$",
        "-sweep_points 1.5e3": r"did you mean 1500\?$",
        "-sweep_min 0,5": r"did you mean 0.5\?$",
        "-sweep_min .1Hz": r"a number \(unit: angular\)$",
        f"-sweep_points {'9' * 30}": "too large$",
        "-sweep_points 1.5e0": "a whole number$",
        # what does not go together
        "-lattice_shape 2,2,2,2": "-lattice_shape",
        "-phase_fit_min 1": "-phase_fit_min",
        "-sweep_min 1 -sweep_max 1": "-sweep_min",
        "-sweep_omega 1,1": "-sweep_omega",
        "-sweep_omega 1,2 -sweep_points 3": "-sweep_points",
        "-bonds_law file": "-bonds_file",
        "-bonds_file x.h5": "-bonds_law",
        "-bonds_law file -bonds_file x.h5 -bonds_kmin 1": "-bonds_kmin",
        "-network_file a.h5 -lattice_shape 3,3": "contradicts",
        "-network_file a.h5,b.h5": "-network_file: several networks are samples of",
        "-network_file a.h5 -detectors 1 -detectors_at 1,1": "contradicts",
        "-detectors_at 1,1": "-detectors_at: balls of a lattice are named by their indices",
        "-network_damping .1": "belongs to -network_file",
        "-detectors_component x": "balls of a lattice have one displacement",
        "-damping_part normal": "-damping_part belongs to -network_file",
        "-bonds_gravity 1": "-bonds_gravity: it needs -bonds_law hertz",
        "-bonds_redrawn 1 -bonds_law hertz -bonds_gravity 1": "-bonds_gravity: a bond that is",
        "-bonds_redrawn 1 -bonds_law file -bonds_file x.h5": "-bonds_redrawn: -bonds_law file",
    },
    "relaxation": {
        "-spectrum_fit_min .3": "-spectrum_fit_min",
        "-bonds_law file -bonds_file a.h5": "-bonds_law",
        "-bonds_law hertz -bonds_gravity 1": "-bonds_gravity: a bond that is redrawn",
        "-bonds_redrawn 5": "-bonds_redrawn: the relaxation would repeat these changes",
    },
    "modes": {
        "-modes_omega_min .5 -modes_omega_max .4": "-modes_omega_min",
        "-modes_omega_min .5": "-modes_omega_max",
        "-modes_target .5": "-modes_count",
        "-modes_count 3": "-modes_target",
        "-modes_omega_min 0 -modes_omega_max 1 -modes_count 3": "-modes_count",
        "-modes_density 9 -modes_target .5 -modes_count 3": "-modes_target",
        "-modes_density 9 -modes_method dense": "-modes_method",
        "-modes_density 9 -modes_detectors 2,2": "-modes_detectors",
        "-modes_density 9 -modes_omega_min .5": "-modes_omega_max",
        "-modes_density_method moments": "-modes_density_method: belongs to -modes_density$",
        "-modes_density 9 -modes_density_vectors 3": "-modes_density_vectors: .* moments$",
        "-modes_density 9 -modes_density_diffusivity x": "-modes_density_diffusivity: .* moments$",
        "-output_fields -modes_density 9": "-output_fields",
        "-ranks_per_lattice 2": "-ranks_per_lattice",
    },
    "projection": {"-ranks_per_lattice 2": "-ranks_per_lattice"},
    "continuum": {
        "-ranks_per_lattice 2": "-ranks_per_lattice",
        "-sweep_unit omega_mx": "-sweep_unit",
    },
    "pulse": {
        "-pulse_shape ricker -pulse_width 3": "pulse_width.* no part of a ricker",
        "-pulse_shape gauss -pulse_omega 1": "pulse_omega.* no part of a gauss",
        "-pulse_file a.txt -pulse_shape gauss": "pulse_shape.* contradicts -pulse_file",
        "-pulse_method integrate": "integrate: is gone, .* take -pulse_method moments, or laplace",
        "-pulse_ts_type rk": "-pulse_ts_type: is gone, .* take -pulse_method moments, or laplace",
    },
    "sensitivity": {
        "-heat_factor 2 -heat_overlap .1": "-heat_factor, -heat_overlap: .* one of these ways",
        "-heat_radius .1 -heat_kelvin 1": "-heat_radius, -heat_kelvin: a ball is warmed in one",
        "-heat_factor 2 -heat_relax true": "-heat_relax: only for balls that grow",
        "-heat_balls 1,1 -heat_cut": "-heat_balls: say by how much",
        "-network_file a.h5 -heat_radius .1 -bonds_redrawn 1": "-heat_radius: a redrawn contact",
    },
    "ensemble": {
        "-ensemble_of modes -detectors 2,2": "-detectors: -ensemble_of modes does not use it",
        "-ensemble_of pulse -sweep_points 9": "-sweep_points: -ensemble_of pulse does not use it",
        "-bonds_law hertz -sweep_unit omega_mx": "differs between samples .* -bonds_kmax says",
        "-network_file README.md": "a file holds one sample only; give several",
        "-network_file README.md,README.md": "-network_file: a file is named twice",
        "-network_file a*.h5,b.h5": "-network_file a.*: no file is called so, or matches it",
        "-network_file README.md,pyproject.toml -ensemble_samples 3": "-network_file lists 2",
        "-network_file README.md,pyproject.toml -sweep_unit omega_mx": "-sweep_unit omega_mx: diff",
        "-bonds_law file -bonds_file a.h5": "a file holds one only",
        "-ensemble_of modes -ranks_per_lattice 2": "scene modes has one rank for each lattice",
        "-ensemble_of sensitivity -ensemble_keep curves": "only response, modes, pulse have some",
        "-transport_depths 3,9": "needs responses or pulses",
        "-transport_depths 9,3 -ensemble_keep curves": "9 is not below 3",
        "-transport_depths 1,2,3,4 -ensemble_keep curves": "one window of depths is needed",
        "-statistics_windows .4,.5": "needs responses, -ensemble_keep curves",
        "-ensemble_keep curves -statistics_windows .4,.5,.6": "numbers given: 3",
        "-ensemble_keep curves -statistics_windows .4,.5 -ensemble_samples 7": "8 samples or more",
    },
}


def test_a_scene_is_missing():
    with pytest.raises(InputError, match="-scene is missing: choose accuracy, "):
        resolve(read_words(["-lattice_shape", "3,3"]))


@pytest.mark.parametrize(
    ("scene", "words", "said"),
    [(scene, words, said) for scene in REFUSED for words, said in REFUSED[scene].items()],
)
def test_refused(scene, words, said):
    with pytest.raises(InputError) as caught:
        resolve(read_words(["-scene", scene, *words.split()]))
    assert re.search(said, str(caught.value))
    assert "\n" not in str(caught.value)
