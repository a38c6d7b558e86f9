"""What every record is: a frozen dataclass whose fields declare what they hold.

The declaration of an array says what it is, its unit, its type and its axes. Files, checks and
xarray follow from it. An axis is named after the array that holds its coordinates, an array of one
axis, or counts from 0. `balls` stands for the axes of the lattice, `bonds_x` for those of the bonds
along x. An array without axes is a coordinate itself.
"""

import dataclasses
import reprlib
from dataclasses import dataclass
from types import MappingProxyType, UnionType
from typing import get_args

import numpy as np

from pgran.catalogue import EXPERIMENTS
from pgran.errors import FileError, InputError, needed

SPACE = "xyz"
# Kinds of NumPy's types, what a file may hold instead of each, and what to call it.
KINDS = {
    "f": ("fiu", "real number"),
    "c": ("c", "complex number"),
    "i": ("iu", "integer"),
    "b": ("biu", "truth value"),
    "U": ("U", "text"),
}
ERROR = "its standard error"
DATASETS = "pgran.store.datasets"  # which imports xarray


def attribute(long_name, units="", since=1, optional=False, **said):
    """Declare a plain value that files have since some version of their format, or may have.

    What a file may have is None in a record unless it is given, by its name.
    """
    said |= {"long_name": long_name, "units": units}
    return dataclasses.field(
        metadata=said | {"since": since, "optional": optional},
        default=None if optional else dataclasses.MISSING,
        kw_only=optional,
    )


def attribute_array(long_name, units, *along, since=1, optional=False):
    """Declare a short array of real numbers: an attribute of its group."""
    return attribute(long_name, units, since, optional, along=along, dtype=float)


def array(long_name, units, *axes, dtype=float, since=1, optional=False, row=False):
    """Declare an array: a dataset of a file, with its axes (None for a coordinate).

    Files have it `since` a version of their format, and it is None in a record of an older one; an
    `optional` array may be missing in any. With `row` ranks compute it, one entry of the first axis
    after the other: see `row_of`.
    """
    return attribute(long_name, units, since, optional, axes=axes, dtype=dtype, row=row)


def error_of(measured, meaning=ERROR):
    """Declare the error of an array that is declared, or a bound of it."""
    facts = measured.metadata
    same = {name: facts[name] for name in ("since", "optional", "row")}
    return array(meaning, facts["units"], *facts["axes"], **same)


def part(kind):
    """Declare a record within a record, a group within its group, which may be missing."""
    return dataclasses.field(default=None, metadata={"part": kind})


def row_of(kind, without=(), **lengths):
    """Return the fields of a row that ranks send: a record's arrays without their first axis.

    Those of its arrays count that are declared with `row`, but for some optional ones. `lengths`
    are the shapes along the other axes by name; `balls` may be several.
    """
    row = []
    for item in dataclasses.fields(kind):
        if item.metadata.get("row") and item.name not in without:
            axes = item.metadata["axes"][1:]
            for axis in [axis for axis in axes if axis not in lengths]:
                said = f"no length of its axis {axis}: row_of({kind.__name__}, {axis}=(n,))"
                raise TypeError(f"{kind.__name__}.{item.name}: {said}")
            shape = sum((lengths[axis] for axis in axes), ())
            row.append((item.name, item.metadata["dtype"], shape))
    return row


def columns_of(kind, rows):
    """Return the arrays of a record that rows hold, by name, each in one piece."""
    names = [item.name for item in dataclasses.fields(kind) if item.metadata.get("row")]
    return {name: rows[name].copy() for name in names if name in rows.dtype.names}


def axes_of(item, value, dimensions=None):
    """Return the name of each axis of a field's array, in a lattice of so many dimensions.

    By default these follow from the shape of the value.
    """
    names = []
    declared = item.metadata.get("along") or item.metadata["axes"] or (item.name,)
    space = SPACE[: np.ndim(value) - len(declared) + 1 if dimensions is None else dimensions]
    for axis in declared:
        if axis == "balls":
            names += space
        elif axis.startswith("bonds_"):
            names += [f"bond_{name}" if axis == f"bonds_{name}" else name for name in space]
        else:
            names.append(axis)
    return names


def plain_value(item, value):
    """Return an attribute of a file as its field's type, or raise an InputError."""
    declared = item.type
    if isinstance(declared, UnionType):  # or None
        declared = get_args(declared)[0]
    many = declared not in (int, float, bool, str)
    dtype = item.metadata.get("dtype") or (*get_args(declared), declared)[0]
    kinds, called = KINDS[np.dtype(dtype).kind]
    found = np.asarray(value)
    if found.ndim != many or found.dtype.kind not in kinds:
        wanted = f"a list of {called}s" if many else f"a single {called}"
        raise InputError(f"{item.name}: {reprlib.repr(value)} is not {wanted}")
    found = found.astype(dtype)
    if declared is np.ndarray:
        return found
    return tuple(found.tolist()) if many else found.item()


class Shown:
    """What is saved, drawn, and seen in a notebook: a record, a result, a medium."""

    def as_result(self):
        """Return it as a result."""
        return self

    def save(self, path, overwrite=False):
        """See `pgran.save`. Collective."""
        import pgran

        pgran.save(self, path, overwrite)

    def plot(self, output=None, **choices):
        """See `pgran.plot`."""
        import pgran

        return pgran.plot(self, output, **choices)

    def _repr_html_(self):
        from pgran.store.display import page

        return page(self)


class Record(Shown):
    """One group of a result; each subclass names it and declares what it holds.

    A record with `within` is a part of that group's record. `failures` says how many of its results
    miss the accuracy asked for. `origin`, if known, holds the records before it in its result, the
    medium's first, and the attributes of this.
    """

    group = within = origin = None
    failures = 0
    axes = MappingProxyType({})  # the lengths of a medium's axes by name

    def filled(self):
        """Yield the declaration and the value of each field that has one."""
        for item in dataclasses.fields(self):
            value = getattr(self, item.name)
            if value is not None:
                yield item, value

    def check(self, axes):
        """Raise an InputError unless every array has its declared axes, each as long everywhere.

        `axes` are the lengths of the medium's axes by name. Parts are checked by themselves.
        """
        lengths = dict(axes)
        for item, value in self.filled():
            if not {"axes", "along"} & set(item.metadata):
                continue
            names = axes_of(item, value, lengths.get("axis", 0))
            shape = tuple(map(lengths.setdefault, names, value.shape))
            if value.ndim != len(names) or value.shape != shape:
                declared = ", ".join(f"{n}: {lengths.get(n, 'any')}" for n in names)
                raise InputError(f"{item.name}: shape {value.shape} is not ({declared})")

    def to_xarray(self):
        """Return the record as an xarray.Dataset: coordinates, units and long names.

        Plain values are its attributes. Its `to_netcdf("a.nc")` keeps complex numbers, of which
        h5netcdf warns; `xarray.load_dataset("a.nc", engine="h5netcdf")` reads them. A PgranError
        says if there is no xarray.
        """
        datasets, variables, attributes = needed("to_xarray", "xarray", DATASETS), {}, {}
        for item, value in self.filled():
            if "axes" in item.metadata:
                meaning = {key: item.metadata[key] for key in ("units", "long_name")}
                variables[item.name] = axes_of(item, value), value, meaning
            elif "part" not in item.metadata:
                attributes[item.name] = value
        return datasets.Dataset(variables, attrs=attributes)

    def to_dataframe(self, *rows):
        """Return a table of the record as a pandas.DataFrame, complex columns as they are.

        A row for each frequency, mode or time, of each detector a column, as `pgran.export` has it.
        Where arrays lie along several axes `rows` says which, `to_dataframe("omega", "ball")`.
        """
        from pgran.store.text import table_of

        return needed("to_dataframe", "pandas").DataFrame(table_of(self, rows))

    def as_result(self):
        """Return the result that the record is of; an InputError where nobody says which."""
        if self.origin is None:
            said = "made or changed by hand, on which medium? record.computed_on(medium) says it"
            raise InputError(f"{self.group}: {said}")
        before, attributes = self.origin
        homes = {group: scene for scene, home in EXPERIMENTS.items() for group in home.groups}
        return Result([*before, self], **{"scene": homes.get(self.group, self.group)} | attributes)

    def computed_on(self, other, **attributes):
        """Return the record, told of the medium, or record, that it was computed on."""
        if not isinstance(other, Shown):
            raise InputError(f"computed_on: a medium or a record is needed, not {other!r:.60}")
        before = (*other.as_result().records.values(),)
        self.check((*before, self)[0].axes)
        vars(self)["origin"] = before, attributes
        return self

    def __repr__(self):
        parts = []
        for item, value in self.filled():
            if isinstance(value, Record):
                parts.append(f"{item.name}: {type(value).__name__}")
            elif isinstance(value, np.ndarray):
                parts.append(f"{item.name}: {value.dtype} {value.shape}")
            else:
                parts.append(f"{item.name}={reprlib.repr(value)}")
        return f"{type(self).__name__}({', '.join(parts)})"


class MissingError(FileError, AttributeError):
    """A result lacks a group or an attribute that was asked for."""


class Result(Shown):
    """The records of a run by the names of their groups, and what the run says of itself.

    `result.response` is a `pgran.results.Response`, `result.scene` a text. What is missing raises
    an AttributeError, so `getattr(result, "spectrum", None)` asks for a group that may be missing.
    `records` and `attributes` are dictionaries of both.
    """

    def __init__(self, records, /, **attributes):
        self.records = {record.group: record for record in records}
        self.attributes = attributes

    def __getattr__(self, name):
        for held in vars(self).values():
            if name in held:
                return held[name]
        there = ", ".join(vars(self).get("records", ()))
        raise MissingError(f"the result holds no {name}; its groups are: {there or 'none'}")

    @property
    def medium(self):
        """The record of the lattice, or of another network."""
        return self.network if "network" in self.records else self.lattice

    def __dir__(self):
        return [*super().__dir__(), *self.records, *self.attributes]

    def __repr__(self):
        told = [f"{name}={self.attributes.get(name)!r}" for name in ("scene", "status")]
        return f"Result({', '.join([*told, *self.records])})"


DETECTOR = "indices of the detecting balls"
PHASE = "phase, unwrapped along omega; without damping 0 or pi"
BOUND = "bound of the error of the displacement; NaN: none is known"
FLOOR = "1: the bound is below error_floor, but not small against the amplitude"


@dataclass(frozen=True, eq=False, repr=False)
class Frequencies(Record):
    """What is computed at driving frequencies, of which those with a positive reason are good."""

    factorizations: int = attribute("how many matrices were factored", "1")
    solve_seconds: float = attribute("time of solving, of the slowest rank", "s")
    omega: np.ndarray = array("driving frequency, angular", "sqrt(k/m)")
    converged_reason: np.ndarray = array(
        "positive: as accurate as asked", "1", "omega", dtype=int, row=True
    )

    @property
    def failures(self):
        """How many frequencies missed the accuracy asked for."""
        return int(np.count_nonzero(self.converged_reason <= 0))


def ball_names(detectors):
    """Return what each detector is called, "ball (8, 10)"."""
    return [f"ball {site_name(site)}" for site in detectors]


def site_name(site):
    """Return the number of a ball, "11", or its indices on the axes, "(8, 10)"."""
    numbers = np.asarray(site).tolist()
    return str(numbers[0] if len(numbers) == 1 else tuple(numbers))
