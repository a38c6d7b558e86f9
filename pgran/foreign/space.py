"""Balls, contacts and displacements in files for ParaView and OVITO."""

from xml.sax.saxutils import quoteattr

import numpy as np

from pgran.errors import FileError, InputError, log, needed
from pgran.foreign.lammps import box_of, data_file, numbered
from pgran.medium.space import as_network, in_space, mesh, motions
from pgran.run.numbers import numbers
from pgran.store.paths import whole

SERIES = '<VTKFile type="Collection"><Collection>\n{}</Collection></VTKFile>\n'
SPECIES = np.array(["free", "rest", "driven"])  # of the numbers of `held`
# OVITO draws a "disp", its Displacement, as arrows; a dump of LAMMPS has velocities instead.
MOVES = {
    "": ("disp:R:3", "vx vy vz"),
    "_rotation": ("rotation:R:3", "omegax omegay omegaz"),
    "scalar": ("amplitude:R:1", "amplitude"),
}


def write(result, output, modes):
    """Write a result with these `modes`, all if None, and return the paths; see `pgran.export`."""
    if not hasattr(result, "medium"):
        raise FileError(f"no balls in this result (scene {result.scene})")
    if not result.medium.has_places:
        raise FileError("the network has no positions: there is nothing to write in space")
    stored = dict(enumerate(motions(result)))
    if not stored and result.scene in ("modes", "response", "pulse"):
        log.warning("no displacements in this result: -output_fields stores them")
    chosen = stored if modes is None else numbers("modes", modes, whole=True).ravel().tolist()
    if modes is not None and not chosen:
        raise InputError("modes: none is chosen")
    for n in {*chosen} - {*stored}:
        raise InputError(f"modes: {n} is none of the {len(stored)} that are stored, from 0 on")
    writer = _write_meshes if output.suffix.lower() in (".vtu", ".pvd") else _write_frames
    return writer(result, output, [(n, *stored[n]) for n in chosen])


def _write_meshes(result, output, moved):
    """Write balls, contacts and displacements by meshio, those of a series to a file each."""
    meshio = needed(output.suffix, "meshio")
    series = output.suffix.lower() == ".pvd"
    files, listed = {} if series else {output: {}}, ""
    for n, name, fact, moves in moved:
        path = output.with_name(f"{output.stem}_{n:04}.vtu") if series else output
        name = "displacement" if series else name
        files.setdefault(path, {}).update({name + part: x for part, x in moves.items()})
        time = fact.partition("time=")[2] or n
        listed += f'<DataSet timestep="{time}" file={quoteattr(path.name)}/>\n'
    points, lines, of_points, of_lines = mesh(result)
    cell_data = {name: [values] for name, values in of_lines.items()}
    for path, own in files.items():
        data = {"point_data": of_points | own, "cell_data": cell_data}
        with whole(path) as stream:
            meshio.Mesh(points, [("line", lines)], **data).write(stream.name, file_format="vtu")
    if not series:
        return [output]
    with whole(output) as stream:
        stream.write(SERIES.format(listed).encode())
    return [output, *files]


def _write_frames(result, output, moved):
    """Write balls and each displacement, a frame each; beside a dump the contacts."""
    network, dump = as_network(result.medium), output.suffix.lower() == ".dump"
    with whole(output) as stream:
        for n, _, fact, moves in moved or [(0, "", "", {})]:
            stream.write(_frame(network, n, fact, moves, dump).encode())
    if not dump or network.radius is None:
        return [output]
    bonds = output.with_name(f"{output.stem}-bonds.data")  # NAME.data may be the user's own
    with whole(bonds) as stream:
        stream.write(data_file(network.built, bonds=True).encode())
    return [output, bonds]


def _frame(network, number, fact, moves, dump):
    """Return the text of a frame, all digits; a `dump` has its number, the other a fact of it."""
    count, (low, high, periodic) = len(network.held), box_of(network)
    columns = [
        ("species:S:1", "type", network.held + 1 if dump else SPECIES[network.held]),
        ("pos:R:3", "x y z", in_space(network.position)),
        ("radius:R:1", "radius", network.radius),
        ("mass:R:1", "mass", network.mass),
        *((*MOVES[part if x.ndim > 1 else "scalar"], x) for part, x in moves.items()),
    ]
    columns = [column for column in columns if column[2] is not None]
    names, rows = [column[dump] for column in columns], numbered(*(x for *_, x in columns))
    if dump:
        sides = " ".join(np.where(periodic, "pp", "ff"))
        head = ["ITEM: TIMESTEP", number, "ITEM: NUMBER OF ATOMS", count]
        head += [f"ITEM: BOX BOUNDS {sides}", *map("{} {}".format, low, high)]
        head += [f"ITEM: ATOMS id {' '.join(names)}"]
    else:
        edges = np.diag(np.subtract(high, low)).ravel()
        texts = (" ".join(map(str, x)) for x in (edges, low, np.where(periodic, "T", "F")))
        box = 'Lattice="{}" Origin="{}" pbc="{}"'.format(*texts)
        head = [count, f"{box} {fact} Properties=id:I:1:{':'.join(names)}"]
    return "\n".join([*map(str, head), *rows, ""])
