"""Networks in GraphML files, as tables of their nodes and edges."""

import numpy as np

from pgran.errors import FileError, PgranError
from pgran.foreign.tables import Table
from pgran.store.lines import is_number
from pgran.store.paths import open_regular

LARGEST_GRAPH = 2**28  # bytes; NetworkX keeps all of a graph as Python objects


def read_graph(path):
    """Return the tables of the nodes and of the edges of a GraphML file, and the nodes' names.

    The columns `id` and `id1`, `id2` are the names where these are all integers, else numbers from
    0 in the order of the file.
    """
    open_regular(path, what="a GraphML file", most=LARGEST_GRAPH).close()
    try:
        import networkx
    except ImportError:
        cure = "pip install networkx, or give balls and contacts as CSV"
        raise PgranError(f"GraphML is read by NetworkX, which is not here: {cure}") from None
    try:
        graph = networkx.read_graphml(path)
        nodes, edges = list(graph.nodes(data=True)), list(graph.edges(data=True))
    except Exception as error:  # whatever a damaged file makes of NetworkX
        why = f"{type(error).__name__}: {error}"
        raise FileError(f"{path}: NetworkX cannot read it: {why}") from None
    names = [str(name) for name, _ in nodes]
    numbered = all(name.isascii() and name.isdigit() and len(name) < 16 for name in names)
    ids = {name: int(name) if numbered else k for k, name in enumerate(names)}
    balls = [{**data, "id": ids[str(name)]} for name, data in nodes]
    pairs = [{**data, "id1": ids[str(a)], "id2": ids[str(b)]} for a, b, data in edges]
    return (
        _table_of(path, balls, [f"node {name}" for name in names], "nodes"),
        _table_of(path, pairs, [f"edge {a} - {b}" for a, b, _ in edges], "edges"),
        names,
    )


def _table_of(path, rows, places, what):
    """Return the table of rows given as dictionaries; NaN where one lacks a number."""
    if not rows:
        raise FileError(f"{path}: has no {what}")
    columns, texts = {}, {}
    for name in dict.fromkeys(name for row in rows for name in row):
        words = [row.get(name, np.nan) for row in rows]
        try:
            columns[str(name)] = np.array(words, dtype=float)
        except (TypeError, ValueError, OverflowError):
            row = next(k for k, word in enumerate(words) if not is_number(str(word)))
            texts[str(name)] = (row, str(words[row]))
    return Table(path, columns, texts, places)
