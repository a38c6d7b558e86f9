"""The table of the paper's figures and numbers, made by jobs/paper.sh from result files."""

import inspect
import re
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

PROJECT = Path(__file__).parents[1]
sys.path.append(str(PROJECT / "jobs"))

import paper  # noqa: E402
import paper_beads  # noqa: E402
import paper_loud  # noqa: E402
import paper_measures  # noqa: E402
import paper_table  # noqa: E402

FIGURES = (
    "exptime", "expfreq", "sprlat", "exactpl", "sprpic", "freqres", "phaseres", "modepic",
    "onefreq", "maxci", "cifreq", "timeres",
)  # fmt: skip
# what makes results that the table does without
APART = "`bash jobs/paper.sh --beads`", "`bash jobs/paper.sh --loud`"
# What is said instead of carried out.
STAND_INS = """
cd "$(dirname "${BASH_SOURCE[0]}")/.."
mpirun() { echo "${@:3}"; }
pgran() { echo "$@" >&3; [ "$1" != pack ] || echo "-detectors BALL"; }
python() {
  case $1 in
    jobs/paper_beads.py) echo beads_1_1_180 -detectors 7 -heat_samples 5 ;;
    jobs/paper_loud.py) echo loud_1_5_1 -detectors 7 ;;
  esac
}
exec 3>units
"""


@pytest.fixture
def commands(tmp_path):
    """What the script carries out: the words of each run, and of each `pgran units` and `pack`."""
    (tmp_path / "jobs").mkdir()
    shutil.copy(PROJECT / "jobs" / "paper.sh", tmp_path / "jobs")
    (tmp_path / "jobs" / "setup.sh").write_text(STAND_INS)
    runs = runs_of(tmp_path)
    others = [row.split() for row in (tmp_path / "units").read_text().splitlines()]
    return runs, *([row for row in others if row[0] == word] for word in ("units", "pack"))


def runs_of(folder, *words):
    """The words of each run that the script in a folder carries out."""
    words = ["bash", folder / "jobs" / "paper.sh", *words]
    said = subprocess.run(words, check=True, capture_output=True, text=True).stdout
    return [row.split() for row in said.splitlines() if row.startswith("pgran run")]


def test_heaters_in_packings_of_beads_are_a_step_of_their_own(commands, tmp_path):
    (run,) = runs_of(tmp_path, "--beads")
    words = "-detectors 7 -heat_samples 5 -output_file results/paper/beads_1_1_180.h5"
    expected = f"pgran run options/heater_packing.opts {words} -output_overwrite"
    assert run == expected.split()
    assert run[2] not in [words[2] for words in commands[0]]
    (run,) = runs_of(tmp_path, "--loud")
    assert run[2:6] == ["options/loud.opts", "-detectors", "7", "-output_file"]


SMALL = {
    "-lattice_shape": "8,8", "-detectors": "4,3", "-sweep_points": "141", "-relax_steps": "3200",
    "-ensemble_samples": "2", "-modes_detectors": "4,3", "-spectrum_fit_min": ".01",
}  # fmt: skip


@pytest.fixture
def folder(commands, call, tmp_path, monkeypatch):
    """The script's results, on small lattices."""
    monkeypatch.chdir(tmp_path)
    ball = {}
    for words in commands[2]:
        done = call(*["60" if word == "500" else word for word in words])
        ball[words[-1]] = done.stdout.split()[-1]
    for _, run, experiment, *words in commands[0]:
        words = [ball[words[words.index("-network_file") + 1]] if word == "BALL" else word
                 for word in words]  # fmt: skip
        words = [SMALL["-detectors"] if word.startswith("8,2,") else word for word in words]
        fixed = set(words) - (SMALL.keys() - {"-lattice_shape", "-detectors"})
        given = {*(PROJECT / experiment).read_text().split(), *words} - fixed
        fewer = [word for key in SMALL if key in given for word in (key, SMALL[key])]
        done = call(run, str(PROJECT / experiment), *words, *fewer, "-output_progress", "none")
        assert done.returncode in (0, 3), done.stderr
    for name, words in zip(("weight", "speed"), commands[1], strict=True):
        path = tmp_path / "results" / "paper" / f"units_{name}.txt"
        path.write_text(call(*words).stdout)
    return tmp_path / "results" / "paper"


def cells(text):
    """The rows of all tables: paper, found, from, by what."""
    rows = [re.split(r" (?<!\\)\| ", row[2:-2]) for row in text.splitlines() if row[:2] == "| "]
    assert all(len(row) == 5 for row in rows)
    return {row[0].replace("\\", ""): [*row[1:3], row[4]] for row in rows if row[0] != "what"}


def numbers(text):
    return [float(x) for x in re.findall(r"-?\d+\.?\d*(?:e[-+]\d+)?", text)]


def test_the_table_holds_what_the_files_hold(folder, here, monkeypatch):
    drawn = []
    monkeypatch.setattr(
        paper.figures,
        "save",
        lambda made, path: drawn.extend(f"paper/{path.stem}-{name}{path.suffix}" for name in made),
    )
    for stem, names in paper.drawings().items():
        paper.draw(folder, stem, names)
    assert paper.write(folder) == []
    text = folder.with_suffix(".md").read_text()
    titles = "\n".join(row for row in text.splitlines() if row.startswith("## "))
    assert all(re.search(rf"\b{name}\b", titles) for name in FIGURES)
    assert sorted(re.findall(r"!\[.*?\]\((.*?)\)", text)) == sorted(set(drawn))

    rows = cells(text)
    for _, found, files in rows.values():
        there = [
            (folder / name).exists() for name in files.split(", ") if name and name not in APART
        ]
        assert all(there)
        assert found.startswith("missing") == (files in APART)

    def says(name, expected, **tolerance):
        assert numbers(rows[name][1]) == pytest.approx(expected, **tolerance), name

    with h5py.File(folder / "response.h5") as file:
        response = file["response"]
        slope = [-response.attrs["phase_slope"][0], response.attrs["phase_slope_error"][0]]
        velocity = response.attrs["phase_velocity"][0]
        error = response.attrs["phase_velocity_error"][0]
        bound = max(response["error_bound"][:, 0] / response["amplitude"][:, 0])
    says("slope mu between .3 and 1, rad per omega_mx", slope, abs=0.06)
    says("phase velocity X/mu (phsvel, velobs), d omega_mx", [velocity, error], abs=1e-4)
    says("relative error of every amplitude", [bound], rel=0.05)
    name = "omega_mx that makes it the measured 57 m/s (expomx)"
    assert numbers(rows[name][1])[0] == pytest.approx(57 / (0.005 * velocity), rel=5e-3)
    with h5py.File(folder / "modes.h5") as file:
        says("modes above omega_mx, of all", [sum(file["modes/omega"][:] > 1), 64])
    with h5py.File(folder / "ensemble_modes.h5") as file:
        many = file["ensemble/above"][:]
    spread = [many.mean(), many.std(ddof=1), many.min(), many.max(), 2]
    says("modes above omega_mx over samples", spread, abs=0.06)
    with h5py.File(folder / "relaxation_long.h5") as file:
        psi = [file["spectrum"].attrs[name] for name in ("exponent_plain", "exponent_error")]
    says("exponent psi of S(f) ~ f^-psi, plain f", psi, abs=6e-4)
    with h5py.File(folder / "continuum_damped.h5") as file:
        size, omega = file["continuum/amplitude"][:], file["continuum/omega"][1:-1]
    first = omega[np.argmax((size[1:-1] > size[:-2]) & (size[1:-1] > size[2:]))]
    assert numbers(rows["simpfreq: which n2"][1])[-1] == pytest.approx(first, abs=6e-3)
    lines = (folder / "units_weight.txt").read_text().splitlines()
    (weight,) = (line for line in lines if "Hz" in line)
    name = "omega_mx under the weight of a bead (omxest)"
    assert numbers(rows[name][1])[0] == numbers(weight)[1]


def test_what_is_missing_is_said_in_a_line_each(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where no results of the user's are named instead
    assert paper.main(tmp_path / "paper") == 4
    rows = cells((tmp_path / "paper.md").read_text()).values()
    files = {name for row in rows for name in row[2].split(", ")} - {"", *APART}
    said = capsys.readouterr().err.splitlines()
    assert len(said) == len(files)
    for name in files:
        (row,) = (row for row in said if f"/{name}: " in row)
        assert row == f"paper: {tmp_path}/paper/{name}: No such file or directory"


def test_every_file_of_the_table_is_made_by_the_script(commands):
    made = {words[words.index("-output_file") + 1] for words in commands[0]}
    made = {Path(name).stem for name in made} | {"units_weight", "units_speed"}
    rows = [row for section in paper_table.SECTIONS for row in section.rows]
    used = {name for row in rows for name in inspect.signature(row.found).parameters}
    for stem in paper.drawings():
        used |= {*paper.TOGETHER.get(stem, [stem])}
    assert used - {"beads", "beads_*", "loud"} == made
    assert len({row.what for row in rows}) == len(rows)
    for words in commands[0]:
        assert (PROJECT / words[2]).exists()


def test_the_heater_in_packings_of_beads(tmp_path, call, capsys, monkeypatch):
    """Under two loads: the table has what the files hold, by loads, growths and distances."""
    monkeypatch.setattr(paper_beads, "HEATERS", 3)
    monkeypatch.setattr(paper_beads, "ProcessPoolExecutor", ThreadPoolExecutor)
    folder = tmp_path / "paper"
    paper_beads.main(folder, loads=(100, 300), seeds=(1,), balls=70)
    for line in capsys.readouterr().out.splitlines():
        name, *words = line.split()
        words += ["-sweep_omega", ".3,.7", "-output_file", f"{folder}/{name}.h5"]
        done = call("run", str(PROJECT / "options" / "heater_packing.opts"), *words)
        assert done.returncode == 0, done.stderr
    paper.draw(folder, "beads", ["growth"])
    assert (folder / "beads-growth.png").exists()
    paper.write(folder)
    rows = cells(folder.with_suffix(".md").read_text())
    mass, c = 2500 * np.pi * 5e-3**3 / 6, 4 / 3 * 70e9 / (2 * (1 - 0.22**2)) * 0.00125**0.5  # glass
    for weights, growth in ((100, 1000), (100, 180), (300, 1000)):
        with h5py.File(folder / f"beads_{weights}_1_{growth}.h5") as file:
            heat, network = file["heat"], file["network"]
            changes = abs(abs(heat["warmed"][:]) / abs(heat["displacement"][:][..., None]) - 1)
            overlap = np.mean(1.5 * network["force"][:] / network["stiffness"][:])
            expected = [np.median(changes), np.quantile(changes, 0.9), np.mean(changes >= 0.25)]
            expected += [growth * 1e-10 / 5e-3 / overlap, heat["opened"][:].mean()]
            centres, box = network["position"][:], [np.inf, *network.attrs["box"][1:]]
            away = centres[heat["ball"][:]] - centres[heat["detector"][:, 0]][:, None]
            away = np.linalg.norm(away - np.rint(away / box) * [0, *box[1:]], axis=2)
            groups = [changes[:, part] for part in (away < 2.5, (away >= 2.5) & (away < 5))]
            expected += [np.median(group) for group in groups if group.size]
        assert c * (5e-3 * overlap) ** 1.5 == pytest.approx(weights * mass * 9.81, rel=0.25)
        found = rows[f"+{growth} A, W = {weights}"][1]
        assert numbers(found) == pytest.approx([*expected, 3, 1, 0], rel=0.06)


def test_loud_sound_in_packings_of_beads(tmp_path, call, capsys, monkeypatch):
    """Two packings under a load: the table has medians and ranges of what the files hold."""
    monkeypatch.setattr(paper_loud, "ProcessPoolExecutor", ThreadPoolExecutor)
    monkeypatch.setitem(paper_loud.NM, 30, (1.6, 15))
    folder = tmp_path / "paper"
    paper_loud.main(folder, loads=(30,), seeds=(1, 2), balls=60)
    for line in capsys.readouterr().out.splitlines():
        name, *words = line.split()
        words += ["-loud_harmonics", "3", "-output_file", f"{folder}/{name}.h5"]
        done = call("run", str(PROJECT / "options" / "loud.opts"), *words)
        assert done.returncode in (0, 3), done.stderr
    for quality in (5, 20):
        first, middle, last, size, louder = [], [], [], [], []
        for seed in (1, 2):
            with h5py.File(folder / f"loud_30_{quality}_{seed}.h5") as file:
                loud, nm = file["loud"], 1e9 * file.attrs["units_length"]
                drive = nm * loud["drive"][0]
                assert drive == pytest.approx([1.6, 15], rel=1e-5)
                first.append(nm * loud["opening"][0, 0])
                middle.append(100 * loud["change"][0, 0])
                last.append(100 * loud["clapping"][0, -1])
                size.append(abs(loud["multiplier"][0, -1]))
                louder += [*drive[abs(loud["multiplier"][0]) > 1]]
                network = file["network"]
                Q = network["stiffness"][:].mean() / network.attrs["damping"]
                assert Q / loud["omega"][0] == pytest.approx(quality, rel=1e-4)
        paper.write(folder)
        rows = cells(folder.with_suffix(".md").read_text()).items()
        (found,) = (row[1] for name, row in rows if name.startswith(f"W = 30, Q = {quality}, "))
        found = [numbers(text) for text in found.split(";")]
        for values, shown in ((first, found[0]), (middle, found[3]), (last, found[4][-3:]),
                              (size, found[5])):  # fmt: skip
            expected = [np.median(values), min(values), max(values)]
            assert shown == pytest.approx(expected, rel=0.06)
        assert found[6][1:] == pytest.approx([2, min(louder)] if louder else [2], rel=0.06)


def test_where_a_change_becomes_small():
    """Of a square law, between amplitudes; not of what is small, or large, everywhere."""
    drive = np.array([1.0, 2.0, 5.0, 10.0])
    assert paper_loud.up_to(drive, 1e-3 * drive**2) == pytest.approx(10**0.5)
    assert np.isnan(paper_loud.up_to(drive, 1e-5 * drive**2))
    assert np.isnan(paper_loud.up_to(drive, drive**2))
    assert paper_loud.told([1.0, np.nan, 3.0]) == "2 (1 to 3, 1 without)"


def test_maxima_dips_and_widths():
    """Of a comb whose dips are 20 and 3 dB deep, and of a resonance."""
    omega = np.linspace(0.3, 1.0, 71)
    size = np.interp(omega, [0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 1.0], [0, 10, 0.5, 5, 3.54, 7, 0])
    curve = SimpleNamespace(omega=omega, amplitude=size[:, None])
    places, tops = paper_measures.maxima(curve, 0.3, 1.0)
    assert places == pytest.approx([0.4, 0.6, 0.8])
    assert list(tops) == [10, 5, 7]
    assert paper_measures.dips(curve) == pytest.approx([20, 3], abs=0.01)
    assert paper_measures.deep(SimpleNamespace(response=curve)) == [1]
    assert paper_measures.apart(0) == np.inf
    drive = np.linspace(0.5, 0.7, 20001)
    weak, strong = 1 / (drive - 0.61 - 0.03j), 5 / (drive - 0.6 - 0.01j)
    projection = SimpleNamespace(omega=drive, coefficient=np.stack([weak, strong], axis=1))
    assert paper_measures.width(projection) == pytest.approx(0.02, abs=2e-5)
    cut = SimpleNamespace(omega=drive[:10001], coefficient=projection.coefficient[:10001])
    assert np.isnan(paper_measures.width(cut))


def test_local_exponents():
    results = [
        SimpleNamespace(lattice=SimpleNamespace(damping=beta),
                        response=SimpleNamespace(phase_slope=[-3 / beta**0.5]))
        for beta in (0.001, 0.003, 0.03)
    ]  # fmt: skip
    assert paper_measures.local_exponents(*results) == pytest.approx([0.5] * (len(results) - 1))


def test_the_edge_and_the_deepest_dips():
    """Of a curve that falls tenfold a tenth above omega_mx = 2, and of the comb on two grids."""
    omega = np.linspace(0.0, 2.8, 2801)
    size = np.minimum(1.0, 10.0 ** (-10 * (omega / 2 - 1)))
    lattice, curve = SimpleNamespace(omega_mx=2.0), SimpleNamespace(omega=omega, amplitude=size)
    result = SimpleNamespace(response=curve, lattice=lattice)
    assert paper_measures.edge(result) == pytest.approx([1, 3], abs=0.03)
    size = np.where(np.arange(71) % 10 == 5, 0.1, 1.0) + np.arange(71) % 10 / 1e3
    comb = SimpleNamespace(omega=np.linspace(0.3, 0.999, 71), amplitude=size[:, None])
    comb.requested = np.arange(71) % 10 != 5
    found = paper_measures.deepest(SimpleNamespace(response=comb))
    assert found[:2] == pytest.approx([20 * np.log10(1.004 / 0.105)] * 2, abs=0.1)
    assert max(found[2:]) < 1
