"""Captions: what all figures of a result have in common, in words that a paper can use.

A figure's own words are its `caption`, set where it is drawn; what is proven of the errors of a
group is said by `errors(record, how)` beside its figures. Formulas are LaTeX's.
"""

import re

import numpy as np

from pgran import catalogue
from pgran.draw import marks, scales
from pgran.medium import labels
from pgran.store.estimate import counted
from pgran.store.record import ball_names

SAMPLES = "bonds", "network"  # figures that show what was computed on
NAMED_DETECTORS = 6  # detectors
FORMULAS = {  # patterns, and what stands for them
    r"\b(alpha|beta|eta) (= )?": r"$\\\1$ = ",
    r"\bp (= )?(?=\d)": "$p$ = ",
    r"\bomega_mx ": r"$\\omega_{mx}$ = ",
    r"(?<=\d) x (?=\d)": r" $\\times$ ",
}


def number(value, digits=2):
    r"""Return a number as LaTeX writes it, `$4.1\times10^{-5}$`; 0.003 stays as it is."""
    size = f"{value:.{digits}g}"
    if "e" not in size:
        return size
    mantissa, exponent = size.split("e")
    return rf"${mantissa}\times10^{{{int(exponent)}}}$".replace(r"$1\times", "$")


def formulas(text):
    """Return words with their letters, products of numbers and powers of ten as formulas."""
    for pattern, formula in FORMULAS.items():
        text = re.sub(pattern, formula, text)
    return re.sub(r"\b\d(\.\d+)?e[+-]\d+\b", lambda found: number(float(found[0]), 6), text)


def complete(figure, results, si, sampled=False):
    """Return a figure's own caption with the sample, and the bound reached, of each result.

    A figure of the sample itself (`sampled`) has no error; `si` are the program's units.
    """
    facts = [sample(result, si) for result in results]
    if len(set(map(len, facts))) == 1:  # each fact once, and in what it differs
        facts = [[" or ".join(dict.fromkeys(alike)) for alike in zip(*facts, strict=True)]]
    samples = [f"Sample: {'; '.join(told)}." if told else "" for told in facts]
    reached = [] if sampled else dict.fromkeys(bound(result) for result in results)
    return " ".join(filter(None, [figure.caption, *samples, *reached]))


def sample(result, si):
    """Return the facts of what was computed on: of `labels.sample`, mass, damping, detectors."""
    medium = getattr(result, "medium", None)
    if medium is None:
        return []  # the box says what it is
    options, ensemble = getattr(result, "options", ""), getattr(result, "ensemble", None)
    seeds = () if ensemble is None else ensemble.seed
    facts = [*labels.sample(medium.built, labels.facts_of(options), seeds)]
    if medium.group == "lattice":
        driven = ", one of which is driven" * bool(np.any(medium.built.wall_motion))
        facts.insert(1, f"balls of mass {number(medium.mass)} between walls{driven}")
    if not len(seeds) and not any(fact.startswith("seed") for fact in facts):
        facts.append(f"SHA-256 of the bonds {medium.bonds_sha256[:12]}")
    unit = f"{medium.omega_mx:.4g}{si.say('Hz', medium.omega_mx)}"
    facts += [medium.built.law_in_words, f"omega_mx {unit}"]
    sites = heard(result)
    if sites is not None:
        names = ball_names(sites)
        more = f" and {len(names) - NAMED_DETECTORS} more" if len(names) > NAMED_DETECTORS else ""
        facts.append(f"heard at {', '.join(names[:NAMED_DETECTORS])}{more}")
    return list(map(formulas, facts))


def heard(result):
    """Return the detectors of a result, shape (nd, dim), None if it has none."""
    records = (getattr(result, group, None) for group in catalogue.RECORDS)
    sites = (getattr(record, "detector", None) for record in records)
    return next((each for each in sites if each is not None), None)


def by_depth(medium, sites, between=", "):
    """Return the order of balls by their distance from what drives, and all their names with it."""
    depths, names = medium.built.depths(sites), ball_names(sites)
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
    return " ".join(filter(None, dict.fromkeys(words)))


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
