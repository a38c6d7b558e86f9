"""Exports, read back by other means: meshio, and NumPy's reader of tables."""

import dataclasses
import importlib.util
import sys
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
from result_samples import no_room_beyond
from samples import random_lattice
from scipy.linalg import eigh, solve
from scipy.sparse import csr_matrix
from test_light_balls import light_chain

import pgran
from pgran import __main__ as program
from pgran.errors import FileError, InputError, PgranError
from pgran.experiments.relaxation import fluctuations
from pgran.medium.base import record_of
from pgran.medium.crystals import crystal
from pgran.store import file as store
from pgran.store.record import Result


def result_of(record, medium=None):
    return Result([record_of(medium), record] if medium else [record], scene=record.group)


def packing(displacement="vector", **others):
    """A periodic strip of discs of random masses and stiffness."""
    rng = np.random.default_rng(4)
    net = crystal("triangular", (4, 3), periodic=(False, True), displacement="rotations")
    given = {"stiffness": rng.uniform(0.5, 1, net.bonds)}
    given |= {"masses": rng.uniform(0.5, 2, len(net.held)), "median_mass": None, "kmax": None}
    given["tangential"] = rng.uniform(0.1, 0.4, net.bonds)
    return dataclasses.replace(net, displacement=displacement, **given | others)


def read_mesh(result, path):
    """What meshio reads of an export: points, lines, data of points and of lines."""
    meshio = pytest.importorskip("meshio")
    pgran.export(result, path)
    mesh = meshio.read(path)
    ((kind, lines),) = [(cells.type, cells.data) for cells in mesh.cells]
    assert kind == "line"
    return mesh.points, lines, mesh.point_data, {k: v for k, (v,) in mesh.cell_data.items()}


def assert_columns(path, expected):
    """A table has these columns, to the last digit."""
    table = np.genfromtxt(path, delimiter=",", names=True, encoding="utf-8")
    for name, values in expected.items():
        assert np.array_equal(table[name], values, equal_nan=True), name
    return table.dtype.names


def parts(name, values):
    """The columns of complex numbers."""
    return {f"{name}_real": values.real, f"{name}_imag": values.imag}


def unbalanced(balls, lines, u, omega, pull):
    """What Newton's law leaves at the free balls where contacts pull their ends together."""
    force = balls["mass"].reshape(-1, *[1] * (u.ndim - 1)) * omega**2 * u
    np.add.at(force, lines[:, 0], pull)
    np.add.at(force, lines[:, 1], -pull)
    return force[balls["held"] == 0]


def test_exported_modes_obey_newtons_law(tmp_path):
    """The file says all: masses, contacts, normals, constants; held balls are at rest."""
    net = packing(tangential=None)
    found = pgran.find_modes(net, shapes=True)
    points, lines, balls, contacts = read_mesh(result_of(found, net), tmp_path / "new" / "m.vtu")
    assert np.array_equal(points[:, :2], net.position)
    assert not points[:, 2].any()
    assert np.array_equal(balls["held"], net.held)
    assert np.array_equal(balls["radius"], net.radius)
    i, j = lines.T
    wraps = np.abs(points[i, 1] - points[j, 1]) > 1.5
    assert np.array_equal(contacts["crosses"], wraps)
    assert sum(name.startswith("mode_") for name in balls) == len(found.omega)
    for number, omega in enumerate(found.omega, 1):
        u = balls[f"mode_{number:04}"]
        n = contacts["normal"]
        pull = (contacts["stiffness"] * np.sum(n * (u[j] - u[i]), axis=1))[:, None] * n
        assert not u[balls["held"] > 0].any()
        assert unbalanced(balls, lines, u, omega, pull) == pytest.approx(0, abs=1e-12)
        assert np.sum(balls["mass"][:, None] * u**2) == pytest.approx(net.mass)


MEDIA = {  # of the component that is read; with drag, power laws, loss, a push, light balls
    "u": lambda: pgran.with_source(random_lattice((4, 3), damping=0.1), balls=[1, 1]),
    "u3": lambda: pgran.Lattice.random((3, 2, 2), free=("y+",), damping_power=0.5, drag=0.1),
    "u light": lambda: light_chain(1e-14, 4, 2e-16),
    "x": lambda: packing(force=np.full(48, 0.02), damping_power=0.5, damped="normal"),
    "y": lambda: packing("rotations", component="y", drag=0.02, loss=0.1),
}


@pytest.mark.parametrize("name", MEDIA)
def test_matrices_have_the_modes_and_the_steady_states(world, tmp_path, name):
    """In their file: K u = omega^2 M u, u^T M u = m, and S u = f."""
    net = MEDIA[name]()
    with np.load(*pgran.export(net, tmp_path / "a.npz")) as f:
        unknowns, force = f["unknowns"], f["f_K"] + 0.7j * f["f_C"]
        entries = [(f[X], (f[f"{X}_row"], f[f"{X}_column"])) for X in "KCM"]
    K, C, M = (csr_matrix(each, 2 * unknowns.shape).toarray() for each in entries)
    assert all(np.array_equal(X, X.T) for X in (K, C, M))
    modes = pgran.find_modes(net, shapes=True)
    squares = eigh(K.real, M, eigvals_only=True)
    assert modes.omega * abs(modes.omega) == pytest.approx(squares, rel=1e-9, abs=1e-12)
    u = modes.displacements(net)
    u = (u if net.is_grid else u[:, net.free]).reshape(len(u), -1).T
    for X, values in ((M, np.ones(len(u))), (K.real, squares)):
        assert u.T @ X @ u == pytest.approx(net.mass * np.diag(values), abs=1e-9)
    ball, exact = unknowns["ball"][len(u) // 2], solve(K + 0.7j * C - 0.49 * M, force)
    site = np.unravel_index(ball, net.shape) if net.is_grid else [ball]
    found = pgran.sweep(net, [0.7], site, fields=True, error_tolerance=1e-10, method="points")
    assert found.field.ravel() == pytest.approx(exact, rel=1e-8)
    read = (unknowns["ball"] == ball) & (unknowns["component"] == name[0])
    assert exact[read] == pytest.approx(found.displacement[0], rel=1e-8)
    with pytest.raises(PgranError, match="modes of this medium, with shapes"):
        pgran.find_modes(net).displacements(net)


@pytest.mark.parametrize("shape", [(5,), (4, 3), (3, 2, 2)])
def test_the_exported_response_of_a_lattice_obeys_newtons_law(tmp_path, shape):
    """Walls included: what moves by 1 is the driven one."""
    lattice = random_lattice(shape, damping=0.1)
    omegas = np.array([0.3, 0.6])
    found = pgran.sweep(lattice, omegas, [0] * len(shape), fields=True, error_tolerance=1e-10,
                        method="points")  # fmt: skip
    points, lines, balls, bonds = read_mesh(result_of(found, lattice), tmp_path / "r.vtu")
    assert len(lines) == lattice.bonds
    i, j = lines.T
    assert np.linalg.norm(points[i] - points[j], axis=1) == pytest.approx(1)
    free, driven = balls["held"] == 0, balls["held"] == 2
    assert np.count_nonzero(free) == lattice.size
    assert np.array_equal(driven, points[:, 0] == shape[0])
    assert not balls["mass"][~free].any()
    for number, omega in enumerate(omegas, 1):
        name = f"response_{number:04}"
        u = balls[f"{name}_real"] + 1j * balls[f"{name}_imag"]
        assert np.all(u[driven] == 1)
        assert not u[~free & ~driven].any()
        pull = (bonds["stiffness"] + 1j * omega * lattice.damping) * (u[j] - u[i])
        assert unbalanced(balls, lines, u, omega, pull) == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("displacement", ["vector", "rotations"])
def test_exported_fields_of_a_pulse(tmp_path, displacement):
    net = packing(displacement, direction=[0.6, 0.8])
    sent = {"width": 3.0, "omega": 0.5, "time": 40.0, "points": 61, "fields": True}
    found = pgran.pulse(net, [int(net.free[5])], **sent)
    _, _, balls, contacts = read_mesh(result_of(found, net), tmp_path / "p.vtu")
    assert np.array_equal(contacts["tangential"], net.tangential)
    for number, time in enumerate(found.field_time):
        u = balls[f"field_{number + 1:04}"]
        wall = np.interp(time, found.time, found.wall)
        assert u[net.held == 2] == pytest.approx(
            np.tile([0.6 * wall, 0.8 * wall, 0], (np.count_nonzero(net.held == 2), 1))
        )
        components = found.field[number].reshape(len(net.free), -1)
        assert np.array_equal(u[net.free, :2], components[:, :2])
        turned = balls.get(f"field_{number + 1:04}_rotation")
        assert (turned is None) == (displacement == "vector")
        if turned is not None:
            assert np.array_equal(turned[net.free, 2], components[:, 2])
            assert not turned[:, :2].any()
    pgran.export(result_of(found, net), tmp_path / "p.pvd")
    listed = ElementTree.parse(tmp_path / "p.pvd").findall(".//DataSet")
    assert [float(each.get("timestep")) for each in listed] == found.field_time.tolist()
    for number, each in enumerate(listed, 1):
        alone = pytest.importorskip("meshio").read(tmp_path / each.get("file")).point_data
        assert np.array_equal(alone["displacement"], balls[f"field_{number:04}"])


@pytest.mark.parametrize("displacement", ["vector", "rotations", "lattice"])
def test_ovito_reads_chosen_modes(tmp_path, displacement):
    """By its own names what the VTK file holds, a frame a mode; and the contacts as bonds."""
    ovito = pytest.importorskip("ovito.io", reason="no reader of OVITO's: pip install ovito")
    lattice = displacement == "lattice"
    net = random_lattice((4, 3)) if lattice else packing(displacement, box=[0, 4.5])
    result = result_of(pgran.find_modes(net, shapes=True), net)
    points, lines, balls, bonds = read_mesh(result, tmp_path / "a.vtu")
    moves = {".xyz": ["Displacement", "rotation"], ".dump": ["Velocity", "Angular Velocity"]}
    for ending, (move, turn) in moves.items():
        path, *others = pgran.export(result, tmp_path / f"a{ending}", modes=[3, 0])
        assert not (tmp_path / "a.data").exists()  # the user's own
        frames = ovito.import_file(path)
        assert frames.num_frames == 2
        for n, mode in enumerate([3, 0]):
            found, name = frames.compute(n), f"mode_{mode + 1:04}"
            names = {"amplitude" if lattice else move: name, turn: f"{name}_rotation"}
            for theirs, ours in (names | {"Mass": "mass", "Radius": "radius"}).items():
                if ours in balls:
                    assert found.particles[theirs][...] == pytest.approx(balls[ours], rel=1e-14)
            assert found.particles.positions[...] == pytest.approx(points, rel=1e-14)
            assert tuple(found.cell.pbc) == (False, not lattice, False)
            kinds = found.particles.particle_types
            named = [kinds.type_by_id(kind).name or str(kind) for kind in kinds[...]]
            species = ["free", "rest", "driven"] if ending == ".xyz" else ["1", "2", "3"]
            assert named == [species[held] for held in balls["held"].tolist()]
            omega = found.attributes.get("omega", result.modes.omega[mode])
            assert omega == pytest.approx(result.modes.omega[mode])
    if not lattice:
        found = ovito.import_file(others[0]).compute().particles.bonds
        assert np.array_equal(found.topology[...], lines)
        assert np.array_equal(np.any(found.pbc_vectors[...], axis=1), bonds["crosses"])


@pytest.mark.parametrize("most", [0, 6])
def test_what_flows_into_an_exported_ball_is_lost_in_its_bonds(tmp_path, most):
    """Half of a bond's loss at each end; derivatives where they are kept; no failed frequency."""
    lattice = random_lattice((4, 3), damping=0.1)
    found = pgran.sensitivity(lattice, [0.3, 0.6], [(1, 1)], most=most)
    found.converged_reason[0] = 0
    result = result_of(found, lattice)
    _, lines, balls, bonds = read_mesh(result, tmp_path / "s.vtu")
    names = {name for name in bonds if "_0" in name}
    assert names == {"log_amplitude_0002_1_1", "flux_0002", "loss_0002"}
    i, j = lines.T
    flux, lost = bonds["flux_0002"], 0.5 * bonds["loss_0002"]
    balance = np.zeros(len(balls["held"]))
    for end, flows in ((i, -flux), (j, flux)):
        np.add.at(balance, end, flows - lost)
    assert balance[balls["held"] == 0] == pytest.approx(0, abs=1e-6 * np.abs(flux).max())
    slopes = bonds["log_amplitude_0002_1_1"]
    assert np.count_nonzero(np.isfinite(slopes)) == (most or lattice.bonds)
    assert np.nanmax(np.abs(slopes)) == np.abs(found.log_amplitude[1, 0]).max()


@pytest.mark.parametrize("medium", ["lattice", "network"])
def test_tables_of_scenes(tmp_path, medium):
    net = packing() if medium == "network" else random_lattice((4, 3))
    sites = [[int(ball)] for ball in net.free[[3, 8]]] if medium == "network" else [[1, 1], [3, 0]]
    names, path = ["_".join(map(str, site)) for site in sites], tmp_path / "a.csv"
    found = pgran.sweep(net, np.linspace(0.1, 1, 7), np.ravel(sites), method="points")
    expected = {"omega": found.omega, "converged_reason": found.converged_reason}
    expected |= parts("force", found.force)
    for d, name in enumerate(names):
        expected |= parts(f"displacement_{name}", found.displacement[:, d])
        expected |= {f"delay_{name}": found.delay[:, d]}
    assert pgran.export(result_of(found, net), path) == [path]
    assert_columns(path, expected)
    sent = {"width": 3.0, "omega": 0.5, "time": 40.0, "points": 61}
    heard = pgran.pulse(net, np.ravel(sites), fields=True, **sent)
    speeds = {f"velocity_{name}": heard.velocity[:, d] for d, name in enumerate(names)}
    assert pgran.export(result_of(heard, net), path) == [path]
    assert_columns(path, {"time": heard.time, "wall": heard.wall} | speeds)
    modes = pgran.find_modes(net)
    assert pgran.export(result_of(modes, net), path) == [path]
    names = assert_columns(path, {"participation": modes.participation})
    proven = ("omega_bound",) * (medium == "network")
    assert names == ("omega", "residual", "participation", *proven, "width", "source")


def test_tables_of_several_axes(tmp_path):
    """Of the scene and of what was measured beside it; long, where arrays have several axes."""
    lattice, law = random_lattice((4, 3), damping=0.05), pgran.BondLaw("uniform")
    found = pgran.relax(lattice, law, 0.6, [(1, 1), (2, 0)], steps=2100)
    records = fluctuations.measured(found, fluctuations.FIT, lattice.bonds)
    relaxation = Result([record_of(lattice), *records], scene="relaxation")
    omegas = [0.3, 0.6]
    warm = pgran.heat(lattice, omegas, [(1, 1)], factor=1.1)
    counts = pgran.count_modes(lattice, np.linspace(0.2, 1.0, 5))
    states = {"state": np.arange(2101), **parts("displacement_2_0", found.displacement[0, :, 1])}
    balls = {"omega": np.repeat(omegas, 12), "ball": np.tile(warm.ball, 2)}
    balls |= parts("warmed_1_1", warm.warmed[:, 0].ravel())
    for result, tables in (
        (relaxation, {"a": {"stiffness": found.stiffness[0],
                            "bond_index_1": found.bond_index[0, :, 1]},
                      "a-trajectory-state": states,
                      "a-spectrum": {"power": records[1].power},
                      "a-memory": {"correlation": records[2].correlation}}),
        (result_of(warm, lattice), {"a": {}, "a-omega-ball": balls}),
        (result_of(counts, lattice), {"a": {"count": counts.count},
                                      "a-middle": {"density": counts.density}}),
    ):  # fmt: skip
        paths = pgran.export(result, tmp_path / "a.csv")
        assert [path.stem for path in paths] == [*tables]
        for path, expected in zip(paths, tables.values(), strict=True):
            assert_columns(path, expected)


def test_the_command(tmp_path, capsys):
    net = packing()
    found, path = pgran.find_modes(net, shapes=True), tmp_path / "modes.h5"
    records = [record_of(net), found]
    store.write(path, {"scene": "modes", "bonds_sha256": net.bonds_sha256}, records)
    for ending in ("csv", "VTU") if importlib.util.find_spec("meshio") else ("csv",):
        output = tmp_path / f"out.{ending}"
        assert program.main(["export", str(path), str(output)]) == 0
        assert capsys.readouterr().out == f"{output}\n"
        assert output.stat().st_size > 100
    assert "pgran export" in program.USAGE
    words = ["export", str(path), str(tmp_path / "a.xyz"), "--modes"]
    assert program.main([*words, "7,0:3"]) == 0
    assert (tmp_path / "a.xyz").read_text().count("omega=") == 4
    for wrong, said in (("0:30", "24 is none of the 24 that"), ("7;0", "--modes: 7;0 is no list")):
        with pytest.raises(InputError, match=said):
            program.main([*words, wrong])


@pytest.mark.parametrize("ending", ["csv", "vtu"])
def test_no_room_for_an_export(tmp_path, ending):
    """What was there stays, and nothing beside it."""
    pytest.importorskip("meshio")
    net, path = packing("vector"), tmp_path / f"a.{ending}"
    path.write_bytes(b"earlier")
    modes = result_of(pgran.find_modes(net), net)
    with no_room_beyond(100, path.name):
        pgran.export(modes, path)
    assert path.read_bytes() == b"earlier"
    assert [*tmp_path.iterdir()] == [path]


def test_refusals(tmp_path, monkeypatch):
    lost = ("position", "normal", "distance", "tangential", "radius", "direction", "box")
    net = packing("scalar", **dict.fromkeys(lost))
    modes = result_of(pgran.find_modes(net), net)
    box = pgran.continuum(np.linspace(0.3, 3, 5), point=(0.15, 0.52), size=(1 / 3, 1.0))
    (tmp_path / "file").touch()
    with pytest.raises(FileError, match=r"ends in one of \.vtu, \.pvd"):
        pgran.export(modes, tmp_path / "a.png")
    with pytest.raises(InputError, match=r"chosen for \.vtu, \.pvd, \.xyz, \.dump, not for \.csv"):
        pgran.export(modes, tmp_path / "a.csv", modes=[0])
    with pytest.raises(InputError, match="modes: none is chosen"):
        pgran.export(packing(), tmp_path / "a.xyz", modes=[])
    with pytest.raises(FileError, match=r"no table in this result .scene network"):
        pgran.export(net, tmp_path / "a.csv")
    with pytest.raises(FileError, match=r"a\.csv: cannot be written"):
        pgran.export(modes, tmp_path / "file" / "a.csv")
    monkeypatch.setitem(sys.modules, "meshio", SimpleNamespace())
    with pytest.raises(FileError, match="no positions"):
        pgran.export(modes, tmp_path / "a.vtu")
    with pytest.raises(FileError, match=r"no balls in this result .scene continuum"):
        pgran.export(result_of(box), tmp_path / "a.vtu")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
