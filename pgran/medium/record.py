"""The records of what a result belongs to: a lattice, or another network."""

import math
from dataclasses import dataclass, field, fields
from functools import cached_property

import numpy as np

from pgran.medium.base import Medium
from pgran.medium.springs import FREE
from pgran.store.record import SPACE, MisfitError, Record, Result, array, attribute, attribute_array


@dataclass(frozen=True, eq=False, repr=False)
class LatticeRecord(Record):
    """The lattice a result belongs to."""

    group = "lattice"
    shape: tuple[int, ...]
    mass: float
    damping: float
    omega_mx: float
    bonds_sha256: str = field(metadata={"of_run": True})  # an attribute of the whole file
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
    free: str | None = attribute(optional=True)  # sides without a wall, "y+,y-"
    damping_power: float | None = attribute(optional=True)
    damping_reference: float | None = attribute(optional=True)
    drag: float | None = attribute(optional=True)
    loss: float | None = attribute(optional=True)

    def __post_init__(self):
        there = [k is not None for k in (self.stiffness_x, self.stiffness_y, self.stiffness_z)]
        axes = len(self.shape)
        if there != [True] * axes + [False] * (3 - axes) or min(self.shape) < 1:
            raise MisfitError(f"shape: {self.shape} does not fit {sum(there)} arrays stiffness_*")

    length = "spacings"  # what distances are in
    has_places = True  # its balls, to be drawn at

    @property
    def stiffness(self):
        """The constants of the bonds, an array for each axis, as `Lattice` takes them."""
        return (self.stiffness_x, self.stiffness_y, self.stiffness_z)[: len(self.shape)]

    @property
    def axes(self):
        """How long the axes of the lattice and of its bonds are, by name."""
        balls = dict(zip(SPACE, self.shape, strict=False))
        return {"axis": len(balls)} | balls | {f"bond_{name}": n + 1 for name, n in balls.items()}

    @property
    def free_balls(self):
        """How many balls move freely: all."""
        return math.prod(self.shape)

    @cached_property
    def built(self):
        """The lattice itself, a `lattice.Lattice`."""
        from pgran.medium.lattice import Lattice

        kmax = self.mass * self.omega_mx**2 / (2 * len(self.shape))
        wall = None if self.wall is None else self.wall.reshape(self.shape[1:])
        laws = {name: getattr(self, name) or 0.0 for name in ("damping_power", "drag", "loss")}
        return Lattice(
            self.stiffness, self.mass, self.damping, kmax, wall, self.push, self.free or (),
            damping_reference=self.damping_reference, **laws,
        )  # fmt: skip

    @classmethod
    def of(cls, lattice):
        """Return the record of a `lattice.Lattice`."""
        same = ("shape", "mass", "damping", "omega_mx", "bonds_sha256", "push")
        arrays = {f"stiffness_{x}": k for x, k in zip(SPACE, lattice.stiffness, strict=False)}
        if lattice.wall is not None:
            arrays["wall"] = lattice.wall.ravel()
        if lattice.free:
            arrays["free"] = ",".join(lattice.free)
        laws = ("damping_power", "damping_reference", "drag", "loss")
        arrays |= {name: getattr(lattice, name) or None for name in laws}  # only what there is
        return cls(**{name: getattr(lattice, name) for name in same}, **arrays)


@dataclass(frozen=True, eq=False, repr=False)
class NetworkRecord(Record):
    """The network a result belongs to: N balls, nb contacts, laid out like a network's own file.

    Arrays of `balls` in other records have the components of its free balls one after the other.
    """

    group = "network"
    displacement: str
    damped: str
    component: str
    damping: float
    kmax: float
    median_mass: float = attribute(since=5)
    omega_mx: float
    unknowns: int
    bonds_sha256: str = field(metadata={"of_run": True})
    direction: np.ndarray = attribute_array("drive_coordinate")
    bond: np.ndarray = array("balls of the contacts", "1", "contact", "end", dtype=int)
    stiffness: np.ndarray = array("constants of the contacts", "k", "contact")
    held: np.ndarray = array("0: free, 1: at rest, 2: driven", "1", "ball", dtype=int)
    mass: np.ndarray = array("masses of the balls", "m", "ball")
    position: np.ndarray | None = array(
        "positions of the balls", "1", "ball", "coordinate", optional=True
    )
    radius: np.ndarray | None = array("radii of the balls", "1", "ball", optional=True)
    normal: np.ndarray | None = array(
        "from the first ball of a contact to the second, of length 1",
        "1", "contact", "coordinate", optional=True,
    )  # fmt: skip
    distance: np.ndarray | None = array("of the centres", "1", "contact", optional=True)
    force: np.ndarray | None = array("repulsive force", "k", "contact", optional=True)
    tangential: np.ndarray | None = array(
        "constants of tangential springs", "k", "contact", optional=True
    )

    push: np.ndarray | None = array(
        "force on each ball, which drives instead of held balls", "k", "ball", "drive_coordinate",
        optional=True,
    )  # fmt: skip

    dashpot: np.ndarray | None = array("part of the damping", "1", "contact", optional=True)
    tangential_dashpot: np.ndarray | None = array(
        "part of the damping along tangents", "1", "contact", optional=True
    )
    drag: np.ndarray | None = array("alpha of the balls", "sqrt(k/m)", "ball", optional=True)
    loss: np.ndarray | None = array("eta of the contacts", "1", "contact", optional=True)
    damping_power: float | None = attribute(optional=True)
    damping_reference: float | None = attribute(optional=True)
    power: float | None = attribute(optional=True)
    box: np.ndarray | None = attribute_array("coordinate", optional=True)
    gravity: np.ndarray | None = attribute_array("coordinate", optional=True)

    length = "lengths"

    @property
    def has_places(self):
        """Whether its balls have positions, to be drawn at."""
        return self.position is not None

    @property
    def axes(self):
        """How long the axes of its unknowns are, by name."""
        return {"axis": 1, "x": self.unknowns}

    @property
    def shape(self):
        """The unknowns, as those of `network.Network`."""
        return (self.unknowns,)

    @property
    def free_balls(self):
        """How many balls move freely."""
        return int(np.count_nonzero(self.held == FREE))

    @cached_property
    def built(self):
        """The network itself, a `network.Network`."""
        from pgran.medium.network import Network

        same = [item.name for item in fields(self) if item.name in Network.__dataclass_fields__]
        values = {name: getattr(self, name) for name in same}
        if self.median_mass is None:  # of an older file: the median of the free balls
            values["median_mass"] = float(np.median(self.mass[self.held == FREE]))
        return Network(masses=self.mass, **values)

    @classmethod
    def of(cls, network):
        """Return the record of a `network.Network`."""
        same = [item.name for item in fields(cls) if item.name not in ("mass", "unknowns")]
        values = {name: getattr(network, name) for name in same}
        values["damping_power"] = network.damping_power or None
        return cls(mass=network.masses, unknowns=network.size, **values)


def record_of(lattice):
    """Return the record of a lattice or of another network."""
    return (LatticeRecord if lattice.is_grid else NetworkRecord).of(lattice)


def as_result(medium):
    """Return a lattice or a network by itself as a result, others as they are."""
    if not isinstance(medium, Medium):
        return medium
    record = record_of(medium)
    return Result([record], scene=record.group)
