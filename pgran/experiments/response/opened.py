"""Which drive opens contacts, in words, of a medium that says how far these overlap."""

import numpy as np

from pgran.errors import InputError
from pgran.medium.overlaps import are_lengths, overlaps_of
from pgran.run.experiment import Caution
from pgran.store.si import SI


def in_words(response, lattice, si):
    """Yield which drive opens the first contact and 1 %, where least does, or why none is known."""
    try:
        overlaps = overlaps_of(lattice.built)
    except InputError as error:
        yield f"no drive that opens contacts is known: {error}"
        return
    if response.opening is None:  # of an older version
        return
    known = response.opening_contact >= 0
    if not known.any():
        if response.method == "curve":
            yield "models do not say which drive opens contacts; -sweep_method points does"
        else:
            yield "no bound is known of the drive that opens contacts"
        return
    if si.length and not are_lengths(lattice.built, overlaps):
        si = SI(time=si.time)
        yield Caution(
            f"contacts overlap by up to {overlaps.overlap.max():.3g} spacings: -bonds_hertz is not "
            "in force / spacing^(3/2), and what opens contacts is not in m"
        )
    least = np.where(known, response.opening[:, 0], np.inf).argmin()
    size = lattice.built.drive_size  # a push may have any
    first, part = (
        " to ".join(dict.fromkeys(f"{end:.3g}" for end in ends)) + si.say("m", ends[0])
        for ends in (size * response.opening[least], size * response.opening_part[least])
    )
    omega, mean = response.omega[least], overlaps.overlap.mean()
    what = "a motion of the wall" if lattice.push is None else "F / kmax"
    yield (
        f"contact {response.opening_contact[least]} opens first, by the linear field: at "
        f"omega = {omega:.6g}{si.say('Hz', omega)} from {what} of {first} on, "
        f"1 % of contacts from {part} on; they overlap by {mean:.3g}{si.say('m', mean)} on average"
    )
