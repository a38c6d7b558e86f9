"""Tall matrices whose rows several ranks hold, block by block: QR factorizations, products."""

import math

import numpy as np

from pgran.medium.rounding import EPSILON

BLOCK = 400  # rows that are factored at once, and stay in the cache
SUMMED = 256  # rows of a product that are summed up on their own


def tall_qr(columns, comm):
    """Return Q, this rank's rows, and R of the QR factorizations of tall matrices, whole.

    Collective over `comm`, whose ranks hold the rows, the last axis but one; R is the same on all.
    """
    q, r = _qr(columns)
    if comm.size == 1:
        return q, r
    parts = comm.allgather(r)
    q2, r = np.linalg.qr(np.concatenate(parts, axis=-2))
    start = sum(part.shape[-2] for part in parts[: comm.rank])
    return q @ q2[..., start : start + q.shape[-1], :], r


def _qr(columns):
    """Factor block by block, small enough for the cache, then the triangles of the blocks."""
    *several, rows, width = columns.shape
    blocks = rows // max(BLOCK, 4 * width)
    if blocks < 2:
        return np.linalg.qr(columns)
    padding = [(0, 0)] * len(several) + [(0, -rows % blocks), (0, 0)]
    q, r = np.linalg.qr(np.pad(columns, padding).reshape(*several, blocks, -1, width))
    q2, r = _qr(r.reshape(*several, -1, width))
    q = q @ q2.reshape(*several, blocks, width, width)
    return q.reshape(*several, -1, width)[..., :rows, :], r


def qr_rounding(width):
    """Return a u: W - Q R can be computed but for u times the norms of R's columns, and is no more.

    Each entry is a sum of `width` products of complex numbers.
    """
    return 2 * EPSILON * (width + 4) * math.sqrt(width)


def products(Z, W):
    """Return Z^T W of this rank's rows, block by block: rounding adds up in short sums."""
    if len(W) <= 2 * SUMMED:
        return Z.swapaxes(-1, -2) @ W
    blocks = -(-len(W) // SUMMED)
    Z, W = (
        np.pad(x, [*[(0, 0)] * (x.ndim - 2), (0, blocks * SUMMED - len(W)), (0, 0)])
        .reshape(*x.shape[:-2], blocks, SUMMED, x.shape[-1])
        for x in (Z, W)
    )  # fmt: skip
    return (Z.swapaxes(-1, -2) @ W).sum(axis=-3)


def squares(columns):
    """Return the sums of squares of the magnitudes down the columns, the last axis but one."""
    numbers = np.ascontiguousarray(columns).view(float)
    both = np.einsum("...in,...in->...n", numbers, numbers)
    return both[..., ::2] + both[..., 1::2]
