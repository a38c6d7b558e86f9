"""What a notebook shows without being asked: xarray's tables of what there is, and one picture."""

import base64
from html import escape  # all that may come from a file

import numpy as np

MOST = 500_000  # numbers in a result whose figures are quickly made
PANELS = 4  # of a figure that is quickly drawn


def page(thing):
    """Return a record, a result or a medium as HTML: what its records hold, a figure of it."""
    records = [thing] if hasattr(thing, "filled") else thing.as_result().records.values()
    title = type(thing).__name__ if thing in records else repr(thing)
    tables = [_tried(lambda record: record.to_xarray()._repr_html_(), each) for each in records]
    return f"<b>{escape(title)}</b>{''.join(tables)}{_tried(_figure, thing)}"


def picture(figure, name):
    """Return a figure as HTML that holds its picture, its caption below."""
    code = base64.b64encode(figure._repr_png_()).decode()
    image = f"<img alt='{escape(name)}' src='data:image/png;base64,{code}'>"
    return f"<figure>{image}<figcaption>{escape(figure.caption)}</figcaption></figure>"


def _tried(show, thing):
    """Return what a function shows, or in words why it cannot: a look at something never fails."""
    try:
        return show(thing)
    except Exception as error:
        return f"<p>{escape(str(error))}</p>"


def _figure(thing):
    """Return the first figure of a thing as HTML, or in words that it would take its time."""
    result = thing.as_result()
    if hasattr(thing, "filled"):  # a record, without what lies between it and its medium
        medium, *_ = result.records.values()
        result = type(result)([medium, thing], **result.attributes)
    if sum(np.size(x) for each in result.records.values() for _, x in each.filled()) > MOST:
        return "<p>large: plot() draws it</p>"
    made = result.plot()
    name = min(made, key="network".__eq__)  # the first, or what is beside a network
    if len(made[name].axes) > PANELS:
        return "<p>many panels: plot() draws them</p>"
    return picture(made[name], name) + f"<p>plot() has {escape(', '.join(made))}</p>"
