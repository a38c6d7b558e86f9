"""Captions of figures, and the command that writes them and says how wide figures are."""

from dataclasses import replace

import numpy as np
import pytest
from figure_results import LATTICE, ensemble, find_modes, listen, relax, respond, result_of
from samples import random_lattice

import pgran
from pgran import errors
from pgran.command.plot import run as plot
from pgran.draw import captions
from pgran.draw import pages as figures
from pgran.errors import FileError, InputError
from pgran.medium.crystals import crystal
from pgran.store.si import SI


def sample(result):
    return "; ".join(captions.sample(result, SI()))


def test_captions_say_the_numbers_of_the_record():
    result = respond(detectors=[(1, 1)])
    shown = result.response
    shown.converged_reason[7] = -3
    shown.at_floor[9] = 1
    shown.error_bound[[7, 9]] = 1.0
    shown.phase_slope[:], shown.phase_intercept[:] = -31.25, 0.0
    result.options = "-bonds_law uniform\n-bonds_kmin 0.0\n-bonds_kmax 0.25\n-bonds_seed 1993"
    good = ~np.isin(np.arange(260), [7, 9])
    largest = captions.number((shown.error_bound / shown.amplitude)[good].max())
    made = figures.make(result)
    everywhere = [r"a 4 $\times$ 3 lattice", "of mass 0.25", "uniform on [0, 0.25]; seed 1993",
                  r"$\beta$ = 0.003", r"$\omega_{mx}$ = 2", "heard at ball (1, 1)"]  # fmt: skip
    of_curves = [largest, "at the floor: 1 amplitude.", "1 of 260 amplitudes missed"]
    for name, figure in made.items():
        said = [part in figure.caption for part in everywhere + of_curves]
        assert said == [True] * 6 + [name != "bonds"] * 3, name
    assert f"{shown.phase_slope[0]:.4g}" in made["phase"].caption
    assert "low frequencies" in made["amplitude"].caption
    si = SI(time=1e-5)
    assert si.say("Hz", result.medium.omega_mx) in figures.make(result, si)["phase"].caption
    del result.options
    assert result.medium.bonds_sha256[:12] in sample(result)


def modes(**changed):
    return result_of(replace(find_modes().modes, residual=np.full(12, 3e-14), **changed))


def depends(bound):
    found = pgran.sensitivity(LATTICE, [0.5, 1.1], [(1, 1)])
    return result_of(replace(found, log_bound=np.full_like(found.log_bound, bound)))


def test_captions_say_how_large_errors_are():
    slope = r"of every derivative $d\,\ln|A| / d\,\ln k$: at most "
    for result, said in (
        (modes(), "12 of 12 normal modes, certified"),
        (modes(), r"residuals at most $3\times10^{-14}$"),
        (modes(count_certified=False), "not certified"),
        (depends(2.5e-9), slope + r"$2.5\times10^{-9}$ (proven)"),
        (listen(), "(proven)"),
        (respond(lattice=random_lattice((4, 3), damping=0.0)), "(certified)"),
    ):
        assert said in captions.bound(result)
    assert "derivative" not in captions.bound(depends(np.inf))
    assert captions.number(0.003) == "0.003"


def test_captions_say_which_networks_samples_and_detectors():
    net = crystal("triangular", (4, 3), periodic=(False, True))
    shown = result_of(pgran.find_modes(net), net)
    shown.options = "-network_file mine.h5"
    made = figures.make(shown)
    assert "dots" not in made["network"].caption  # nobody listens
    for part in ("the network mine.h5", f"{len(net.bond)} contacts", "vectors in 2 dimensions"):
        assert part in made["participation"].caption
    assert "; seeds 1993 to 2002; " in sample(ensemble())
    balls = [(x, y) for x in range(4) for y in range(2)]
    assert "(2, 1) and 2 more" in sample(respond([0.5], balls))


@pytest.mark.parametrize(
    ("law", "said"),
    [
        ("uniform", "uniform on [0.1, 0.25]; seed 7"),
        ("loguniform", "log-uniform on [0.1, 0.25]; seed 7"),
        ("bimodal", "0.25 with probability 0.3, else 0.1; seed 7"),
        ("constant", "all 0.25; SHA-256 of the bonds "),
        ("hertz", "with $c$ = 4, of exponential forces of mean 2; seed 7"),
        ("file", "read from my.h5; SHA-256 of the bonds "),
    ],
)
def test_captions_say_the_law_of_the_bonds(law, said):
    result = find_modes()
    given = {"law": law, "kmin": "0.1", "kmax": "0.25", "fraction": "0.3", "force": "2.0"}
    given |= {"hertz": "4.0", "file": "my.h5", "seed": "7"}
    result.options = "\n".join(f"-bonds_{name} {value}" for name, value in given.items())
    assert said in sample(result)


def test_the_command_has_a_width_and_captions(monkeypatch, tmp_path, capsys):
    result, target = relax(), tmp_path / "a.png"
    monkeypatch.setattr(pgran, "load", lambda path: result)
    assert plot(["a.h5", "-o", str(target), "-width", "100", "-caption"]) == errors.DONE
    written = [tmp_path / f"a-timeres.{ending}" for ending in ("png", "txt")]
    assert capsys.readouterr().out.splitlines() == [str(path) for path in written]
    made = pgran.plot(result, target, width=60, caption=True)
    assert made["timeres"].get_figwidth() == pytest.approx(60 / 25.4)
    assert pgran.plot(result)["timeres"].get_figwidth() == pytest.approx(85 / 25.4)
    assert written[1].read_text(encoding="utf-8") == made["timeres"].caption + "\n"
    for width, said in (("20", "a figure is 60 to 400 mm wide, not"), ("nan", "a figure is 60 to"),
                        ("wide", "wide is no number")):  # fmt: skip
        with pytest.raises(InputError, match=f"-width: {said}"):
            plot(["a.h5", "-width", width])
    written[1].unlink()
    written[1].mkdir()
    with pytest.raises(FileError, match=r"a-timeres\.txt: cannot be written"):
        pgran.plot(result, target, caption=True)


def test_a_caption_replaces_no_data(tmp_path):
    """Of the measurement that is drawn, if it is called like a figure."""
    data = tmp_path / "a-amplitude.txt"
    data.write_text("0.3 1.5\n0.4 1.2\n")
    with pytest.raises(InputError, match=r"a-amplitude\.txt: a caption would replace these data"):
        pgran.plot(respond(), tmp_path / "a.png", measured=data, caption=True)
    assert data.read_text() == "0.3 1.5\n0.4 1.2\n"
    assert [path.name for path in tmp_path.iterdir()] == [data.name]
