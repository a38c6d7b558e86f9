"""Networks on disk: five lines write one, and what is wrong or damaged is refused."""

import re

import h5py
import numpy as np
import pytest
from packing_samples import Sample, bring

from pgran.errors import FileError, InputError
from pgran.medium.network_file import read_network


def five_lines(path, attributes=(), **members):
    with h5py.File(path, "w") as file:
        for name, value in members.items():
            file[f"network/{name}"] = value
        file.require_group("network").attrs.update(attributes)
    return path


SPRINGS = {"bond": [[0, 1], [1, 2]], "stiffness": [1.0, 2.0], "mass": [1, 2, 3]}


def test_five_lines_write_a_network(tmp_path):
    """Read by a process of its own first; what is missing follows from what is there."""
    network = read_network(five_lines(tmp_path / "a.h5", **SPRINGS))
    assert (network.displacement, network.held.tolist()) == ("scalar", [0, 0, 0])
    place = [[0, 0], [0, 1], [2, 1]]
    made = {"direction": "y", "kmax": 7}
    path = five_lines(tmp_path / "b.h5", made, position=place, held=[2, 0, 0], **SPRINGS)
    network = read_network(path, damping=0.125)
    assert (network.displacement, network.kmax, network.damping) == ("vector", 7, 0.125)
    np.testing.assert_array_equal(network.normal, [[0, 1], [1, 0]])
    np.testing.assert_array_equal(network.direction, [0, 1])
    assert read_network(path, displacement="scalar").axes == 1
    with pytest.raises(InputError):
        read_network(path, damping=-1)


@pytest.mark.parametrize(
    ("members", "attributes", "said"),
    [
        ({"bond": None}, {}, "/network/bond is missing"),
        ({"stiffness": None}, {}, "/network/stiffness is missing"),
        ({"mass": None}, {}, "does not say how many balls"),
        ({"masses": [1, 2, 3], "mass": None}, {}, "masses is not known; is the dataset mass of"),
        ({}, {"dampin": 1.0}, "is the attribute damping of"),
        ({}, {"damping": "much"}, "network: damping: real numbers are needed"),
        ({}, {"displacement": 1}, "network: displacement: 1 is none of"),
        ({}, {"displacement": "tensor"}, "'tensor' is none of"),
        ({"normal": [[1, 0], [1, 0]]}, {"direction": "z"}, "choose x, y, or 2 components, not 'z'"),
        ({"damping": 1.0}, {}, "is the attribute damping of /network"),
        ({"Drag": [1, 1, 1]}, {}, "/network/Drag is not known; is the dataset drag of"),
        ({}, {"LOSS": 1.0}, "is the dataset loss of /network"),
        ({}, {"loss": [0.1, 0.1]}, "is the dataset loss of /network"),
        ({}, {"damping": np.array(["1"], "S1")}, "/network/damping is no text, number or list"),
        ({}, {"kmax": h5py.Empty("f8")}, "/network/kmax is no text, number or list"),
        ({"friction": [0.5, 0.5]}, {}, "/network/friction is not known; others' data"),
        ({}, {"friction": 0.5}, "/network/friction is not known; others' data"),
        ({"bond": [[0.5, 1], [1, 2]]}, {}, "/network/bond holds no integers"),
        ({"bond": 3}, {}, "bond"),
        ({"stiffness": [1.0]}, {}, "stiffness: shape (1,) is not (2,)"),
        ({"mass": ["a", "b", "c"]}, {}, "/network/mass"),
        ({"held": 0}, {}, "held"),
        ({}, {"damped": [1.0, 2.0]}, "network: damped"),
        ({"normal": [[1, 0], [1, 1]]}, {}, "length 1"),
        ({"stiffness": h5py.SoftLink("/network/mass")}, {}, "is a link"),
    ],
)
def test_refused_networks(tmp_path, here, members, attributes, said):
    values = {k: v for k, v in (SPRINGS | members).items() if v is not None}
    path = five_lines(tmp_path / "a.h5", attributes, **values)
    with pytest.raises(FileError, match=re.escape(said)) as caught:
        read_network(path)
    assert str(caught.value).startswith(str(path))


def test_beside_the_network(tmp_path, here):
    """What others add stays; what is of the network, or of a later version, is refused."""
    path = five_lines(tmp_path / "a.h5", {"comment": "mine", "_Netcdf4Dimid": 1}, **SPRINGS)
    with h5py.File(path, "r+") as file:
        file.attrs.update(_NCProperties="version=2", title="a", id="b", seconds=1.0)
        file["others/drag"], file["time"], file["network/ball"] = [1], [1], [0, 1, 2]
        file["network/ball"].make_scale("ball")
        file["network/mass"].dims[0].attach_scale(file["network/ball"])
    assert read_network(path).masses.tolist() == [1, 2, 3]
    for name, said in (
        ("drag", "/drag is not known; is the dataset drag of /network"),
        ("Damping", "/Damping is not known; is the attribute damping of"),
        ("format_version", "format version 99; this pgran reads 1 to 1"),
    ):
        with h5py.File(path, "r+") as file:
            (file if name == "drag" else file.attrs)[name] = 99
        with pytest.raises(FileError, match=said):
            read_network(path)
        with h5py.File(path, "r+") as file:
            del (file if name == "drag" else file.attrs)[name]


def test_a_chunk_that_is_larger_than_all_data(tmp_path, here):
    """HDF5 would take its memory for three numbers."""
    path = five_lines(tmp_path / "a.h5", **{k: v for k, v in SPRINGS.items() if k != "mass"})
    with h5py.File(path, "r+") as file:
        file.create_dataset("network/mass", (3,), float, maxshape=(None,), chunks=(2**24,))
    with pytest.raises(FileError, match=r"/network/mass of shape \(3,\) declares far more"):
        read_network(path)


def test_a_damaged_packing_has_checksums(call, place, shared_path, here):
    """Wherever a bit flips that h5py reads, it is found: the network is the same or refused."""
    sample, rng = Sample(2), np.random.default_rng(1)
    sample.write(place)
    bring(call, "--law", "hertz")
    network, content = read_network("n.h5"), (shared_path / "n.h5").read_bytes()
    refused = 0
    for place in rng.integers(0, len(content), 60):
        bad = bytearray(content)
        bad[place] ^= 1 << rng.integers(8)
        (shared_path / "n.h5").write_bytes(bad)
        try:
            assert read_network("n.h5").bonds_sha256 == network.bonds_sha256
        except FileError:
            refused += 1
    assert refused > 10


def test_damaged_networks(tmp_path):
    path = five_lines(tmp_path / "a.h5", **SPRINGS)
    content = path.read_bytes()
    for bad in (b"garbage", content[:900] + bytes(800)):
        path.write_bytes(bad)
        with pytest.raises(FileError):
            read_network(path)


def test_a_direction_is_of_vectors_and_distances_are_not_changed(tmp_path):
    """Of a scalar network what the file says of vectors is left out; what is handed in is not."""
    vectors = SPRINGS | {"position": [[0, 0], [0, 1], [2, 1]]}
    path = five_lines(tmp_path / "a.h5", {"displacement": "vector", "direction": "y"}, **vectors)
    with pytest.raises(ValueError, match="read-only"):
        read_network(path).distance[0] = 9.0
    assert read_network(path, displacement="scalar").displacement == "scalar"
    with pytest.raises(InputError, match="direction"):
        read_network(path, displacement="scalar", direction=[1, 0])
