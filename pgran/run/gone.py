"""What earlier versions had, by how it begins, and what to take instead."""

from pgran.errors import InputError

INTEGRATED = (
    "is gone, with the integration in time: take -pulse_method moments, or laplace where motions "
    "are overdamped, contacts pre-stressed, or signals weak"
)
GONE = dict.fromkeys(
    ("pulse_method integrate", "pulse_ts_", "pulse_snes_", "pulse_ksp_", "pulse_pc_"), INTEGRATED
)


def check_gone(text, where):
    """Raise where a key, or a key and its value, is one that earlier versions had."""
    for begin, instead in GONE.items():
        if text.startswith(begin):
            raise InputError(f"-{text}{where}: {instead}")
