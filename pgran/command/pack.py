"""`pgran pack`: a packing in mechanical equilibrium, made here."""

import contextlib
import dataclasses

import numpy as np

from pgran.balance.networks import floor
from pgran.balance.ordered import DIAGONAL, ordered
from pgran.balance.pack import packed_network
from pgran.command.imports import balls_of, next_step
from pgran.command.words import Parser, positive
from pgran.errors import DONE, InputError
from pgran.medium.dissipation import warn_of_damping
from pgran.medium.network_file import check_output, parts_of, write_network
from pgran.run.options import REALS, Option
from pgran.store.estimate import counted

SHAPE = Option("shape", REALS, None, "ratios of the sides of the box, such as 2,1 (all equal)")
DESCRIPTION = """\
Make a packing of discs or spheres in mechanical equilibrium: in a periodic box under a pressure, or
under gravity on a floor of held balls, with a free surface. Lengths are in mean diameters, masses
in that of a ball of this diameter, and forces in those of the law: F = h is harmonic,
F = sqrt(R_i R_j / (R_i + R_j)) h^(3/2) is Hertz, h the overlap. There is no friction. A CONDITION
compares a coordinate or the radius of balls, 'x<1.5', 'x>max-1 and y<4'."""


def run(words):
    """Make a packing, and say what it is, on rank 0."""
    options = _parser().read(words)
    check_output(options.output, options.overwrite)
    chosen = {name: value for name, value in vars(options).items() if value is not None}
    output, overwrite = chosen.pop("output"), chosen.pop("overwrite")
    kind, in_order = chosen.pop("displacement", None), chosen.pop("ordered")
    if in_order and kind == "vector":
        raise InputError("pack: --ordered: its lattice does not resist the shear of vectors")
    packing, packed = packed_network(**chosen)
    network = packing
    if in_order:
        network = ordered(packing, chosen.get("seed", 1993))
    elif kind == "scalar":
        network = dataclasses.replace(packing, displacement=kind, direction=None)
    write_network(output, *parts_of(network), overwrite)
    warn_of_damping(network, "-network_damping")
    for line in _summary(output, network, packing, packed):
        print(line)
    return DONE


def _parser():
    """Return the parser of the command line."""
    parser = Parser(
        "pack",
        DESCRIPTION,
        "pgran pack --balls 400 --pressure 1e-3 --walls x -o discs.h5",
        "pgran pack --balls 500 --dimension 3 --law hertz --gravity 1e-6 --walls x -o beads.h5",
        "pgran pack --balls 400 --gravity 1e-5 --walls x --drive 'x>max-1 and y<4' -o box.h5",
    )
    add = parser.add_argument
    add("--balls", type=int, required=True, metavar="N", help="number of balls, rattlers included")
    add("--dimension", type=int, choices=(2, 3), help="2: discs, 3: spheres (2)")
    add("--law", type=_named, help="harmonic, hertz, or a power of the overlap (harmonic)")
    add("--pressure", type=positive, metavar="P", help="pressure, in a periodic box")
    add("--gravity", type=positive, metavar="G", help="gravity down the last axis, on a floor")
    add("--sizes", type=_named, help="bidisperse (1 : 1.4), equal, or a spread such as .1")
    add("--shape", type=SHAPE.read, help=SHAPE.meaning)
    add("--walls", choices=tuple("xyz"), help="hold both ends of this axis, and drive the far one")
    add("--rest", metavar="CONDITION", help="more balls that are held at rest")
    add("--drive", metavar="CONDITION", help="balls that drive; those of walls are then at rest")
    add("--seed", type=int, help="seed of the random positions: which packing (1993)")
    kinds = ("vector", "scalar")
    add("--displacement", choices=kinds, help="scalar: one component, the paper's model (vector)")
    add("--ordered", action="store_true", help="put its stiffnesses at random on a lattice")
    add("-o", "--output", required=True, help="HDF5 file to write")
    add("--overwrite", action="store_true", help="replace an existing network")
    return parser


def _named(text):
    """Return a name, of a law or of a distribution of diameters, or else a number."""
    with contextlib.suppress(ValueError):
        return float(text)
    return text


def _summary(output, network, packing, packed):
    """Say in a few lines what has been made, how well it balances, and what to do next."""
    yield balls_of(network, output)
    if network.power is None:
        diagonals = np.count_nonzero(network.distance > DIAGONAL * network.distance.min())
        yield f"these are on a lattice, {diagonals} along diagonals; of the packing itself:"
    yield f"{counted(packed.rattlers, 'rattler')} left out; {packed.excess} contacts more than " \
        "an isostatic packing has"  # fmt: skip
    yield f"forces balance to {packed.rest.residual:.1e} of the mean one, by positions alone to " \
        f"{floor(packing):.1e}; mean overlap {packing.overlap.mean():.3g}"  # fmt: skip
    yield f"{packed.descents} steps of FIRE, {counted(packed.rest.factorizations, 'factorization')}"
    if packed.rest.saddle:
        yield "the packing rests on a saddle of its energy: try another --seed"
    yield next_step(network, output)
