"""Keys that belong to PETSc and SLEPc, and which of them a file may set.

A file can choose solvers and set numbers; it cannot make PETSc load code, start programs or write
files. What is not on the list is taken from the command line only, from who means it.
"""

import contextlib
import functools
import logging
import re

from pgran.arguments import meant, nearest, shown
from pgran.errors import InputError
from pgran.run import launch
from pgran.run.options import read_file, text_of

log = logging.getLogger("pgran")
SMALLEST_SHIFT = 1e-14  # of pivots, against bond constants of about 1


def _one_of(names):
    """Return a regular expression of names apart by blanks."""
    return f"({'|'.join(names.split())})"


# What a file may give, in letters of either case: numbers, a flag, or one of a few words that do no
# harm; PETSc refuses others. Long numbers need an exponent, which PETSc takes for no integer: no
# file asks for absurd work.
NUMBER = r"[+-]?(\d{1,6}(\.\d*)?|\.\d+)(e[+-]?\d{1,3})?"
VALUE = rf"|{NUMBER}(,{NUMBER})*|\d{{0,2}}[a-z]\w*"
COUNT = r"\d{1,3}"  # of what takes memory or time each
ALONE = ""  # prints to the terminal; a value would name a file or a window
# Types and packages: those for complex numbers and for a matrix without grids, of which multigrid
# (mg) crashes.
TYPE = _one_of(
    "bcgs bcgsl bicg cg cgls cgne cgs chebyshev cr fbcgs fbcgsr fcg fgmres gcr gmres groppcg "
    "lgmres lsqr pgmres pipebcgs pipecg pipecg2 pipecgrr pipecr pipefcg pipegcr pipeprcg preonly "
    "qmrcgs richardson tcqmr tfqmr asm bjacobi cholesky composite eisenstat gamg gasm icc ilu "
    "jacobi lu none pbjacobi redundant sor svd telescope petsc mumps superlu superlu_dist klu "
    "umfpack cholmod pastix strumpack mkl_pardiso mkl_cpardiso krylovschur lanczos arnoldi power "
    "subspace lapack gd jd rqcg lobpcg ciss arpack primme blopex trlan feast evsl elpa elemental "
    "scalapack chase toar stoar qarnoldi linear shift sinvert cayley precond filter rk alpha2 "
    "basic dsp newtonls newtontr nrichardson qn anderson bt l2 cp"
)
TYPE = f"{TYPE}(,{TYPE})*"

# The keys of solvers that a file may set, by the values that they take: of linear systems, with no
# unit of Fortran that MUMPS prints to (icntl 1 to 3, files fort.N) and no factors on disk (22),
LINEAR = {
    TYPE: "ksp_type pc_type pc_composite_pcs pc_factor_mat_solver_type",
    COUNT: "ksp_((gmres|gcr)_restart|lgmres_augment|bcgsl_ell|(fcg|pipefcg|pipegcr)_mmax) "
    "ksp_chebyshev_esteig_steps pc_(factor_levels|(asm|gasm)_overlap|gasm_total_subdomains) "
    "pc_((asm|bjacobi)_(local_)?blocks|sor_l?its|mg_levels|mg_multiplicative_cycles) "
    "pc_(redundant_number|telescope_reduction_factor) mat_superlu_dist_[rc] "
    "pc_gamg_(agg_nsmooths|aggressive_coarsening|square_graph)",
    VALUE: "ksp_(rtol|atol|divtol|max_it|min_it|check_norm_iteration|richardson_scale|knoll) "
    "ksp_gmres_(haptol|breakdown_tolerance|(modified|classical)gramschmidt|preallocate) "
    "ksp_chebyshev_(eigenvalues|esteig|kind) ksp_(initial_guess_nonzero|lag_norm|cg_type) "
    "ksp_bcgsl_(xres|cxpoly|mrpoly|pinv) ksp_(diagonal_scale(_fix)?|lgmres_constant|norm_type) "
    "ksp_(richardson_self_scale|cg_single_reduction|pc_side|fcg_truncation_type) "
    "ksp_gmres_cgs_refinement_type pc_factor_(fill|zeropivot|shift_amount|column_pivot) "
    "pc_factor_(nonzeros_along_diagonal|diagonal_fill|in_place|pivot_in_blocks) "
    "pc_factor_(reuse_fill|reuse_ordering|mat_ordering_type|shift_type) pc_eisenstat_omega "
    "pc_sor_(omega|diagonal_shift|(local_)?(symmetric|forward|backward)) pc_svd_zero_sing "
    "pc_gamg_(threshold|threshold_scale|coarse_eq_limit|process_eq_limit|repartition) "
    "pc_gamg_(reuse_interpolation|use_sa_esteig) pc_jacobi_(abs|fixdiagonal) pc_mg_cycle_type "
    "pc_mg_distinct_smoothup pc_(asm|asm_local|gasm|composite|jacobi|mg|gamg)_type "
    "mat_mumps_icntl_([46-8]|1[0-5]|2[0347-9]|3[135-8]|4[89]|58) mat_mumps_cntl_[1-57] "
    "mat_superlu_dist_(equil|parsymbfact|replacetinypivot|iterrefine|rowperm|colperm|fact)",
    ALONE: "ksp_view ksp_converged_reason ksp_converged_rate ksp_monitor pc_view "
    "ksp_monitor_(true_residual|short|singular_value|max) mat_superlu_dist_(statprint|printstat)",
}
# of modes, with what these solvers stand on: bases (bv), dense problems (ds), regions (rg),
MODES = {
    TYPE: "eps_type pep_type st_type",
    COUNT: "eps_(balance_its|krylovschur_partitions|rqcg_reset|lobpcg_blocksize) st_filter_degree "
    "eps_[gj]d_(blocksize|minv|plusk|initial_size) ds_(method|block_size) "
    "eps_ciss_((refine_)?(blocksize|inner)|integration_points|moments|maxblocksize|partitions)",
    VALUE: "(eps|pep)_(tol|max_it|nev|ncv|mpd|target|interval|conv_(abs|rel|norm)|true_residual) "
    "(eps|pep)_(largest|smallest|target)_(magnitude|real|imaginary) pep_(scale|extract|refine) "
    "eps_(balance(_cutoff)?|lobpcg_(restart|locking)|jd_fix|all|hermitian|purify|ritz|harmonic) "
    "eps_krylovschur_(restart|nev|ncv|mpd|locking|detect_zeros) eps_(arnoldi_delayed|refined) "
    "eps_ciss_(delta|spurious_threshold|realmats|usest|extraction|quadrule) eps_lanczos_reorthog "
    "eps_([gj]d_krylov_start|gd_double_expansion|jd_const_correction_tol|power_shift_type) "
    "pep_(toar|stoar|qarnoldi)_(restart|locking) st_filter_(interval|range|type|damping) "
    "st_(shift|transform|matmode|matstructure|cayley_antishift) ds_parallel "
    "bv_(definite_tol|type|matmult|orthog_(eta|type|block|refine)) rg_(type|scale|complement) "
    "rg_(interval_endpoints|ellipse_(center|radius|vscale))",
    ALONE: "(eps|pep)_(view(_values)?|converged_reason|monitor(_all|_conv)?) "
    "(eps|pep)_error_(absolute|backward|relative)",
}
# Solvers inside of preconditioners.
INNER = r"((sub|mg_levels|mg_coarse|redundant|telescope|esteig)_(\d{1,3}_)?)*"
# What begins the keys of a solver, what that solves, and the keys there that a file may set.
SOLVERS = {
    "steady_": ("every driven steady state (KSP, PC)", {f"steady_(comparison_)?{INNER}": LINEAR}),
    "normal_": (
        "normal modes (EPS, ST; count_pc for the factorizations that count them)",
        {"normal_": MODES}
        | {f"normal_{inside}_{INNER}": LINEAR for inside in ("st", "eps_ciss", "count")},
    ),
    "damped_": (
        "damped modes near a target (PEP, ST)", {"damped_": MODES, f"damped_st_{INNER}": LINEAR}
    ),
    "loud_": (
        "loud sound (KSP, PC of each harmonic; EPS of multipliers)",
        {"loud_": MODES, f"loud_{INNER}": LINEAR},
    ),
}  # fmt: skip
# PETSc's own keys at run time: those that only print, and all others, which no file may set.
PRINTING = _one_of(
    "citations get_total_flops info log_view log_view_memory malloc_view memory_view options_left "
    "options_view"
)
OTHERS = _one_of(
    "history nox objects_dump on_error_abort on_error_attach_debugger skip_petscrc fp_trap "
    "start_in_debugger stop_for_debugger log (log|memory|info|viewer)_.* malloc.* "
    "options_(left|view).*"
)


@functools.cache
def _in_files():
    """Return regular expressions of the keys that a file may set, and of their values."""
    tables = [table for _, keys in SOLVERS.values() for table in keys.items()]
    return [
        (re.compile(begin + _one_of(keys), re.ASCII), re.compile(values, re.ASCII | re.IGNORECASE))
        for begin, table in [*tables, ("", {ALONE: PRINTING})]
        for values, keys in table.items()
    ]


def is_solver_key(key):
    """Return whether a key goes to a solver."""
    listed = is_listed(key) and not is_petsc_key(key)
    return listed or (key.startswith(tuple(SOLVERS)) and key not in SOLVERS)


def is_petsc_key(key):
    """Return whether a key is one of PETSc's own at run time."""
    return re.fullmatch(f"{PRINTING}|{OTHERS}", key, re.ASCII) is not None


def is_listed(key):
    """Return whether files may set a key of PETSc's, to some values."""
    return any(keys.fullmatch(key) for keys, _ in _in_files())


def check_in_file(key, item):
    """Raise where a file sets a key of PETSc's that it may not; the command line may set all."""
    listed = [values for keys, values in _in_files() if keys.fullmatch(key)]
    if item.where and not any(values.fullmatch(item.text) for values in listed):
        setting = f"-{key} {item.text}".rstrip()
        raise InputError(
            f"{setting}{item.where}: not on the list of what a file may set (others could load "
            "code, start a program or write a file); give it on the command line if you mean it"
            + meant(not listed and near(key))
        )


def near(key):
    """Return the key most like one that no solver has, with its dash, or None."""
    tables = [table for _, keys in SOLVERS.values() for table in keys.items()]
    words = [(begin, word) for begin, keys in tables for word in " ".join(keys.values()).split()]
    plain = [
        f"-{re.match('[a-z_]+', begin)[0]}{word}" for begin, word in words if word.isidentifier()
    ]
    return nearest(f"-{key}", plain)


def check_pivot_shifts(keys):
    """Raise where PETSc would shift the pivots of a singular matrix by nothing, and never end."""
    for key, text in keys.items():
        if not (key.startswith("steady_") and key.endswith("pc_factor_zeropivot")):
            continue
        pc = key.removesuffix("factor_zeropivot")
        # what a preconditioner inside another one shifts by default depends on both
        plain = pc == "steady_pc_" and keys.get("steady_pc_type", "lu") in ("lu", "cholesky", "ilu")
        shift = keys.get(f"{pc}factor_shift_type", "none" if plain else "unknown").lower()
        with contextlib.suppress(ValueError):  # PETSc says itself what is no number
            if float(text) < SMALLEST_SHIFT and shift not in ("none", "nonzero"):
                raise InputError(
                    f"-{key} {text}: shifting pivots by so little PETSc may never end; leave it "
                    f"out, give {SMALLEST_SHIFT:g} or more, or say -{pc}factor_shift_type none"
                )


def solver_keys_of(solver):
    """Return the keys of a dict for solvers, as texts; raise an InputError if it has others."""
    if not isinstance(solver, dict):
        raise InputError(f"solver: a dict of keys is needed, not {shown(solver)}")
    keys = {}
    for key, value in solver.items():
        key = str(key).lower()
        if not (key.isidentifier() and is_solver_key(key)):
            near = nearest(key, [prefix + key for prefix in SOLVERS if prefix != "loud_"])
            raise InputError(f"solver: {key!r} belongs to no solver{meant(near and repr(near))}")
        keys[key] = "" if value is None or value is True else text_of(value)
        if not keys[key].isprintable():
            raise InputError(f"solver: {keys[key]!r} is no value of {key!r}")
    check_pivot_shifts(keys)
    return keys


def read_solver(path, own):
    """Return what the options file of a solver sets: of the `own` options, and keys for PETSc."""
    values, keys = {}, {}
    for item in read_file(path):
        key = item.key.lower()
        if key in own:
            values[key] = own[key].read(item.text, item.where)
        elif is_solver_key(key):
            check_in_file(key, item)
            keys[key] = item.text
        else:
            allowed = ", -".join([*own, *(f"{prefix}*" for prefix in SOLVERS)])
            raise InputError(f"-{key}{item.where}: the file of a solver holds -{allowed} only")
    check_pivot_shifts(keys)
    return values, keys


@contextlib.contextmanager
def holding_solver(keys):
    """Let keys hold for all solvers that are made meanwhile."""
    world = launch.start().COMM_WORLD
    from pgran.run.petsc import holding

    with holding(keys):
        yield
        if world.rank == 0:
            warn_of_unused(keys)


def warn_of_unused(keys):
    """Warn of those of some keys in PETSc's database that nothing has acted on."""
    from pgran.run.petsc import unused

    for key in unused(keys):
        what = meant(not is_listed(key) and near(key))
        log.warning("-%s was not used: no solver of this run has such an option%s", key, what)
