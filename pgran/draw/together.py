"""Results of one scene over each other in one figure, and what was measured over a response.

Curves differ by colour and, for print in grey, by line style; points by their marks.
"""

import textwrap

from matplotlib.mathtext import MathTextParser

from pgran import catalogue
from pgran.draw import captions, style
from pgran.errors import FileError

LINES = ("-", (0, (4, 1)), (0, (1, 0.8)), (0, (4, 1, 1, 1)), (0, (1.5, 2)), (0, (3, 1, 1, 1, 1, 1)))
MARKS = (".", "+", "x", "^", "s", "d")
MOST = len(LINES)
# of which figures have a function `over`
PAGES = ("response", "modes", "relaxation", "pulse", *catalogue.POINTS)
WIDE = 48  # characters of a line in a legend


def figures(results, labels):
    """Yield the names and the pages of results of one scene, each with its label."""
    scene = str(results[0].scene)
    if scene not in PAGES:
        raise FileError(f"results of the scene {scene} are not laid over each other, but of "
                        f"{', '.join(PAGES)}")  # fmt: skip
    if len(results) > MOST and scene not in catalogue.POINTS:
        raise FileError(f"{len(results)} results: at most {MOST} are told apart in one figure")
    labels = [_typeset(label) for label in labels]
    units = [f"{result.medium.omega_mx:.6g}" for result in results]
    differ = len(set(units)) > 1  # axes are in units of each one's own
    if differ:
        pairs = zip(labels, units, strict=True)
        labels = [rf"{label}, $\omega_{{mx}}$ = {unit}" for label, unit in pairs]
    for name, figure in catalogue.figures(scene).over(results, labels):
        figure.caption += r" Each result is in units of its own $\omega_{mx}$." * differ
        yield name, figure


def _typeset(label):
    """Return a label in lines, with formulas where dollars enclose some."""
    try:
        MathTextParser("path").parse(label)
    except ValueError:
        label = label.replace("$", r"\$")
    text = captions.formulas("\n".join(textwrap.wrap(label, WIDE)))
    return f" {text}" if text.startswith("_") else text  # which no legend would list


def curve_look(number):
    """Return the colour and the line style of a result; dashes look thinner than they are."""
    look = {"color": style.COLOURS[number], "linestyle": LINES[number]}
    return look | {"linewidth": 1.0 if number else 0.8}
