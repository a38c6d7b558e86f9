"""Networks under a contact law, as balls at rest and back: `pgran.equilibrate`."""

import dataclasses
import math

import numpy as np
from numpy.typing import ArrayLike

from pgran.arguments import called_right
from pgran.balance.equilibrium import BALANCED, at_rest, without_rattlers
from pgran.balance.motion import Balls, Contacts, listed, pair_numbers
from pgran.errors import InputError, log
from pgran.medium.base import EPSILON
from pgran.medium.dissipation import of_new
from pgran.medium.network import Network
from pgran.medium.overlaps import NO_LAW
from pgran.medium.packing import ContactLaw, nearest_images
from pgran.medium.springs import AT_REST, FREE
from pgran.run.numbers import numbers

ASTRAY = 1e-3  # of a contact's length: what printed digits may leave of it
GROWTH = 0.5  # of the mean overlap: how much a ball grows before all find their rest anew
ON_THE_WAY = 1e-6  # of the mean force: how well they find it before the last step


@called_right
def equilibrate(network: Network, radius: "ArrayLike | None" = None) -> Network:
    """Return the network at rest under its contact law, with other radii if they are given.

    Free balls move until the forces on each cancel, sum F n + load = 0 with F = c h^alpha, to 1e-12
    of the mean contact force; contacts open and close. Held balls stay; those that bear less than
    1e-11 are rattlers, which lose their contacts and are held at rest. Not parallel: each rank that
    calls it computes the same.

    Parameters
    ----------
    network : pgran.Network
        With `power`, `force`, `radius` and `position`.
    radius : array_like of float, shape (N,), optional
        New radii of the balls.

    Returns
    -------
    pgran.Network
        With its new contacts, normals, distances, forces and stiffnesses.

    Raises
    ------
    InputError
        If the network does not know its law, or bears no force.
    PgranError
        If the balls find no rest.

    Examples
    --------
    >>> packing = pgran.pack(40, pressure=1e-2, seed=2)
    >>> larger = pgran.equilibrate(packing, 1.001 * packing.radius)
    >>> bool(larger.force.mean() > packing.force.mean())
    True
    """
    balls, contacts = balls_of(network)
    radius = balls.radius if radius is None else numbers("equilibrate: radius", radius)
    fits = radius.shape == balls.radius.shape and np.all((radius > 0) & np.isfinite(radius))
    if not fits:
        raise InputError(f"equilibrate: radius: {len(balls.radius)} positive numbers are needed")
    rest = grown(balls, contacts, radius)
    result = network_of(rest, network)
    opened, closed = contact_changes(network, result)
    overlap = result.overlap.mean()
    moved = np.linalg.norm(rest.balls.position - balls.position, axis=1).max()
    log.info(
        "in balance to %.1e of the mean force (positions alone would hold it to %.1e); contacts: "
        "%d opened, %d closed; moved by %.2g of the mean overlap at most; rattlers: %d more",
        rest.residual, floor(result), opened, closed, moved / overlap,
        np.count_nonzero(result.held != network.held),
    )  # fmt: skip
    if rest.undecided:
        log.warning("of %d contacts or balls rounding decides if they bear forces", rest.undecided)
    if rest.saddle:
        log.warning("the packing rests on a saddle of its energy: a small push would rearrange it")
    return result


def law_of(network):
    """Return the law that the contacts of a network obey, by their forces and radii.

    Raises InputError where the network does not know them, or no force is there to balance.
    """
    if network.overlap is None:
        raise InputError(NO_LAW)
    if network.radius is None or network.position is None or network.normal is None:
        raise InputError("balls under a contact law need positions, normals and radii")
    if network.tangential is not None:
        raise InputError("the contact law has no friction, and the network has tangential springs")
    pressed = network.overlap > 0
    if not np.any(pressed):
        raise InputError("no contact of the network bears a force: there is nothing to balance")
    unit, force = ContactLaw(network.power), network.force[pressed]
    alone = unit.constants(*network.radius[network.bond[pressed]].T)
    modulus = np.median(force / unit.force(alone, network.overlap[pressed]))
    return ContactLaw(network.power, float(modulus))


def balls_of(network):
    """Return the balls of a network, and its contacts as the reference of increments.

    Raises InputError where it knows no law, or where contacts do not join its balls.
    """
    law, (first, second) = law_of(network), network.radius[network.bond].T
    constants, overlap = law.constants(first, second), network.overlap
    pressed = overlap > 0
    constants[pressed] = network.force[pressed] / overlap[pressed] ** law.power
    box = np.zeros(network.position.shape[1]) if network.box is None else network.box
    box = np.where(box > 0, box, np.inf)
    away = network.normal * network.distance[:, None]
    first, second = network.position[network.bond.T]
    images, _ = nearest_images(second - first, box)
    astray = np.linalg.norm(images - away, axis=1) > ASTRAY * network.distance
    for contact in np.flatnonzero(astray)[:1]:
        raise InputError(
            f"contact {contact} does not lead from ball to ball as their positions do: are periods "
            "of the box missing, or are these positions of another packing?"
        )
    load = 0.0 if network.gravity is None else network.masses[:, None] * network.gravity
    held = network.held != FREE
    balls = Balls(network.position, network.radius, held, box, law, load)
    return balls, Contacts(network.bond, away, overlap, constants)


def network_of(rest, like=None, **values):
    """Return the network of balls at rest: one `like` another, but for what changes.

    A ball without contacts is at rest.
    """
    balls, contacts = rest.balls, rest.contacts.of(rest.contacts.overlap > 0)
    held = np.where(balls.held, AT_REST, FREE) if like is None else like.held
    alone = np.bincount(contacts.pairs.ravel(), minlength=len(held)) == 0
    values = balls.law.fields(**vars(contacts)) | {
        "held": np.where(alone & (held == FREE), AT_REST, held),
        "position": balls.position,
        "radius": balls.radius,
        "box": np.where(np.isfinite(balls.box), balls.box, 0.0),
    } | values  # fmt: skip
    if like is None:
        return Network(**values)
    return dataclasses.replace(like, **values, **of_new(like))


def grown(balls, contacts, radius, growth=GROWTH):
    """Return the `Rest` of balls whose radii become others, by steps of a part of the overlap.

    An infinite part is a single step.
    """
    before = balls.radius
    overlap = contacts.overlap[contacts.overlap > 0].mean()
    steps = max(math.ceil(np.abs(radius - before).max() / (growth * overlap)), 1)
    factorizations = 0
    for step in range(1, steps + 1):
        last = step == steps
        now = radius if last else before + step / steps * (radius - before)
        contacts = contacts.grown(balls.law, balls.radius, now)
        balls = dataclasses.replace(balls, radius=now)
        rest = at_rest(balls, contacts, tolerance=BALANCED if last else ON_THE_WAY)
        rest = without_rattlers(rest) if last else rest
        balls, contacts = rest.balls, rest.contacts
        factorizations += rest.factorizations
    return rest._replace(factorizations=factorizations)


def contact_changes(before, after):
    """Return how many contacts of a network another one lacks, and how many it has besides."""
    numbers = [pair_numbers(network.bond, len(network.held)) for network in (before, after)]
    common = len(np.intersect1d(*numbers))
    return before.bonds - common, after.bonds - common


def floor(network):
    """Return how well forces would balance by positions alone, which round, in mean forces."""
    return 2 * EPSILON * np.ptp(network.position, axis=0).max() / network.overlap.mean()


def by_positions(network):
    """Return the largest difference of a force from that by positions and radii, in mean forces."""
    balls, exact = balls_of(network)
    both = exact.of(~balls.held[exact.pairs].all(axis=1)), listed(balls, reach=0.0)
    numbers = [pair_numbers(contacts.pairs, len(balls.radius)) for contacts in both]
    forces = [balls.law.force(contacts.constants, contacts.overlap) for contacts in both]
    _, place = np.unique(np.concatenate(numbers), return_inverse=True)
    difference = np.bincount(place, np.concatenate([forces[0], -forces[1]]))
    return float(np.abs(difference).max() / network.force.mean())
