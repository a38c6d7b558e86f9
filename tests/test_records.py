"""What Python functions return, saved and loaded, drawn, in tables, and in a notebook."""

import dataclasses
import sys
import warnings
from functools import partial

import numpy as np
import pytest
from samples import UNIFORM, assert_same

import pgran
from pgran.foreign.tables import read_graph
from pgran.medium.crystals import crystal

LATTICE = pgran.Lattice.random((6, 5), damping=0.05, free=("y+",), mass=0.3, kmax=0.7)
PACKING = crystal("triangular", (4, 3), damping=0.1)
HEARD, OMEGAS, BOX = [(3, 2)], np.linspace(0.3, 0.9, 13), {"shape": (9, 4), "damping": 0.05}
FIRST, LINE = pgran.Lattice.random(**BOX), {"detectors": [(i, 2) for i in range(2, 7)]}
MANY = partial(pgran.ensemble, "response", 8, lattice=BOX, keep="curves", omegas=OMEGAS, **LINE)
CURVE = partial(pgran.sweep, LATTICE, OMEGAS, HEARD, fields=True)
MADE = {
    CURVE: LATTICE,
    partial(pgran.find_modes, PACKING, shapes=True): PACKING,
    partial(pgran.count_modes, PACKING, OMEGAS): PACKING,
    partial(pgran.project, LATTICE, OMEGAS): LATTICE,
    partial(pgran.relax, LATTICE, UNIFORM, 0.6, HEARD, steps=9): LATTICE,
    partial(pgran.pulse, LATTICE, HEARD, width=3.0, time=99.0, points=99): LATTICE,
    partial(pgran.sensitivity, LATTICE, OMEGAS[:2], HEARD): LATTICE,
    partial(pgran.heat, LATTICE, OMEGAS, HEARD, factor=1.1): LATTICE,
    partial(pgran.structure, LATTICE, 2, OMEGAS): LATTICE,
    partial(pgran.green, LATTICE, OMEGAS, HEARD): LATTICE,
    partial(pgran.continuum, OMEGAS): None,
    MANY: FIRST,
    lambda: pgran.statistics(MANY(), [(0.3, 0.9)]): FIRST,
    lambda: pgran.transport(FIRST, MANY()): FIRST,
    lambda: pgran.compare(CURVE(), CURVE(), [(0.35, 0.85)]): None,
}


@pytest.mark.parametrize("make", MADE)
def test_a_record_is_saved_and_loaded(make, shared_path):
    """Bit for bit, with its medium; file and record have the same figures."""
    record, path = make(), shared_path / "a.h5"
    record.save(path)
    result = pgran.load(path)
    again = getattr(result, record.group)
    assert_same(again, record, but=())
    medium = getattr(result, "medium", None)  # which is computed on like the first
    assert getattr(medium, "built", None) == MADE[make]
    assert [*pgran.plot(path)] == [*record.plot()] == [*again.plot()]
    with pytest.raises(pgran.PgranError, match="exists already; overwrite=True"):
        again.save(path)


def test_media_and_what_is_changed_by_hand(shared_path):
    path, changed = shared_path / "a.h5", dataclasses.replace(CURVE(), solve_seconds=1.0)
    for use in (lambda: changed.save(path), changed.plot, lambda: pgran.save([changed], path)):
        with pytest.raises(pgran.InputError, match=r"record.computed_on\(medium\)|save: a result"):
            use()
    changed.computed_on(LATTICE).save(path)
    assert pgran.load(path).medium.built == LATTICE
    with pytest.raises(pgran.InputError, match=r"field: shape .* is not .*x: 6, y: 5"):
        dataclasses.replace(changed, field=np.ones((2, 2))).computed_on(LATTICE)
    with pytest.raises(pgran.InputError, match="a medium or a record is needed, not"):
        changed.computed_on((6, 5))
    for number, medium in enumerate((LATTICE, PACKING)):
        medium.save(shared_path / f"{number}.h5")
        assert pgran.load(shared_path / f"{number}.h5") == medium


@pytest.mark.parametrize(
    ("package", "use"),
    [
        ("matplotlib", PACKING.plot),
        ("xarray", lambda: pgran.find_modes(PACKING).to_xarray()),
        ("pandas", lambda: pgran.find_modes(PACKING).to_dataframe()),
        ("pandas", lambda: pgran.table([PACKING])),
        ("meshio", lambda: pgran.export(PACKING, "a.vtu")),
        ("networkx", lambda: read_graph(__file__)),
    ],
)
def test_a_package_that_is_missing_is_said(monkeypatch, package, use):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(pgran.PgranError, match=f"needs {package}, which .* pip install {package},"):
        use()


@pytest.mark.filterwarnings("ignore:You are writing invalid netcdf")
def test_complex_numbers_in_tables(tmp_path):
    xarray, *_ = map(pytest.importorskip, ("xarray", "pandas", "h5netcdf"))
    found, path = CURVE(), tmp_path / "a.nc"
    found.to_xarray().isel(omega=slice(3)).to_netcdf(path)
    read = xarray.load_dataset(path, engine="h5netcdf")
    assert np.array_equal(read.field.values, found.field[:3])
    assert np.array_equal(found.to_dataframe()["displacement_3_2"], found.displacement[:, 0])
    with warnings.catch_warnings(action="error"):  # without them it is plain netCDF
        modes = pgran.find_modes(LATTICE)
        modes.to_xarray().to_netcdf(path)
    assert xarray.load_dataset(path).attrs["count_certified"] == modes.count_certified
    with pytest.raises(pgran.InputError, match=r"to_dataframe\('omega'\) or to_dataframe\('mid"):
        pgran.count_modes(LATTICE, OMEGAS).to_dataframe()


def test_in_a_notebook(clean_environment):
    """Tables and pictures without a magic command; of an error the user's own lines."""
    nbclient, nbformat, *_ = map(pytest.importorskip, ("nbclient", "nbformat", "ipykernel"))
    show = "import pgran; found = pgran.continuum([0.5, 1.0], progress='bar'); found"
    texts = show, "found.plot()", "found.plot()['exactpl']", "def f():\n    pgran.sound(3)\nf()"
    cells = nbformat.v4.new_notebook(cells=[*map(nbformat.v4.new_code_cell, texts)])
    client = nbclient.NotebookClient(cells, timeout=60, allow_errors=True)
    ran = client.execute(env=clean_environment).cells
    seen, drawn, one, failed = (cell.outputs[-1] for cell in ran)
    assert all("src='data:image/png" in each.data["text/html"] for each in (seen, drawn))
    assert "image/png" in one.data
    first, second, message = failed.traceback
    assert (first, second) == ("Cell In[4], line 3: f()", "Cell In[4], line 2: pgran.sound(3)")
    assert message.startswith("InputError: lattice")
