"""What the paper says of normal modes and of their projection coefficients."""

import numpy as np
from paper_measures import audible, count, excited, nearest, off_drive, participation, spread, usual
from paper_rows import Row, Section

R = Row
MODES = (
    Section("modepic (section 4): three modes",
            ("modes-shapes", "modes-participation", "modes-resonances"), (
        R("(a) second mode; how many balls take part", ".1013; extended", "{:.4f}; {:.0f}",
          lambda modes: (modes.modes.omega[1], modes.modes.participation[1]), "right"),
        R("second mode over samples", ".1013 of one",
          "{:.4f} +- {:.4f}, {:.4f} to {:.4f}, {} samples",
          lambda ensemble_modes: spread(ensemble_modes.ensemble.mode_omega[:, 1]),
          "right: .1013 is within the spread"),
        R("(b) mode near .6 of median extent; balls", ".6053; some localization", "{:.4f}; {:.0f}",
          lambda modes: usual(modes.modes), "right"),
        R("(c) mode nearest to 1.000; balls", "striking localization", "{:.4f}; {:.0f}",
          lambda modes: nearest(modes.modes, 1.0), "right"),
        R("median of balls that take part: below .3, .3 to 1, above 1",
          "extended, some localization, localized", "{:.0f}, {:.0f}, {:.1f}",
          lambda modes: participation(modes.modes), "right"),
        R("modes above omega_mx, of all", "density very low", "{} of {}",
          lambda modes: (count(modes.modes, 1, np.inf), len(modes.modes.omega)),
          "right: 8 %, which thin out towards the last"),
        R("modes above omega_mx whose peaks at ball (8, 10), each alone, exceed .01, of all; the "
          "median peak; how f_i there falls with its distance from the ball that moves most, and "
          "the overlap with the drive with that ball's distance from the wall, decades a spacing "
          "(correlations)",
          "seen only if the detector is inside the mode, and if it overlaps with the wall",
          "{} of {}; {:.1g}; {:.2f} ({:.2f}), {:.2f} ({:.2f})",
          lambda modes: audible(modes.modes, modes.lattice.shape),
          "right: both parts fall exponentially with distance"),
        R("modes above omega_mx over samples", "", "{:.1f} +- {:.1f}, {:.0f} to {:.0f}, {} samples",
          lambda ensemble_modes: spread(ensemble_modes.ensemble.above), "as given"),
    )),
    Section("onefreq (section 4): |c_i| at .6", ("projection_one_frequency-onefreq",), (
        R("mode of the largest |c_i|", "omega_i close to omega", "{:.4f}",
          lambda projection_one_frequency: excited(projection_one_frequency.projection)[0],
          "right"),
        R("part of sum |c_i|^2 within .05 of the drive", "the most important", "{:.2f}",
          lambda projection_one_frequency: excited(projection_one_frequency.projection)[1],
          "right"),
        R("rank by |c_i| of the mode nearest to the drive", "not by |omega - omega_i| alone",
          "{}", lambda projection_one_frequency: excited(projection_one_frequency.projection)[2],
          "right"),
    )),
    Section("maxci (section 4): the dominant mode", ("projection_dominant-maxci",), (
        R("slope of omega_i over omega in .1-.9", "1", "{1:.4f}",
          lambda projection_dominant: off_drive(projection_dominant.projection, 0.1, 0.9),
          "right"),
        R("mean |omega_i - omega| in .1-.9, above 1", "breaks down above 1", "{:.4f}, {:.3f}",
          lambda projection_dominant: [off_drive(projection_dominant.projection, *ends)[0]
                                       for ends in ((0.1, 0.9), (1.0, 2.0))], "right"),
    )),
    Section("cifreq (section 4): three successive modes", ("projection_three_modes-cifreq",), (
        R("their omega_i", "near .6", "{:.4f}, {:.4f}, {:.4f}",
          lambda projection_three_modes: projection_three_modes.projection.mode_omega, "as given"),
        R("drive of the largest |c_i|", "approaches omega_i", "{:.4f}, {:.4f}, {:.4f}",
          lambda projection_three_modes: [
              projection_three_modes.projection.omega[k] for k in
              np.abs(projection_three_modes.projection.coefficient).argmax(axis=0)],
          "right"),
        R("largest |c_i|", "to a different degree", "{:.3g}, {:.3g}, {:.3g}",
          lambda projection_three_modes: np.abs(
              projection_three_modes.projection.coefficient).max(axis=0), "right"),
    )),
)  # fmt: skip
