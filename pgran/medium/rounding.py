"""What rounding does to the residual of a ball."""

import numpy as np

EPSILON = float(np.finfo(float).eps)
SMALLEST_NORMAL = float(np.finfo(float).tiny)  # a result below it may be lost


def residual_rounding(axes):
    """Return the u for which rounding moves a ball's residual by at most u (|f| + |S| |x|).

    Each operation adds at most h = EPSILON / 2 of the sum of all magnitudes, a product of complex
    numbers sqrt(5) h (Brent, Percival, Zimmermann 2007). On a path from the constants to f - S x
    lie

    - 2d - 1 sums of bonds in K_pp, with two more where s C and s^2 m are added, or one product
      (s beta), one product with C_pp and two sums, or two products (m s^2) and a sum: 2d + 3 hold
      all three for d axes;
    - a complex product, 2d sums in the row and the difference from f: less than 2d + 4.

    So 4d + 7, and one more for what is of second order and for evaluating the bound. A residual
    K x - lambda x, stretch by stretch, has fewer: two differences, three products and d sums.
    """
    return (2 * axes + 4) * EPSILON
