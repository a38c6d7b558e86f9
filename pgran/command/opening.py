"""The first line of a run: what it solves."""

from pgran.store.estimate import counted
from pgran.store.si import SI


def opening(options, ranks, lattice=None):
    """Return in words what a run solves, and on how many ranks.

    The lattice is that of the run, of an ensemble its first sample; None where there is none.
    """
    scene, of, samples = options.scene, None, None
    if scene in ("ensemble", "accuracy"):
        of = options.ensemble_of if scene == "ensemble" else options.accuracy_of
    if scene == "ensemble":
        samples = options.ensemble_samples
    if lattice is None:
        size = " x ".join(f"{length:g}" for length in options.continuum_size)
        facts = [f"a homogeneous box of {size}", f"beta {options.continuum_damping:g}"]
    elif options.network_file is not None:
        facts = [*_network(options, lattice), *_constants(options, lattice, of or scene)]
    else:
        facts = [*_lattice(options, lattice, samples), *_constants(options, lattice, of or scene)]
    facts.append(counted(ranks, "rank"))
    return f"{scene} of {f'{of} of ' if of else ''}{', '.join(facts)}"


def _network(options, network):
    """Return the facts of a network that was read."""
    yield f"the network {options.network_file}"
    yield f"{len(network.free)} free balls, {network.bonds} contacts"
    moves = {"scalar": "scalar displacements", "vector": "vectors", "rotations": "rotations"}
    where = "" if network.displacement == "scalar" else f" in {network.axes} dimensions"
    yield moves[network.displacement] + where


def _lattice(options, lattice, samples):
    """Return the facts of a lattice, or of many."""
    size = " x ".join(map(str, lattice.shape))
    yield f"a {size} lattice" if samples is None else f"{samples} lattices of {size}"
    law = options.bonds_law
    if law == "file":
        yield f"bonds of {options.bonds_file}"
        return
    between = f"{options.bonds_kmin:g} and {options.bonds_kmax:g}" if law == "bimodal" else ""
    if law in ("uniform", "loguniform"):
        between = f"[{options.bonds_kmin:g}, {options.bonds_kmax:g}]"
    yield {
        "constant": f"constant bonds {lattice.kmax:g}",
        "bimodal": f"bimodal bonds {between}, {options.bonds_fraction:g} of them the latter",
        "hertz": f"Hertzian bonds, mean force {options.bonds_force:g}, c {options.bonds_hertz:g}",
    }.get(law, f"{law} bonds on {between}")
    first = options.bonds_seed
    yield f"seed {first}" if samples is None else f"seeds {first} to {first + samples - 1}"


def _constants(options, lattice, experiment):
    """Return damping, which modes have not, and the unit of frequency."""
    if experiment != "modes":
        yield f"beta {lattice.damping:g}"
    yield f"omega_mx {lattice.omega_mx:.6g}{SI.of(options).say('Hz', lattice.omega_mx)}"
