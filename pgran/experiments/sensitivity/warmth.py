"""In which ways a ball may be warmed: its bonds stiffen, its overlaps or its radius grow."""

import dataclasses
from typing import NamedTuple

import numpy as np

from pgran.errors import InputError
from pgran.experiments.sensitivity import finite
from pgran.experiments.sensitivity.record import OUTCOMES
from pgran.medium.dissipation import of_new
from pgran.medium.network import Network
from pgran.run.experiment import Caution
from pgran.store.estimate import counted

LARGE = 0.3  # of the mean overlap: growth beyond which packings rearrange
WAYS = "heat_factor", "heat_overlap", "heat_radius", "heat_kelvin"
SEED = 1993  # of the balls that are drawn


def check_options(values):
    """Raise where options contradict each other."""
    ways = [name for name in WAYS if values[name] is not None]
    if len(ways) > 1:
        names = ", ".join(f"-{name}" for name in ways)
        raise InputError(f"{names}: a ball is warmed in one of these ways; leave the others out")
    which = [f"-{name}" for name in ("heat_balls", "heat_samples") if values[name] is not None]
    if which and not ways:
        raise InputError(f"{which[0]}: say by how much, with -{' or -'.join(WAYS)}")
    if len(which) > 1:
        raise InputError(f"{' and '.join(which)}: give one, the balls or how many to draw")
    if values["heat_relax"] is not None and not {"heat_radius", "heat_kelvin"} & {*ways}:
        raise InputError("-heat_relax: only for balls that grow, by -heat_radius or -heat_kelvin")


class Warmth(NamedTuple):
    """What is done to a warm ball: one of these; see the keywords of `heat`."""

    factor: float | None = None
    overlap: float | None = None
    radius: float | None = None
    kelvin: float | None = None
    expansion: float = 0.0
    hertz: float = 0.0

    @property
    def is_asked(self):
        """Whether one is."""
        return any(way is not None for way in self[: len(WAYS)])

    def balls(self, medium, balls=None, samples=None):
        """Return the places among the free balls of those that are warmed, which increase.

        All, unless balls are given, or how many to draw: the same whatever is done to them.
        """
        count = len(medium.ball_numbers) if self.is_asked else 0
        if balls is not None:
            return np.unique(medium.numbers_of(medium.sites(balls, "-heat_balls")))
        if samples is not None and samples > count:
            raise InputError(f"-heat_samples {samples}: there are only {count} balls to warm")
        return np.sort(np.random.default_rng(SEED).permutation(count)[:samples])

    @property
    def grows(self):
        """Whether the radius does."""
        return self.radius is not None or self.kelvin is not None

    def growth(self, network):
        """Return by how much the radius of each ball grows if it is warm."""
        if network.radius is None and self.kelvin is not None:
            raise InputError("-heat_kelvin: balls expand by parts of radii, which are not known")
        if self.radius is None:
            growth = self.expansion * self.kelvin * network.radius
        else:
            growth = np.full(len(network.held), self.radius)
        if network.radius is not None and np.any(network.radius + growth <= 0):
            raise InputError("-heat_radius, -heat_kelvin: a ball would have no radius left")
        return growth

    def changes(self, medium, warm):
        """Return springs of groups and their changes, of some free balls by their places."""
        contacts, case = finite.contacts_of(medium, warm), 0
        if self.factor is not None:
            growth = (self.factor - 1) * medium.springs.elastic[None]
        elif self.overlap is not None:
            growth = finite.grown_by_overlap(medium, self.overlap, self.hertz)[None]
        else:
            radii, ends = self.growth(medium), medium.bond.T
            growth = [finite.grown_by_overlap(medium, radii[end], self.hertz) for end in ends]
            growth = np.stack(growth)
            case = (ends[1][contacts] == medium.ball_numbers[warm][:, None]).astype(int)
        return finite.changes(medium, contacts, growth, case)


def with_vectors(network):
    """Return the network whose balls move in all directions, as those of a packing do at rest."""
    if network.displacement == "vector":
        return network
    return dataclasses.replace(
        network, displacement="vector", direction=None, component="drive", damped="all"
    )


def check_law(network):
    """Raise an InputError where the network does not say what larger radii do to it."""
    from pgran.balance.networks import law_of

    if network.turns:
        raise InputError(
            "-heat_relax: the rest of balls that turn depends on their past; take -heat_relax false"
        )
    law_of(with_vectors(network))
    pulling = np.flatnonzero(network.force <= 0)
    if len(pulling):
        raise InputError(f"-heat_relax: contact {pulling[0]} bears no repulsive force")


def relaxes(medium, relax):
    """Return whether a packing relaxes; raise an InputError where it should and cannot."""
    if not isinstance(medium, Network):
        raise InputError("-heat_radius, -heat_kelvin: only for a network whose balls have radii")
    if relax is False:
        return False
    try:
        check_law(medium)
    except InputError:
        if relax:
            raise
        return False
    try:
        of_new(medium)
    except InputError as error:
        raise InputError(f"{error}; -heat_relax false keeps neighbours in place") from None
    return True


def told(heat):
    """Return in words by how much balls have grown, and what packings did."""
    if heat.growth is None:
        return
    if heat.lost:
        lost = f"{heat.lost} of {len(heat.ball)} packings found no rest"
        yield Caution(f"{lost}: their amplitudes are NaN")
    by = f"{np.abs(heat.growth).max(initial=0.0):.4g}"
    if heat.growth_overlap is not None:
        large, least = np.abs(heat.growth_overlap).max(initial=0.0), np.abs(heat.growth_least)
        if large > LARGE:
            yield Caution(
                f"radii grow by {large:.3g} of the mean overlap: beyond {LARGE:g} packings "
                "rearrange, and derivatives by radii say little of what happens"
            )
        by += (
            f", {large:.3g} of the mean overlap and, of a ball's own smallest overlap, "
            f"{np.median(least):.3g} (median) to {least.max():.3g}"
        )
    if heat.by_radius_bound is not None and np.isinf(heat.by_radius_bound).any():
        yield Caution(
            "derivatives by radii have no bounds: it is not certain that the packing is stable"
        )
    rest = "all balls find a new rest" if heat.relaxed else "neighbours frozen"
    yield f"radii of warm balls grow by up to {by}; {rest}"
    if heat.relaxed and np.any(there := heat.outcome != OUTCOMES[-1]):
        outcomes = [f"{np.count_nonzero(heat.outcome == what)} {what}" for what in OUTCOMES[:-1]]
        opened, closed = (f"{x[there].mean():.3g}" for x in (heat.opened, heat.closed))
        yield (
            f"{counted(len(heat.ball), 'packing')}: {', '.join(outcomes)}; on average {opened} "
            f"contacts opened, {closed} closed"
        )
