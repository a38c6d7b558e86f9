"""What tells results apart: the options in which they differ, or their files."""

from pgran.errors import log
from pgran.medium.dissipation import LETTERS
from pgran.medium.labels import facts_of, value_of
from pgran.run.options import options_in

LONGEST_LABEL = 120  # characters of what tells results apart
MOST = 6  # results that colours and line styles tell apart in one figure
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
    facts = [options_in(str(getattr(result, "options", ""))) for result in results]
    return [{k: value_of(each[k]) for k in _differing(facts) if k in each} for each in facts]


def _differing(facts):
    """Return the keys that some of several dicts lack, or have with another value."""
    keys = dict.fromkeys(key for each in facts for key in each)
    return [key for key in keys if len({each.get(key) for each in facts}) > 1]


def label_of(keys, facts):
    """Return options in words: by their own, or their keys without the groups they belong to."""
    words = [
        WORDS.get(key, f"{key.partition('_')[2] or key} {{}}".replace("_", " ")).format(facts[key])
        for key in keys
        if key in facts
    ]
    return ", ".join(words) or "by default"
