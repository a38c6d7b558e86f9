"""Labels of results: the options in which they differ, or else the names of their files."""

import logging

from pgran.medium.dissipation import LETTERS
from pgran.medium.law import IN_WORDS, PARAMETERS
from pgran.run.options import options_in

log = logging.getLogger("pgran")

LONGEST_LABEL = 120  # characters of what tells results apart
# Options that are not called by their keys; {} is the value.
WORDS = {key: f"{letter} = {{}}" for key, letter in LETTERS.items()}
WORDS |= {"lattice_shape": "{} balls", "network_file": "network {}", "bonds_law": "bonds {}"}
WORDS |= {"sweep_points": "{} points", "network_damping": WORDS["lattice_damping"]}
WORDS |= {"drive_part": "driven at {}", "drive_balls": "force on {}", "bonds_redrawn": "{} redrawn"}


def labels_of(results, names):
    """Return a label of each result: the options in which they differ, else its file's name.

    How a run was carried out, and what it stored, is no difference, nor at which frequencies, which
    curves show, unless nothing else is.
    """
    facts = [facts_of(result) for result in results]
    keys = dict.fromkeys(key for each in facts for key in each)
    differ = [key for key in keys if len({each.get(key) for each in facts}) > 1]
    labels = [_label(differ, each) for each in facts]
    fewer = [_label([k for k in differ if not k.startswith("sweep_")], each) for each in facts]
    labels = fewer if len(set(fewer)) == len(set(labels)) else labels
    told = []
    for label, name in zip(labels, names, strict=True):
        if labels.count(label) > 1 or len(label) > LONGEST_LABEL:
            why = f"no short words tell it apart: {label}" if differ else "no option differs"
            log.warning("%s is named by its file: %s", name, why)
            label = f"file {name}"
        told.append(label)
    return told


def facts_of(result):
    """Return the options of a result by key, numbers as one writes them, its law of bonds in words.

    The parameters of that law are in its words alone, and a seed is there if it draws anything.
    """
    options = options_in(str(getattr(result, "options", "")))
    facts = {key: _plain(text) for key, text in options.items()}
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


def _label(keys, facts):
    """Return options in words: by their own, or their keys without the groups they belong to."""
    words = [
        WORDS.get(key, f"{key.partition('_')[2] or key} {{}}".replace("_", " ")).format(facts[key])
        for key in keys
        if key in facts
    ]
    return ", ".join(words) or "by default"
