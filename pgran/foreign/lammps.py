"""A packing as LAMMPS takes it: a data file of atom_style sphere, and a script that reads it."""

import itertools
import re

import numpy as np

from pgran.errors import InputError
from pgran.foreign.contacts import AXES
from pgran.medium.space import in_space
from pgran.medium.springs import AT_REST, DRIVEN, FREE

# By the power of the contact law: of the overlap alone, without a history of slips.
STYLES = {1.0: ("gran/hooke/history", "harmonic"), 1.5: ("gran/hertz/history", "hertz")}
TYPES = {FREE: "free", AT_REST: "at rest", DRIVEN: "driven"}  # of the atom types 1, 2, 3
FLAT = 0.5  # half the thickness of a plane, in mean diameters
SKIN = 0.3  # of the lists of neighbours, in mean diameters


def data_file(network, bonds=False):
    """Return the text of a data file: box, types, diameters, densities, positions, all digits.

    With `bonds` these are the contacts, for pictures: atom_style hybrid bond sphere, one molecule.
    """
    count, kinds = len(network.held), ", ".join(f"{n + 1} {name}" for n, name in TYPES.items())
    lines = [f"A packing from pgran; atom types: {kinds}", "", f"{count} atoms"]
    lines += [f"{network.bonds} bonds", "1 bond types"] * bonds + [f"{len(TYPES)} atom types", ""]
    ends = zip(*box_of(network)[:2], AXES, strict=True)
    lines += [f"{low!r} {high!r} {x}lo {x}hi" for low, high, x in ends]
    density = network.masses / (4 / 3 * np.pi * network.radius**3)  # of spheres in a plane too
    place, size = in_space(network.position), np.stack([2 * network.radius, density], axis=1)
    row = [place, np.ones(count, int), size] if bonds else [size, place]
    lines += ["", f"Atoms # {'hybrid bond sphere' if bonds else 'sphere'}", ""]
    lines += numbered(network.held + 1, *row)
    if bonds:
        lines += ["", "Bonds", "", *numbered(np.ones(network.bonds, int), network.bond + 1)]
    return "\n".join([*lines, ""])


def numbered(*columns):
    """Return lines of the numbers from 1 and of columns, shape (n,) or (n, d), with all digits."""
    cells = [column.reshape(len(column), -1).tolist() for column in columns]
    rows = enumerate(zip(*cells, strict=True), 1)
    return [" ".join(map(str, itertools.chain([n], *row))) for n, row in rows]


def box_of(network):
    """Return lower and upper ends of a box around all balls, and where it is periodic: lists."""
    position, periods = in_space(network.position), in_space(_periods(network))
    radius = np.full(1, 0.5) if network.radius is None else network.radius
    room = np.full(3, 2 * radius.max())  # beyond the centres, where the box is not periodic
    room[network.position.shape[1] :] = FLAT * 2 * radius.mean()
    low, high = position.min(axis=0) - room, position.max(axis=0) + room
    ends = np.where(periods > 0, 0.0, low), np.where(periods > 0, periods, high)
    return *(each.tolist() for each in ends), periods > 0


def input_script(network, law, name):
    """Return the text of a script: the forces of the packing `name`.lmp, in the dumps of an import.

    Raises InputError where LAMMPS has no such contact law, or takes no such name.
    """
    if not re.fullmatch(r"[\w.+-]+", name):
        raise InputError(f"LAMMPS takes no name like {name!r}: letters, digits, . _ + - will do")
    if law.power not in STYLES:
        raise InputError(
            f"contacts repel by the power {law.power:g}: LAMMPS has 1, harmonic, and 3/2, hertz"
        )
    style, called = STYLES[law.power]
    axes, diameter = network.position.shape[1], 2 * float(network.radius.mean())
    periodic = np.pad(_periods(network), (0, 3 - axes), constant_values=1.0) > 0
    roles = [("--rest", AT_REST), ("--drive", DRIVEN)]
    words = [f" {key} 'type=={kind + 1}'" for key, kind in roles if np.any(network.held == kind)]
    script = f"""\
# A packing from pgran with its forces: lmp -in {name}.in, and then
#   pgran import {name}.atoms {name}.contacts -o {name}_lammps.h5 --law {called}{"".join(words)}
# Lengths, masses and forces are in the units of the packing; no friction, no dashpots.

units lj
dimension {axes}
newton off
boundary {" ".join("p" if x else "f" for x in periodic)}
atom_style sphere
comm_modify vel yes
neighbor {SKIN * diameter!r} bin
read_data {name}.lmp
pair_style {style} {law.modulus!r} 0 0 0 0 0
pair_coeff * *
"""
    if network.gravity is not None and np.any(network.gravity):
        pull = np.pad(network.gravity, (0, 3 - axes)) + 0.0  # which is no -0.0
        along = " ".join(map(repr, pull.tolist()))
        script += f"fix gravity all gravity {float(np.linalg.norm(pull))!r} vector {along}\n"
    if axes == 2:
        script += "fix plane all enforce2d\n"
    return f"""{script}group held type {AT_REST + 1} {DRIVEN + 1}
fix held held setforce 0 0 0
thermo_style custom step atoms fmax
compute ids all property/local patom1 patom2
compute contacts all pair/local dist force
dump atoms all custom 1 {name}.atoms id type {" ".join(AXES[:axes])} radius mass
dump contacts all local 1 {name}.contacts c_ids[1] c_ids[2] c_contacts[1] c_contacts[2]
dump_modify atoms sort id format float %.17g
dump_modify contacts format float %.17g
run 0
"""


def _periods(network):
    """Return the periods along each axis, 0 where there is none."""
    return np.zeros(network.position.shape[1]) if network.box is None else network.box
