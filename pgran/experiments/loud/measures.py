"""What is measured of a periodic state."""

import numpy as np


def read(balance, U, sites):
    """Return the harmonics (nd, N + 1) that detectors read of a field. Collective."""
    first, last = balance.operators.first, balance.operators.last
    unknowns, weights = balance.operators.layout.readings(sites)
    mine = (unknowns >= first) & (unknowns < last)
    values = np.vstack([U, np.zeros_like(U, shape=(1, U.shape[1]))])
    rows = np.where(mine, unknowns - first, len(U))
    return balance.summed(np.einsum("da,dan->dn", weights, values[rows]))


def measured(balance, U, field, contact):
    """Return what a record holds of a state, by name. Collective.

    `field` is the linear one for the amplitude 1, `contact` are the numbers of all contacts.
    """
    a, contacts, norm = balance.amplitude, balance.contacts, balance.norm
    balance.residual(U)
    balance.linearize()
    opened, near = balance.stretch >= contacts.overlap[:, None], contacts.number < 0
    claps = balance.counted & opened.any(axis=1) & ~opened.all(axis=1)
    clapped = np.zeros(len(contact), np.int8)
    clapped[np.searchsorted(contact, contacts.number[claps & ~near])] = 1
    clapped, first = balance.summed(clapped), norm(U[:, 1])
    parts = {"mean": 0, "second": 2, "third": 3}
    found = {name: norm(U[:, n]) / first for name, n in parts.items() if n <= balance.harmonics}
    found["change"] = norm(U[:, 1] - a * field) / norm(a * field)
    found["clapped"], found["clapping"] = clapped, clapped.mean()
    closing = balance.summed(np.sum([claps & near, balance.counted & near], axis=1))
    found["closing"] = closing[0] / max(closing[1], 1)
    found["power_in"], found["power_lost"] = _powers(balance, U)
    return found


def _powers(balance, U):
    """Return the mean power of the drive, and what is lost."""
    w, a, mine, contacts = balance.omega, balance.amplitude, balance.counted, balance.contacts
    stiffness, damping = balance.medium.pulls
    phi, psi = (harmonics[mine, 1] for harmonics in balance.harmonic_forces)
    force = contacts.drive[mine] @ (phi + 1j * w * psi)
    force -= (balance.force + 1j * w * balance.force_rate) @ U[:, 1]
    force = balance.summed(force) + a * (stiffness + 1j * w * damping)
    # of the dashpots at rest, and what they lose besides while contacts move
    lost = np.sum((w * balance.n) ** 2 * (U.conj() * balance.damped(U)).real) / 2
    lost -= w**2 * a * np.real(balance.force_rate @ U[:, 1])
    speed = balance.times(1j * w * balance.n * balance.stretches(U, a))
    lost += np.mean(balance.tangents[1] * speed**2, axis=1)[mine].sum()
    return w * a * force.imag / 2, balance.summed(lost) + (w * a) ** 2 * damping / 2
