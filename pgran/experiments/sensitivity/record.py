"""The records of what a signal depends on: derivatives, and finite changes."""

from dataclasses import dataclass

import numpy as np

from pgran.store.record import BOUND, DETECTOR, Frequencies, array, attribute, error_of

ITS_BOUND = "bound of its error"
WHERE = "omega", "detector_number"
AT_BOND, AT_BALL = (*WHERE, "bond_number"), (*WHERE, "ball_number")
# what a packing does when a ball grows; the last of them found no rest
OUTCOMES = "smooth", "opened or closed", "rearranged", "not balanced"
COMPLEX, NUMBERS = {"dtype": complex, "row": True}, {"dtype": int, "row": True}


@dataclass(frozen=True, eq=False, repr=False)
class Sensitivity(Frequencies):
    """What the amplitude at each detector depends on, and the power through every bond.

    Bonds are numbered axis after axis, each array in C order, the contacts of a network as there;
    balls in C order, of a network the free ones. With `most` > 0 only so many bonds and balls are
    kept at each frequency for each detector, the largest d ln A / d ln k and d ln A / d ln m first:
    `bond` and `ball` are their numbers. A point whose `converged_reason` is not positive failed, or
    the bound of a derivative is above the accuracy asked for of the largest one.
    """

    group = "sensitivity"
    most: int = attribute("how many bonds and balls are kept; 0: all", "1")
    detector: np.ndarray = array(DETECTOR, "1", "detector_number", "axis", dtype=int)
    displacement: np.ndarray = array(
        "amplitude at the detectors relative to the driven wall, convention exp(+i omega t)",
        "1", *WHERE, **COMPLEX
    )  # fmt: skip
    error_bound: np.ndarray = error_of(displacement, BOUND)
    by_stiffness: np.ndarray = array(
        "derivative of the displacement by each bond constant", "1/k", *AT_BOND, **COMPLEX
    )
    by_stiffness_bound: np.ndarray = error_of(by_stiffness, ITS_BOUND)
    log_amplitude: np.ndarray = array("d ln|A| / d ln k of each bond", "1", *AT_BOND)
    log_phase: np.ndarray = array("d phase / d ln k of each bond", "rad", *AT_BOND)
    log_bound: np.ndarray = array("bound of the error of both", "1", *AT_BOND)
    by_mass: np.ndarray = array(
        "derivative of the displacement by each ball's mass", "1/m", *AT_BALL, **COMPLEX
    )
    by_mass_bound: np.ndarray = error_of(by_mass, ITS_BOUND)
    by_damping: np.ndarray = array(
        "derivative of the displacement by beta", "1/sqrt(k m)", *WHERE, **COMPLEX
    )
    by_damping_bound: np.ndarray = error_of(by_damping, ITS_BOUND)
    flux: np.ndarray = array(
        "mean power through each bond, from its first ball to its second", "k sqrt(k/m)",
        "omega", "every_bond", row=True,
    )  # fmt: skip
    loss: np.ndarray = array(
        "mean power that each bond's dashpot takes", "k sqrt(k/m)", "omega", "every_bond", row=True
    )
    iterations: np.ndarray = array("Krylov iterations, adjoints included", "1", "omega", **NUMBERS)
    bond: np.ndarray | None = array(
        "numbers of the bonds that are kept", "1", *AT_BOND, optional=True, **NUMBERS
    )
    ball: np.ndarray | None = array(
        "numbers of the balls that are kept", "1", *AT_BALL, optional=True, **NUMBERS
    )
    by_tangential: np.ndarray | None = array(
        "derivative by each contact's tangential stiffness", "1/k", *AT_BOND,
        optional=True, **COMPLEX
    )  # fmt: skip
    by_tangential_bound: np.ndarray | None = error_of(by_tangential, ITS_BOUND)
    by_force: np.ndarray | None = array(
        "derivative by each contact's force, as pre-stress", "1/force", *AT_BOND,
        optional=True, **COMPLEX
    )  # fmt: skip
    by_force_bound: np.ndarray | None = error_of(by_force, ITS_BOUND)

    def on_bonds(self, number, d):
        """Return d ln|A| / d ln k of all bonds, NaN of those that are not kept, shape (bonds,).

        At the frequency of this number, for the detector d.
        """
        if self.bond is None:
            return self.log_amplitude[number, d]
        values = np.full(self.flux.shape[1], np.nan)
        values[self.bond[number, d]] = self.log_amplitude[number, d]
        return values


@dataclass(frozen=True, eq=False, repr=False)
class Heat(Frequencies):
    """Amplitudes after each ball is warmed, or each bond is cut, one at a time.

    A warm ball's bonds are `factor` times as stiff, or overlap by `overlap` more (NaN: not so), or
    its radius grows by `growth`; then the packing finds its rest anew if `relaxed`, else neighbours
    stay. A number that is not known to the accuracy asked for has its bound all the same; `heard`
    is the share of balls whose warming changes the amplitude, for certain, by a quarter or more.
    """

    group = "heat"
    factor: float = attribute("how many times as stiff; NaN: not so", "1")
    overlap: float = attribute("how much more contacts overlap; NaN: not so", "length")
    detector: np.ndarray = array(DETECTOR, "1", "detector_number", "axis", dtype=int)
    displacement: np.ndarray = array(
        "amplitude at the detectors before any change", "1", *WHERE, **COMPLEX
    )
    error_bound: np.ndarray = error_of(displacement, BOUND)
    ball: np.ndarray = array(
        "numbers of the balls that are warmed, in C order, of a network as there", "1", dtype=int
    )
    warmed: np.ndarray | None = array(
        "amplitude with each ball warm", "1", *WHERE, "ball", optional=True, **COMPLEX
    )
    warmed_bound: np.ndarray | None = error_of(warmed, BOUND)
    heard: np.ndarray | None = array(
        "share of the balls whose warming changes the amplitude by a quarter or more", "1", *WHERE,
        optional=True,
    )  # fmt: skip
    cut: np.ndarray | None = array(
        "amplitude with each bond cut", "1", *WHERE, "every_bond", optional=True, **COMPLEX
    )
    cut_bound: np.ndarray | None = error_of(cut, BOUND)
    relaxed: bool | None = attribute("1: the packing finds its rest anew", optional=True)
    kelvin: float | None = attribute("by how much balls are warmer", "K", optional=True)
    expansion: float | None = attribute("relative growth of a radius", "1/K", optional=True)
    growth: np.ndarray | None = array(
        "growth of each warm ball's radius", "length", "ball", optional=True
    )
    growth_overlap: np.ndarray | None = array(
        "growth over the mean overlap of all contacts", "1", "ball", optional=True
    )
    growth_least: np.ndarray | None = array(
        "growth over the smallest overlap of the ball's contacts", "1", "ball", optional=True
    )
    by_radius: np.ndarray | None = array(
        "derivative of the displacement by the radius of each free ball", "1/length",
        *AT_BALL, optional=True, **COMPLEX
    )  # fmt: skip
    by_radius_bound: np.ndarray | None = array(
        "bound of its error; infinite where no stable packing is certain", "1/length", *AT_BALL,
        optional=True, row=True,
    )  # fmt: skip
    frozen: np.ndarray | None = array(
        "amplitude with each ball warm whose neighbours do not move, where packings relax", "1",
        *WHERE, "ball", optional=True, **COMPLEX
    )  # fmt: skip
    frozen_bound: np.ndarray | None = error_of(frozen, BOUND)
    outcome: np.ndarray | None = array(
        "what the packing did: smooth, opened or closed, rearranged, not balanced", "1", "ball",
        dtype=str, optional=True,
    )  # fmt: skip
    opened: np.ndarray | None = array("contacts that opened", "1", "ball", dtype=int, optional=True)
    closed: np.ndarray | None = array("contacts that closed", "1", "ball", dtype=int, optional=True)
    balance: np.ndarray | None = array(
        "largest force left on a ball, over the mean one", "1", "ball", optional=True
    )

    @property
    def lost(self):
        """How many packings found no rest."""
        return 0 if self.outcome is None else int(np.count_nonzero(self.outcome == OUTCOMES[-1]))

    @property
    def failures(self):
        """How many frequencies missed their accuracy, and how many packings found no rest."""
        return super().failures + self.lost
