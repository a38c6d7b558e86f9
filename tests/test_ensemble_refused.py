"""Ensembles that are refused: options and values that contradict each other."""

import numpy as np
import pytest

import pgran
from pgran.command.resolve import resolve
from pgran.errors import InputError
from pgran.run.reading import read_words

LATTICE = {"shape": (5, 4)}
OMEGAS = np.linspace(0.3, 0.9, 25)

WRONG = {
    "-ensemble_of modes -detectors 2,2": "-detectors: -ensemble_of modes does not use it",
    "-ensemble_of pulse -sweep_points 9": "-sweep_points: -ensemble_of pulse does not use it",
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
    "-ensemble_keep curves -statistics_windows .5,.4": "0.5 is not below 0.4",
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
    ],
)
def test_wrong_values_in_python(of, given, said):
    given = {"samples": 5, "lattice": LATTICE} | given
    with pytest.raises(InputError, match=said):
        pgran.ensemble(of, **given)


def test_samples_of_another_size_are_refused():
    with pytest.raises(InputError, match="the sample of seed 5 is of another size"):
        pgran.ensemble(
            "modes", 3, seed=4, lattice=lambda seed: pgran.Lattice.random((3, 3 + seed % 2))
        )
