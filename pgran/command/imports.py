"""`pgran import`: a contact network of another program becomes one of pgran's."""

import argparse
import re

import numpy as np

from pgran.command.words import Parser, magnitude, positive
from pgran.errors import DONE, InputError, log
from pgran.foreign.assemble import assemble
from pgran.foreign.contacts import AXES, ROLES, Balls, read_contacts, touching
from pgran.foreign.tables import read_graph, read_table
from pgran.medium.base import BETA
from pgran.medium.checks import KINDS
from pgran.medium.dissipation import warn_of_damping
from pgran.medium.network_file import check_output, write_network
from pgran.medium.packing import POWERS, ContactLaw
from pgran.medium.springs import DRIVEN, FREE
from pgran.run.options import REALS, Option
from pgran.store.estimate import counted

UNSURE = 1e-2  # of a stiffness: what the printed digits may leave open
BALANCED = 1e-3  # of the mean contact force: what may be left on a ball at rest
BOX = Option("box", REALS, None, "periods of a table that does not say them, 0 for none", low=0)
DESCRIPTION = """\
Make a network from the balls and contacts that another program has written: two dumps of LAMMPS or
LIGGGHTS (dump custom and dump local), two CSV files with a header, or one GraphML file. Without
CONTACTS balls that overlap are in contact. Of several snapshots the last one is taken. A CONDITION
compares a coordinate or another column of the balls, 'x<1.5', 'x>max-1.5 and type==2', or lists
ids, '12,15,30-40'."""


def run(words):
    """Make a network from files of another program, and say what became of them, on rank 0."""
    options = _parser().read(words)
    _check(options)
    check_output(options.output, options.overwrite)
    with np.errstate(all="ignore"):  # of absurd numbers in a file: what comes of them is checked
        names = None  # of a graph's nodes
        if options.by_geometry or options.contacts:
            nodes, edges = (path and read_table(path) for path in (options.balls, options.contacts))
        else:
            nodes, edges, names = read_graph(options.balls)
        balls = Balls(nodes, options.box)
        edges = edges or touching(balls, ContactLaw(POWERS[options.law], options.modulus or 1.0))
        contacts = read_contacts(edges, balls, options.columns)
        made = assemble(contacts, options, names)
        cautions = [*_cautions(made, contacts, options)]
    write_network(options.output, made.members, made.attributes, options.overwrite)
    for line in cautions:
        log.warning("%s", line)
    warn_of_damping(made.network, "--damping")
    for line in _summary(made, contacts, options):
        print(line)
    return DONE


def _parser():
    """Return the parser of the command line."""
    parser = Parser(
        "import",
        DESCRIPTION,
        "pgran import beads.atoms beads.contacts -o beads.h5 --rest 'x<1.5' --drive 'x>max-1.5'",
        "pgran import balls.csv contacts.csv -o beads.h5 --law hertz --drive 12,15,30-40",
        "pgran import beads.csv -o beads.h5 --law hertz --box 20,20,0 --rest 'z<1'",
        "pgran import graph.graphml -o graph.h5 --drive 1",
    )
    columns = (
        "names of the columns of contacts, in their order, such as id1,id2,distance,force "
        "(_ for none), or id1=c_p[1],force=4; by default they are recognised"
    )
    prestress = "keep the forces as pre-stress (by default for vectors, where they are known)"
    add = parser.add_argument
    add("balls", metavar="ATOMS", help="dump custom, CSV (id,x,y[,z],radius,mass) or GraphML")
    add("contacts", metavar="CONTACTS", nargs="?", help="dump local, or CSV (i,j,force or ...)")
    add("-o", "--output", required=True, help="HDF5 file to write")
    add("--overwrite", action="store_true", help="replace an existing network")
    add("--law", help="stiffness: hertz (3/2 F/h), harmonic (F/h), or the column that holds it")
    add("--hertz", type=positive, metavar="C", help="C of F = C h^(3/2): stiffness by force alone")
    add("--modulus", type=positive, metavar="C", help="without CONTACTS: F = C h, C sqrt(R*) h^1.5")
    add("--box", type=BOX.read, metavar="LX,LY", help=BOX.meaning)
    add("--columns", help=columns)
    add("--rest", metavar="CONDITION", help="balls that are held at rest")
    add("--drive", metavar="CONDITION", help="balls that are driven")
    add("--direction", help="direction of the drive: x, y, z or 1,0.5 (x)")
    add("--cut", metavar="AXES", help="axes of a periodic box whose ends are cut: x or xy")
    add("--displacement", choices=KINDS, help="what a ball has (vector where there are positions)")
    add("--prestress", action=argparse.BooleanOptionalAction, help=prestress)
    add("--tangential", type=magnitude, metavar="RATIO", help="tangential over normal stiffness")
    add("--damping", type=magnitude, metavar="BETA", default=BETA, help="of each contact (.003)")
    return parser  # fmt: skip


def _check(options):
    """Refuse words that contradict each other."""
    if options.hertz is not None and options.law != "hertz":
        raise InputError("--hertz goes with --law hertz")
    if options.cut is not None and not re.fullmatch("[xyz]{1,3}", options.cut):
        raise InputError(f"--cut {options.cut}: must be axes, such as x or xy")
    of_vectors = options.prestress or options.tangential or options.direction is not None
    if options.displacement == "scalar" and of_vectors:
        raise InputError("--prestress, --tangential and --direction need vector displacements")
    is_graph = options.balls.lower().endswith(".graphml")
    if is_graph and options.contacts:
        raise InputError("one GraphML file holds both, dumps and CSV are two")
    options.by_geometry = not is_graph and not options.contacts
    told = options.law not in POWERS or options.hertz or options.columns
    if told if options.by_geometry else options.modulus:
        raise InputError(
            "where CONTACTS is missing, and only there, balls that overlap are in contact: this "
            "needs --law hertz or harmonic, and takes --modulus, but no --hertz and --columns"
        )


def _cautions(made, contacts, options):
    """Say what speaks against the stiffness, or against the rest, of a packing."""
    if not made.network.held.any():
        yield "no ball is held: the network floats; it has modes, sound and waves, and only " \
            "-drive_balls drives it; --rest and --drive hold balls"  # fmt: skip
    power = contacts.power
    if power.words:
        taken = np.median((made.stiffness * contacts.overlap / contacts.force)[power.clear])
        if abs(taken - power.value) > power.far:
            by = options.law or "its column"
            yield f"the stiffness is {taken:.3g} F/h by {by}, but {power.words}"
    if made.error > UNSURE:
        yield f"the digits of overlaps leave a stiffness open by up to {made.error:.1g} of it; " \
            "dump_modify ID format float %.16g prints more of them"  # fmt: skip
    if made.unbalanced is not None and made.unbalanced > BALANCED:
        yield f"forces leave {made.unbalanced:.2g} of the mean one on a free ball: gravity, " \
            "friction, contacts cut or missing (--box) balance it, or nothing does"  # fmt: skip


def _summary(made, contacts, options):
    """Say in a few lines what has been written, what was left out, and what to do next."""
    network, kept = made.network, made.kept
    yield balls_of(network, options.output)
    moves = {"vector": "vectors", "rotations": "vectors and rotations"}.get(network.displacement)
    plane = f"{moves} in {network.axes} dimensions, driven along {_words(network.direction)}"
    yield f"displacements: {plane if moves else 'scalar'}"
    for path, table in {t.path: t for t in (contacts.balls.table, contacts.table)}.items():
        if table.snapshots > 1:
            yield f"{path}: the last of {table.snapshots} snapshots, of the time step {table.step}"
    roles = [f"{role} = {contacts.roles[role]}" for role in ROLES if role in contacts.roles]
    if options.by_geometry:
        roles = [f"none; overlaps are {contacts.overlap.mean():.3g} in the mean"]
    yield f"columns of contacts: {', '.join(roles)}"
    left_out = (
        (kept.rattlers, "rattler", "without contacts"),
        (kept.torn_off, "ball", "torn off by the cut"),
        (kept.floating, "ball", "in parts without a path to a held ball"),
        (kept.idle, "held ball", "without a free neighbour"),
        (made.apart, "contact", "of balls that do not touch"),
        (made.twice, "contact", "listed a second time"),
        (kept.inert, "contact", "between held balls"),
    )
    texts = [f"{counted(count, what)} {why}" for count, what, why in left_out if count]
    yield f"left out: {'; '.join(texts) or 'nothing'}"
    if options.cut:
        yield f"cut: {counted(made.cut, 'contact')} across {' and '.join(options.cut)}"
    k, law = network.stiffness, options.law or contacts.roles["stiffness"]
    formula = {"hertz": "hertz, 3/2 F/h", "harmonic": "harmonic, F/h"}.get(law, f"column {law}")
    if options.hertz is not None:
        formula = f"hertz, 3/2 c^(2/3) F^(1/3) with c = {options.hertz:g}"
    if made.error:
        formula += f", each to {made.error:.1g} by the digits"
    yield f"stiffness: {formula}; {k.min():.4g} to {k.max():.4g}; {contacts.power.words}".rstrip(
        "; "
    )
    if not contacts.balls.weighed:
        yield "masses: all 1, as the balls have no column mass, or density and radius"
    yield f"omega_mx {network.omega_mx:.4g}, by the stiffest contact, {network.kmax:.4g}, and " \
        f"the median mass, {network.mass:.4g}, of the whole packing, whatever is held"  # fmt: skip
    if made.unbalanced is not None:
        stress = "are not kept as" if network.force is None else "are"
        yield f"forces {stress} pre-stress; the largest unbalanced one on a free ball is " \
            f"{made.unbalanced:.2g} of the mean contact force"  # fmt: skip
    yield _rigidity(network)
    yield next_step(network, options.output)
    ball = middle(network)
    name = made.members["id"][ball]
    name = name.decode() if isinstance(name, bytes) else name
    yield f"(ball {ball}, of the id {name}, is free and in the middle; /network/id has all ids)"


def balls_of(network, path):
    """Say which balls and contacts of a network are in a file."""
    free, rest, driven = np.bincount(network.held, minlength=3)
    balls = f"{counted(free, 'free ball')}, {rest} at rest, {driven} driven"
    return f"{path}: {balls}; {counted(network.bonds, 'contact')}"


def next_step(network, path):
    """Return the command line that computes with a network, heard at a ball in its middle."""
    ball = middle(network)
    drive = "" if DRIVEN in network.held or network.push is not None else f"-drive_balls {ball} "
    return f"next: pgran run FILE -network_file {path} {drive}-detectors {ball}"


def _words(direction):
    """Return a direction as the name of an axis, or as its components."""
    axes = np.flatnonzero(direction)
    if len(axes) == 1 and direction[axes[0]] > 0:
        return AXES[axes[0]]
    return ",".join(f"{x:.4g}" for x in direction)


def _rigidity(network):
    """Say how many contacts a free ball has, and how many an isostatic packing would have."""
    free = network.held == FREE
    ends = network.bond[free[network.bond]]
    contacts = np.bincount(ends, minlength=len(free))[free]  # of each free ball
    text = f"contacts per free ball: {contacts.mean():.4g}"
    if network.displacement == "scalar":
        return text
    springs = network.bonds * (1 if network.tangential is None else network.axes)
    least = network.size - (0 if network.held.any() else network.axes - 1)  # as of `Packed`
    excess = springs - least
    text += f"; {springs} springs for {network.size} unknowns, {abs(excess)} " \
        f"{'fewer' if excess < 0 else 'more'} than isostatic ({least})"  # fmt: skip
    loose = np.count_nonzero(contacts <= network.axes)
    few = f"; {counted(loose, 'ball')} with {network.axes} contacts or fewer"
    return text + (few if loose else "")


def middle(network):
    """Return the free ball nearest to the middle (first of equals), or in the list's middle."""
    if network.position is None:
        return int(network.free[len(network.free) // 2])
    position = network.position
    away = position[network.free] - (position.min(axis=0) + position.max(axis=0)) / 2
    distance = np.linalg.norm(away, axis=1)
    return int(network.free[np.argmax(distance <= distance.min() * (1 + 1e-9))])
