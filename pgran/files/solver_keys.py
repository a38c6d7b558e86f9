"""Keys that belong to PETSc and SLEPc, and which of them a file may set.

A file can choose solvers and set numbers; it cannot make PETSc load code, start programs or write
files. So there is a list of what it may set; what is not on the list is taken from the command line
only, from who means it.
"""

import re

from pgran.errors import InputError

SMALLEST_SHIFT = 1e-14  # of pivots, against bond constants of about 1

SOLVER_PREFIXES = {
    "steady_": "every driven steady state (KSP, PC)",
    "normal_": "normal modes (EPS, ST; count_pc for the factorizations that count them)",
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
ST_TYPE = _one_of("shift sinvert cayley precond filter")

# The keys of each object that a file may set, by the values that they take.
KSP = {
    KSP_TYPE: "type",
    NUMBERS: "rtol atol divtol max_it min_it check_norm_iteration gmres_haptol "
    "gmres_breakdown_tolerance bcgsl_xres richardson_scale chebyshev_eigenvalues chebyshev_esteig",
    COUNT: "gmres_restart gcr_restart lgmres_augment bcgsl_ell fcg_mmax pipefcg_mmax pipegcr_mmax "
    "chebyshev_esteig_steps",
    FLAG: "initial_guess_nonzero knoll lag_norm diagonal_scale diagonal_scale_fix "
    "gmres_modifiedgramschmidt gmres_classicalgramschmidt gmres_preallocate lgmres_constant "
    "bcgsl_cxpoly bcgsl_mrpoly bcgsl_pinv richardson_self_scale cg_single_reduction",
    WORD: "norm_type pc_side cg_type chebyshev_kind fcg_truncation_type gmres_cgs_refinement_type",
    ALONE: "view converged_reason converged_rate monitor monitor_true_residual monitor_short "
    "monitor_singular_value monitor_max",
}
PC = {
    PC_TYPE: "type",
    f"{PC_TYPE}(,{PC_TYPE})*": "composite_pcs",
    PACKAGE: "factor_mat_solver_type",
    NUMBERS: "factor_fill factor_zeropivot factor_shift_amount factor_column_pivot "
    "factor_nonzeros_along_diagonal sor_omega sor_diagonal_shift eisenstat_omega gamg_threshold "
    "gamg_threshold_scale gamg_coarse_eq_limit gamg_process_eq_limit svd_zero_sing",
    COUNT: "factor_levels asm_overlap asm_blocks asm_local_blocks gasm_overlap "
    "gasm_total_subdomains bjacobi_blocks bjacobi_local_blocks sor_its sor_lits mg_levels "
    "mg_multiplicative_cycles gamg_agg_nsmooths gamg_aggressive_coarsening gamg_square_graph "
    "redundant_number telescope_reduction_factor",
    FLAG: "factor_diagonal_fill factor_in_place factor_pivot_in_blocks factor_reuse_fill "
    "factor_reuse_ordering sor_symmetric sor_forward sor_backward sor_local_symmetric "
    "sor_local_forward sor_local_backward jacobi_abs jacobi_fixdiagonal mg_distinct_smoothup "
    "gamg_repartition gamg_reuse_interpolation gamg_use_sa_esteig",
    WORD: "factor_mat_ordering_type factor_shift_type asm_type asm_local_type gasm_type "
    "composite_type jacobi_type mg_type mg_cycle_type gamg_type",
    ALONE: "view",
}
# No unit of Fortran that MUMPS prints to (icntl 1 to 3, files fort.N), no factors on disk (22).
FACTOR = {
    NUMBERS: "mumps_icntl_([46-8]|1[0-5]|2[0347-9]|3[135-8]|4[89]|58) mumps_cntl_[1-57]",
    COUNT: "superlu_dist_r superlu_dist_c",
    FLAG: "superlu_dist_equil superlu_dist_parsymbfact superlu_dist_replacetinypivot "
    "superlu_dist_iterrefine",
    WORD: "superlu_dist_rowperm superlu_dist_colperm superlu_dist_fact",
    ALONE: "superlu_dist_statprint superlu_dist_printstat",
}
EPS = {
    EPS_TYPE: "type",
    NUMBERS: "tol max_it nev ncv mpd target interval balance_cutoff krylovschur_restart "
    "krylovschur_nev krylovschur_ncv krylovschur_mpd lobpcg_restart jd_fix ciss_delta "
    "ciss_spurious_threshold",
    COUNT: "balance_its krylovschur_partitions gd_blocksize gd_minv gd_plusk gd_initial_size "
    "jd_blocksize jd_minv jd_plusk jd_initial_size lobpcg_blocksize rqcg_reset "
    "ciss_integration_points ciss_moments ciss_blocksize ciss_maxblocksize ciss_partitions "
    "ciss_refine_inner ciss_refine_blocksize",
    FLAG: "all hermitian true_residual purify ritz harmonic refined largest_magnitude "
    "largest_real smallest_magnitude smallest_real target_magnitude target_real conv_abs conv_rel "
    "conv_norm krylovschur_locking krylovschur_detect_zeros lobpcg_locking arnoldi_delayed "
    "gd_krylov_start gd_double_expansion jd_krylov_start jd_const_correction_tol ciss_realmats "
    "ciss_usest",
    WORD: "balance lanczos_reorthog power_shift_type ciss_extraction ciss_quadrule",
    ALONE: "view view_values converged_reason monitor monitor_all monitor_conv error_absolute "
    "error_backward error_relative",
}
ST = {
    ST_TYPE: "type",
    NUMBERS: "shift cayley_antishift filter_interval filter_range",
    COUNT: "filter_degree",
    FLAG: "transform",
    WORD: "matmode matstructure filter_type filter_damping",
}
# What eigensolvers stand on: bases, dense problems, regions.
BASES = {
    NUMBERS: "bv_definite_tol bv_orthog_eta rg_scale rg_interval_endpoints rg_ellipse_center "
    "rg_ellipse_radius rg_ellipse_vscale",
    COUNT: "ds_method ds_block_size",
    FLAG: "rg_complement",
    WORD: "bv_type bv_matmult bv_orthog_type bv_orthog_block bv_orthog_refine ds_parallel rg_type",
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
LINEAR = rf"(steady_(comparison_)?|normal_st_|normal_eps_ciss_){INNER}"
IN_FILES = [
    *_under(rf"{LINEAR}ksp_", KSP),
    *_under(rf"({LINEAR}|normal_count_)pc_", PC),
    *_under(rf"({LINEAR}|normal_count_)mat_", FACTOR),
    *_under("normal_eps_", EPS),
    *_under("normal_st_", ST),
    *_under("normal_", BASES),
    *_under("", {ALONE: PRINTING}),
]


def is_solver_key(key):
    """Return whether a key goes to a solver."""
    return key.startswith(tuple(SOLVER_PREFIXES)) and key not in SOLVER_PREFIXES


def is_petsc_key(key):
    """Return whether a key is one of PETSc's own at run time. Not collective."""
    return re.fullmatch(f"{PRINTING}|{OTHERS}", key, re.ASCII) is not None


def check_in_file(key, item):
    """Raise where a file sets a key of PETSc's that it may not; the command line may set all."""
    if item.where and not any(
        keys.fullmatch(key) and values.fullmatch(item.text) for keys, values in IN_FILES
    ):
        raise InputError(
            f"-{key} {item.text}".rstrip() + f"{item.where}: not on the list of solvers, numbers "
            "and flags that a file may set (others could load code, start a program or write a "
            "file); give it on the command line if you mean it"
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
        try:
            small = float(text) < SMALLEST_SHIFT
        except ValueError:
            continue  # PETSc says so itself
        if small and shift not in ("none", "nonzero"):
            raise InputError(
                f"-{key} {text}: PETSc may shift the pivots of a singular matrix by as little, and "
                f"never end; leave it out, give {SMALLEST_SHIFT:g} or more, or say "
                f"-{pc}factor_shift_type none"
            )
