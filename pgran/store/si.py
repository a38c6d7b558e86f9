"""What the numbers of a result are in SI units, where the run or its reader says the scale."""

import math
from dataclasses import dataclass

from pgran.errors import InputError

# Powers of the units of length and time that a quantity has, and what it is multiplied with:
# frequencies are angular in the program, and in Hz here.
QUANTITIES = {
    "Hz": (0, -1, 1 / (2 * math.pi)),
    "1/Hz": (0, 1, 2 * math.pi),
    "rad/Hz": (0, 1, 2 * math.pi),
    "s": (0, 1, 1.0),
    "1/s": (0, -1, 1.0),
    "m": (1, 0, 1.0),
    "m/s": (1, -1, 1.0),
}
PREFIXES = {-4: "p", -3: "n", -2: "µ", -1: "m", 0: "", 1: "k", 2: "M", 3: "G", 4: "T"}
FREQUENCIES_IN = "absolute", "omega_mx", "Hz"  # that users give
SMALLEST, LARGEST = 1e-99, 1e99  # units whose powers, times frequencies, are numbers


@dataclass(frozen=True)
class SI:
    """The program's units of length and time, in m and s; None: not known.

    The unit of length of a lattice is the spacing, that of time sqrt(m/k) in the units of m and k.
    """

    length: float | None = None
    time: float | None = None

    def __post_init__(self):
        for name, value in (("length", self.length), ("time", self.time)):
            if value is not None and not SMALLEST <= value <= LARGEST:
                limits = f"{SMALLEST:g} and {LARGEST:g}"
                raise InputError(f"-units_{name}: a unit lies between {limits}, not {value}")

    @classmethod
    def of(cls, result):
        """Return the units that the run of a `record.Result` was given."""
        return cls(*(getattr(result, f"units_{name}", None) for name in ("length", "time")))

    def factor(self, unit):
        """Return what a number is to be multiplied with to be in a key of QUANTITIES, or None."""
        *powers, factor = QUANTITIES[unit]
        for power, own in zip(powers, (self.length, self.time), strict=True):
            if power and own is None:
                return None
            if power:
                factor *= own**power
        return factor

    def angular(self, unit, omega_mx=None):
        """Return the program's angular frequency of one of FREQUENCIES_IN, None if unknown."""
        factor = self.factor("Hz")
        return {"absolute": 1.0, "omega_mx": omega_mx, "Hz": factor and 1 / factor}[unit]

    def say(self, unit, *values):
        """Return numbers of the program in SI units, in parentheses; nothing if unknown.

        As `si.say("Hz", 1.0)`: " (12.5 kHz)".
        """
        factor = self.factor(unit)
        if factor is None:
            return ""
        texts = []
        for value in values:
            shift, prefix = prefix_of(factor * value, unit)
            texts.append(f"{factor * value * shift:.4g} {prefix}")
        return f" ({' to '.join(texts)})"


def prefix_of(value, unit):
    """Return what to multiply with so that a value reads well, and the unit with its prefix."""
    if not (math.isfinite(value) and value) or unit == "1/s":
        return 1.0, unit
    inverse = unit.endswith("/Hz")
    step = math.floor(math.log10(abs(value)) / 3 + 1e-9)
    step = max(min(PREFIXES), min(max(PREFIXES), step))
    name = unit.replace("/", f"/{PREFIXES[-step]}") if inverse else PREFIXES[step] + unit
    return 1000.0**-step, name
