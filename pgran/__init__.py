"""Sound in a granular material: Leibig's lattice of balls and random springs."""

__version__ = "0.1.0"


def load(path):
    """Return the records of a result file, `load(path).response`. See `pgran.files.store.load`."""
    from pgran.files import store

    return store.load(path)
