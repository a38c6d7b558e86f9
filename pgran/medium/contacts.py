"""The springs of a network's contacts as rows of B.

A contact of the balls i and j is a few springs; b u is how far each is stretched:

- along the normal n, from i to j, of the contact's stiffness: b u = n . (u_j - u_i);
- along each tangent t, of its tangential stiffness: b u = t . (u_j - u_i), with rotations less
  (R_i theta_i + R_j theta_j) . (n x t), which is zero for rolling;
- along each tangent, of the constant -F / d, if the contact bears a force F at a distance d:
  b u = t . (u_j - u_i) (pre-stress).

Dashpots act on the relative velocity at each contact, or on its normal part.
"""

from typing import NamedTuple

import numpy as np

from pgran.medium.springs import DRIVEN, Springs


class Block(NamedTuple):
    """A spring of each contact: rows of B, k, k without pre-stress, its share of beta."""

    name: str
    rows: np.ndarray
    constants: np.ndarray
    elastic: np.ndarray
    share: np.ndarray | float


def springs_of(network):
    """Return the springs of a `network.Network`."""
    balls, components = len(network.held), network.components
    unknown = np.full((balls + 1, components), -1)
    unknown[network.free] = np.arange(network.size).reshape(-1, components)
    i, j = network.bond.T
    columns = np.concatenate([unknown[i], unknown[j]], axis=1)
    moving = np.zeros((balls, components))
    moving[network.held == DRIVEN, : network.axes] = network.direction
    first, second = moving[i], moving[j]
    weights = np.append(network.weights, 0.0)[columns]
    blocks = _blocks(network, i, j)
    each = (len(blocks), 1)
    values = np.concatenate([block.rows for block in blocks])
    elastic = np.concatenate([block.elastic for block in blocks])
    shares = np.concatenate([np.broadcast_to(block.share, len(i)) for block in blocks])
    angles = np.zeros(len(i)) if network.loss is None else network.loss

    def stretched(*moving, rows=values):
        return np.einsum("sw,sw->s", rows, np.tile(np.concatenate(moving, axis=1), each))

    return Springs(
        network.size,
        tuple(block.name for block in blocks),
        np.tile(columns, each),
        values * np.tile(weights, each),
        stretched(first, second),
        stretched(abs(first), abs(second), rows=abs(values)),
        stretched(-first, second),
        np.concatenate([block.constants for block in blocks]),
        elastic,
        shares,
        shares * network.dashpot_law(elastic),
        np.tile(angles, len(blocks)),
    )


def _blocks(network, i, j):
    """Return the `Block`s of springs that contacts of the balls i and j have."""
    # A row of a contact: -t (of u_i), the first ball's rotation, t (of u_j), the second's.
    still = np.zeros((len(i), network.turns))

    def row(t, first=still, second=still):
        return np.concatenate([-t, first, t, second], axis=1)

    share = 1.0 if network.dashpot is None else network.dashpot
    scalar = network.displacement == "scalar"
    along = np.ones((len(i), 1)) if scalar else network.normal
    blocks = [Block("normal", row(along), network.stiffness, network.stiffness, share)]
    if scalar:
        return blocks
    nothing = np.zeros(len(i))
    pre_stress = nothing if network.force is None else -network.force / network.distance
    shear = nothing if network.tangential is None else network.tangential
    damped = share * float(network.damped == "all")
    if network.tangential_dashpot is not None:
        damped = network.tangential_dashpot
    # constants that are given, zeros too: amplitudes have derivatives by them
    bent, sheared = network.force is not None, network.tangential is not None or np.any(damped)
    across = tangents(network.normal)
    # n x t: of two tangents each is the other's, exactly
    levers = [np.ones((len(i), 1))] if len(across) == 1 else [across[1], -across[0]]
    for t, lever in zip(across, levers, strict=True):
        if not network.turns and (bent or sheared):
            blocks.append(Block("transverse", row(t), shear + pre_stress, shear, damped))
        if network.turns and sheared:
            # (R theta) . (n x t): what a ball's rotation adds to the slip along t
            turned = [-network.radius[end][:, None] * lever for end in (i, j)]
            blocks.append(Block("tangential", row(t, *turned), shear, shear, damped))
        if network.turns and bent:
            blocks.append(Block("pre_stress", row(t), pre_stress, nothing, 0.0))
    return blocks


def tangents(normal):
    """Return the directions across normals, an array like them for each."""
    if normal.shape[1] == 2:
        return [np.stack([-normal[:, 1], normal[:, 0]], axis=1)]
    axis = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
    first = np.cross(normal, axis)
    first /= np.linalg.norm(first, axis=1)[:, None]
    return [first, np.cross(normal, first)]
