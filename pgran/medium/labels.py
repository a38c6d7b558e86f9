"""What was computed on, in words, and what tells results apart: their options, or their files."""

import logging

from pgran.medium.dissipation import LETTERS
from pgran.medium.law import IN_WORDS, PARAMETERS
from pgran.run.options import options_in
from pgran.store.estimate import counted

log = logging.getLogger("pgran")

LONGEST_LABEL = 120  # characters of what tells results apart
MOST = 6  # results that colours and line styles tell apart in one figure
# Options that are not called by their keys; {} is the value.
WORDS = {key: f"{letter} = {{}}" for key, letter in LETTERS.items()}
WORDS |= {"lattice_shape": "{} balls", "network_file": "network {}", "bonds_law": "bonds {}"}
WORDS |= {"sweep_points": "{} points", "network_damping": WORDS["lattice_damping"]}
WORDS |= {"drive_part": "driven at {}", "drive_balls": "force on {}", "bonds_redrawn": "{} redrawn"}
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


def labels_of(results, names):
    """Return a label of each result: the options in which they differ, else its file's name.

    How a run was carried out, and what it stored, is no difference, nor at which frequencies, which
    curves show, unless nothing else is.
    """
    facts = [facts_of(getattr(result, "options", "")) for result in results]
    differ = _differing(facts)
    labels = [label_of(differ, each) for each in facts]
    fewer = [label_of([k for k in differ if not k.startswith("sweep_")], each) for each in facts]
    labels = fewer if len(set(fewer)) == len(set(labels)) else labels
    told = []
    for label, name in zip(labels, names, strict=True):
        if labels.count(label) > 1 or len(label) > LONGEST_LABEL:
            why = f"no short words tell it apart: {label}" if differ else "no option differs"
            log.warning("%s is named by its file: %s", name, why)
            label = f"file {name}"
        told.append(label)
    return told


def differences(results):
    """Return of each result {key: value} of the options in which they differ, numbers as such."""
    from pgran.store.text import value_of

    facts = [options_in(str(getattr(result, "options", ""))) for result in results]
    return [{k: value_of(each[k]) for k in _differing(facts) if k in each} for each in facts]


def _differing(facts):
    """Return the keys that some of several dicts lack, or have with another value."""
    keys = dict.fromkeys(key for each in facts for key in each)
    return [key for key in keys if len({each.get(key) for each in facts}) > 1]


def facts_of(options):
    """Return options by key, numbers as one writes them, and the law of bonds in words.

    `options` is the text that a result has of them. The parameters of the law are in its words
    alone, and a seed is there if it draws anything.
    """
    facts = {key: _plain(text) for key, text in options_in(str(options)).items()}
    if "lattice_shape" in facts:
        facts["lattice_shape"] = facts["lattice_shape"].replace(",", " x ")
    bonds = {key[6:]: value for key, value in facts.items() if key.startswith("bonds_")}
    law = IN_WORDS.get(bonds.get("law"))
    if law:
        facts["bonds_law"] = law.format(**bonds)
        for name in [*PARAMETERS, "file"] + ["seed"] * (bonds["law"] in ("file", "constant")):
            facts.pop(f"bonds_{name}", None)
    return facts


def _plain(text):
    """Return a number of an options file as one writes it, other texts as they are."""
    try:
        return text if text.isdigit() else f"{float(text):.6g}"
    except ValueError:
        return text


def label_of(keys, facts):
    """Return options in words: by their own, or their keys without the groups they belong to."""
    words = [
        WORDS.get(key, f"{key.partition('_')[2] or key} {{}}".replace("_", " ")).format(facts[key])
        for key in keys
        if key in facts
    ]
    return ", ".join(words) or "by default"
