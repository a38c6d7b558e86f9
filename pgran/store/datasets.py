"""The datasets of xarray that records become."""

from functools import partialmethod

import xarray


class Dataset(xarray.Dataset):
    """An xarray.Dataset whose files may hold complex numbers and truth values."""

    __slots__ = ()
    to_netcdf = partialmethod(xarray.Dataset.to_netcdf, engine="h5netcdf", invalid_netcdf=True)


def dataset(record, axes_of):
    """Return a record as a dataset; see `Record.to_xarray`."""
    variables, attributes = {}, {}
    for item, value in record.filled():
        if "axes" in item.metadata:
            meaning = {key: item.metadata[key] for key in ("units", "long_name")}
            variables[item.name] = xarray.Variable(axes_of(item, value), value, meaning)
        elif "part" not in item.metadata:
            attributes[item.name] = value
    return Dataset(variables, attrs=attributes)
