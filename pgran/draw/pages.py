"""The figures of a result; matplotlib is imported when they are made.

The `figures(result, **over)` of a group's module, `pgran.figures.response` say, yields names and
pages; `over` is what another result of the same lattice adds, `modes` or `response`. Its panels,
`panel(ax, record, medium)`, draw into axes of the user's and return what they drew; their
docstrings begin with their captions.
"""

import contextlib
import io
from pathlib import Path

from pgran import catalogue
from pgran.errors import FileError, log, needed
from pgran.store.paths import whole
from pgran.store.si import SI


class Figures(dict):
    """Figures by their names; a notebook shows them, with their captions."""

    def _repr_html_(self):
        from pgran.store.display import picture

        return "".join(picture(figure, name) for name, figure in self.items())


def make(result, si=None, width=None, **over):
    """Return all figures of a result by their names. See `pgran.plot`."""
    groups = [group for group in sorted(catalogue.FIGURES) if hasattr(result, group)]
    si = si or SI.of(result)
    for every in (False, True):  # panel, of few points too, where all have few
        with _style([result], width, si, every):
            made = {}
            for module in dict.fromkeys(map(catalogue.figures, groups)):  # some draw several groups
                made |= dict(module.figures(result, **over))
            few = [name for name, figure in made.items() if not len(figure.panels)]
            if len(few) < len(made):
                if few:
                    names = ", ".join(few)
                    log.warning("not drawn, as points are too few for a curve: %s", names)
                made = {name: figure for name, figure in made.items() if name not in few}
                return _finished(made, [result], si)
    why = f"(scene {result.scene}){catalogue.without(result.scene)}"
    raise FileError(f"nothing to draw in this result {why}")


def compare(results, labels, si=None, width=None):
    """Return figures of results of one scene over each other. See `pgran.plot`."""
    si = si or SI()
    with _style(results, width, si):
        from pgran.draw import together

        return _finished(dict(together.figures(results, labels)), results, si)


def _finished(made, results, si):
    """Return figures with what all of them have: SI units, letters of panels, whole captions."""
    from pgran.draw import captions, scales, style

    unit_of = getattr(results[0], "medium", getattr(results[0], "likeness", None))
    if unit_of is not None and not unit_of.omega_mx:
        unit_of = None
    for name, figure in made.items():
        scales.finish(figure, unit_of)
        style.letter(figure.panels)
        figure.caption = captions.complete(figure, results, si, name in captions.SAMPLES)
    return Figures(made)


def add_measured(made, results, data, label, scale=1.0):
    """Draw what was measured into figures of responses; see the response's."""
    with _style(results):
        return catalogue.figures("response").add_measured(made, results, data, label, scale)


@contextlib.contextmanager
def _style(results, width=None, si=None, every=False):
    """Make the style and units hold for a while; raise a FileError without a unit of frequency."""
    if any(hasattr(each, "medium") and not each.medium.omega_mx > 0 for each in results):
        raise FileError("nothing to draw in this result: without stiff bonds omega_mx is 0")
    try:
        style = needed("a figure", "matplotlib", "pgran.draw.style")
    except OSError as error:
        raise FileError(
            f"matplotlib needs a folder that it can write to ({error}): let MPLCONFIGDIR name one"
        ) from None
    with style.applied(width, si, every):
        yield


def save(made, output):
    """Save what `make` returns, and return the paths. See `pgran.plot`."""
    from matplotlib.backend_bases import FigureCanvasBase

    from pgran.draw import style

    output, written = Path(output), []
    # Not what nobody calls a figure, or what needs a LaTeX installation.
    endings = sorted(set(FigureCanvasBase.get_supported_filetypes()) - {"pgf", "raw", "rgba"})
    ending = output.suffix[1:].lower()
    if ending not in endings:
        raise FileError(f"{output}: a figure's name ends in one of .{', .'.join(endings)}")
    for name, figure in made.items():
        path = output.with_name(f"{output.stem}-{name}{output.suffix}")
        with whole(path) as stream, style.applied():
            memory = io.BytesIO()  # where some writers crash when a disk is full
            figure.savefig(memory, format=ending)
            stream.write(memory.getbuffer())
        written.append(path)
    return written


def save_captions(made, paths):
    """Save the captions of figures at these paths, and return them."""
    for figure, path in zip(made.values(), paths, strict=False):
        with whole(path) as stream:
            stream.write(f"{figure.caption}\n".encode())
    return paths
