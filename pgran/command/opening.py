"""The first line of a run: what it solves."""

from pgran.command.resolve import SCENES
from pgran.store.estimate import counted
from pgran.store.si import SI


def opening(options, ranks, lattice=None):
    """Return in words what a run solves, and on how many ranks.

    The lattice is that of the run, of an ensemble its first sample; None where there is none.
    """
    of = getattr(options, f"{options.scene}_of", None)
    if lattice is None:
        facts = [*SCENES[options.scene].subject(options)]
    else:
        from pgran.medium.source import in_words

        facts = [*(_lattice if options.network_file is None else _network)(options, lattice)]
        facts += in_words(lattice)
        if of != "modes":  # samples keep no widths of theirs
            facts.append(lattice.law_in_words)
        unit = SI.of(options).say("Hz", lattice.omega_mx)
        facts.append(f"omega_mx {lattice.omega_mx:.6g}{unit}")
    facts.append(counted(ranks, "rank"))
    return f"{options.scene} of {f'{of} of ' if of else ''}{', '.join(facts)}"


def _network(options, network):
    """Return the facts of a network that was read."""
    first, *others = options.network_file
    yield f"{len(others) + 1} networks; {first}" if others else f"the network {first}"
    loose = " without rattlers" * (options.network_rattlers == "remove")
    balls, contacts = counted(len(network.free), "free ball"), counted(network.bonds, "contact")
    yield f"{balls}{loose}, {contacts}"
    moves = {"scalar": "scalar displacements", "vector": "vectors", "rotations": "rotations"}
    where = "" if network.displacement == "scalar" else f" in {network.axes} dimensions"
    yield moves[network.displacement] + where


def _lattice(options, lattice):
    """Return the facts of a lattice, or of many."""
    from pgran.medium.law import DEFAULTS, IN_WORDS

    size, first = " x ".join(map(str, lattice.shape)), options.bonds_seed
    values = {name: getattr(options, f"bonds_{name}") for name in (*DEFAULTS, "file")}
    values |= {name: f"{value:g}" for name, value in values.items() if isinstance(value, float)}
    bonds = "bonds " + IN_WORDS[options.bonds_law].format(**values).replace("$", "")
    if options.scene == "ensemble":
        samples = options.ensemble_samples
        yield from (f"{samples} lattices of {size}", bonds)
        yield f"seeds {first} to {first + samples - 1}"
    else:
        yield from (f"a {size} lattice", bonds)
        if options.bonds_law != "file":
            yield f"seed {first}"
