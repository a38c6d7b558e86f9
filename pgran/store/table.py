"""Results as tables: a row for each frequency, time, mode or whatever a record has arrays along."""

import dataclasses
import math

import numpy as np

from pgran.errors import FileError

ASIDE = "detector_number", "axis"  # along these a table has columns, not rows
IN_SPACE = "balls", "bonds_"  # what arrays along these hold is a picture, no table


def tables(result):
    """Return the tables of a result: columns by their names.

    Of each record but the medium's all arrays along the same axes make a table: a row for each
    place along them, first what is there (`omega`, or a number from 0), then the arrays, of each
    detector a column: `amplitude_8_10`, `amplitude_17`. Group and axes name the tables but the
    first, "", of the scene's own record if it has one. A FileError says if there is none.
    """
    records, scene = result.records, str(result.scene)
    own = {scene: records[scene]} if scene in records else {}
    named = {}
    for group, record in (own | records).items():
        if group in ("lattice", "network"):
            continue
        for number, (axes, columns) in enumerate(_of_record(record).items()):
            name = [group] * (group not in own) + [*axes] * (number > 0)
            named["-".join(name) if named else ""] = columns
    if not named:
        raise FileError(f"no table in this result (scene {result.scene})")
    return named


def _of_record(record):
    """Return the tables of a record by their axes."""
    fields = dataclasses.fields(record)
    along = {item.name: item.metadata["axes"] for item in fields if "axes" in item.metadata}
    coordinates = {name for name, axes in along.items() if not axes}
    used = {axis for axes in along.values() for axis in axes}
    of_axes = {}
    for name, axes in along.items():
        values, axes = getattr(record, name), axes or (name,)
        in_space = any(axis.startswith(IN_SPACE) for axis in axes)
        if values is None or name in used or in_space or axes == ASIDE:
            continue
        # displacement (omega, detector_number): a row each omega, a column each detector
        rows = tuple(axis for axis in axes if axis not in ASIDE)
        at = [axes.index(axis) for axis in rows]
        if rows not in of_axes:
            places = [
                getattr(record, axis) if axis in coordinates else np.arange(values.shape[n])
                for axis, n in zip(rows, at, strict=True)
            ]
            grids = np.meshgrid(*places, indexing="ij")
            of_axes[rows] = dict(zip(rows, map(np.ravel, grids), strict=True))
        if name not in coordinates:
            of_axes[rows] |= _columns(record, name, values, axes, at)
    filled = {rows: columns for rows, columns in of_axes.items() if len(columns[rows[0]])}
    return dict(sorted(filled.items(), key=lambda table: len(table[0])))


def _columns(record, name, values, axes, at):
    """Return the columns of an array, one for each place along the axes that have columns."""
    aside = [n for n in range(len(axes)) if n not in at]
    flat = values.transpose(*at, *aside).reshape(math.prod(values.shape[n] for n in at), -1)
    labels = [name]
    for n in aside:
        sites = np.arange(values.shape[n])[:, None]
        if axes[n] == "detector_number":
            sites = record.detector
        labels = ["_".join(map(str, [label, *site])) for label in labels for site in sites.tolist()]
    return dict(zip(labels, flat.T, strict=True))
