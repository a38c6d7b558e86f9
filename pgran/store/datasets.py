"""The dataset of xarray that a record becomes."""

import numpy as np
import xarray


class Dataset(xarray.Dataset):
    """An xarray.Dataset whose files may hold complex numbers; without these they are netCDF."""

    __slots__ = ()

    def to_netcdf(self, *words, **choices):
        """See `xarray.Dataset.to_netcdf`; truth values among the attributes are 0 and 1."""
        truths = {name: int(x) for name, x in self.attrs.items() if isinstance(x, bool | np.bool_)}
        beyond = any(np.iscomplexobj(x) for x in self.variables.values())
        own = {"engine": "h5netcdf", "invalid_netcdf": beyond}
        return xarray.Dataset.to_netcdf(self.assign_attrs(truths), *words, **own | choices)
