"""`pgran import`: a contact network of another program becomes one of pgran's."""

import argparse
import math
import re
from dataclasses import dataclass

import numpy as np

from pgran.errors import DONE, InputError
from pgran.files import tables
from pgran.files.conditions import choose
from pgran.files.foreign import AXES, read_balls
from pgran.files.network import check_output, write_network
from pgran.files.recognise import read_contacts
from pgran.physics import packing
from pgran.physics.network import AT_REST, DRIVEN, FREE, KINDS, Network

DESCRIPTION = """\
Make a network from the balls and contacts that another program has written: two dumps of LAMMPS or
LIGGGHTS (dump custom and dump local), two CSV files with a header, or one GraphML file. Of several
snapshots the last one is taken. A CONDITION compares a coordinate or another column of the balls,
'x<1.5', 'x>max-1.5 and type==2', or lists ids, '12,15,30-40'."""
SAME = 1e-6  # contacts that are listed twice agree to this part


def run(words):
    """Make a network from files of another program, and say what became of them. Not collective."""
    given = _parser().parse_intermixed_args(words)
    _check(given)
    check_output(given.output, given.overwrite)
    with np.errstate(all="ignore"):  # of absurd numbers in a file: what comes of them is checked
        found, names = _read(given)
        made = _assemble(found, given)
        if names is not None and not np.array_equal(names, found.balls.id.astype(str)):
            made.members["id"] = np.char.encode(names, "utf-8")[made.kept.balls]
        made.network()
    write_network(given.output, made.members, made.attributes, given.overwrite)
    for line in _summary(made, found, given):
        print(line)
    return DONE


def _parser():
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser("pgran import", description=DESCRIPTION, allow_abbrev=False)
    add = parser.add_argument
    add("balls", metavar="ATOMS", help="dump custom, CSV (id,x,y[,z],radius,mass) or GraphML")
    add("contacts", metavar="CONTACTS", nargs="?", help="dump local, or CSV (i,j,force or ...)")
    add("-o", "--output", required=True, help="HDF5 file to write")
    add("--overwrite", action="store_true", help="replace a network that is there")
    add("--law", help="stiffness: hertz (3/2 F/h), harmonic (F/h), or the column that holds it")
    add("--hertz", type=_positive, metavar="C", help="of F = C h^(3/2): stiffness by force alone")
    add(
        "--columns",
        help="what the columns of contacts are, in their order, such as "
        "id1,id2,distance,force (_ for none), or id1=c_p[1],force=4; else they are recognised",
    )
    add("--rest", metavar="CONDITION", help="balls that are held at rest")
    add("--drive", metavar="CONDITION", help="balls that are driven")
    add("--direction", type=_direction, help="of the drive: x, y, z or components 1,0.5 (x)")
    add("--cut", metavar="AXES", help="cut the contacts across these ends of a periodic box: x")
    add("--displacement", choices=KINDS, help="of a ball (vector where there are positions)")
    add(
        "--prestress",
        action=argparse.BooleanOptionalAction,
        help="whether the forces act in the network (yes for vectors, if they are known)",
    )
    add("--tangential", type=_magnitude, metavar="RATIO", help="tangential over normal stiffness")
    add("--damping", type=_magnitude, metavar="BETA", default=0.003, help="of each contact (.003)")
    return parser  # fmt: skip


def _magnitude(text):
    """Return a number that is 0 or more."""
    number = float(text)
    if not 0 <= number < math.inf:
        raise argparse.ArgumentTypeError(f"{text} is not 0 or more and finite")
    return number


def _positive(text):
    """Return a positive number."""
    if not _magnitude(text) > 0:
        raise argparse.ArgumentTypeError(f"{text} is not positive")
    return float(text)


def _direction(text):
    """Return the components of a direction."""
    if text in tuple(AXES):
        return text
    components = np.array([float(word) for word in text.split(",")])
    if len(components) not in (2, 3) or not 0 < np.linalg.norm(components) < math.inf:
        raise argparse.ArgumentTypeError(f"{text} is neither x, y, z nor 2 or 3 components")
    return components


def _check(given):
    """Refuse words that contradict each other."""
    if given.hertz is not None and given.law != "hertz":
        raise InputError("--hertz goes with --law hertz")
    if given.cut is not None and not re.fullmatch("[xyz]{1,3}", given.cut):
        raise InputError(f"--cut {given.cut}: must be axes, such as x or xy")
    if given.displacement == "scalar" and (given.prestress or given.tangential or given.direction):
        raise InputError("--prestress, --tangential and --direction need vector displacements")
    if tables.is_graph(given.balls) == (given.contacts is not None):
        raise InputError(
            "one GraphML file holds balls and contacts"
            if given.contacts
            else "CONTACTS is missing: only GraphML holds balls and contacts in one file"
        )


def _read(given):
    """Return the contacts between the balls in the files, and the names of nodes of a graph."""
    if given.contacts is None:
        nodes, edges, names = tables.read_graph(given.balls)
        return read_contacts(edges, read_balls(nodes), given.columns), np.array(names)
    balls = read_balls(tables.read_table(given.balls))
    return read_contacts(tables.read_table(given.contacts), balls, given.columns), None


@dataclass(frozen=True, eq=False)
class Made:
    """What is written, and what has been left out."""

    members: dict
    attributes: dict
    kept: packing.Kept
    apart: int
    twice: int
    cut: int
    unbalanced: float | None

    def network(self):
        """Return the network, which raises an InputError where it is none."""
        values = {name: self.members[name] for name in self.members if name != "id"}
        values["masses"] = values.pop("mass")
        return Network(**values, **self.attributes)


def _assemble(found, given):
    """Return the network of contacts: what touches, is not cut, and hangs together."""
    balls = found.balls
    kind = given.displacement or ("vector" if balls.axes else "scalar")
    if kind != "scalar" and not balls.axes:
        raise InputError(f"--displacement {kind} needs positions of the balls")
    if kind == "rotations" and balls.radius is None:
        raise InputError("--displacement rotations needs radii of the balls")
    stiffness = found.stiffness(given.law, given.hertz)
    touch = stiffness != 0
    once = touch & _first_of_each(found, stiffness, touch)
    across = _crossing(found, given.cut)
    held = _held(balls, given)
    index = np.flatnonzero(once)
    kept = packing.keep(found.bond[index], held, across[index])
    rows = index[kept.contacts]
    if not len(rows):
        raise InputError("no contact is left that a free ball has: see --rest, --drive, --cut")
    if given.drive and not np.any(held[kept.balls] == DRIVEN):
        raise InputError(f"--drive {given.drive}: none of these balls touches a free one")

    number = np.cumsum(kept.balls) - 1
    bond, held = number[found.bond[rows]], held[kept.balls]
    members = {"position": None if balls.position is None else balls.position[kept.balls]}
    members |= {"mass": balls.mass[kept.balls], "held": held, "bond": bond}
    members["radius"] = None if balls.radius is None else balls.radius[kept.balls]
    members["stiffness"] = stiffness[rows]
    members["id"] = balls.id[kept.balls]
    attributes = {"displacement": kind, "damping": given.damping}
    normal, force = found.normal, found.force
    ratio = None
    if normal is not None and force is not None:
        ratio = packing.unbalanced(bond, normal[rows], force[rows], held == FREE)
    if kind != "scalar":
        members |= {"normal": normal[rows], "distance": found.distance[rows]}
        if given.prestress and force is None:
            raise InputError("--prestress needs forces; --columns says which column they are in")
        if given.prestress is not False and force is not None:
            members["force"] = force[rows]
        shear = found.given("tangential")
        if given.tangential is not None:
            members["tangential"] = given.tangential * stiffness[rows]
        elif shear is not None:
            members["tangential"] = shear[rows]
        attributes["direction"] = _along(given.direction, balls.axes)
    return Made(
        members, attributes, kept, np.count_nonzero(~touch), np.count_nonzero(touch & ~once),
        np.count_nonzero(across & once), ratio,
    )  # fmt: skip


def _first_of_each(found, stiffness, touch):
    """Return which contacts are the first of the same two balls; those listed again must agree."""
    low, high = np.sort(found.bond, axis=1).T
    order = np.lexsort((np.arange(len(low)), high, low, ~touch))
    order = order[: np.count_nonzero(touch)]
    again = (np.diff(low[order]) == 0) & (np.diff(high[order]) == 0)
    one, other = stiffness[order[:-1]], stiffness[order[1:]]
    wrong = np.flatnonzero(again & ~(np.abs(one - other) <= SAME * np.abs(one)))
    if wrong.size:
        why = "these balls touch twice, with different stiffness"
        found.table.refuse(order[wrong[0] + 1], why)
    first = np.ones(len(low), dtype=bool)
    first[order[1:][again]] = False
    return first


def _crossing(found, cut):
    """Return which contacts lead through the ends that are cut."""
    across = np.zeros(len(found.bond), dtype=bool)
    for axis in map(AXES.index, cut or ""):
        if axis >= found.balls.axes or not np.isfinite(found.balls.periods[axis]):
            raise InputError(f"--cut {AXES[axis]}: the packing is not periodic along {AXES[axis]}")
        across |= found.crossing[:, axis]
    return across


def _held(balls, given):
    """Return which balls are free, at rest, driven."""
    held = np.full(len(balls.id), FREE) if balls.held is None else balls.held.copy()
    chosen = {}
    for option, kind in (("rest", AT_REST), ("drive", DRIVEN)):
        condition = getattr(given, option)
        if condition is not None:
            try:
                chosen[kind] = choose(condition, balls.id, balls.column)
            except InputError as error:
                raise InputError(f"--{option}: {error}") from None
            held[chosen[kind]] = kind
    if len(chosen) == 2 and np.any(chosen[AT_REST] & chosen[DRIVEN]):
        ball = balls.id[chosen[AT_REST] & chosen[DRIVEN]][0]
        raise InputError(f"--rest and --drive: ball {ball} cannot be both")
    return held


def _along(direction, axes):
    """Return the direction of the drive as components."""
    if direction is None or isinstance(direction, str):
        axis = AXES.index(direction or "x")
        if axis >= axes:
            raise InputError(f"--direction {direction}: the packing has {axes} axes")
        return np.eye(axes)[axis]
    if len(direction) != axes:
        raise InputError(f"--direction: the packing has {axes} axes")
    return direction / np.linalg.norm(direction)


def _summary(made, found, given):
    """Say in a few lines what has been written, what was left out, and what to do next."""
    kept, members, network = made.kept, made.members, made.network()
    free, rest, driven = (np.count_nonzero(network.held == kind) for kind in (0, 1, 2))
    kind = network.displacement
    plane = f"in {network.axes} dimensions, driven along {_words(network.direction)}"
    yield f"{given.output}: {_count(free, 'free ball')}, {rest} at rest, {driven} driven; " \
        f"{_count(len(network.bond), 'contact')}"  # fmt: skip
    rotations = " and rotations" if kind == "rotations" else ""
    yield "displacements: " + ("scalar" if kind == "scalar" else f"vectors{rotations} {plane}")
    taken = {table.path: table for table in (found.balls.table, found.table)}
    for path, table in taken.items():
        if table.snapshots > 1:
            yield f"{path}: the last of {table.snapshots} snapshots, of the time step {table.step}"
    named = ", ".join(f"{role} = {name}" for role, name in found.roles.items())
    yield f"columns of contacts: {named}"
    left = (
        (kept.rattlers, "rattler", "without contacts"),
        (kept.torn_off, "ball", "torn off by the cut"),
        (kept.floating, "ball", "in parts without a path to a held ball"),
        (kept.idle, "held ball", "without a free neighbour"),
        (made.apart, "contact", "of balls that do not touch"),
        (made.twice, "contact", "listed a second time"),
        (kept.inert, "contact", "between held balls"),
    )
    said = [f"{_count(n, what)} {why}" for n, what, why in left if n]
    yield "left out: " + ("; ".join(said) if said else "nothing")
    if given.cut:
        yield f"cut: {_count(made.cut, 'contact')} across {' and '.join(given.cut)}"
    k, law = members["stiffness"], given.law or found.roles["stiffness"]
    formula = {"hertz": "hertz, 3/2 F/h", "harmonic": "harmonic, F/h"}.get(law, f"column {law}")
    if given.hertz is not None:
        formula = f"hertz, 3/2 c^(2/3) F^(1/3) with c = {given.hertz:g}"
    yield f"stiffness: {formula}; {k.min():.4g} to {k.max():.4g}"
    if made.unbalanced is not None:
        stress = "are pre-stress" if "force" in members else "are not kept as pre-stress"
        yield f"forces {stress}; the largest unbalanced one on a free ball is " \
            f"{made.unbalanced:.2g} of the mean contact force"  # fmt: skip
    yield _rigidity(network)
    if not rest + driven:
        yield "no ball is held: the network floats and cannot be driven; see --rest and --drive"
    ball = _middle(network)
    name = members["id"][ball]
    name = name.decode() if isinstance(name, bytes) else name
    yield f"next: pgran run FILE -network_file {given.output} -detectors {ball}"
    yield f"(ball {ball}, of the id {name}, is free and in the middle; /network/id has all ids)"


def _count(n, what):
    """Return a number of things in words."""
    return f"{n} {what}{'' if n == 1 else 's'}"


def _words(direction):
    """Return a direction as the name of an axis, or its components."""
    axes = np.flatnonzero(direction)
    if len(axes) == 1 and direction[axes[0]] > 0:
        return AXES[axes[0]]
    return ",".join(f"{x:.4g}" for x in direction)


def _rigidity(network):
    """Say how many contacts a free ball has, and how many an isostatic packing would have."""
    ends = network.held[network.bond] == FREE
    met = np.bincount(network.bond[ends], minlength=len(network.held))[network.held == FREE]
    said = f"contacts per free ball: {met.mean():.4g}"
    if network.displacement == "scalar":
        return said
    each = 1 if network.tangential is None else network.axes  # springs of a contact
    unknowns, springs = network.balls, each * len(network.bond)
    more = springs - unknowns
    said += f"; {springs} springs for {unknowns} unknowns, {abs(more)} " \
        f"{'more' if more >= 0 else 'fewer'} than isostatic"  # fmt: skip
    loose = np.count_nonzero(met <= network.axes)
    return said + (
        f"; {_count(loose, 'ball')} with {network.axes} contacts or fewer" if loose else ""
    )


def _middle(network):
    """Return the free ball that is nearest to the middle of the packing, or of the list."""
    if network.position is None:
        return int(network.free[len(network.free) // 2])
    position = network.position
    away = position[network.free] - (position.min(axis=0) + position.max(axis=0)) / 2
    return int(network.free[np.argmin(np.sum(away**2, axis=1))])
