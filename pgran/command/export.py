"""`pgran export`: a result in space (ParaView, OVITO), tables, matrices, a packing for LAMMPS."""

import csv
import functools
import io
import os
from pathlib import Path

import numpy as np

import pgran
from pgran.arguments import called_right, shown
from pgran.command.words import Parser
from pgran.errors import DONE, FileError, InputError, log
from pgran.store.file import is_result
from pgran.store.paths import check_seal, whole
from pgran.store.record import Shown

IN_SPACE = (".vtu", ".pvd", ".xyz", ".dump")
HELD = 1e-3  # of the mean force: how exactly positions must hold the forces of a packing


@called_right
def export(
    result: Shown | str | os.PathLike, output: str | os.PathLike, modes: list[int] | None = None
) -> list[Path]:
    """Write a result for other programs: `export("modes.h5", "modes.vtu")`.

    The ending of its name says what is written: balls, contacts, mode shapes and stored fields for
    ParaView, `.vtu`, or a series of these, `.pvd`; for OVITO, a frame each, `.xyz`, or `.dump`;
    tables, `.csv`; what `pgran.matrices` returns, `.npz`; for LAMMPS a packing that knows its
    contact law, `.lmp`, and a script. `pgran manual experiments` says what they hold.

    Parameters
    ----------
    result : pgran.store.record.Result, a record, pgran.Network, str or os.PathLike
        What `load` or a function returns, or the path of its file.
    output : str or os.PathLike
        A missing folder is made; a file that is there is replaced.
    modes : array_like of int, optional
        Which modes, or stored fields, are written in space, from 0; by default all.

    Returns
    -------
    list of pathlib.Path
        The files that were written.

    Raises
    ------
    FileError
        If the result cannot be read or has no such thing, or the file cannot be written.
    InputError
        If no such modes are stored, or the file is not one that holds them in space.
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
    writers = {".csv": _write_tables, ".npz": _write_matrices, ".lmp": _write_packing}
    ending = output.suffix.lower()
    if ending in IN_SPACE:
        from pgran.foreign import space

        return space.write(result_of(result), output, modes)
    if ending not in writers:
        known = ", ".join([*IN_SPACE, *writers])
        raise FileError(f"{output}: an export's name ends in one of {known}")
    if modes is not None:
        raise InputError(f"modes: are chosen for {', '.join(IN_SPACE)}, not for {ending}")
    return writers[ending](result_of(result), output)


def result_of(given):
    """Return the result that a user hands in, its path, a record of it, or a medium by itself."""
    given = pgran.load(given) if isinstance(given, (str, os.PathLike)) else given
    result = given.as_result() if isinstance(given, Shown) else given
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
        "pgran export results/modes.h5 results/modes.xyz --modes 0:10,33",
        "pgran export results/response.h5 results/response.csv",
        "pgran export results/pressed.h5 results/pressed.lmp",
    )
    target = (
        "file to write; .vtu, .pvd: in space, for ParaView; .xyz, .dump: the same for OVITO; .csv: "
        "tables; .npz: matrices; .lmp: a packing for LAMMPS, and a script; see pgran manual "
        "experiments"
    )
    parser = Parser("export", run.__doc__, *examples)
    parser.add_argument("result", metavar="RESULT", help="HDF5 file of a result or a network")
    parser.add_argument("output", metavar="TO", help=target)
    of_modes = "which modes, or stored fields, from 0: numbers, and ranges as 0:10, the first ten"
    parser.add_argument("--modes", type=_mode_numbers, metavar="LIST", help=of_modes)
    options = parser.read(words)
    for path in export(options.result, options.output, options.modes):
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


def _mode_numbers(text):
    """Return the whole numbers of a list as 0,3,10:20."""
    ends = [[int(end) for end in part.split(":")] for part in text.split(",")]
    return [n for first, *last in ends for n in (range(first, *last) if last else [first])]


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
