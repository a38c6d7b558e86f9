"""Captions: what all figures of a result have in common, in words that a paper can use.

A figure's own words are its `caption`, set where it is drawn; what is proven of the errors of a
group is said by `errors(record, how)` beside its figures. Formulas are LaTeX's.
"""

import numpy as np

from pgran import catalogue
from pgran.draw import marks, style
from pgran.medium.law import IN_WORDS
from pgran.medium.source import in_words

SAMPLES = "bonds", "network"  # figures that show what was computed on
NAMED = 6  # detectors
LETTERS = {"beta": r"\beta", "p": "p", "alpha": r"\alpha", "eta": r"\eta"}  # of damping
AXES = {1: "chain", 2: "square lattice", 3: "cubic lattice"}


def number(value, digits=2):
    r"""Return a number as LaTeX writes it, `$4.1\times10^{-5}$`; 0.003 stays as it is."""
    size = f"{value:.{digits}g}"
    if "e" not in size:
        return size
    mantissa, exponent = size.split("e")
    return rf"${mantissa}\times10^{{{int(exponent)}}}$"


def complete(figure, results, si, sampled=False):
    """Return a figure's own caption with the sample, and the bound reached, of each result.

    A figure of the sample itself (`sampled`) has no error; `si` are the program's units.
    """
    samples = dict.fromkeys(sample(result, si) for result in results)
    reached = [] if sampled else dict.fromkeys(bound(result) for result in results)
    marked = any(line.get_gid() == style.UNIT for ax in figure.panels for line in ax.get_lines())
    unit = r"Dotted line: $\omega_{mx}$." if marked else ""
    return " ".join(filter(None, [figure.caption, *samples, *reached, unit]))


def sample(result, si):
    """Return what was computed on: size, law and seed of bonds or the network's file, damping."""
    medium = getattr(result, "medium", None)
    if medium is None:
        return ""  # the box says what it is
    lines = str(getattr(result, "options", "")).splitlines()
    options = dict(line.lstrip("-").partition(" ")[::2] for line in lines)
    bonds = {key[6:]: _plain(value) for key, value in options.items() if key.startswith("bonds_")}
    if medium.group == "network":
        law = ""
        facts = [f"network of {len(medium.held)} balls, {medium.free_balls} of them free, and "
                 f"{len(medium.bond)} contacts"]  # fmt: skip
        if "network_file" in options:
            facts[0] += f" (file {options['network_file']})"
        facts[0] += f", displacements: {medium.displacement}"
    else:
        count = r" \times ".join(map(str, medium.shape))
        driven = ", one of which is driven" * bool(np.any(medium.built.moved))
        law = IN_WORDS.get(bonds.get("law"), "")
        facts = [f"{AXES[len(medium.shape)]} of ${count}$ balls of mass {number(medium.mass)} "
                 f"between walls{driven}"]  # fmt: skip
        facts += [f"bonds {law.format(**bonds)}"] * bool(law)
    facts += in_words(medium.built)
    ensemble = getattr(result, "ensemble", None)
    if ensemble is not None:
        seeds = ensemble.seed
        facts.append(f"{len(seeds)} samples, seeds {seeds.min()} to {seeds.max()}")
    elif law and bonds["law"] not in ("file", "constant"):
        facts.append(f"seed {bonds['seed']}")
    else:
        facts.append(f"SHA-256 of the bonds {medium.bonds_sha256[:12]}")
    damping = [
        rf"${LETTERS[name]}$ = {number(low)}" + (f" to {number(high)}" if high > low else "")
        for name, (low, high) in medium.built.damping_facts.items()
    ]
    facts.append(f"damping {', '.join(damping)}")
    unit = f"{number(medium.omega_mx, 4)}{si.say('Hz', medium.omega_mx)}"
    facts.append(rf"$\omega_{{mx}}$ = {unit}")
    sites = style.heard(result)
    if sites is not None:
        names = style.ball_names(sites)
        more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
        facts.append(f"heard at {', '.join(names[:NAMED])}{more}")
    return f"Sample: {'; '.join(facts)}."


def _plain(text):
    """Return a number of an options file as a caption has it, other texts as they are."""
    try:
        return text if text.isdigit() else number(float(text), 6)
    except ValueError:
        return text


def bound(result):
    """Return what is proven of the errors of a result, or how they were estimated."""
    medium = getattr(result, "medium", None)
    how = "proven" if medium is not None and medium.built.dissipates else "certified"
    words = []
    for group in catalogue.FIGURES:
        record = getattr(result, group, None)
        errors = record and getattr(catalogue.figures(group), "errors", None)
        words += [errors(record, how)] if errors else []
    return " ".join(dict.fromkeys(words))


def amplitudes(record, how):
    """Return the largest relative bound of amplitudes that are as accurate as asked."""
    size = np.abs(record.displacement)
    failed = np.isnan(size)
    if hasattr(record, "converged_reason"):
        failed |= (record.converged_reason <= 0)[(...,) + (None,) * (size.ndim - 1)]
    floored = np.isfinite(marks.upper_limits(record))
    good = ~failed & ~floored & (size > 0)
    relative = np.divide(record.error_bound, size, out=np.zeros_like(size), where=good)[good]
    words = "No bound of the errors is known."
    if good.any() and np.isfinite(relative).all():
        words = f"Relative error of every amplitude: at most {number(relative.max())} ({how})."
    if floored.any():
        words += f" {np.count_nonzero(floored)} amplitudes are upper limits, at the floor."
    if failed.any():
        missed = f"{np.count_nonzero(failed)} of {size.size} amplitudes"
        words += f" {missed} missed the accuracy asked for."
    if np.any(getattr(record, "unresolved", False)):
        words += " Where it is marked the curve is not resolved between its points."
    return words
