"""The record of the lattice that a result belongs to; `network` has that of networks."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgran.errors import InputError
from pgran.medium.base import AXES
from pgran.store.record import Record, array, attribute


@dataclass(frozen=True, eq=False, repr=False)
class LatticeRecord(Record):
    """The lattice a result belongs to."""

    group = "lattice"
    shape: tuple[int, ...] = attribute("balls along each axis", "1")
    mass: float = attribute("mass of a ball", "m")
    damping: float = attribute("beta, of every bond's dashpot", "sqrt(k m)")
    omega_mx: float = attribute("sqrt(2 d kmax / m)", "sqrt(k/m)")
    bonds_sha256: str = attribute("checksum of the bond constants", of_run=True)
    stiffness_x: np.ndarray = array("constants of the bonds along x", "k", "bonds_x")
    stiffness_y: np.ndarray | None = array(
        "constants of the bonds along y", "k", "bonds_y", optional=True
    )
    stiffness_z: np.ndarray | None = array(
        "constants of the bonds along z", "k", "bonds_z", optional=True
    )
    wall: np.ndarray | None = array(
        "how far each place of the driven wall moves; by default 1", "1", "place", optional=True
    )
    push: np.ndarray | None = array(
        "force on each ball, which drives instead of the wall", "k", "balls", optional=True
    )
    free: str | None = attribute("sides without a wall, as y+,y-", optional=True)
    damping_power: float | None = attribute("p of dashpots beta (k / k_ref)^p", "1", optional=True)
    damping_reference: float | None = attribute("k_ref of that law", "k", optional=True)
    drag: float | None = attribute("alpha of a drag -alpha m v", "sqrt(k/m)", optional=True)
    loss: float | None = attribute("eta of springs k (1 + i eta)", "1", optional=True)
    kmax: float | None = attribute("stiffness that omega_mx is by", "k", optional=True)
    hertz: float | None = attribute(
        "c of F = c h^(3/2), by which contacts overlap", "k / sqrt(length)", optional=True
    )

    length = "spacings"  # what distances are in
    has_places = True  # its balls, to be drawn at

    def __post_init__(self):
        there = [k is not None for k in (self.stiffness_x, self.stiffness_y, self.stiffness_z)]
        axes = len(self.shape)
        if there != [True] * axes + [False] * (3 - axes) or min(self.shape) < 1:
            raise InputError(f"shape: {self.shape} does not fit {sum(there)} arrays stiffness_*")

    @property
    def stiffness(self):
        """The constants of the bonds, an array for each axis, as `Lattice` takes them."""
        return (self.stiffness_x, self.stiffness_y, self.stiffness_z)[: len(self.shape)]

    @property
    def axes(self):
        """How long the axes of the lattice and of its bonds are, by name."""
        balls = dict(zip(AXES, self.shape, strict=False))
        return {"axis": len(balls)} | balls | {f"bond_{name}": n + 1 for name, n in balls.items()}

    @property
    def free_balls(self):
        """How many balls move freely: all."""
        return math.prod(self.shape)

    @cached_property
    def built(self):
        """The lattice itself."""
        from pgran.medium.lattice import Lattice

        kmax = self.kmax or self.mass * self.omega_mx**2 / (2 * len(self.shape))
        wall = None if self.wall is None else self.wall.reshape(self.shape[1:])
        laws = {name: getattr(self, name) or 0.0 for name in ("damping_power", "drag", "loss")}
        return Lattice(
            self.stiffness, self.mass, self.damping, kmax, wall, self.push, self.free or (),
            damping_reference=self.damping_reference, hertz=self.hertz, **laws,
        )  # fmt: skip

    @classmethod
    def of(cls, lattice):
        """Return the record of a lattice."""
        same = ("shape", "mass", "damping", "omega_mx", "bonds_sha256", "push", "kmax")
        values = {name: getattr(lattice, name) for name in same}
        values |= {f"stiffness_{x}": k for x, k in zip(AXES, lattice.stiffness, strict=False)}
        values["wall"] = None if lattice.wall is None else lattice.wall.ravel()
        values["free"] = ",".join(lattice.free) or None
        for name in ("damping_power", "damping_reference", "drag", "loss", "hertz"):
            values[name] = getattr(lattice, name) or None  # only what there is
        return cls(**values)
