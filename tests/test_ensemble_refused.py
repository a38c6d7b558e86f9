"""Ensembles that there cannot be in Python; tests/test_contradictions.py has those of options."""

import pytest
from test_ensemble import LATTICE, OMEGAS, lattice_of

import pgran

pytestmark = pytest.mark.usefixtures("world")  # what all ranks call alike


@pytest.mark.parametrize(
    ("of", "given", "said"),
    [
        ("heat", {}, "choose response"),
        ("response", {"keep": "all"}, "choose measures"),
        ("response", {"samples": 1}, "1 is not >= 2"),
        ("response", {"seed": -1}, "bonds_seed"),
        ("relaxation", {"keep": "curves"}, "not relaxation"),
        ("modes", {"targets": [0.5], "count": 2}, "count cannot be kept"),
        ("response", {"fields": True}, "fields cannot be kept of each sample"),
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
    with pytest.raises(pgran.InputError, match=said):
        pgran.ensemble(of, **given)
