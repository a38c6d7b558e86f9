"""`pgran sound`: how fast long waves are in a packing or a lattice, and how stiff it is."""

from pgran.command.export import blaming_edits, result_of
from pgran.command.words import Parser, positive
from pgran.errors import DONE, log
from pgran.medium.statics import sound
from pgran.store.estimate import counted
from pgran.store.si import SI

DESCRIPTION = """\
Say how fast long waves run in a periodic packing, or in the lattice of a result, and what its
elastic moduli are, by static deformations: affine ones, where balls move with a uniform
deformation, and relaxed ones, where forces balance, as they do in waves. Speeds are means over
directions, with the smallest and the largest one."""


@blaming_edits
def run(words):
    """Print a table of speeds and moduli."""
    parser = Parser(
        "sound",
        DESCRIPTION,
        "pgran sound results/periodic.h5",
        "pgran sound results/modes.h5 -units_length 5e-3 -units_time 1.27e-5",
    )
    add = parser.add_argument
    add("file", metavar="FILE", help="HDF5 file of pgran pack, pgran import or pgran run")
    for name, unit in (("length", "m"), ("time", "s")):
        words_of = f"the unit of {name} in {unit}, if not the one that the run was given"
        add(f"-units_{name}", type=positive, metavar=unit.upper(), help=words_of)
    options = parser.read(words)
    result = result_of(options.file)
    own = SI.of(result)
    si = SI(options.units_length or own.length, options.units_time or own.time)
    found = sound(result.medium)
    print("\n".join(table(found, result.medium, si)))
    if (found.transverse or found.longitudinal).slowest < 0:  # no wave is slower
        log.warning("a negative speed: c^2 < 0; such a shear would rearrange the packing")
    return DONE


def table(found, medium, si):
    """Yield in words how fast waves are, and in SI units where these are known."""
    how = f"in a periodic box, {counted(found.rattlers, 'rattler')} left out"
    kinds = {"longitudinal waves": found.longitudinal, "transverse waves": found.transverse}
    numbers = {"bulk modulus": found.bulk, "shear modulus": found.shear}
    if medium.group == "lattice":
        how = "pulled between walls, its sides free"
    if found.transverse is None:
        kinds, numbers = {"long waves": found.longitudinal}, {"modulus": found.shear}
    yield f"{counted(found.balls, 'ball')}, {how}; omega_mx {medium.omega_mx:.6g}"
    heads = "relaxed", "over omega_mx", "affine", "single directions"
    yield _row(f"speed, {medium.length} x frequency", *heads)
    for name, waves in kinds.items():
        speeds = waves.speed, waves.speed / medium.omega_mx, waves.affine
        ends = f"{waves.slowest:.4g} to {waves.fastest:.4g}"
        yield _row(name, *(f"{x:.4g}" for x in speeds), ends) + si.say("m/s", waves.speed)
    for name, number in ({"mass per volume": found.density} | numbers).items():
        yield _row(name, f"{number:.4g}")


def _row(name, relaxed, *others):
    """Return a line of the table."""
    return (f"{name:<32}{relaxed:<11}" + "".join(f"{text:<16}" for text in others)).rstrip()
