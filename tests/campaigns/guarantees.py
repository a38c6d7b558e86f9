"""Random cases of what is guaranteed, many of them: numbers of lattices and networks, judged.

    python tests/campaigns/guarantees.py NAME FIRST LAST

tries the seeds from FIRST to before LAST, and prints what is false and what was seen. NAME is one
of `GUARANTEES` in tests/guarantees.py; tests/test_guarantees.py tries a few cases of each.
"""

import logging
import sys
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # before this script, which has the same name

from guarantees import GUARANTEES, carry_out


def main(name, first, last):
    """Carry out random cases; return the number of faults."""
    logging.disable()  # what PETSc fails at
    seen, faults = Counter(), 0
    for fault in carry_out(name, range(int(first), int(last)), seen):
        print(fault, flush=True)
        faults += 1
    print(f"{name} {first} to {last}:", ", ".join(f"{n:.7g} {what}" for what, n in seen.items()))
    return faults


if __name__ == "__main__":
    if len(sys.argv) != 4 or sys.argv[1] not in GUARANTEES:
        sys.exit(f"{__doc__}\nNAME: {', '.join(GUARANTEES)}")
    sys.exit(main(*sys.argv[1:]) > 0)
