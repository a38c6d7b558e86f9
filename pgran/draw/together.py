"""Results of one scene over each other in one figure, and what was measured over a response.

Curves differ by colour and, for print in grey, by line style; points by their marks. More of them
have a scale of colours, over the one option that is another number in each.
"""

import textwrap
from typing import NamedTuple

from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, LogNorm, Normalize
from matplotlib.mathtext import MathTextParser

from pgran import catalogue
from pgran.draw import captions, style
from pgran.errors import FileError
from pgran.medium.differences import MOST, differences, label_of

LINES = ("-", (0, (4, 1)), (0, (1, 0.8)), (0, (4, 1, 1, 1)), (0, (1.5, 2)), (0, (3, 1, 1, 1, 1, 1)))
MARKS = (".", "+", "x", "^", "s", "d")
# of which figures have a function `over`
PAGES = ("response", "modes", "relaxation", "pulse", *catalogue.POINTS)
WIDE = 48  # characters of a line in a legend


def figures(results, labels):
    """Yield the names and the pages of results of one scene, each with its label."""
    scene = str(results[0].scene)
    if scene not in PAGES:
        raise FileError(f"results of the scene {scene} are not laid over each other, but of "
                        f"{', '.join(PAGES)}")  # fmt: skip
    labels = [_typeset(label) for label in labels]
    units = [f"{result.medium.omega_mx:.6g}" for result in results]
    differ = len(set(units)) > 1  # axes are in units of each one's own
    if differ:
        pairs = zip(labels, units, strict=True)
        labels = [rf"{label}, $\omega_{{mx}}$ = {unit}" for label, unit in pairs]
    looks, scale = list(map(Look, labels, style.COLOURS, LINES, MARKS)), None
    if len(results) > MOST and scene not in catalogue.POINTS:
        looks, scale = _by_colour(results)
    for name, figure in catalogue.figures(scene).over(results, looks):
        if scale is not None:
            figure.colorbar(scale, ax=list(figure.panels), label=scale.label, aspect=40, pad=0.02)
            ends = (captions.number(end, 6) for end in scale.get_clim())
            figure.caption += f" Colours: {scale.label}, from {' to '.join(ends)}."
        figure.caption += r" Each result is in units of its own $\omega_{mx}$." * differ
        yield name, figure


class Look(NamedTuple):
    """What a result is called in a legend, and how it is drawn."""

    label: str
    colour: object
    line: object = "-"
    mark: str = "."

    @property
    def curve(self):
        """What `Axes.plot` takes; dashes look thinner than they are."""
        width = 0.8 if self.line == "-" else 1.0
        return {"color": self.colour, "linestyle": self.line, "linewidth": width}

    @property
    def outline(self):
        """What `Axes.stairs` takes, with the label."""
        return {"label": self.label, "edgecolor": self.colour, "linestyle": self.line}


def _by_colour(results):
    """Return the looks of many results, and the scale of their colours, None of seeds."""
    found = differences(results)
    keys = {key for each in found for key in each if not key.startswith("sweep_")}
    values = [each.get(key) for each in found for key in keys]
    if len(keys) != 1 or not all(isinstance(value, int | float) for value in values):
        why = f"at most {MOST} are told apart by labels, more by colours if one option differs that"
        found = ", ".join(sorted(keys)) or "none"
        raise FileError(f"{len(results)} results: {why} is a number, and here differ: {found}")
    (key,) = keys
    if key.endswith("seed"):  # samples, in no order
        return [Look(f"{len(results)} seeds", style.pale("black"))] * len(results), None
    low, high = min(values), max(values)
    norm = LogNorm(low, high) if 0 < 10 * low <= high else Normalize(low, high)
    scale = ScalarMappable(norm, ListedColormap(style.colours(256)))
    scale.label = captions.formulas(f"{label_of([key], {key: ''})} ").strip(" =")
    return [Look("_", scale.to_rgba(value)) for value in values], scale


def _typeset(label):
    """Return a label in lines, with formulas where dollars enclose some."""
    try:
        MathTextParser("path").parse(label)
    except ValueError:
        label = label.replace("$", r"\$")
    text = captions.formulas("\n".join(textwrap.wrap(label, WIDE)))
    return f" {text}" if text.startswith("_") else text  # which no legend would list
