"""Packings at random to import, as LAMMPS, LIGGGHTS and tables list them, and their dense K."""

import itertools

import h5py
import numpy as np

from pgran import Network, matrices
from pgran.medium.network_file import read_network

LENGTH, HERTZ = 5.0, 2.5


def pairs_in(position, radius, periods, reach=0.0):
    """All pairs of balls whose surfaces are less than `reach` apart, of all images one by one.

    A row each: the two balls, the vector from the first to the other, and its length.
    """
    rows = []
    for shift in itertools.product(*({-x, 0.0, x} for x in periods)):
        away = position[None] + shift - position[:, None]
        distance = np.linalg.norm(away, axis=2)
        for i, j in np.argwhere(np.triu(distance < radius[:, None] + radius + reach, 1)):
            rows.append((i, j, *away[i, j], distance[i, j]))
    return np.array(rows)


class Sample:
    """Balls at random in a periodic cube, and all pairs that touch or nearly do."""

    def __init__(self, axes, law="hertz", seed=0, count=None):
        count = count or {2: 40, 3: 100}[axes]
        rng = np.random.default_rng([axes, seed])
        self.axes, self.id = axes, rng.permutation(900)[:count] + 1
        self.position = rng.random((count, axes)) * LENGTH
        self.radius, self.mass = rng.uniform(0.3, 0.5, count), rng.uniform(1, 2, count)
        found = pairs_in(self.position, self.radius, [LENGTH] * axes, reach=0.1)
        turned = rng.random(len(found)) < 0.5
        self.bond = np.where(turned[:, None], found[:, [1, 0]], found[:, [0, 1]]).astype(int)
        self.distance = found[:, -1]
        self.normal = found[:, 2:-1] / np.where(turned, -1, 1)[:, None] / self.distance[:, None]
        self.overlap = self.radius[self.bond].sum(axis=1) - self.distance
        self.touch = self.overlap > 0
        h = np.maximum(self.overlap, 0)
        self.force = HERTZ * (h**1.5 if law == "hertz" else h)
        k = 1.5 * HERTZ * np.sqrt(h) if law == "hertz" else HERTZ
        self.stiffness = np.where(self.touch, k, 0)

    def dense(self, stress=True):
        """Return K over all balls, contact by contact."""
        K = np.zeros((len(self.id), self.axes) * 2)
        for (i, j), n, k, f, d in zip(
            self.bond, self.normal, self.stiffness, self.force, self.distance, strict=True
        ):
            block = k * np.outer(n, n)
            block -= stress * f / d * (np.eye(self.axes) - np.outer(n, n))
            for a, b in itertools.product((i, j), repeat=2):
                K[a, :, b, :] += block if a == b else -block
        return K

    def write(self, place, style="x", digits=17, flags="pp pp pp"):
        """Write two dumps with names that say nothing, and columns that mislead."""
        rng = np.random.default_rng(5)
        where = {
            "x": self.position,
            "xs": self.position / LENGTH,
            "xu": self.position + LENGTH * rng.integers(-2, 3, self.position.shape),
        }[style]
        names = [style.replace("x", x) for x in "xyz"[: self.axes]]
        balls = dict(zip(names, where.T, strict=True))
        balls = {"radius": self.radius, "id": self.id, "type": self.id % 2 + 1, **balls}
        balls |= {"mass": self.mass, "element": np.full(len(self.id), "C")}
        place("a.atoms", dump("ATOMS", balls, digits, flags))
        sign = -self.force[:, None] * self.normal
        contacts = [np.arange(len(self.bond)) + 1, self.touch, *self.id[self.bond].T]
        contacts += [self.distance, np.maximum(self.overlap, 0), self.force, *sign.T, sign[:, 0]]
        names = ["index", *(f"c_p[{k}]" for k in range(len(contacts) - 1))]
        place("a.contacts", dump("ENTRIES", dict(zip(names, contacts, strict=True)), digits, flags))


def dump(kind, columns, digits=17, flags="pp pp pp", step=7, ends=((0.0, LENGTH),) * 3):
    """Return a snapshot as LAMMPS writes it, in a box of these ends along each axis."""
    lines = ["ITEM: TIMESTEP", step, f"ITEM: NUMBER OF {kind}", len(next(iter(columns.values())))]
    lines += [f"ITEM: BOX BOUNDS {flags}", *(f"{low:.17g} {high:.17g}" for low, high in ends)]
    lines += [f"ITEM: {kind} {' '.join(columns)}"]
    word = lambda x: f"{x:.{digits}g}" if isinstance(x, float) else str(x)  # noqa: E731
    rows = zip(*columns.values(), strict=True)
    lines += [" ".join(word(x) for x in row) for row in rows]
    return "".join(f"{line}\n" for line in lines).replace("True", "1").replace("False", "0")


def row_of_balls(place, **columns):
    """Eight balls in a row, a distance of 1 apart, and their contacts in order, without names."""
    ball, flags = np.arange(1, 9), "ff ff ff"
    balls = {"id": ball, "x": ball * 1.0, "y": np.zeros(8)} | columns
    contacts = {"p": ball[:-1], "q": ball[1:], "r": np.ones(7, int), "s": 0.02 + ball[:-1] / 1e3}
    place("a.atoms", dump("ATOMS", balls, flags=flags))
    place("a.contacts", dump("ENTRIES", contacts, flags=flags))


def bring(call, *words):
    """Import a.atoms and a.contacts, and return what was said."""
    done = call("import", "a.atoms", "a.contacts", "-o", "n.h5", "--overwrite", *words)
    assert done.returncode == 0, done.stderr
    return done.stdout


def assert_same(sample, stress=True):
    """K of the network in n.h5 is that of the sample; return it."""
    network, ids = read_network("n.h5"), ids_of("n.h5")
    K = matrices(network).K.toarray()
    rows = {name: row for row, name in enumerate(sample.id)}
    at = [rows[name] for name in ids[network.held == 0]]
    np.testing.assert_allclose(sample.mass[at], network.masses[network.held == 0])
    wanted = sample.dense(stress)[np.ix_(at, range(sample.axes), at, range(sample.axes))]
    np.testing.assert_allclose(K, wanted.reshape(K.shape), rtol=0, atol=1e-11 * np.abs(K).max())
    return network, ids


def ids_of(path):
    with h5py.File(path) as file:
        return file["network/id"][()]


def pushes(network):
    """The sum of all contacts' forces on each ball of a network, or of what has its arrays."""
    total, each = np.zeros_like(network.position), network.force[:, None] * network.normal
    for end, sign in zip(network.bond.T, (-1, 1), strict=True):
        np.add.at(total, end, sign * each)
    return total


def cells(*overlaps, power=1.0, damping=0.1):
    """Discs, each between three that are held, whose contacts overlap so much; F = h^power."""
    angle, count = 2 * np.pi * np.arange(3) / 3, len(overlaps)
    away = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    bond = np.stack([np.zeros(3, int), [1, 2, 3]], axis=1) + 4 * np.arange(count)[:, None, None]
    position = 10.0 * np.arange(count)[:, None, None] * np.ones((4, 2))
    position[:, 1:] += (1 - np.array(overlaps)[:, None, None]) * away
    h = np.repeat(overlaps, 3)
    return Network(
        bond.reshape(-1, 2), power * h ** (power - 1), count * [0, 2, 1, 1], damping=damping,
        displacement="vector", position=position.reshape(-1, 2), force=h**power, direction=[1, 0],
        normal=np.tile(away, (count, 1)), distance=1 - h, radius=np.full(4 * count, 0.5),
        power=power,
    )  # fmt: skip


def csv_of(place, sample, **contacts):
    """Write CSV files, contacts with the columns given."""
    table = [sample.id, *sample.position.T, sample.radius, sample.mass]
    head = f"id,{','.join('xyz'[: sample.axes])},radius,mass\n"
    place("a.atoms", head + "".join(",".join(map(repr, r)) + "\n" for r in _rows(table)))
    table = [*sample.id[sample.bond].T, *contacts.values()]
    rows = "".join(";".join(map(repr, row)) + "\n" for row in _rows(table))
    place("a.contacts", "\ufeff# contacts\ni;j;" + ";".join(contacts) + "\n\n" + rows)


def _rows(table):
    return list(zip(*(np.asarray(column).tolist() for column in table), strict=True))
