"""`pgran units`: what the program's numbers are for balls of a material under a load."""

import math

from pgran.command.words import Parser, positive
from pgran.errors import DONE, InputError, log
from pgran.medium import hertz

GRAVITY = 9.80665  # m/s^2
PACK = "pgran pack --balls 200 --dimension 3 --law hertz --sizes equal"
PACKED = "results/balls.h5"
DESCRIPTION = """\
Compute, in SI units, contact stiffness, omega_mx and the speed of long waves of equal balls in
Hertzian contacts, F = c h^(3/2), and the options of the lattice that has them. The load is that of
the strongest contacts, kmax; a pressure makes the mean one, a quarter of the strongest where
stiffness is uniform on [0, kmax]."""


def run(words):
    """Print a table of units, and the words of an options file."""
    options = _parser().read(words)
    try:
        material = _material(options)
        force = _force(options, material)
        scale = hertz.Scale(material, options.diameter, force, options.dimensions)
        damping = _damping(options, scale)
        if damping is not None and not math.isfinite(scale.own_damping(damping)):
            raise OverflowError
        rows = _table(scale, damping, options.growth)
        commands = _commands(scale, options, damping)
    except (OverflowError, ZeroDivisionError):
        raise InputError("units: these numbers are too far apart to compute with") from None
    if scale.contact_radius > hertz.LARGEST_CONTACT:
        text = "a contact has %.2g of a ball's radius: Hertz's law is for small contacts"
        log.warning(text, scale.contact_radius)
    print(f"{'':<37}{'SI':<22}program's units")
    for name, number, unit, *own in rows:
        print(f"{name:<37}{f'{number:.4g} {unit}':<22}{''.join(own)}".rstrip())
    print(f"\n{commands}")
    return DONE


def _parser():
    """Return the parser of the command line."""
    parser = Parser(
        "units",
        DESCRIPTION,
        "pgran units --diameter 5e-3 --material glass --load 1.6e-3 --restitution .9",
        "pgran units --diameter 1e-3 --material steel --pressure 1e5",
        "pgran units --diameter 5e-3 --material glass --load 1.6e-3 --growth 1e-7",
    )
    add = parser.add_argument
    add("--diameter", type=positive, required=True, metavar="M", help="diameter of a ball, in m")
    named = "its modulus, Poisson's ratio and density"
    add("--material", type=str.lower, choices=hertz.MATERIALS, help=named)
    add("--modulus", type=positive, metavar="PA", help="Young's modulus, in Pa")
    add("--poisson", type=float, metavar="NU", help="Poisson's ratio")
    add("--density", type=positive, metavar="RHO", help="density of the material, in kg/m^3")
    load = parser.add_mutually_exclusive_group(required=True).add_argument
    load("--load", type=positive, metavar="N", help="force of the strongest contacts, in N")
    load("--pressure", type=positive, metavar="PA", help="pressure on the bed, in Pa")
    load("--omega_mx", type=positive, metavar="RAD/S", help="measured omega_mx, in rad/s")
    add("--fraction", type=positive, default=0.64, help="part of the volume that balls fill (.64)")
    add("--contacts", type=positive, default=6.0, help="mean number of contacts of a ball (6)")
    add("--dimensions", type=int, choices=(1, 2, 3), default=2, help="axes of the lattice (2)")
    loss = parser.add_mutually_exclusive_group().add_argument
    loss("--quality", type=positive, metavar="Q", help="quality factor at --frequency")
    loss("--restitution", type=positive, metavar="E", help="restitution of two balls, up to 1")
    add("--growth", type=positive, metavar="M", help="growth of the radius of one ball, in m")
    add("--frequency", type=positive, metavar="HZ", help="frequency of --quality, in Hz")
    return parser


def _material(options):
    """Return the material, the numbers given in place of its own."""
    base = hertz.MATERIALS.get(options.material)
    values = {name: getattr(options, name) for name in ("modulus", "poisson", "density")}
    values = {k: getattr(base, k, None) if v is None else v for k, v in values.items()}
    lacks = [f"--{name}" for name, value in values.items() if value is None]
    if lacks:
        raise InputError(f"units: --material is needed, or else {', '.join(lacks)}")
    return hertz.Material(**values)


def _force(options, material):
    """Return the force of the strongest contacts."""
    if options.fraction > 1:
        raise InputError(f"--fraction {options.fraction:g}: is a part of the volume, at most 1")
    if options.load:
        return options.load
    if options.pressure:
        bed = options.diameter, options.fraction, options.contacts
        return options.pressure / hertz.pressure_of_force(1 / hertz.STRONGEST, *bed)
    mass = hertz.ball_mass(material, options.diameter)
    stiffness = mass * options.omega_mx**2 / (2 * options.dimensions)
    constant = hertz.contact_constant(material, options.diameter)
    return hertz.force_of_stiffness(constant, stiffness)


def _damping(options, scale):
    """Return beta in SI units, or None."""
    if (options.quality is None) != (options.frequency is None):
        raise InputError("units: --quality and --frequency go together")
    if options.quality is not None:
        omega = 2 * math.pi * options.frequency
        return hertz.damping_of_quality(scale.stiffness, options.quality, omega)
    if options.restitution is None:
        return None
    if options.restitution > 1:
        raise InputError(f"--restitution {options.restitution:g}: is at most 1, for elastic balls")
    return hertz.damping_of_restitution(scale.stiffness, scale.mass, options.restitution)


def _table(scale, damping, growth):
    """Return rows of a quantity, its number and unit in SI, and its number in the program's."""
    material, omega = scale.material, scale.omega_mx
    weights = scale.force / (scale.mass * GRAVITY)
    rows = [
        ("Young's modulus", material.modulus, "Pa"),
        ("Poisson's ratio", material.poisson, ""),
        ("density", material.density, "kg/m^3"),
        ("diameter of a ball = spacing", scale.diameter, "m", "1"),
        ("mass of a ball", scale.mass, "kg", "1"),
        ("c of F = c h^(3/2)", scale.constant, "N/m^1.5", f"{scale.own_constant:.4g}"),
        ("force of the strongest contacts", scale.force, "N",
         f"({weights:.3g} x the weight of a ball)"),
        ("mean force, stiffness on [0, kmax]", scale.force / hertz.STRONGEST, "N"),
        ("overlap h", scale.overlap, "m", f"{scale.overlap / scale.diameter:.3g}"),
        ("stiffness kmax = 3/2 F/h", scale.stiffness, "N/m", f"{scale.kmax:.4g}"),
        (f"omega_mx = sqrt({2 * scale.dimensions} kmax/m)", omega, "rad/s", "1"),
        ("frequency omega_mx/(2 pi)", omega / (2 * math.pi), "Hz"),
        ("time 1/omega_mx", 1 / omega, "s", "1"),
        ("long waves, all bonds kmax", scale.velocity, "m/s", f"{math.sqrt(scale.kmax):.4g}"),
    ]  # fmt: skip
    if scale.dimensions > 1:
        speed, own = scale.random_velocity, scale.diameter * omega
        rows.append(("long waves, bonds on [0, kmax]", speed, "m/s", f"{speed / own:.4g}"))
    if damping is not None:
        restitution = hertz.restitution_of_damping(scale.stiffness, scale.mass, damping)
        quality = scale.stiffness / (damping * omega) if damping else math.inf
        rows += [
            ("damping beta", damping, "kg/s", f"{scale.own_damping(damping):.4g}"),
            ("quality factor at omega_mx", quality, ""),
            ("restitution of two balls", restitution, ""),
        ]
    if growth is not None:
        part = growth / scale.overlap  # with its neighbours where they are; k goes like sqrt(h)
        rows += [
            ("growth dR of a ball", growth, "m", f"{growth / scale.diameter:.3g}"),
            ("dR/h of its contacts", part, ""),
            ("dk/k, its neighbours held", math.sqrt(1 + part) - 1, ""),
        ]
    return rows


def _commands(scale, options, damping):
    """Return what an options file needs for a lattice in these units, and commands for a packing.

    They pack these balls, under the mean force, and run the packing.
    """
    lattice = f"-lattice_mass 1 -bonds_kmax {scale.kmax!r} -bonds_hertz {scale.own_constant!r}"
    force, time = scale.packed
    mean = scale.force / hertz.STRONGEST / force
    pressure = hertz.pressure_of_force(mean, 1.0, options.fraction, options.contacts)
    scene = "packing_modes.opts"
    if options.growth is not None:
        scene = "heater_packing.opts -drive_balls 0 -detectors 100 "
        scene += f"-heat_radius {options.growth / scale.diameter!r}"
    if damping is not None:
        lattice += f" -lattice_damping {scale.own_damping(damping)!r}"
        scene += f" -network_damping {damping * time / scale.mass!r}"
    length = f"-units_length {scale.diameter!r}"
    return (
        f"{lattice} {length} -units_time {1 / scale.omega_mx!r}\n"
        f"{PACK} --pressure {pressure!r} -o {PACKED} && pgran run options/{scene} "
        f"-network_file {PACKED} {length} -units_time {time!r}"
    )
