"""The records that functions return and results hold, `pgran.results.Response` and so on.

Each is declared in the `record.py` of its experiment.
"""

from pgran.catalogue import RECORDS, record_kind


def __getattr__(name):
    """Return a record by its name."""
    for group in RECORDS:
        if (kind := record_kind(group)).__name__ == name:
            return kind
    raise AttributeError(f"module pgran.results has no attribute {name!r}")
