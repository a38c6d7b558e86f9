"""How errors are written: in summaries, in figures, in captions."""


def two_digits(error):
    """Return an error with two digits, as it stands after +-: 13, 0.0023, 2600.

    Not collective. Only numbers below 1e-4 or from 1e6 on have an exponent.
    """
    return f"{float(f'{error:.2g}'):g}"
