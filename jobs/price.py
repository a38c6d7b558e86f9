"""What it costs to keep finished units: sweeps and relaxations with a journal and without.

python jobs/price.py prints the ratio of the medians for each experiment, measured in turns. Nothing
else should run meanwhile.
"""

import contextlib
import importlib
import statistics
import tempfile
import time
from pathlib import Path

import mpi4py.MPI  # noqa: F401 (first: PETSc may have no MPI library of its own)
import petsc4py

petsc4py.init(["price", "-skip_petscrc"])

from mpi4py import MPI  # noqa: E402

from pgran.files.reading import read_file, read_words, resolve  # noqa: E402
from pgran.parallel.journal import Journal  # noqa: E402

REPEATS = 9
QUIET = ["-output_progress", "none"]
EXPERIMENTS = ("response", "relaxation_long", "modes")


def seconds(scene, options, path):
    """Return the seconds that a run takes, with a journal at `path` unless it is None."""
    began = time.perf_counter()
    journal = Journal(MPI.COMM_WORLD, path, {}) if path else contextlib.nullcontext()
    with journal as journal:
        scene.run(options, MPI.COMM_WORLD, journal)
    return time.perf_counter() - began


def main():
    """Measure all experiments."""
    folder = Path(__file__).resolve().parent.parent / "options"
    with tempfile.TemporaryDirectory() as temporary:
        path = Path(temporary) / "a.h5"
        for name in EXPERIMENTS:
            given = [*read_file(folder / f"{name}.opts"), *read_words(QUIET)]
            options = resolve(given, output_file=str(path))
            scene = importlib.import_module(f"pgran.scenes.{options.scene}")
            seconds(scene, options, path)
            times = [[seconds(scene, options, p) for p in (path, None)] for _ in range(REPEATS)]
            kept, plain = (statistics.median(column) for column in zip(*times, strict=True))
            pairs = statistics.median(a / b for a, b in times)
            print(
                f"{name}: {kept:.3f} s with the journal, {plain:.3f} s without, "
                f"ratio {kept / plain:.3f} ({pairs:.3f} in pairs)"
            )


if __name__ == "__main__":
    main()
