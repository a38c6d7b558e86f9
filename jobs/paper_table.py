"""The table of the paper, figure by figure: what it says, and where results hold what is found."""

from itertools import product

import numpy as np
import paper_loud
from paper_beads import GROWTHS, LOADS, measures
from paper_measures import (
    deepest,
    in_its_units,
    local_exponents,
    maxima,
    participation,
    spread,
    width,
    within,
)
from paper_modes import MODES
from paper_rows import Row, Section
from paper_sweeps import SWEEPS

R = Row
PACKED = (
    "400 beads (some 315 free) under pressure, at rest before and after, without friction; contact "
    "forces are W weights of a bead in the mean; 7 frequencies in .05-1 omega_mx, 2 detectors; "
    "damping .003 m omega_mx on all of the relative velocity"
)

LOUD = (
    "packings of 400 beads as above, three of a load; contacts by Hertz, of the quality Q, whose "
    "dashpots follow their stiffness; one wall shaken"
)
VERDICT = (
    "wrong at 22 nm but for the highest load with strong damping: contacts that open and close "
    "change the signal by a third under thirty weights, and with weak damping no tone lasts; the "
    "fundamental is that of springs to 1 % up to .04 to 20 nm, by load and Q; this is of packings "
    "without friction, and the Q of real beads is not known"
)


def heated(weights, growth):
    """Return the row of a load and a growth."""
    return R(
        f"+{growth} A, W = {weights}", "25 %, distant" if growth == max(GROWTHS) else "",
        "{:.2g}, {:.2g}; {:.2g}; {:.3g}, {:.1f}; {:.2g}, {:.2g}, {:.2g} ({} heaters in {} "
        "packings, {} without rest)",
        lambda beads: measures(beads, weights, growth), "see the first row",
    )  # fmt: skip


def loudly(weights, quality):
    """Return the row of a load and a quality."""
    first, *_, last = paper_loud.NM[weights]
    return R(
        f"W = {weights}, Q = {quality}, {first:g} to {last:g} nm", "",
        "{}; {}; {}; {}; {}, {}, {}, {}; {}; {}",
        lambda loud: paper_loud.measures(loud, weights, quality), "see the first row",
    )  # fmt: skip


SECTIONS = (
    *SWEEPS,
    *MODES,
    Section("timeres (section 5): relaxation, one bond a step", ("relaxation_long-timeres",), (
        R("omega, beta", ".6, .01", "{:.2g}, {:.2g}", lambda relaxation_long: (
            relaxation_long.relaxation.omega, relaxation_long.lattice.damping), "as given"),
        R("exponent psi of S(f) ~ f^-psi, plain f", "1.9 (measured: 2 to 2.2)", "{:.3f} +- {:.3f}",
          lambda relaxation_long: (relaxation_long.spectrum.exponent_plain,
                                   relaxation_long.spectrum.exponent_error), "right"),
        R("decades", "1.5", "{:.2f}", lambda relaxation_long: np.log10(
            relaxation_long.spectrum.fit_max / relaxation_long.spectrum.fit_min),
          "right: between the corner of its memory and aliasing (exptime)"),
        R("psi of the sampled form (2 sin pi f)^-psi; the series forgets its first sample, so that "
          "other seeds differ by the error", "", "{:.3f} +- {:.3f}",
          lambda relaxation_long: (relaxation_long.spectrum.exponent,
                                   relaxation_long.spectrum.exponent_error),
          "the paper's 1.9 is nearly 2: of a sampled random walk plain f reads 1.94"),
        R("correlation of B and Delta B", "asked: are they uncorrelated?", "{:.3f} +- {:.3f}",
          lambda relaxation_long: (relaxation_long.memory.increment,
                                   relaxation_long.memory.increment_error),
          "answered: no, they cannot be in a stationary series, -sqrt(kbar / 2M)"),
        R("correlation of successive Delta B", "asked: are they uncorrelated?",
          "{:.3f} +- {:.3f}", lambda relaxation_long: (relaxation_long.memory.successive,
                                                       relaxation_long.memory.successive_error),
          "answered: nearly"),
    )),
    Section("Random places (sections 2 and 6): a packing, and its stiffnesses on a lattice",
            ("geometry_response-amplitude", "geometry_modes-participation"), (
        R("maxima of |A| in .3-1, and its median in .9-1; packing and lattice",
          "asked: what is the role of the geometrical disorder?", "{}, {:.2g}; {}, {:.2g}",
          lambda geometry_response_packing, geometry_response_ordered: [
              number for curve in map(in_its_units, (geometry_response_packing,
                                                     geometry_response_ordered))
              for number in (len(maxima(curve, 0.3, 1)[0]),
                             np.median(within(curve, 0.9, 1)[1]))],
          "answered: as many maxima; places make the fall towards omega_mx less steep"),
        R("median of balls that take part: below .3, .3 to 1, above 1; packing and lattice",
          "asked; over samples: `python jobs/geometry.py`",
          "{:.0f}, {:.0f}, {:.1f}; {:.0f}, {:.0f}, {:.1f}",
          lambda geometry_modes_packing, geometry_modes_ordered: [
              *participation(in_its_units(geometry_modes_packing)),
              *participation(in_its_units(geometry_modes_ordered))],
          "answered: random places localize modes some more"),
    )),
    Section("The heater (section 6): one bead of glass of .5 cm grows", ("beads-growth",), (
        R("packings; below, of the change of |A|: median, 90 % quantile; in which part of the "
          "cases it is 25 % or more; dR/overlap, contacts opened; medians up to 2.5, 5, more "
          "diameters from the detector",
          "a box 28 cm wide, 8 to 15 cm of beads", PACKED, lambda beads: (),
          "right: 25 % is usual under a bead's weight, found in a fifth of the cases under ten, "
          "and does not fade with distance; but .8 K make a bead of glass grow by 180 A, not 1000"),
        *[heated(weights, growth) for growth in GROWTHS for weights in LOADS],
    )),
    Section("Small oscillations (section 2): contacts that open and close at 4 kHz", (), (
        R("nm of the wall at which the linear field opens the first contact; 1 %; up to which the "
          "fundamental of the field changes by 1 %; % of its change at 1.6 nm; at the last "
          "amplitude % of change, second harmonic, mean, contacts that clap; |multiplier|; "
          "packings with unstable states: medians (ranges)",
          "contacts are springs, as the signal was sinusoidal; it moved by 1.4 g, 22 nm",
          LOUD, lambda loud: (), VERDICT),
        *[loudly(*case) for case in product(paper_loud.NM, paper_loud.QUALITIES)],
    )),
    Section("Units (section 4): glass beads of .5 cm", (), (
        R("omega_mx under the weight of a bead (omxest)",
          "> 45 kHz, from numbers for the beads that it does not give", "{}, {}",
          lambda units_weight: (units_weight["frequency omega_mx/(2 pi)"],
                                units_weight["omega_mx = sqrt(4 kmax/m)"].rsplit(maxsplit=1)[0]),
          "right as 4.5e4 / s, its unit of omega_mx; wrong as a frequency, by 2 pi"),
        R("force of the strongest contacts for omega_mx = 200,000 / s (expomx)", "none given", "{}",
          lambda units_speed: " ".join(units_speed["force of the strongest contacts"].split()),
          "unclear: contacts of a bed of 30 layers may bear that, at its bottom"),
    )),
    Section("Where the paper and pgran differ", (), (
        R("simpfreq: which n2", "n2 > 0: lowest resonance 9.93", "n2 >= 0: first maximum at {:.2f}",
          lambda continuum_damped: maxima(continuum_damped.continuum, 0, 40)[0][0],
          "wrong: the lowest driven resonance has n2 = 0"),
        R("eigenfunc", "sin(2 q pi x/L), lowest omega^2 = 8 pi^2",
          "sin(q pi x/L): {:.3f} pi^2, as in eigvalues", lambda continuum_damped:
          continuum_damped.continuum.resonance[0] ** 2 / np.pi**2, "wrong: a misprint"),
        R("cidef: sums over", "0 to N", "0 to N - 1: shapes of {} x {} balls",
          lambda modes: modes.modes.vector.shape[1:], "wrong: a misprint"),
        R("width of the peak of |c_i| at beta = .001, .003",
          "much sharper for a larger beta (section 4, at its end)",
          "{:.4f}, {:.4f}",
          lambda projection_damping_small, projection_three_modes: [
              width(x.projection) for x in (projection_damping_small, projection_three_modes)],
          "wrong, and against its own words before: wider for a larger beta"),
        R("maxima of |A| in .3-1 at beta = .001, .003, .03", "many more for a smaller beta",
          "{}, {}, {}",
          lambda response_damping_small, response, response_damping_large: [
              len(maxima(x.response, 0.3, 1)[0])
              for x in (response_damping_small, response, response_damping_large)], "right"),
        R("dB that a tenth, and a fiftieth, of the dips in .3-1 exceed at balls (8, 2) to (8, 17), "
          "beta = .001, .003, .01: of the curves; on the paper's grid of .001",
          "much shallower for a smaller beta",
          "{:.0f}, {:.0f} (grid {:.0f}, {:.0f}); {:.0f}, {:.0f} (grid {:.0f}, {:.0f}); "
          "{:.0f}, {:.0f} (grid {:.0f}, {:.0f})",
          lambda dips_1, dips_3, dips_10: deepest(dips_1, dips_3, dips_10),
          "wrong: curves have as deep dips at any beta, only more of them; the grid misses the "
          "zeros of a small one, which are narrower than its step"),
        R("slope of the phase, rad per omega_mx, at beta = .0003, .001, .003, .01, .03, .1",
          "increases for a smaller beta", "{:.0f}, {:.0f}, {:.0f}, {:.0f}, {:.0f}, {:.0f}",
          lambda response_damping_least, response_damping_small, response, response_damping_10,
          response_damping_large, response_damping_most: [
              -x.response.phase_slope[0] for x in (
                  response_damping_least, response_damping_small, response, response_damping_10,
                  response_damping_large, response_damping_most)],
          "right; but then its velocity, compared with a speed of sound, is one of the damping"),
        R("the power of 1/beta that it grows like, between these", "",
          "{:.2f}, {:.2f}, {:.2f}, {:.2f}, {:.2f}",
          lambda response_damping_least, response_damping_small, response, response_damping_10,
          response_damping_large, response_damping_most: local_exponents(
              response_damping_least, response_damping_small, response, response_damping_10,
              response_damping_large, response_damping_most),
          "1/2, as of waves that diffuse and are absorbed, in between; it saturates at a small "
          "beta, where modes no longer overlap"),
        R("highest frequency at which a ball oscillates by itself", "omega_mx",
          "{:.3f}; over samples {:.3f} to {:.3f}", lambda modes, ensemble_modes: (
              modes.modes.omega[-1], *spread(ensemble_modes.ensemble.mode_omega[:, -1])[2:4]),
          "wrong: neighbours in opposition reach further, up to sqrt(2) omega_mx"),
        R("the system of equations", "real and not symmetric, by BiCG",
          "complex symmetric, by {} factorizations for the whole curve",
          lambda response: response.response.factorizations,
          "unclear why: complex arithmetic keeps the matrix symmetric"),
        R("run time of response, modes, projections and relaxation",
          "150 hours of a SPARCstation IPX", "{:.0f} s on {} ranks",
          lambda response, modes, projection_dominant, projection_three_modes, relaxation_long: (
              sum(x.seconds for x in (response, modes, projection_dominant,
                                      projection_three_modes, relaxation_long)),
              response.mpi_size), ""),
    )),
)  # fmt: skip
