"""What lattices and other networks have in common, whatever asks them."""

from pgran.arguments import shown
from pgran.errors import InputError
from pgran.run.fingerprints import Distinct


class Medium(Distinct):
    """What vibrates: a `pgran.Lattice` or a `pgran.Network`."""


def medium(value):
    """Return a medium that was handed in, as a result's record, too; raise InputError if none."""
    value = getattr(value, "built", value)
    if not isinstance(value, Medium):
        raise InputError(
            f"lattice: a pgran.Lattice or a pgran.Network is needed, not {shown(value)}"
        )
    return value
