"""What others rely on in a result's file: its permissions, and coordinates on every axis."""

import os

import h5py
import pytest
from result_samples import ATTRIBUTES, KINDS, make, stored

from pgran.store import file as store


@pytest.mark.parametrize("mask", [0o022, 0o077, 0o002])
def test_who_may_read_it_is_for_the_users_mask_to_say(tmp_path, mask):
    before = os.umask(mask)
    try:
        store.write(tmp_path / "a.h5", ATTRIBUTES, [make(KINDS[0])])
    finally:
        os.umask(before)
    assert (tmp_path / "a.h5").stat().st_mode & 0o777 == 0o666 & ~mask


def test_every_axis_has_one_coordinate_of_its_length(tmp_path):
    """By HDF5's own dimension scales, each within the group or above it."""
    path, seen = stored(tmp_path / "a.h5"), []

    def check(name, data):
        if isinstance(data, h5py.Dataset):
            for axis, dimension in enumerate(data.dims):
                if h5py.h5ds.is_scale(data.id):
                    continue
                (scale,) = dimension.values()
                assert h5py.h5ds.is_scale(scale.id), name
                assert scale.shape == (data.shape[axis],), name
                seen.append(name)
            assert data.attrs["units"], name
            assert data.attrs["long_name"], name

    with h5py.File(path) as file:
        file.visititems(check)
    assert len(seen) > 100
