"""Instead of LAMMPS: reads the script and the data file of an export, and writes its two dumps.

Contacts are those of all pairs of balls and all their images, one by one.
"""

import re
import sys
from pathlib import Path

import numpy as np
from packing_samples import dump, pairs_in


def read_packing(script):
    """Return what a script and its data file say of a packing, as a dictionary."""
    words = dict(line.partition(" ")[::2] for line in Path(script).read_text().splitlines())
    head, _, rows = (Path(script).parent / words["read_data"]).read_text().partition("Atoms # ")
    kind, _, rows = rows.partition("\n\n")
    assert kind == words["atom_style"] == "sphere"
    rows = np.loadtxt(rows.splitlines(), ndmin=2)
    assert re.search(r"(\d+) atoms$", head, re.MULTILINE)[1] == str(len(rows))
    assert rows[:, 1].max() <= int(re.search(r"(\d+) atom types$", head, re.MULTILINE)[1])
    assert np.array_equal(rows[:, 0], np.arange(len(rows)) + 1)
    ends = re.findall(r"^(\S+) (\S+) (.)lo (.)hi$", head, re.MULTILINE)
    assert "".join(x + y for *_, x, y in ends) == "xxyyzz"
    low, high = np.array([end[:2] for end in ends], dtype=float).T
    axes, flags = int(words["dimension"]), words["boundary"].split()
    style, modulus, *others = words["pair_style"].split()
    assert {*others} == {"0"}  # neither tangential springs nor dashpots nor friction
    return {
        "style": style, "modulus": float(modulus), "axes": axes, "low": low, "high": high,
        "periods": np.where([x == "p" for x in flags], high - low, 0.0)[:axes], "flags": flags,
        "type": rows[:, 1].astype(int), "radius": rows[:, 2] / 2,
        "mass": rows[:, 3] * (4 / 3 * np.pi * (rows[:, 2] / 2) ** 3),
        "position": rows[:, 4 : 4 + axes], "beyond": rows[:, 4 + axes :],
    }  # fmt: skip


def contacts_of(packing):
    """Return pairs, distances and forces of all balls that overlap, a row each."""
    power = {"gran/hooke/history": 1.0, "gran/hertz/history": 1.5}[packing["style"]]
    radius = packing["radius"]
    found = pairs_in(packing["position"], radius, packing["periods"])
    i, j = found[:, :2].astype(int).T
    overlap = radius[i] + radius[j] - found[:, -1]
    rounded = (radius[i] * radius[j] / (radius[i] + radius[j])) ** (power - 1)
    force = packing["modulus"] * rounded * overlap**power
    return np.column_stack([i, j, found[:, -1], force])


def main(script):
    """Write the dumps that the script asks for."""
    packing, text = read_packing(script), Path(script).read_text()
    balls = {name: packing[name] for name in ("type", "radius", "mass")}
    balls |= {"id": np.arange(len(packing["type"])) + 1} | dict(
        zip("xyz", packing["position"].T, strict=False)
    )
    first, other, distance, force = contacts_of(packing).T
    contacts = [first.astype(int) + 1, other.astype(int) + 1, distance, force]
    box = {"flags": " ".join(2 * x for x in packing["flags"]), "step": 0}
    box["ends"] = [*zip(packing["low"], packing["high"], strict=True)]
    for kind, name, words in re.findall(r"^dump .* (custom|local) 1 (\S+) (.*)$", text, re.M):
        names = words.split()
        columns = balls if kind == "custom" else dict(zip(names, contacts, strict=True))
        kind = {"custom": "ATOMS", "local": "ENTRIES"}[kind]
        snapshot = dump(kind, {name: columns[name] for name in names}, **box)
        (Path(script).parent / name).write_text(snapshot)


if __name__ == "__main__":
    main(sys.argv[1])
