"""`pgran export`: a result in space, as tables, matrices (.npz), or its packing for LAMMPS."""

import csv
import functools
import io
import logging
import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import pgran
from pgran.arguments import called_right, shown
from pgran.command.words import Parser
from pgran.errors import DONE, FileError, InputError, PgranError
from pgran.medium.base import as_result
from pgran.store.file import is_result
from pgran.store.paths import check_seal, whole

if TYPE_CHECKING:
    from pgran.medium.lattice import Lattice
    from pgran.medium.network import Network
    from pgran.store.record import Result

log = logging.getLogger("pgran")
HELD = 1e-3  # of the mean force: how exactly positions must hold the forces of a packing


@called_right
def export(
    result: "Result | Lattice | Network | str | os.PathLike", output: str | os.PathLike
) -> list[Path]:
    """Write a result for other programs: `export("modes.h5", "modes.vtu")`.

    The ending of its name says what is written:

    - `.vtu`, for ParaView and whatever reads VTK, by meshio: balls as points with `mass`, `radius`,
      `held`; contacts as lines with `stiffness` and so on, `crosses` where one goes across the end
      of a periodic box; displacements as point data, `mode_0001`, `response_0001_real` and `_imag`,
      `field_0001`, rotations apart; of a sensitivity `log_amplitude_0001_17` (ball 17), `flux_0001`
      and `loss_0001` of the contacts at each frequency that succeeded. On a lattice positions are
      indices, and the walls have points where bonds end, of mass 0.
    - `.csv`: a row for each frequency, time or mode, with all that the scene's record has there.
      Other records, and arrays along other axes, go to files beside it:
      `a-spectrum.csv`, `a-memory.csv` of a relaxation, `a-omega-ball.csv` of the heat at each ball.
    - `.npz`, what `pgran.matrices` returns, its matrices by entries, rows and columns: after `K =
      np.zeros((n, n))` so `K[f["K_row"], f["K_column"]] = f["K"]`, with `f = np.load("a.npz")`.
    - `.lmp`, a data file of LAMMPS (atom_style sphere): the packing of a result, or a network by
      itself, that knows its contact law. A script beside it, `a.in`, reads it and writes the dumps
      that `pgran import` takes. Forces are those that positions and radii hold, to all digits.

    Parameters
    ----------
    result : pgran.store.record.Result, pgran.Network, str or os.PathLike
        What `load` returns, or the path of its file.
    output : str or os.PathLike
        A missing folder is made; a file that is there is replaced.

    Returns
    -------
    list of pathlib.Path
        The files that were written.

    Raises
    ------
    FileError
        If the result cannot be read or has no such thing, or the file cannot be written.
    PgranError
        If there is no meshio.

    Examples
    --------
    >>> import tempfile
    >>> packing = pgran.pack(40, pressure=1e-2, seed=1)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     paths = pgran.export(packing, f"{folder}/discs.lmp")
    >>> [path.name for path in paths]
    ['discs.lmp', 'discs.in']
    """
    try:
        output = Path(output)
    except TypeError:
        raise InputError(f"export: {shown(output)} is no path of a file") from None
    writers = {".vtu": _write_mesh, ".csv": _write_tables, ".lmp": _write_packing}
    writers |= {".npz": _write_matrices}
    if output.suffix.lower() not in writers:
        raise FileError(f"{output}: an export's name ends in one of {', '.join(writers)}")
    return writers[output.suffix.lower()](result_of(result), output)


def result_of(given):
    """Return the result that a user hands in, its path, or a lattice or network by itself."""
    result = as_result(pgran.load(given) if isinstance(given, (str, os.PathLike)) else given)
    if not hasattr(result, "scene"):
        raise InputError(f"a result or its path is needed, not {shown(result)}")
    return result


def blaming_edits(run):
    """Let a command that meets what nobody has foreseen say which results were edited, if any."""

    @functools.wraps(run)
    def told(words):
        try:
            return run(words)
        except Exception as error:
            for path in [] if isinstance(error, FileError) else filter(is_result, words):
                check_seal(path)
            raise

    return told


@blaming_edits
def run(words):
    """Write a result for other programs: in space, as tables, or its packing for LAMMPS."""
    examples = (
        "pgran export results/modes.h5 results/modes.vtu",
        "pgran export results/response.h5 results/response.csv",
        "pgran export results/pressed.h5 results/pressed.lmp",
    )
    target = (
        "file to write; NAME.vtu: balls, contacts and displacements, for ParaView and others; "
        "NAME.csv: a row for each frequency, time or mode, and other arrays in files beside it; "
        "NAME.lmp: a packing, for LAMMPS, with NAME.in beside it; NAME.npz: the medium's matrices"
    )
    parser = Parser("export", run.__doc__, *examples)
    parser.add_argument("result", metavar="RESULT", help="HDF5 file of a result or a network")
    parser.add_argument("output", metavar="TO", help=target)
    options = parser.read(words)
    for path in export(options.result, options.output):
        print(path)
    return DONE


def _write_tables(result, output):
    """Write the tables of a result, each to a file of its own, with all digits."""
    from pgran.store.text import tables

    paths = []
    for table, columns in tables(result).items():
        path = output.with_stem("-".join(filter(None, [output.stem, table])))
        paths.append(path)
        real = {}
        for name, column in columns.items():
            if column.dtype.kind == "c":
                real |= {f"{name}_real": column.real, f"{name}_imag": column.imag}
            else:
                real[name] = column
        with whole(path) as stream:
            text = io.TextIOWrapper(stream, newline="", encoding="utf-8")
            writer = csv.writer(text)
            writer.writerow(real)
            writer.writerows(zip(*(column.tolist() for column in real.values()), strict=True))
            text.detach()  # which leaves the stream open
    return paths


def _write_matrices(result, output):
    """Write K, C and M by entries, rows and columns, what the unknowns are, and the drive."""
    found = pgran.matrices(result)
    arrays = vars(found) | {"unknowns": found.unknowns}
    for name, matrix in zip("KCM", found, strict=False):
        entries = matrix.tocoo()
        arrays |= {name: entries.data, f"{name}_row": entries.row, f"{name}_column": entries.col}
    with whole(output) as stream:
        np.savez_compressed(stream, **arrays)
    return [output]


def _write_mesh(result, output):
    """Write balls, contacts and displacements."""
    try:
        import meshio
    except ImportError as error:
        why = f"needs meshio, which cannot be imported ({error}): pip install meshio"
        raise PgranError(f"{output.suffix} {why}") from None
    from pgran.medium.space import mesh

    if not hasattr(result, "medium"):
        raise FileError(f"no balls in this result (scene {result.scene})")
    if not result.medium.has_places:
        raise FileError("the network has no positions: there is nothing to write in space")
    points, lines, of_points, of_lines = mesh(result)
    cell_data = {name: [values] for name, values in of_lines.items()}
    made = meshio.Mesh(points, [("line", lines)], point_data=of_points, cell_data=cell_data)
    with whole(output) as stream:
        made.write(stream.name, file_format="vtu")
    return [output]


def _write_packing(result, output):
    """Write a packing as data of LAMMPS, and the script that reads them."""
    from pgran.balance.networks import by_positions, law_of
    from pgran.foreign.lammps import data_file, input_script
    from pgran.medium.network import Network

    network = result.medium.built if hasattr(result, "medium") else None
    if not isinstance(network, Network):
        raise FileError(f"no packing in this result (scene {result.scene})")
    law, other = law_of(network), by_positions(network)
    if not other < HELD:
        raise InputError(
            f"the positions, radii and box of the network say other forces, by {other:.1e} of the "
            "mean one: LAMMPS would not find the same packing"
        )
    script = output.with_suffix(".in")
    texts = {output: data_file(network), script: input_script(network, law, output.stem)}
    for path, text in texts.items():
        with whole(path) as stream:
            stream.write(text.encode())
    log.info("positions hold each force to %.1e of the mean one", other)
    return [output, script]
