"""How it is computed, with PETSc and SLEPc.

MPI comes before PETSc, which may have no MPI library of its own; and PETSc reads no file of
options. `pgran run` starts it with the keys of its options file; nobody else has any.
"""

import petsc4py

from pgran.errors import PgranError
from pgran.parallel import launch

launch.start()
petsc4py.init(["pgran", "-skip_petscrc", "-no_signal_handler"])  # once: later calls do nothing

from petsc4py import PETSc  # noqa: E402

if PETSc.ScalarType().dtype.kind != "c":
    raise PgranError("this PETSc has real scalars; pgran needs a complex one (pgran doctor)")
