"""The medium of a run: what it is in words, and the memory that it needs, foreseen."""

import math

from pgran.medium import labels
from pgran.store.si import SI

# Of the entries that nested dissection predicts, a factor has this part: 1.2 of them for a chain,
# .9 to .66 for 20 x 20 to 500 x 500, .73 to .61 for 6^3 to 15^3, .8 for 20^3.
FILLED = 0.75
# Bytes for each entry of a factor, with room to work in; for each nonzero of K, of a lattice and of
# a network; and for each ball in vectors. Shared by r ranks, each holds 1.3/r of a lattice.
ENTRY_BYTES, NONZERO_BYTES, NETWORK_BYTES, VECTOR_BYTES, UNEVEN = 28, 90, 250, 400, 1.3


def facts_of(options, medium):
    """Yield in words what a run's medium is; of an ensemble it is the first sample."""
    seeds = ()
    if options.scene == "ensemble":
        first = options.bonds_seed
        seeds = options.network_file or range(first, first + options.ensemble_samples)
    for fact in labels.sample(medium, labels.facts_of(options.text()), seeds):
        yield fact.replace("$", "")
    if getattr(options, f"{options.scene}_of", None) != "modes":  # samples keep no widths of theirs
        yield medium.law_in_words
    yield f"omega_mx {medium.omega_mx:.6g}{SI.of(options).say('Hz', medium.omega_mx)}"


def dissection(shape):
    """Return the entries of the factor L of a lattice by nested dissection.

    A box is cut in two across its longest axis by a layer of m balls, which is eliminated after
    both halves: it then couples to itself and to the b balls of the layers around the box, m (m/2 +
    b) entries. All boxes of one level are alike, so one box a level is counted. Like n for a chain,
    n^(4/3) for a cube of n balls; for a square of N x N the leading term is George's (1973),
    31/4 N^2 log2 N.
    """
    box, cuts, boxes, entries = [float(n) for n in shape], [0.0] * len(shape), 1.0, 0.0
    while True:
        balls = math.prod(box)
        around = sum(c * balls / side for c, side in zip(cuts, box, strict=True))
        axis = max(range(len(box)), key=box.__getitem__)
        whole = balls <= 1
        layer = balls if whole else balls / box[axis]
        entries += boxes * layer * (layer / 2 + around)
        if whole:
            return FILLED * entries
        # of the two faces across an axis, `cuts` are layers on the average, the others walls
        box[axis], cuts[axis], boxes = (box[axis] - 1) / 2, cuts[axis] / 2 + 1, 2 * boxes


def is_factored(options, medium):
    """Return whether options ask for a factorization of S."""
    key = {"response": "sweep", "modes": "modes_density"}.get(options.scene, options.scene)
    method = getattr(options, f"{key}_method", None)
    # of large media auto takes a recurrence
    if method == "moments" or (method == "auto" and key == options.scene and medium.is_large):
        return False
    return options.solver.get("steady_pc_type", "lu") in ("lu", "cholesky")


def lattice_memory(lattice, ranks, factored=True):
    """Return the bytes that each of `ranks` needs for bonds, matrices, vectors and the factor."""
    if lattice.is_grid:
        entries, each = dissection(lattice.shape), NONZERO_BYTES
    else:
        entries, each = lattice.graph.entries, NETWORK_BYTES
    matrix = each * lattice.nonzeros
    shared = matrix + VECTOR_BYTES * lattice.size + ENTRY_BYTES * entries * factored
    return 3 * 8 * lattice.bonds + shared * (1 if ranks == 1 else UNEVEN / ranks)
