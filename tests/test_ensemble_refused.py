"""Ensembles that there cannot be, by options and in Python."""

import pytest
from test_ensemble import LATTICE, OMEGAS, lattice_of

import pgran
from pgran.command.resolve import resolve
from pgran.errors import InputError
from pgran.run.reading import read_words

pytestmark = pytest.mark.usefixtures("world")  # what all ranks call alike

WRONG = {
    "-ensemble_of modes -detectors 2,2": "-detectors: -ensemble_of modes does not use it",
    "-ensemble_of pulse -sweep_points 9": "-sweep_points: -ensemble_of pulse does not use it",
    "-bonds_law hertz -sweep_unit omega_mx": "differs between samples of hertz",
    "-network_file a.h5": "a file holds one only",
    "-bonds_law file -bonds_file a.h5": "a file holds one only",
    "-output_fields": "-output_fields: scene ensemble does not use it",
    "-sweep_resolve .1": "-sweep_resolve: scene ensemble does not use it",
    "-output_models": "-output_models: scene ensemble does not use it",
    "-ensemble_samples 1": "1 is not >= 2",
    "-ensemble_of heat": "choose response, modes",
    "-ensemble_of modes -ranks_per_lattice 2": "each lattice has one rank only",
    "-ensemble_of pulse -ensemble_keep curves": "of response and modes only, not of pulse",
    "-ensemble_of modes -modes_target .5 -modes_count 3": "-modes_target: scene ensemble does not",
    "-ensemble_of modes -modes_density 9": "-modes_density: scene ensemble does not",
    "-statistics_windows .4,.5": "needs -ensemble_of response and -ensemble_keep curves",
    "-ensemble_keep curves -statistics_windows .4,.5,.6": "so 3 numbers make none",
}


@pytest.mark.parametrize("text", WRONG)
def test_options_that_an_ensemble_cannot_have(text):
    with pytest.raises(InputError) as caught:
        resolve(read_words(f"-scene ensemble {text}".split()))
    assert WRONG[text] in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("of", "given", "said"),
    [
        ("heat", {}, "choose response"),
        ("response", {"keep": "all"}, "choose measures"),
        ("response", {"samples": 1}, "1 is not >= 2"),
        ("response", {"seed": -1}, "bonds_seed"),
        ("pulse", {"keep": "curves"}, "not of pulse"),
        ("modes", {"targets": [0.5], "count": 2}, "have no count"),
        ("response", {"fields": True}, "many samples have no fields"),
        ("response", {"lattice": LATTICE | {"seed": 3}}, "seed says which"),
        ("response", {"steps": 3}, "omegas"),
        ("modes", {"omegas": OMEGAS}, "omegas"),
        ("modes", {"lattice": 3}, "as a dict, a function of the seed, or a list .* not 3"),
        ("modes", {"lattice": lambda seed: seed / 0}, r"lattice\(1993\) fails: ZeroDivisionError"),
        ("modes", {"lattice": [lattice_of(1)] * 2}, "5 samples are asked for, 2 given"),
        (
            "modes",
            {"lattice": lambda seed: pgran.Lattice.random((3, 3 + (seed == 1995)))},
            "the sample of seed 1995 is of another size",
        ),
    ],
)
def test_wrong_values_in_python(of, given, said):
    given = {"samples": 5, "lattice": LATTICE} | given
    with pytest.raises(InputError, match=said):
        pgran.ensemble(of, **given)
