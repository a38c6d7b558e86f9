"""Random networks that lose sound by random laws of damping."""

import dataclasses

import numpy as np
from network_samples import random_network


def lawful_network(seed):
    """A random network with laws of damping: any of them, singular C and floating parts among."""
    case = random_network(seed, balls=7)
    return dataclasses.replace(case, network=with_laws(case.network, seed))


def with_laws(network, seed):
    """Return a network that loses sound by random laws."""
    rng = np.random.default_rng([19, seed])
    contacts, balls = len(network.bond), len(network.held)
    laws = {}
    if rng.random() < 0.6:
        laws["damping_power"] = rng.choice([-0.5, 0.5, 1.0, 2.0])
    if rng.random() < 0.5:
        laws["drag"] = 10 ** rng.uniform(-4, 0, balls) * rng.integers(0, 2, balls)
    if rng.random() < 0.4:
        laws["loss"] = 10 ** rng.uniform(-4, -0.5) * (1 + 0.5 * rng.random(contacts))
    if rng.random() < 0.3:
        laws["dashpot"] = rng.random(contacts) * rng.integers(0, 2, contacts)
    if network.displacement != "scalar" and network.damped == "all" and rng.random() < 0.3:
        laws["tangential_dashpot"] = rng.random(contacts)
    return dataclasses.replace(network, **laws)
