"""The lattice in physical units: equal balls of one material in Hertzian contacts (paper: hertz).

SI or any other consistent units. Johnson, Contact Mechanics (1985), chapter 4; Landau and Lifshitz,
Theory of Elasticity, section 9.
"""

import math
from dataclasses import dataclass

from pgran.errors import InputError
from pgran.medium.base import check_size, einstein_frequency

# In Hertz's law k ~ F^(1/3): where k is drawn uniformly from [0, kmax], the mean force is a quarter
# of the strongest.
STRONGEST = 4.0
LARGEST_CONTACT = 0.2  # radius over that of the ball, beyond which Hertz's law is a poor one


@dataclass(frozen=True)
class Material:
    """Young's modulus E, Poisson's ratio nu and density rho of balls of an isotropic solid."""

    modulus: float
    poisson: float
    density: float

    def __post_init__(self):
        for name in ("modulus", "density"):
            check_size(name, getattr(self, name), positive=True)
        if not -1 < self.poisson <= 0.5:
            raise InputError(f"poisson: must lie above -1 and up to 0.5, not {self.poisson}")


# Typical values (Pa, 1, kg/m^3): soda-lime glass, carbon steel, polycrystalline quartz (Mavko et
# al., The Rock Physics Handbook: bulk modulus 37 GPa, shear modulus 44 GPa), acrylic glass.
QUARTZ = Material(94.5e9, 0.074, 2650.0)
MATERIALS = {
    "glass": Material(70e9, 0.22, 2500.0),
    "steel": Material(206e9, 0.29, 7850.0),
    "quartz": QUARTZ,
    "sand": QUARTZ,
    "acrylic": Material(3.2e9, 0.37, 1190.0),
}


def ball_mass(material, diameter):
    """Return the mass rho pi d^3 / 6 of a ball."""
    return material.density * math.pi * diameter**3 / 6


def contact_constant(material, diameter):
    """Return c of F = c h^(3/2) between equal balls: 4/3 E* sqrt(R*) (paper: hertz)."""
    effective = material.modulus / (2 * (1 - material.poisson**2))
    return 4 / 3 * effective * math.sqrt(diameter / 4)


def force_of_stiffness(constant, stiffness):
    """Return the force F at which k = 3/2 c^(2/3) F^(1/3); `constant` is c."""
    return (stiffness / 1.5) ** 3 / constant**2


def pressure_of_force(force, diameter, fraction=0.64, contacts=6.0):
    """Return the pressure p = phi Z F / (pi d^2) on a bed of balls of a mean contact force (Rumpf).

    Balls fill a part phi, the `fraction`, of the volume and have Z `contacts`, Z/2 of them each, of
    the stress F d. In the simple cubic lattice F = p d^2.
    """
    return fraction * contacts * force / (math.pi * diameter**2)


def damping_of_quality(stiffness, quality, omega):
    """Return beta = k / (Q omega) of a quality factor Q, the inverse loss angle of a contact.

    With equal contacts Q is omega over the full width at half power of a mode.
    """
    return stiffness / (quality * omega)


def damping_of_restitution(stiffness, mass, restitution):
    """Return beta of a linear contact of two balls that part with a part e of their speed.

    e = exp(-pi zeta / sqrt(1 - zeta^2)), beta = 2 zeta sqrt(k m/2), of k and a ball's mass m.
    """
    loss = -math.log(restitution)
    return 2 * loss / math.hypot(math.pi, loss) * math.sqrt(stiffness * mass / 2)


def restitution_of_damping(stiffness, mass, damping):
    """Return e of `damping_of_restitution` for a beta, 0 if it is overdamped."""
    zeta = damping / math.sqrt(2 * stiffness * mass)
    return math.exp(-math.pi * zeta / math.sqrt(1 - zeta**2)) if zeta < 1 else 0.0


def effective_stiffness(dimensions):
    """Return the constant that acts as bonds uniform on [0, 1] do, for long waves of the lattice.

    By effective-medium theory (Kirkpatrick, Rev. Mod. Phys. 45, 574, 1973): 0 for a chain, .3979
    for the square lattice, where it is right to 2 % or so.
    """
    others = dimensions - 1  # constants by which the rest of the lattice acts beside each bond
    if not others:
        return 0.0
    low, high = 0.0, 1.0
    for _ in range(60):  # <(x - k) / (k + others x)> = 0, which grows with x
        x = (low + high) / 2
        mean = (1 + others) * x * math.log1p(1 / (others * x)) - 1
        low, high = (x, high) if mean < 0 else (low, x)
    return x


class Scale:
    """The units of a lattice whose strongest contacts are under a force.

    In the program's units the mass of a ball, omega_mx and the spacing are 1, and the stiffness is
    `kmax`. Raises InputError if numbers do not fit into doubles.
    """

    def __init__(self, material, diameter, force, dimensions=2):
        self.material, self.diameter = material, diameter
        self.force, self.dimensions = force, dimensions
        self.kmax = 1 / (2 * dimensions)
        try:
            self.mass = ball_mass(material, diameter)
            self.constant = contact_constant(material, diameter)
            self.overlap = (force / self.constant) ** (2 / 3)  # h: how far two balls approach
            self.stiffness = 1.5 * force / self.overlap  # k = dF/dh (paper: hertz, basespr)
            self.omega_mx = einstein_frequency(dimensions, self.stiffness, self.mass)
            # of long waves along an axis, all bonds kmax; then uniform on [0, kmax]
            self.velocity = diameter * math.sqrt(self.stiffness / self.mass)
            self.random_velocity = self.velocity * math.sqrt(effective_stiffness(dimensions))
            # the radius of a contact over that of a ball: sqrt(R* h) / R
            self.contact_radius = math.sqrt(self.overlap / diameter)
            numbers = self.mass, self.overlap, self.stiffness, self.omega_mx, self.velocity
            fits = all(0 < value < math.inf for value in numbers)
        except (OverflowError, ZeroDivisionError):
            fits = False
        if not fits:
            raise InputError("diameter, material and load: too far apart to compute with")

    @property
    def packed(self):
        """The units of force and time of `pgran pack`, where diameter and mass are 1, c is 1/2."""
        force = 2 * self.constant * self.diameter**1.5
        return force, math.sqrt(self.mass * self.diameter / force)

    @property
    def own_constant(self):
        """c of F = c h^(3/2) in the program's units, by which kmax belongs to the same overlap."""
        return self.kmax / (1.5 * math.sqrt(self.overlap / self.diameter))

    def own_damping(self, damping):
        """Return a damping in the program's units, of mass times frequency."""
        return damping / (self.mass * self.omega_mx)
