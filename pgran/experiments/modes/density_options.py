"""The options of densities of modes, which `density` reads when these are asked for."""

from pgran.run.options import INTEGER, TEXT, Option

MOST = 10**6  # moments
DENSITY = Option(
    "modes_density", INTEGER, None,
    "count the modes below so many frequencies, instead of finding them, from "
    "-modes_omega_min (0) to -modes_omega_max (above all modes)",
    low=2, high=10**6
)  # fmt: skip
# Of `density.count_modes`, by its keywords.
BY_MOMENTS = {
    "method": Option(
        "modes_density_method", TEXT, "count",
        "count, by a factorization a frequency, certified; moments, estimates by random vectors "
        "with standard errors, for media too large to be factored",
        choices=("count", "moments"),
    ),
    "vectors": Option(
        "modes_density_vectors", INTEGER, 8, "random vectors of the moments", low=2, high=10**6
    ),
    "moments": Option(
        "modes_density_moments", INTEGER, None,
        "of each vector; by default so many that counts are smoothed by a tenth of the distance of "
        "frequencies",
        low=4, high=MOST,
    ),
    "diffusivity": Option(
        "modes_density_diffusivity", TEXT, "none",
        "the axis along which moments estimate the energy diffusivity of modes",
        choices=("none", "x", "y", "z"),
    ),
}  # fmt: skip
