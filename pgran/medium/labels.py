"""What was computed on, in words."""

import contextlib

from pgran.medium.law import IN_WORDS, PARAMETERS
from pgran.run.options import options_in
from pgran.store.estimate import counted

MOVES = {"scalar": "scalar displacements", "vector": "vectors", "rotations": "rotations"}


def sample(medium, facts, seeds=()):
    """Yield in words what was computed on: the medium, its bonds, their seed, and what drives it.

    `facts` are its options (`facts_of`); an ensemble has several `seeds`, or files of networks.
    """
    several = len(seeds)
    if medium.is_grid:
        size = " x ".join(map(str, medium.shape))
        yield f"{several} lattices of {size}" if several else f"a {size} lattice"
        if "bonds_law" in facts:
            yield f"bonds {facts['bonds_law']}"
        if several:
            yield f"seeds {seeds[0]} to {seeds[-1]}"
        elif "bonds_seed" in facts:
            yield f"seed {facts['bonds_seed']}"
    else:
        file = facts.get("network_file", "").partition(",")[0]
        yield f"{several} networks; {file}" if several > 1 else f"the network {file}".rstrip()
        loose = " without rattlers" * (facts.get("network_rattlers") == "remove")
        yield counted(medium.free_balls, "free ball") + loose
        yield counted(medium.bonds, "contact")
        where = "" if medium.displacement == "scalar" else f" in {medium.axes} dimensions"
        yield MOVES[medium.displacement] + where
    yield from medium.drive_in_words()


def facts_of(options):
    """Return options by key, numbers as one writes them, and the law of bonds in words.

    `options` is the text that a result has of them. The parameters of the law are in its words
    alone, and a seed is there if it draws anything.
    """
    facts = options_in(str(options))
    for key, text in facts.items():
        if isinstance(value := value_of(text), float):
            facts[key] = f"{value:.6g}"
    if "lattice_shape" in facts:
        facts["lattice_shape"] = facts["lattice_shape"].replace(",", " x ")
    bonds = {key[6:]: value for key, value in facts.items() if key.startswith("bonds_")}
    law = IN_WORDS.get(bonds.get("law"))
    if law:
        facts["bonds_law"] = law.format(**bonds)
        for name in [*PARAMETERS, "file"] + ["seed"] * (bonds["law"] in ("file", "constant")):
            facts.pop(f"bonds_{name}", None)
    return facts


def value_of(text):
    """Return the number that a text of an options file is, or else the text."""
    for kind in (int, float):
        with contextlib.suppress(ValueError):
            return kind(text)
    return text
