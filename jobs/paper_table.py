"""What the paper says, figure by figure, and where result files hold what pgran found."""

from typing import NamedTuple

import numpy as np
from paper_beads import GROWTHS, LOADS, measures
from paper_measures import (
    apart,
    audible,
    bonds,
    count,
    deep,
    excited,
    in_its_units,
    maxima,
    nearest,
    off_drive,
    participation,
    power_of_damping,
    spread,
    usual,
    width,
    within,
)

from pgran.driven.phase import fit_line

BEAD, SPEED = 0.5, 5700.0  # cm and cm/s, measured (paper: velobs)
MEASURED = "measured: not to be computed by the model"


class Row(NamedTuple):
    """What the paper says of a quantity, and the function of results that says what pgran found."""

    what: str
    paper: str
    form: str
    found: callable


class Section(NamedTuple):
    """A figure of the paper, or numbers beyond figures: files of figures, and rows."""

    title: str
    drawn: tuple
    rows: tuple


R = Row
PACKED = (
    "400 beads (some 315 free) under pressure, at rest before and after, without friction; contact "
    "forces are W weights of a bead in the mean; 7 frequencies in .05-1 omega_mx, 2 detectors; "
    "damping .003 m omega_mx on all of the relative velocity"
)


def heated(weights, growth):
    """Return the row of a load and a growth."""
    return R(
        f"+{growth} A, W = {weights}", "25 %, distant" if growth == max(GROWTHS) else "",
        "{:.2g}, {:.2g}; {:.2g}; {:.3g}, {:.1f}; {:.2g}, {:.2g}, {:.2g} ({} heaters in {} "
        "packings, {} without rest)",
        lambda beads: measures(beads, weights, growth),
    )  # fmt: skip


SECTIONS = (
    Section("exptime, expfreq (section 1): the experiment of Liu and Nagel", (), (
        R("(exptime) exponent of the power spectrum", "2 from 1e-5 to 1e-1 Hz", MEASURED,
          lambda: ()),
        R("(exptime) driving frequency, acceleration", "4 kHz, 1.4 g", MEASURED, lambda: ()),
    )),
    Section("sprlat (section 2): balls and springs, one wall driven; here 4 x 4",
            ("lattice-bonds",), (
        R("balls", "", "{} x {}", lambda lattice: lattice.lattice.shape),
    )),
    Section("exactpl (section 3): the homogeneous box at (.47, .52)",
            ("continuum_undamped-exactpl", "continuum_damped-exactpl"), (
        R("(a) beta = 0: first maxima of |A|", "at the resonances (simpfreq)",
          "{:.2f}, {:.2f}, {:.2f}; resonances {:.3f}, {:.3f}, {:.3f}",
          lambda continuum_undamped: [*maxima(continuum_undamped.continuum, 0, 40)[0][:3],
                                      *np.unique(continuum_undamped.continuum.resonance)[:3]]),
        R("(a) largest |A| on the grid", "much greater than the wall's", "{:.3g}",
          lambda continuum_undamped: continuum_undamped.continuum.amplitude.max()),
        R("(b) beta = .003: first maxima", "at the resonances", "{:.2f}, {:.2f}, {:.2f}",
          lambda continuum_damped: maxima(continuum_damped.continuum, 0, 40)[0][:3]),
        R("(b) maxima up to 40, and resonances", "higher modes merge", "{}, and {}",
          lambda continuum_damped: (len(maxima(continuum_damped.continuum, 0, 40)[0]),
                                    len(continuum_damped.continuum.resonance))),
        R("(b) median |A| for omega in 10-20, 30-40", "overall decrease", "{:.2f}, {:.2f}",
          lambda continuum_damped: [np.median(within(continuum_damped.continuum, a, a + 10)[1])
                                    for a in (10, 30)]),
    )),
    Section("sprpic (section 4): the lattice", ("response-bonds",), (
        R("balls; bonds", "20 x 20; (840 by counting)", "{} x {}; {}",
          lambda response: [*response.lattice.shape, bonds(response.lattice).size]),
        R("bond constants", "random in [0, .25]", "{:.4f} to {:.4f}",
          lambda response: (bonds(response.lattice).min(), bonds(response.lattice).max())),
        R("detecting ball, and spacings to the driven wall", "(8, 10), 12", "({}, {}), {}",
          lambda response: [*response.response.detector[0],
                            response.lattice.shape[0] - response.response.detector[0, 0]]),
        R("omega_mx = sqrt(4 Kmax/m) (omxdef)", "1.0", "{:.4g}",
          lambda response: response.lattice.omega_mx),
    )),
    Section("freqres (section 4): the frequency response of ball (8, 10)",
            ("response-amplitude",), (
        R("frequencies", ".01 to 1.3", "{:.3g} to {:.3g}, {} of them",
          lambda response: (*response.response.omega[[0, -1]], len(response.response.omega))),
        R("relative error of every amplitude", "1 part in 10000", "at most {:.1e}, proven",
          lambda response: np.max(response.response.error_bound / response.response.amplitude)),
        R("(a) below .3: maxima, and modes", "peaks with little overlap", "{}, and {}",
          lambda response, modes: (len(maxima(response.response, 0, 0.3)[0]),
                                   count(modes.modes, 0, 0.3))),
        R("(a) first maximum, |A| there, and lowest mode", "at the mode",
          "{:.5f}, {:.0f}, and {:.5f}",
          lambda response, modes: [*(x[0] for x in maxima(response.response, 0, 0.3)),
                                   modes.modes.omega[0]]),
        R("(b) .3 to 1: maxima, and modes", "no one-to-one identification", "{}, and {}",
          lambda response, modes: (len(maxima(response.response, 0.3, 1)[0]),
                                   count(modes.modes, 0.3, 1))),
        R("(b) median |A| in .3-.4 and .9-1", "overall decrease", "{:.3g}, {:.3g}",
          lambda response: [np.median(within(response.response, a, a + 0.1)[1])
                            for a in (0.3, 0.9)]),
        R("(c) above 1: maxima", "very smooth", "{}",
          lambda response: len(maxima(response.response, 1, 2)[0])),
        R("(c) |A| at 1 and at 1.3", "decreases very quickly", "{:.2g}, {:.2g}",
          lambda response: [within(response.response, 1, 2)[1][k] for k in (0, -1)]),
    )),
    Section("phaseres (section 4): the phase of the same ball", ("response-phase",), (
        R("slope mu between .3 and 1, rad per omega_mx", "linear; 200 by velobs",
          "{:.1f} +- {:.1f}", lambda response: (-response.response.phase_slope[0],
                                                response.response.phase_slope_error[0])),
        R("phase velocity X/mu (phsvel, velobs), d omega_mx", ".06", "{:.4f} +- {:.4f}",
          lambda response: (response.response.phase_velocity[0],
                            response.response.phase_velocity_error[0])),
        R("phase velocity over samples", ".06 of one",
          "{:.4f} +- {:.4f}, {:.4f} to {:.4f}, {} samples",
          lambda ensemble_response: spread(ensemble_response.ensemble.velocity)),
        R("phase velocity in cm, d = .5 cm", ".03 omega_mx", "{:.4f} omega_mx",
          lambda response: BEAD * response.response.phase_velocity[0]),
        R("omega_mx that makes it the measured 57 m/s (expomx)", "200,000 / s",
          "{:.3g} / s; over samples {:.3g} to {:.3g}",
          lambda response, ensemble_response: [
              SPEED / (BEAD * v) for v in (response.response.phase_velocity[0],
                                           *spread(ensemble_response.ensemble.velocity)[3:1:-1])]),
        R("Delta omega over which |A| changes, in omega_mx: mean distance of dips deeper than "
          "10 dB, of all maxima", ".1 (20 kHz of 200,000 / s; measured: 3 kHz)", "{:.3f}, {:.3f}",
          lambda response: [apart(deep(response)[0]),
                            apart(len(maxima(response.response, 0.3, 1)[0]))]),
        R("slope above omega_mx, 1 to 1.3", "distinctly different", "{:.1f}",
          lambda response: -fit_line(*(x[response.response.omega >= 1] for x in (
              response.response.omega, response.response.phase[:, 0])))[0]),
    )),
    Section("modepic (section 4): three modes",
            ("modes-shapes", "modes-participation", "modes-resonances"), (
        R("(a) second mode; how many balls take part", ".1013; extended", "{:.4f}; {:.0f}",
          lambda modes: (modes.modes.omega[1], modes.modes.participation[1])),
        R("second mode over samples", ".1013 of one",
          "{:.4f} +- {:.4f}, {:.4f} to {:.4f}, {} samples",
          lambda ensemble_modes: spread(ensemble_modes.ensemble.mode_omega[:, 1])),
        R("(b) mode near .6 of median extent; balls", ".6053; some localization", "{:.4f}; {:.0f}",
          lambda modes: usual(modes.modes)),
        R("(c) mode nearest to 1.000; balls", "striking localization", "{:.4f}; {:.0f}",
          lambda modes: nearest(modes.modes, 1.0)),
        R("median of balls that take part: below .3, .3 to 1, above 1",
          "extended, some localization, localized", "{:.0f}, {:.0f}, {:.1f}",
          lambda modes: participation(modes.modes)),
        R("modes above omega_mx, of all", "density very low", "{} of {}",
          lambda modes: (count(modes.modes, 1, np.inf), len(modes.modes.omega))),
        R("modes above omega_mx whose peaks at ball (8, 10), each alone, exceed .01, of all; the "
          "median peak; how f_i there falls with its distance from the ball that moves most, and "
          "the overlap with the drive with that ball's distance from the wall, decades a spacing "
          "(correlations)",
          "seen only if the detector is inside the mode, and if it overlaps with the wall",
          "{} of {}; {:.1g}; {:.2f} ({:.2f}), {:.2f} ({:.2f})",
          lambda modes: audible(modes.modes, modes.lattice.shape)),
        R("modes above omega_mx over samples", "", "{:.1f} +- {:.1f}, {:.0f} to {:.0f}, {} samples",
          lambda ensemble_modes: spread(ensemble_modes.ensemble.above)),
    )),
    Section("onefreq (section 4): |c_i| at .6", ("projection_one_frequency-onefreq",), (
        R("mode of the largest |c_i|", "omega_i close to omega", "{:.4f}",
          lambda projection_one_frequency: excited(projection_one_frequency.projection)[0]),
        R("part of sum |c_i|^2 within .05 of the drive", "the most important", "{:.2f}",
          lambda projection_one_frequency: excited(projection_one_frequency.projection)[1]),
        R("rank by |c_i| of the mode nearest to the drive", "not by |omega - omega_i| alone",
          "{}", lambda projection_one_frequency: excited(projection_one_frequency.projection)[2]),
    )),
    Section("maxci (section 4): the dominant mode", ("projection_dominant-maxci",), (
        R("slope of omega_i over omega in .1-.9", "1", "{1:.4f}",
          lambda projection_dominant: off_drive(projection_dominant.projection, 0.1, 0.9)),
        R("mean |omega_i - omega| in .1-.9, above 1", "breaks down above 1", "{:.4f}, {:.3f}",
          lambda projection_dominant: [off_drive(projection_dominant.projection, *ends)[0]
                                       for ends in ((0.1, 0.9), (1.0, 2.0))]),
    )),
    Section("cifreq (section 4): three successive modes", ("projection_three_modes-cifreq",), (
        R("their omega_i", "near .6", "{:.4f}, {:.4f}, {:.4f}",
          lambda projection_three_modes: projection_three_modes.projection.mode_omega),
        R("drive of the largest |c_i|", "approaches omega_i", "{:.4f}, {:.4f}, {:.4f}",
          lambda projection_three_modes: [
              projection_three_modes.projection.omega[k] for k in
              np.abs(projection_three_modes.projection.coefficient).argmax(axis=0)]),
        R("largest |c_i|", "to a different degree", "{:.3g}, {:.3g}, {:.3g}",
          lambda projection_three_modes: np.abs(
              projection_three_modes.projection.coefficient).max(axis=0)),
    )),
    Section("timeres (section 5): relaxation, one bond a step", ("relaxation_long-timeres",), (
        R("omega, beta", ".6, .01", "{:.2g}, {:.2g}", lambda relaxation_long: (
            relaxation_long.relaxation.omega, relaxation_long.lattice.damping)),
        R("exponent psi of S(f) ~ f^-psi, plain f", "1.9 (measured: 2 to 2.2)", "{:.3f} +- {:.3f}",
          lambda relaxation_long: (relaxation_long.spectrum.exponent_plain,
                                   relaxation_long.spectrum.exponent_error)),
        R("decades", "1.5", "{:.2f}", lambda relaxation_long: np.log10(
            relaxation_long.spectrum.fit_max / relaxation_long.spectrum.fit_min)),
        R("psi of the sampled form (2 sin pi f)^-psi; the series forgets its first sample, so that "
          "other seeds differ by the error", "", "{:.3f} +- {:.3f}",
          lambda relaxation_long: (relaxation_long.spectrum.exponent,
                                   relaxation_long.spectrum.exponent_error)),
        R("correlation of B and Delta B", "asked: are they uncorrelated?", "{:.3f} +- {:.3f}",
          lambda relaxation_long: (relaxation_long.memory.increment,
                                   relaxation_long.memory.increment_error)),
        R("correlation of successive Delta B", "asked: are they uncorrelated?",
          "{:.3f} +- {:.3f}", lambda relaxation_long: (relaxation_long.memory.successive,
                                                       relaxation_long.memory.successive_error)),
    )),
    Section("Random places (sections 2 and 6): a packing, and its stiffnesses on a lattice",
            ("geometry_response-amplitude", "geometry_modes-participation"), (
        R("maxima of |A| in .3-1, and its median in .9-1; packing and lattice",
          "asked: what is the role of the geometrical disorder?", "{}, {:.2g}; {}, {:.2g}",
          lambda geometry_response_packing, geometry_response_ordered: [
              number for curve in map(in_its_units, (geometry_response_packing,
                                                     geometry_response_ordered))
              for number in (len(maxima(curve, 0.3, 1)[0]),
                             np.median(within(curve, 0.9, 1)[1]))]),
        R("median of balls that take part: below .3, .3 to 1, above 1; packing and lattice",
          "asked; over samples: `python jobs/geometry.py`",
          "{:.0f}, {:.0f}, {:.1f}; {:.0f}, {:.0f}, {:.1f}",
          lambda geometry_modes_packing, geometry_modes_ordered: [
              *participation(in_its_units(geometry_modes_packing)),
              *participation(in_its_units(geometry_modes_ordered))]),
    )),
    Section("The heater (section 6): one bead of glass of .5 cm grows", ("beads-growth",), (
        R("packings; below, of the change of |A|: median, 90 % quantile; in which part of the "
          "cases it is 25 % or more; dR/overlap, contacts opened; medians up to 2.5, 5, more "
          "diameters from the detector",
          "a box 28 cm wide, 8 to 15 cm of beads", PACKED, lambda beads: ()),
        *[heated(weights, growth) for growth in GROWTHS for weights in LOADS],
    )),
    Section("Units (section 4): glass beads of .5 cm", (), (
        R("omega_mx under the weight of a bead (omxest)",
          "> 45 kHz, from numbers for the beads that it does not give", "{}, {}",
          lambda units_weight: (units_weight["frequency omega_mx/(2 pi)"],
                                units_weight["omega_mx = sqrt(4 kmax/m)"].rsplit(maxsplit=1)[0])),
        R("force of the strongest contacts for omega_mx = 200,000 / s (expomx)", "none given", "{}",
          lambda units_speed: " ".join(units_speed["force of the strongest contacts"].split())),
        R("speed of sound", "57 m/s", MEASURED, lambda: ()),
    )),
    Section("Where the paper and pgran differ", (), (
        R("simpfreq: which n2", "n2 > 0: lowest resonance 9.93", "n2 >= 0: first maximum at {:.2f}",
          lambda continuum_damped: maxima(continuum_damped.continuum, 0, 40)[0][0]),
        R("eigenfunc", "sin(2 q pi x/L), lowest omega^2 = 8 pi^2",
          "sin(q pi x/L): {:.3f} pi^2, as in eigvalues", lambda continuum_damped:
          continuum_damped.continuum.resonance[0] ** 2 / np.pi**2),
        R("cidef: sums over", "0 to N", "0 to N - 1: shapes of {} x {} balls",
          lambda modes: modes.modes.vector.shape[1:]),
        R("width of the peak of |c_i| at beta = .001, .003",
          "much sharper for a larger beta (section 4, at its end)",
          "{:.4f}, {:.4f}: wider for a larger beta",
          lambda projection_damping_small, projection_three_modes: [
              width(x.projection) for x in (projection_damping_small, projection_three_modes)]),
        R("maxima of |A| in .3-1 at beta = .001, .003, .03", "many more for a smaller beta",
          "{}, {}, {}: so it is",
          lambda response_damping_small, response, response_damping_large: [
              len(maxima(x.response, 0.3, 1)[0])
              for x in (response_damping_small, response, response_damping_large)]),
        R("dips deeper than 10 dB in .3-1 at these beta", "much shallower for a smaller beta",
          "{}, {}, {}: the fewer, the larger beta is, on curves that are resolved",
          lambda response_damping_small, response, response_damping_large: deep(
              response_damping_small, response, response_damping_large)),
        R("phase velocity at these beta", "one velocity, compared with that of sound; its slope "
          "depends on beta", "{:.3f}, {:.3f}, {:.3f} d omega_mx",
          lambda response_damping_small, response, response_damping_large: [
              x.response.phase_velocity[0]
              for x in (response_damping_small, response, response_damping_large)]),
        R("the power of beta that it grows like, between these", "",
          "{:.2f}, {:.2f}; 1/2, as of waves that diffuse and are absorbed, from .003 on only",
          lambda response_damping_small, response, response_damping_large: power_of_damping(
              response_damping_small, response, response_damping_large)),
        R("highest frequency at which a ball oscillates by itself", "omega_mx",
          "{:.3f}; over samples {:.3f} to {:.3f}", lambda modes, ensemble_modes: (
              modes.modes.omega[-1], *spread(ensemble_modes.ensemble.mode_omega[:, -1])[2:4])),
        R("the system of equations", "real and not symmetric, by BiCG",
          "complex symmetric, by {} factorizations for the whole curve",
          lambda response: response.response.factorizations),
        R("run time of response, modes, projections and relaxation",
          "150 hours of a SPARCstation IPX", "{:.0f} s on {} ranks",
          lambda response, modes, projection_dominant, projection_three_modes, relaxation_long: (
              sum(x.seconds for x in (response, modes, projection_dominant,
                                      projection_three_modes, relaxation_long)),
              response.mpi_size)),
    )),
)  # fmt: skip
