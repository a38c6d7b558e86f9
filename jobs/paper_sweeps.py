"""What the paper says of its experiment, of the continuum and of frequency responses."""

import numpy as np
from paper_measures import (
    apart,
    bonds,
    count,
    deep,
    edge,
    likeness,
    maxima,
    slow_spectrum,
    spread,
    within,
)
from paper_rows import Row, Section

import pgran
from pgran.driven.amplitudes import fit_line

BEAD, SPEED = 0.5, 5700.0  # cm and cm/s, measured (paper: velobs)
OMEGA_MX = 2e5  # 1/s, the paper's (expomx)
TURN = 2 * np.pi

R = Row
SWEEPS = (
    Section("exptime (section 1): the amplitude in time, measured by Liu and Nagel",
            ("relaxation_seconds-timeres",), (
        R("(exptime) exponent of the power spectrum; a step of one bond takes 5 s",
          "2 from 1e-5 to 1e-1 Hz",
          "{:.2f} from {:.1g} to {:.1g} Hz; the corner 1/(2 pi M tau) is at {:.1e}, with kbar = "
          "{:.0f} bonds jointly at {:.1e} Hz", slow_spectrum,
          "right in the exponent above both corners (timeres), below which this window reaches; "
          "840 bonds, redrawn one by one, cannot fall for the measured four decades: that takes "
          "M / kbar of 3200 or more"),
        R("(exptime) driving frequency, acceleration", "omega = 4 kHz, 1.4 g",
          "{:.3f} omega_mx of 200,000 / s if 4 kHz are cycles; the disc moves by {:.0f} nm",
          lambda units_weight: [TURN * 4e3 / OMEGA_MX, 1.4 * 9.81 / (TURN * 4e3) ** 2 * 1e9],
          "unclear: as an angular frequency 4e3 / s would be .02 omega_mx, below all modes; more "
          "than the overlap under a bead's weight (Units): contacts near the disc may open"),
    )),
    Section("expfreq (section 1): two sweeps, undisturbed and disturbed", ("expfreq-amplitude",), (
        R("correlation of ln|A| in .3-1, less its straight line, of the sample with itself after "
          "0, 1, 10, 100, 840 steps of relaxation, and with another sample",
          "undisturbed: alike; disturbed: very different",
          "{:.2f}, {:.2f}, {:.2f}, {:.2f}, {:.2f}; {:.2f}",
          lambda response, response_after_1, response_after_10, response_after_100,
          response_after_840, response_other: [
              likeness(response, other) for other in (
                  response, response_after_1, response_after_10, response_after_100,
                  response_after_840, response_other)],
          "right: a curve is that of its contacts, and a tenth of the bonds make another one"),
    )),
    Section("sprlat (section 2): balls and springs, one wall driven; here 4 x 4",
            ("lattice-bonds",), (
        R("balls", "", "{} x {}", lambda lattice: lattice.lattice.shape, "as given"),
    )),
    Section("exactpl (section 3): the homogeneous box at (.47, .52)",
            ("continuum_undamped-exactpl", "continuum_damped-exactpl"), (
        R("(a) beta = 0: first maxima of |A|", "at the resonances (simpfreq)",
          "{:.2f}, {:.2f}, {:.2f}; resonances {:.3f}, {:.3f}, {:.3f}",
          lambda continuum_undamped: [*maxima(continuum_undamped.continuum, 0, 40)[0][:3],
                                      *np.unique(continuum_undamped.continuum.resonance)[:3]],
          "right"),
        R("(a) largest |A| on the grid", "much greater than the wall's", "{:.3g}",
          lambda continuum_undamped: continuum_undamped.continuum.amplitude.max(),
          "right: without damping it has no limit"),
        R("(b) beta = .003: first maxima", "at the resonances", "{:.2f}, {:.2f}, {:.2f}",
          lambda continuum_damped: maxima(continuum_damped.continuum, 0, 40)[0][:3], "right"),
        R("(b) maxima up to 40, and resonances", "higher modes merge", "{}, and {}",
          lambda continuum_damped: (len(maxima(continuum_damped.continuum, 0, 40)[0]),
                                    len(continuum_damped.continuum.resonance)), "right"),
        R("(b) median |A| for omega in 10-20, 30-40", "overall decrease", "{:.2f}, {:.2f}",
          lambda continuum_damped: [np.median(within(continuum_damped.continuum, a, a + 10)[1])
                                    for a in (10, 30)], "right"),
        R("(b) last maximum of |A|, and |A| at 200", "at even higher frequencies smooth",
          "{:.1f}, none from there to {:.0f}; {:.1g}",
          lambda continuum_smooth: [maxima(continuum_smooth.continuum, 1, 300)[0][-1],
                                    continuum_smooth.continuum.omega[-1],
                                    within(continuum_smooth.continuum, 200, 300)[1][0]],
          "right"),
    )),
    Section("sprpic (section 4): the lattice", ("response-bonds",), (
        R("balls; bonds", "20 x 20; (840 by counting)", "{} x {}; {}",
          lambda response: [*response.lattice.shape, bonds(response.lattice).size], "as given"),
        R("bond constants", "random in [0, .25]", "{:.4f} to {:.4f}",
          lambda response: (bonds(response.lattice).min(), bonds(response.lattice).max()),
          "as given"),
        R("detecting ball, and spacings to the driven wall", "(8, 10), 12", "({}, {}), {}",
          lambda response: [*response.response.detector[0],
                            response.lattice.shape[0] - response.response.detector[0, 0]],
          "so balls count from 0"),
        R("omega_mx = sqrt(4 Kmax/m) (omxdef)", "1.0", "{:.4g}",
          lambda response: response.lattice.omega_mx, "right"),
    )),
    Section("freqres (section 4): the frequency response of ball (8, 10)",
            ("response-amplitude",), (
        R("frequencies", ".01 to 1.3", "{:.3g} to {:.3g}, {} of them",
          lambda response: (*response.response.omega[[0, -1]], len(response.response.omega)),
          "as given"),
        R("relative error of every amplitude", "1 part in 10000", "at most {:.1e}, proven",
          lambda response: np.max(response.response.error_bound / response.response.amplitude),
          "as given"),
        R("(a) below .3: maxima, and modes", "peaks with little overlap", "{}, and {}",
          lambda response, modes: (len(maxima(response.response, 0, 0.3)[0]),
                                   count(modes.modes, 0, 0.3)), "right"),
        R("(a) first maximum, |A| there, and lowest mode", "at the mode",
          "{:.5f}, {:.0f}, and {:.5f}",
          lambda response, modes: [*(x[0] for x in maxima(response.response, 0, 0.3)),
                                   modes.modes.omega[0]], "right"),
        R("(b) .3 to 1: maxima, and modes", "no one-to-one identification", "{}, and {}",
          lambda response, modes: (len(maxima(response.response, 0.3, 1)[0]),
                                   count(modes.modes, 0.3, 1)), "right"),
        R("(b) median |A| in .3-.4 and .9-1", "overall decrease", "{:.3g}, {:.3g}",
          lambda response: [np.median(within(response.response, a, a + 0.1)[1])
                            for a in (0.3, 0.9)], "right"),
        R("(c) above 1: maxima", "very smooth", "{}",
          lambda response: len(maxima(response.response, 1, 2)[0]), "right"),
        R("(c) |A| at 1 and at 1.3", "decreases very quickly", "{:.2g}, {:.2g}",
          lambda response: [within(response.response, 1, 2)[1][k] for k in (0, -1)], "right"),
        R("(c) decades by which |A| falls from its median in .9-1 omega_mx to 1.1 and 1.3 of it, "
          "for Kmax = .0625, .25, 1", "always at omega_mx (omxdef)",
          "{:.1f}, {:.1f}; {:.1f}, {:.1f}; {:.1f}, {:.1f}",
          lambda response_kmax_small, response, response_kmax_large: [
              fall for each in (response_kmax_small, response, response_kmax_large)
              for fall in edge(each)],
          "right: exactly, if beta grows like sqrt(Kmax); beta = .003 hardly matters there"),
    )),
    Section("phaseres (section 4): the phase of the same ball", ("response-phase",), (
        R("slope mu between .3 and 1, rad per omega_mx", "linear; 200 by velobs",
          "{:.1f} +- {:.1f}", lambda response: (-response.response.phase_slope[0],
                                                response.response.phase_slope_error[0]),
          "right within the spread of samples"),
        R("phase velocity X/mu (phsvel, velobs), d omega_mx", ".06", "{:.4f} +- {:.4f}",
          lambda response: (response.response.phase_velocity[0],
                            response.response.phase_velocity_error[0]), "right, see samples"),
        R("phase velocity over 10 samples, of those whose phase is certain", ".06 of one",
          "{:.4f} +- {:.4f}, {:.4f} to {:.4f}, {} samples",
          lambda ensemble_response: spread(ensemble_response.ensemble.velocity),
          "right for its sample; others differ by an eighth"),
        R("phase velocity in cm, d = .5 cm", ".03 omega_mx", "{:.4f} omega_mx",
          lambda response: BEAD * response.response.phase_velocity[0], "right"),
        R("omega_mx that makes it the measured 57 m/s (expomx)", "200,000 / s",
          "{:.3g} / s; over samples {:.3g} to {:.3g}",
          lambda response, ensemble_response: [
              SPEED / (BEAD * v) for v in (response.response.phase_velocity[0],
                                           *spread(ensemble_response.ensemble.velocity)[3:1:-1])],
          "right for that beta; but the slope goes with 1/sqrt(beta), which nobody has measured"),
        R("speed of long waves with that omega_mx: c, d omega_mx; at 200,000 / s, at the row above",
          "not asked; one velocity, 57 m/s, was compared",
          "{:.3f}; {:.0f} m/s, {:.0f} m/s",
          lambda response: [c := pgran.sound(response.medium.built).longitudinal.speed,
                            c * BEAD * OMEGA_MX / 100,
                            c * SPEED / response.response.phase_velocity[0] / 100],
          "left out: the slope of the phase is no speed of a front; one omega_mx explains 57 m/s "
          "by the phase beside a first arrival some four times as fast"),
        R("Delta omega over which |A| changes, in omega_mx: mean distance of dips deeper than "
          "10 dB, of all maxima; the first at 200,000 / s", ".1 (20 kHz; measured: 3 kHz)",
          "{:.3f}, {:.3f}; {:.3g} / s, which are {:.1f} kHz",
          lambda response: [d := apart(deep(response)[0]),
                            apart(len(maxima(response.response, 0.3, 1)[0])),
                            d * OMEGA_MX, d * OMEGA_MX / TURN / 1e3],
          "wrong by 2 pi: .1 x 200,000 / s is an angular frequency, 3.2 kHz, and agrees with the "
          "3 kHz measured"),
        R("slope above omega_mx, 1 to 1.3", "distinctly different", "{:.1f}",
          lambda response: -fit_line(*(x[response.response.omega >= 1] for x in (
              response.response.omega, response.response.phase[:, 0])))[0], "right"),
    )),
)  # fmt: skip
