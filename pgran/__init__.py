"""Sound in a granular material: Leibig's lattice of balls and random springs.

    lattice = pgran.Lattice.random((20, 20), seed=7)
    response = pgran.sweep(lattice, np.linspace(0.01, 1.3, 1291), detectors=[(8, 10)])
    modes = pgran.find_modes(lattice)

The functions take lattices and plain values, work alike in a notebook, a script and under mpirun,
and return the records of `pgran.results`, on every rank. Keys of PETSc's and SLEPc's solvers come
as a dict, solver={"steady_ksp_type": "gmres"}.
"""

import importlib

from pgran.run import machine

__version__ = "1.3.0"

machine.take_one_thread()  # before NumPy is loaded, if it is not

# Where the names of the Python interface come from, once they are asked for: what needs neither
# PETSc nor matplotlib does without them.
_HOMES = {
    "BondLaw": "pgran.medium.law",
    "InputError": "pgran.errors",
    "Lattice": "pgran.medium.lattice",
    "Network": "pgran.medium.network",
    "PgranError": "pgran.errors",
    "compare": "pgran.experiments.likeness.compare",
    "continuum": "pgran.experiments.continuum.scene",
    "count_modes": "pgran.experiments.modes.density",
    "ensemble": "pgran.experiments.ensemble.scene",
    "equilibrate": "pgran.balance.networks",
    "export": "pgran.command.export",
    "find_modes": "pgran.experiments.modes.scene",
    "green": "pgran.experiments.green.scene",
    "heat": "pgran.experiments.sensitivity.scene",
    "load": "pgran.medium.network_file",
    "loud": "pgran.experiments.loud.scene",
    "matrices": "pgran.medium.matrices",
    "ordered": "pgran.balance.ordered",
    "pack": "pgran.balance.pack",
    "plot": "pgran.command.plot",
    "project": "pgran.experiments.modes.projection",
    "pulse": "pgran.experiments.pulse.scene",
    "redrawn": "pgran.medium.law",
    "relax": "pgran.experiments.relaxation.scene",
    "save": "pgran.medium.network_file",
    "sensitivity": "pgran.experiments.sensitivity.scene",
    "sound": "pgran.medium.statics",
    "statistics": "pgran.experiments.ensemble.statistics",
    "structure": "pgran.experiments.structure.scene",
    "sweep": "pgran.experiments.response.scene",
    "table": "pgran.command.table",
    "transport": "pgran.experiments.ensemble.transport",
    "without_rattlers": "pgran.medium.graph",
    "with_source": "pgran.medium.source",
}
__all__ = sorted(_HOMES)


def __getattr__(name):
    if name in ("errors", "figures", "results"):
        return importlib.import_module(f"pgran.{name}")
    if name not in _HOMES:
        raise AttributeError(f"module pgran has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__():
    return [*__all__, "__version__"]
