"""`pgran export`: a result for other programs, in space (.vtu) or as a table (.csv)."""

import csv
import dataclasses
import os
from pathlib import Path

import pgran
from pgran.command.words import Parser
from pgran.errors import DONE, FileError, PgranError
from pgran.parallel import launch

ENDINGS = (".vtu", ".csv")


def export(result, output):
    """Write a result for other programs: `export("modes.h5", "modes.vtu")`.

    Not collective. What the file is follows from its ending:

    - `.vtu`, for ParaView and whatever reads VTK, by meshio: balls as points with `mass`, `radius`,
      `held`; contacts as lines with `stiffness` and so on, `crosses` where one goes across the end
      of a periodic box; displacements as point data, `mode_0001`, `response_0001_real` and `_imag`,
      `field_0001`, rotations apart; of a sensitivity `log_amplitude_0001_17` (ball 17), `flux_0001`
      and `loss_0001` of the contacts at each frequency that succeeded. On a lattice positions are
      indices, and the walls have points where bonds end, of mass 0.
    - `.csv`: a row a frequency, time or mode, a column all that the record of the scene has there.

    Parameters
    ----------
    result : pgran.record.Result, str or os.PathLike
        What `load` returns, or the path of its file.
    output : str or os.PathLike
        A missing folder is made; a file that is there is replaced.

    Raises
    ------
    FileError
        If the result cannot be read or has no such thing, or the file cannot be written.
    PgranError
        If there is no meshio.
    """
    output = Path(output)
    write = {".vtu": _write_mesh, ".csv": _write_table}.get(output.suffix.lower())
    if write is None:
        raise FileError(f"{output}: an export's name ends in one of {', '.join(ENDINGS)}")
    shown = pgran.load(result) if isinstance(result, (str, os.PathLike)) else result
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        write(shown, output)
    except OSError as error:
        raise FileError(f"{output}: cannot be written: {error.strerror or error}") from None


def run(words):
    """Write a result for other programs, in space or as a table."""
    parser = Parser(
        "export",
        run.__doc__,
        "pgran export results/modes.h5 results/modes.vtu",
        "pgran export results/response.h5 results/response.csv",
    )
    parser.add_argument("result", metavar="RESULT", help="HDF5 file that pgran run has written")
    parser.add_argument(
        "output",
        metavar="TO",
        help="file to write; NAME.vtu: balls, contacts and displacements, for ParaView and others; "
        "NAME.csv: a row a frequency, time or mode",
    )
    given = parser.parse_intermixed_args(words)
    if launch.rank() > 0:
        return DONE
    export(given.result, given.output)
    print(given.output)
    return DONE


def table(result):
    """Return the table of a result: columns by their names.

    Not collective. What the record of the scene has at each frequency, time or mode, of complex
    numbers both parts; of each detector a column: `amplitude_8_10`, `amplitude_17`.

    Raises
    ------
    FileError
        If the record has no array that all others belong to.
    """
    record = getattr(result, "records", vars(result)).get(result.scene)
    there = [item for item in dataclasses.fields(record) if "axes" in item.metadata] if record \
        else []  # fmt: skip
    there = [item for item in there if getattr(record, item.name) is not None]
    first = next((item.name for item in there if not item.metadata["axes"]), None)
    columns = {}
    for item in there:
        values, axes = getattr(record, item.name), item.metadata["axes"]
        if item.name == first or axes == (first,):
            columns[item.name] = values
        elif axes == (first, "detector_number"):
            for site, column in zip(record.detector.tolist(), values.T, strict=True):
                columns["_".join(map(str, [item.name, *site]))] = column
    if not columns:
        raise FileError(f"no table in this result (scene {result.scene})")
    return columns


def _write_table(result, output):
    """Write the table of a result; its numbers are read back as they are."""
    parts = {}
    for name, column in table(result).items():
        both = column.dtype.kind == "c"
        parts |= {f"{name}_real": column.real, f"{name}_imag": column.imag} if both \
            else {name: column}  # fmt: skip
    with open(output, "w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(parts)
        writer.writerows(zip(*(column.tolist() for column in parts.values()), strict=True))


def _write_mesh(result, output):
    """Write balls, contacts and displacements."""
    try:
        import meshio
    except ImportError as error:
        raise PgranError(
            f"{output.suffix} needs meshio, which cannot be imported ({error}): pip install meshio"
        ) from None
    from pgran.results.space import mesh

    if not hasattr(result, "medium"):
        raise FileError(f"no balls in this result (scene {result.scene})")
    if not result.medium.has_places:
        raise FileError("the network has no positions: there is nothing to write in space")
    points, lines, of_points, of_lines = mesh(result)
    cells = [("line", lines)]
    held = {name: [values] for name, values in of_lines.items()}
    meshio.Mesh(points, cells, point_data=of_points, cell_data=held).write(output)
