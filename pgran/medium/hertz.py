"""The lattice in physical units: equal balls of one material in Hertzian contacts (paper: hertz).

SI or any other consistent units. Johnson, Contact Mechanics (1985), chapter 4; Landau and Lifshitz,
Theory of Elasticity, section 9.
"""

import math
from dataclasses import dataclass

from pgran.errors import InputError
from pgran.medium.units import einstein_frequency

# In Hertz's law k ~ F^(1/3): where k is drawn uniformly from [0, kmax], the mean force is a quarter
# of the strongest.
STRONGEST = 4.0
LARGE = 0.2  # contact radius over that of the ball, beyond which Hertz's law is a poor one


@dataclass(frozen=True)
class Material:
    """Young's modulus E, Poisson's ratio nu and density rho of balls of an isotropic solid."""

    modulus: float
    poisson: float
    density: float

    def __post_init__(self):
        """Raise InputError if no solid has these numbers."""
        for name in ("modulus", "density"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InputError(f"{name}: must be positive and finite, not {value}")
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


def force_of_pressure(pressure, diameter, fraction=0.64, contacts=6.0):
    """Return the mean force of a contact in a bed of balls under pressure.

    The mean stress of contacts F d, Z/2 of them a ball, where balls fill a part phi of the volume,
    is p = phi Z F / (pi d^2) (Rumpf); `fraction` is phi, `contacts` is Z. In the simple cubic
    lattice F = p d^2.
    """
    return math.pi * diameter**2 * pressure / (fraction * contacts)


def damping_of_quality(stiffness, quality, omega):
    """Return beta = k / (Q omega), which makes waves ring with a quality factor Q.

    It is the loss angle of a contact, and with equal contacts omega over the full width at half
    power of a mode.
    """
    return stiffness / (quality * omega)


def damping_of_restitution(stiffness, mass, restitution):
    """Return beta of a linear contact between two balls that part with a part e of their speed.

    e = exp(-pi zeta / sqrt(1 - zeta^2)), beta = 2 zeta sqrt(k m/2), with k of the contact, m of a
    ball.
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


@dataclass(frozen=True)
class Scale:
    """The units of a lattice of so many dimensions whose strongest contacts are under a force.

    In the program's units the mass of a ball, omega_mx and the spacing are 1.
    """

    material: Material
    diameter: float
    force: float
    dimensions: int = 2

    def __post_init__(self):
        """Raise InputError if numbers do not fit into doubles."""
        try:
            numbers = [self.mass, self.overlap, self.stiffness, self.omega_mx, self.velocity]
            fits = all(0 < value < math.inf for value in numbers)
        except (OverflowError, ZeroDivisionError):
            fits = False
        if not fits:
            raise InputError("diameter, material and load: too far apart to compute with")

    @property
    def mass(self):
        """The mass of a ball."""
        return ball_mass(self.material, self.diameter)

    @property
    def constant(self):
        """The c of the contact law."""
        return contact_constant(self.material, self.diameter)

    @property
    def overlap(self):
        """By how much two balls approach each other: h = (F/c)^(2/3) (paper: hertz)."""
        return (self.force / self.constant) ** (2 / 3)

    @property
    def stiffness(self):
        """The stiffness kmax of a contact: k = dF/dh = 3/2 F/h (paper: basespr)."""
        return 1.5 * self.force / self.overlap

    @property
    def omega_mx(self):
        """The unit of frequency, angular: see `einstein_frequency`."""
        return einstein_frequency(self.dimensions, self.stiffness, self.mass)

    @property
    def velocity(self):
        """The speed of long waves along an axis where all bonds are kmax: d sqrt(k/m)."""
        return self.diameter * math.sqrt(self.stiffness / self.mass)

    @property
    def random_velocity(self):
        """The speed of long waves where bonds are uniform on [0, kmax]."""
        return self.velocity * math.sqrt(effective_stiffness(self.dimensions))

    @property
    def kmax(self):
        """The stiffness in the program's units, 1 / (2 dimensions): omega_mx is 1."""
        return 1 / (2 * self.dimensions)

    @property
    def contact_radius(self):
        """The radius of a contact over that of a ball: sqrt(R* h) / R = sqrt(h/d)."""
        return math.sqrt(self.overlap / self.diameter)

    def own_damping(self, damping):
        """Return a damping in the program's units, of mass times frequency."""
        return damping / (self.mass * self.omega_mx)
