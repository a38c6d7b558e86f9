"""Keys that belong to PETSc and SLEPc, and which of them a file may set.

A file can choose solvers and set numbers; it cannot make PETSc load code, start programs or write
files. What is not on the list is taken from the command line only, from who means it.
"""

import contextlib
import functools
import inspect
import re
from types import SimpleNamespace

from pgran.arguments import meant, nearest, shown
from pgran.errors import InputError
from pgran.run import launch
from pgran.run.options import text_of

SMALLEST_SHIFT = 1e-14  # of pivots, against bond constants of about 1
SOLVER_PREFIXES = {
    "steady_": "every driven steady state (KSP, PC)",
    "normal_": "normal modes (EPS, ST; count_pc for the factorizations that count them)",
    "damped_": "damped modes near a target (PEP, ST)",
    "pulse_ts_": "pulses that are integrated (TS)",
    "pulse_snes_": "implicit steps of a pulse (SNES)",
    "pulse_ksp_": "linear systems of these steps (KSP)",
    "pulse_pc_": "preconditioners of these systems (PC)",
}

# What values a file may give, in letters of either case. Long numbers need an exponent, which PETSc
# takes for no integer: no file asks for absurd work.
NUMBER = r"[+-]?(\d{1,6}(\.\d*)?|\.\d+)(e[+-]?\d{1,3})?"
NUMBERS = f"{NUMBER}(,{NUMBER})*"
COUNT = r"\d{1,3}"  # of what takes memory or time each
FLAG = "|true|false|yes|no|on|off|1|0"
WORD = r"\w+"  # one of a few that do no harm; PETSc refuses others
ALONE = ""  # prints to the terminal; a value would name a file or a window


def _one_of(names):
    """Return a regular expression of names apart by blanks."""
    return f"({'|'.join(names.split())})"


# Those for complex numbers and for a matrix without grids, of which multigrid (mg) crashes.
KSP_TYPE = _one_of(
    "bcgs bcgsl bicg cg cgls cgne cgs chebyshev cr fbcgs fbcgsr fcg fgmres gcr gmres groppcg "
    "lgmres lsqr pgmres pipebcgs pipecg pipecg2 pipecgrr pipecr pipefcg pipegcr pipeprcg preonly "
    "qmrcgs richardson tcqmr tfqmr"
)
PC_TYPE = _one_of(
    "asm bjacobi cholesky composite eisenstat gamg gasm icc ilu jacobi lu none pbjacobi redundant "
    "sor svd telescope"
)
PACKAGE = _one_of(
    "petsc mumps superlu superlu_dist klu umfpack cholmod pastix strumpack mkl_pardiso mkl_cpardiso"
)
EPS_TYPE = _one_of(
    "krylovschur lanczos arnoldi power subspace lapack gd jd rqcg lobpcg ciss arpack primme blopex "
    "trlan feast evsl elpa elemental scalapack chase"
)

# The keys of each object that a file may set, by the values that they take.
KSP = {
    KSP_TYPE: "type",
    NUMBERS: "rtol atol divtol max_it min_it check_norm_iteration richardson_scale bcgsl_xres "
    "gmres_(haptol|breakdown_tolerance) chebyshev_(eigenvalues|esteig)",
    COUNT: "(gmres|gcr)_restart lgmres_augment bcgsl_ell (fcg|pipefcg|pipegcr)_mmax "
    "chebyshev_esteig_steps",
    FLAG: "initial_guess_nonzero knoll lag_norm diagonal_scale(_fix)? lgmres_constant "
    "gmres_(modifiedgramschmidt|classicalgramschmidt|preallocate) bcgsl_(cxpoly|mrpoly|pinv) "
    "richardson_self_scale cg_single_reduction",
    WORD: "norm_type pc_side cg_type chebyshev_kind fcg_truncation_type gmres_cgs_refinement_type",
    ALONE: "view converged_(reason|rate) monitor(_true_residual|_short|_singular_value|_max)?",
}
PC = {
    PC_TYPE: "type",
    f"{PC_TYPE}(,{PC_TYPE})*": "composite_pcs",
    PACKAGE: "factor_mat_solver_type",
    NUMBERS: "factor_(fill|zeropivot|shift_amount|column_pivot|nonzeros_along_diagonal) "
    "sor_(omega|diagonal_shift) eisenstat_omega svd_zero_sing "
    "gamg_(threshold|threshold_scale|coarse_eq_limit|process_eq_limit)",
    COUNT: "factor_levels (asm|gasm)_overlap (asm|bjacobi)_(local_)?blocks gasm_total_subdomains "
    "sor_l?its mg_levels mg_multiplicative_cycles redundant_number telescope_reduction_factor "
    "gamg_(agg_nsmooths|aggressive_coarsening|square_graph)",
    FLAG: "factor_(diagonal_fill|in_place|pivot_in_blocks|reuse_fill|reuse_ordering) "
    "sor_(local_)?(symmetric|forward|backward) jacobi_(abs|fixdiagonal) mg_distinct_smoothup "
    "gamg_(repartition|reuse_interpolation|use_sa_esteig)",
    WORD: "factor_(mat_ordering|shift)_type asm_(local_)?type mg_cycle_type "
    "(gasm|composite|jacobi|mg|gamg)_type",
    ALONE: "view",
}
# No unit of Fortran that MUMPS prints to (icntl 1 to 3, files fort.N), no factors on disk (22).
FACTOR = {
    NUMBERS: "mumps_icntl_([46-8]|1[0-5]|2[0347-9]|3[135-8]|4[89]|58) mumps_cntl_[1-57]",
    COUNT: "superlu_dist_[rc]",
    FLAG: "superlu_dist_(equil|parsymbfact|replacetinypivot|iterrefine)",
    WORD: "superlu_dist_(rowperm|colperm|fact)",
    ALONE: "superlu_dist_(statprint|printstat)",
}
# With what eigensolvers stand on: bases (bv), dense problems (ds), regions (rg).
EPS = {
    EPS_TYPE: "eps_type",
    "shift|sinvert|cayley|precond|filter": "st_type",
    NUMBERS: "eps_(tol|max_it|nev|ncv|mpd|target|interval|balance_cutoff|lobpcg_restart|jd_fix) "
    "eps_krylovschur_(restart|nev|ncv|mpd) eps_ciss_(delta|spurious_threshold) st_shift "
    "st_cayley_antishift st_filter_(interval|range) bv_(definite_tol|orthog_eta) "
    "rg_(scale|interval_endpoints|ellipse_center|ellipse_radius|ellipse_vscale)",
    COUNT: "eps_balance_its eps_krylovschur_partitions eps_rqcg_reset eps_lobpcg_blocksize "
    "eps_[gj]d_(blocksize|minv|plusk|initial_size) ds_method ds_block_size st_filter_degree "
    "eps_ciss_(integration_points|moments|blocksize|maxblocksize|partitions) "
    "eps_ciss_refine_(inner|blocksize)",
    FLAG: "eps_(all|hermitian|true_residual|purify|ritz|harmonic|refined|arnoldi_delayed) "
    "eps_(largest|smallest)_(magnitude|real) eps_target_(magnitude|real) eps_conv_(abs|rel|norm) "
    "eps_(krylovschur|lobpcg)_locking eps_krylovschur_detect_zeros eps_[gj]d_krylov_start "
    "eps_gd_double_expansion eps_jd_const_correction_tol eps_ciss_(realmats|usest) st_transform "
    "rg_complement",
    WORD: "eps_(balance|lanczos_reorthog|power_shift_type|ciss_extraction|ciss_quadrule) "
    "st_(matmode|matstructure|filter_type|filter_damping) ds_parallel rg_type "
    "bv_(type|matmult|orthog_type|orthog_block|orthog_refine)",
    ALONE: "eps_view(_values)? eps_converged_reason eps_monitor(_all|_conv)? "
    "eps_error_(absolute|backward|relative)",
}
# How pulses are integrated.
TS = {
    "rk|alpha2": "type",
    "1fe|2a|2b|3|3bs|4|5f|5dp|5bs|6vr|7vr|8vr": "rk_type",
    "none|basic|dsp": "adapt_type",
    NUMBERS: "dt max_steps max_reject alpha_(radius|alpha_m|alpha_f|gamma|beta) "
    "adapt_(safety|reject_safety|clip|dt_min|dt_max|scale_solve_failed|time_step_increase_delay)",
    WORD: "adapt_wnormtype",
    ALONE: "view monitor adapt_monitor",
}
SNES = {
    NUMBERS: "rtol atol stol max_it",
    WORD: "type linesearch_type",
    ALONE: "view monitor converged_reason",
}
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


def _under(prefix, table):
    """Return regular expressions of the keys of a table under a prefix, and of their values."""
    return [
        (re.compile(prefix + _one_of(keys), re.ASCII), re.compile(values, re.ASCII | re.IGNORECASE))
        for values, keys in table.items()
    ]


# Solvers inside of preconditioners.
INNER = r"((sub|mg_levels|mg_coarse|redundant|telescope|esteig)_(\d{1,3}_)?)*"
LINEAR = rf"(steady_(comparison_)?|normal_st_|normal_eps_ciss_|pulse_){INNER}"


@functools.cache
def _in_files():
    """Return what a file may set; most runs have nothing to look up."""
    return [
        *_under(rf"{LINEAR}ksp_", KSP),
        *_under(rf"({LINEAR}|normal_count_)pc_", PC),
        *_under(rf"({LINEAR}|normal_count_)mat_", FACTOR),
        *_under("normal_", EPS),
        *_under("pulse_ts_", TS),
        *_under("pulse_snes_", SNES),
        *_under("", {ALONE: PRINTING}),
    ]


def is_solver_key(key):
    """Return whether a key goes to a solver."""
    return key.startswith(tuple(SOLVER_PREFIXES)) and key not in SOLVER_PREFIXES


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
        )


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


def with_solver(function):
    """Let a function take `solver`, a dict of keys that hold for solvers while it runs."""
    signature = inspect.signature(function)
    declared = SimpleNamespace(default=None, check=solver_keys_of)  # as an option is declared
    solver = inspect.Parameter("solver", inspect.Parameter.KEYWORD_ONLY, default=declared)
    # by kind, because **keywords come last
    parameters = sorted([*signature.parameters.values(), solver], key=lambda p: p.kind)

    @functools.wraps(function)
    def wrapped(*arguments, solver=None, **keywords):
        with holding_solver(solver):
            return function(*arguments, **keywords)

    wrapped.__signature__ = signature.replace(parameters=parameters)
    return wrapped


def solver_keys_of(solver):
    """Return the keys of a dict for solvers, as texts; raise an InputError if it has others."""
    if not isinstance(solver, dict):
        raise InputError(f"solver: a dict of keys is needed, not {shown(solver)}")
    keys = {}
    for key, value in solver.items():
        key = str(key).lower()
        if not (key.isidentifier() and is_solver_key(key)):
            near = nearest(key, [prefix + key for prefix in SOLVER_PREFIXES])
            raise InputError(f"solver: {key!r} belongs to no solver{meant(near and repr(near))}")
        keys[key] = "" if value is None or value is True else text_of(value)
        if not keys[key].isprintable():
            raise InputError(f"solver: {keys[key]!r} is no value of {key!r}")
    check_pivot_shifts(keys)
    return keys


@contextlib.contextmanager
def holding_solver(keys):
    """Let keys hold for all solvers that are made meanwhile."""
    if not keys:
        yield  # what needs no PETSc does without
        return
    world = launch.start().COMM_WORLD
    from pgran.run.petsc import holding, warn_of_unused

    with holding(keys):
        yield
        if world.rank == 0:
            warn_of_unused(keys)
