"""Captions: what all figures of a result have in common, in words that a paper can use.

A figure's own words are its `caption`, set where it is drawn; what is proven of the errors of a
group is said by `errors(record, how)` beside its figures. Formulas are LaTeX's.
"""

import re

import numpy as np

from pgran import catalogue
from pgran.draw import marks, scales, style
from pgran.medium.labels import facts_of
from pgran.store.estimate import counted

SAMPLES = "bonds", "network"  # figures that show what was computed on
NAMED = 6  # detectors
AXES = {1: "chain", 2: "square lattice", 3: "cubic lattice"}


def number(value, digits=2):
    r"""Return a number as LaTeX writes it, `$4.1\times10^{-5}$`; 0.003 stays as it is."""
    size = f"{value:.{digits}g}"
    if "e" not in size:
        return size
    mantissa, exponent = size.split("e")
    return rf"${mantissa}\times10^{{{int(exponent)}}}$".replace(r"$1\times", "$")


def formulas(text):
    """Return words with their letters, products of numbers and powers of ten as formulas."""
    text = re.sub(r"\b(alpha|beta|eta) =", r"$\\\1$ =", text)
    text = re.sub(r"\bp =", "$p$ =", text)
    text = re.sub(r"(?<=\d) x (?=\d)", r" $\\times$ ", text)
    return re.sub(r"\b\d(\.\d+)?e[+-]\d+\b", lambda found: number(float(found[0]), 6), text)


def complete(figure, results, si, sampled=False):
    """Return a figure's own caption with the sample, and the bound reached, of each result.

    A figure of the sample itself (`sampled`) has no error; `si` are the program's units.
    """
    facts = [sample(result, si).split("; ") for result in results]
    if len(set(map(len, facts))) == 1:  # each fact once, and in what it differs
        facts = [[" or ".join(dict.fromkeys(alike)) for alike in zip(*facts, strict=True)]]
    samples = [f"Sample: {'; '.join(told)}." if any(told) else "" for told in facts]
    reached = [] if sampled else dict.fromkeys(bound(result) for result in results)
    return " ".join(filter(None, [figure.caption, *samples, *reached]))


def sample(result, si):
    """Return what was computed on: size, law and seed of bonds or the network's file, damping."""
    medium = getattr(result, "medium", None)
    if medium is None:
        return ""  # the box says what it is
    options = facts_of(result)
    if medium.group == "network":
        facts = [f"network of {len(medium.held)} balls, {medium.free_balls} of them free, and "
                 f"{len(medium.bond)} contacts"]  # fmt: skip
        if "network_file" in options:
            facts[0] += f" (file {options['network_file']})"
        facts[0] += f", displacements: {medium.displacement}"
    else:
        count = r" \times ".join(map(str, medium.shape))
        driven = ", one of which is driven" * bool(np.any(medium.built.wall_motion))
        facts = [f"{AXES[len(medium.shape)]} of ${count}$ balls of mass {number(medium.mass)} "
                 f"between walls{driven}"]  # fmt: skip
        if "bonds_law" in options:
            facts.append(formulas(f"bonds {options['bonds_law']}"))
    facts += medium.built.drive_in_words()
    ensemble = getattr(result, "ensemble", None)
    if ensemble is not None:
        seeds = ensemble.seed
        facts.append(f"{len(seeds)} samples, seeds {seeds.min()} to {seeds.max()}")
    elif "bonds_seed" in options:
        facts.append(f"seed {options['bonds_seed']}")
    else:
        facts.append(f"SHA-256 of the bonds {medium.bonds_sha256[:12]}")
    damping = [
        f"{name} = {number(low)}" + (f" to {number(high)}" if high > low else "")
        for name, (low, high) in medium.built.damping_facts.items()
    ]
    facts.append(formulas(f"damping {', '.join(damping)}"))
    unit = f"{number(medium.omega_mx, 4)}{si.say('Hz', medium.omega_mx)}"
    facts.append(rf"$\omega_{{mx}}$ = {unit}")
    sites = style.heard(result)
    if sites is not None:
        names = style.ball_names(sites)
        more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
        facts.append(f"heard at {', '.join(names[:NAMED])}{more}")
    return "; ".join(facts)


def by_depth(medium, sites, between=", "):
    """Return the order of balls by their distance from what drives, and all their names with it."""
    depths, names = medium.built.depths(sites), style.ball_names(sites)
    factor, unit = scales.unit_of(scales.DISTANCE._replace(own=""), medium, depths.max())
    if np.isfinite(depths).all():
        words = [f"{between}depth {factor * depth:.3g} {unit}".rstrip() for depth in depths]
        names = [name + depth for name, depth in zip(names, words, strict=True)]
    return np.argsort(depths, kind="stable"), names


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
        words += f" Upper limits, at the floor: {counted(np.count_nonzero(floored), 'amplitude')}."
    if failed.any():
        missed = f"{np.count_nonzero(failed)} of {size.size} amplitudes"
        words += f" {missed} missed the accuracy asked for."
    if np.any(getattr(record, "unresolved", False)):
        words += " Where it is marked the curve is not resolved between its points."
    return words
