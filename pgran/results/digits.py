"""How errors and numbers of things are written: in summaries, in figures, in captions."""


def two_digits(error):
    """Return an error with two digits, as it stands after +-: 13, 0.0023, 2600.

    Not collective. Only numbers below 1e-4 or from 1e6 on have an exponent.
    """
    return f"{float(f'{error:.2g}'):g}"


def counted(count, name):
    """Return a number of things in words, "1 frequency", "2 frequencies". Not collective."""
    if count != 1:
        name = f"{name[:-1]}ies" if name.endswith("y") else f"{name}s"
    return f"{count} {name}"
