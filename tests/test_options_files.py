"""Options files: how they are read, and that they can choose solvers and set numbers only."""

import os
import re
from pathlib import Path

import pytest

from pgran.command.resolve import SCENES, options_of, resolve
from pgran.errors import FileError, InputError
from pgran.files.reading import read_environment, read_file, read_solver, read_words

SHIPPED = sorted((Path(__file__).parents[1] / "options").rglob("*.opts"))


@pytest.mark.parametrize(
    ("line", "hint"),
    [
        ("-lattice_shape 2, 2", "a list has no blanks: -lattice_shape 2,2"),
        ("-detectors 3 ,4", "a list has no blanks: -detectors 3,4"),
        ("-accuracy_solvers a.opts b.opts", "no blanks: -accuracy_solvers a.opts,b.opts"),
        ("-sweep_points=3", "-sweep_points=3.* write -sweep_points 3"),
        ("Sweep_Points 3", "did you mean -sweep_points?"),
        ("-output_fields true sweep_points 3", "did you mean -sweep_points?"),
        ("// it's the paper's", "a comment begins with #"),
        ("-sweep_points 3 // few", "a comment begins with #"),
        ("%few", "a comment begins with #"),
        ("\u2013scene response", "long dash; keys begin with -"),
        ("-sc\u00e8ne response", "no key has such a name"),
        ("-steady_a'b 3", "No closing quotation"),
        ("7", "keys look like -key"),
    ],
)
def test_what_to_write_instead(written, line, hint):
    with pytest.raises(InputError, match=rf"{hint}|{re.escape(hint)}") as caught:
        read_file(written(f"-sweep_max 2\n{line}\n"))
    assert "a.opts, line 2" in str(caught.value)


@pytest.mark.parametrize("odd", ["\n", "\r", "\x1b", "\x85", "\u2028", "\udcff"])
@pytest.mark.parametrize("word", ["-output_file a{}b.h5", "-steady_ksp_type b{}", "{}", "-a{}b"])
def test_words_that_no_file_could_hold(word, odd):
    """The result repeats its options as a file, where these would end a line, or could not be."""
    with pytest.raises(InputError, match="line break, a control character, or a byte that"):
        read_words(word.format(odd).split(" "))


def test_file_syntax(written):
    text = """\ufeff# a mark and a comment

      -scene response # another
    -lattice_shape 3,4 -bonds_seed 9
    -output_fields
    -output_file 'a folder/b#c.h5'
    -steady_ksp_type "gmres"
    """
    found = resolve(read_file(written(text)))
    assert (found.lattice_shape, found.bonds_seed, found.output_fields) == ((3, 4), 9, True)
    assert found.output_file == "a folder/b#c.h5"
    assert found.solver == {"steady_ksp_type": "gmres"}


def test_refusals_name_file_and_line(written):
    path = written("-scene response\n\n-sweep_points many\n")
    with pytest.raises(InputError, match=r"-sweep_points many .*a\.opts, line 3"):
        resolve(read_file(path))


def test_files_that_cannot_be_read(tmp_path):
    for path, said in (("missing.opts", r"missing\.opts: No such file"), ("", "directory")):
        with pytest.raises(FileError, match=said):
            read_file(tmp_path / path)
    with pytest.raises(FileError, match="no name of a file"):
        read_file("a\0b")
    for odd in (b"\0", b"\x1b[2J", b"\xff", b"\xc3", b"\xed\xa0\x80", b"\x7f", b"\xc2\x85"):
        (tmp_path / "binary.opts").write_bytes(b"-scene response\n-output_file a" + odd + b"b\n")
        with pytest.raises(FileError, match=r"binary\.opts: not a text file \(line 2\)"):
            read_file(tmp_path / "binary.opts")


def test_files_without_end(tmp_path, written):
    """Pipes and devices are not even opened; of large files no more is read than may be."""
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", "/dev/zero"):
        with pytest.raises(FileError, match="is a pipe or a device"):
            read_file(path)
    with open(tmp_path / "large.opts", "wb") as stream:
        stream.truncate(10 * 2**30)
    with pytest.raises(FileError, match="at most 1048576 bytes"):
        read_file(tmp_path / "large.opts")
    (tmp_path / "large.opts").unlink()
    start = "-scene response\n"
    assert resolve(read_file(written(start + (2**20 - len(start)) * "#")))


def test_yaml_of_the_environment_is_refused(monkeypatch):
    monkeypatch.setenv("PETSC_OPTIONS_YAML", "steady_pc_type: python")
    with pytest.raises(InputError, match="PETSC_OPTIONS_YAML: not read"):
        read_environment()
    assert "PETSC_OPTIONS_YAML" not in os.environ


# Keys of PETSc's

HARMFUL = [
    # code that is loaded, programs that are started
    "steady_pc_type python", "steady_PC_Type PYTHON", "steady_pc_python_type m.f",
    "steady_ksp_type shell", "steady_ksp_monitor_python m.f", "steady_sub_pc_type mypython",
    "steady_pc_composite_pcs ilu,python", "steady_pc_factor_mat_solver_type matlab",
    "start_in_debugger", "on_error_attach_debugger gdb", "stop_for_debugger",
    # files, sockets and windows
    "steady_ksp_view ascii:a.txt", "steady_ksp_view :a.txt", "steady_ksp_view binary",
    "steady_ksp_view_mat hdf5:a.h5", "steady_ksp_view_mat", "steady_ksp_monitor draw",
    "steady_ksp_view socket:5000", "normal_eps_view_vectors vtk:a.vts",
    "normal_eps_error_relative ::ascii_info_detail", "normal_eps_view_values xbinary",
    "steady_pc_mg_dump_binary", "steady_pc_bddc_save 5", "steady_pc_asm_print_subdomains out",
    "steady_ksp_gmres_krylov_monitor", "steady_mat_mumps_ooc_tmpdir here",
    "steady_mat_mumps_icntl_22 1", "steady_mat_mumps_icntl_3 7", "steady_sub_mat_mumps_icntl_1 8",
    "log_view :a.txt", "log_trace", "log_all", "log a", "info a", "history", "history a.txt",
    "citations a.bib", "malloc_dump", "malloc_view a.txt", "memory_view a", "objects_dump a",
    "viewer_binary_filename a", "viewer_socket_machine a", "options_left a", "options_view a",
    # what is no name, number or flag, or no key that pgran knows
    "steady_pc_type ../lib", "steady_pc_type ~/lib", "steady_ksp_rtol $HOME", "steady_ksp_max_it é",
    "steady_ksp_max_it \u0663", "steady_ksp_norm_type a;b", "steady_ksp_typo gmres", "steady_x",
    "normal_count_eps_tol 1", "normal_ksp_type gmres", "steady_eps_tol 1",
    # work without end
    "steady_pc_mg_levels 100000000", "steady_pc_mg_levels 1000", "steady_ksp_bcgsl_ell 1000",
    "steady_ksp_max_it 1000000", "normal_eps_ncv 99999999999", "steady_pc_type mg",
]  # fmt: skip


@pytest.mark.parametrize("text", HARMFUL)
def test_files_cannot_load_code_start_programs_or_write_files(written, monkeypatch, text):
    """Nor can the environment; who gives the same on the command line means it."""
    monkeypatch.setenv("PETSC_OPTIONS", f"-scene response -{text}")
    key, _, value = text.partition(" ")
    for given, where in (
        (read_file(written(f"-scene response\n-{text}\n")), "a.opts, line 2"),
        (read_environment(), "PETSC_OPTIONS"),
    ):
        with pytest.raises(InputError) as caught:
            resolve(given)
        message = str(caught.value)
        assert message.startswith(f"-{key.lower()} {value}".rstrip())
        assert where in message
        assert "give it on the command line if you mean it" in message
        overridden = resolve([*given, *read_words([f"-{key}", *value.split()])])
        assert overridden.solver == {key.lower(): value}


@pytest.mark.parametrize(
    "key",
    [
        "options_file a",
        "options_file_yaml a",
        "prefix_push steady_",
        "dll_append a",
        "python",
        "f x",
    ],
)
def test_keys_that_make_petsc_read_or_load_files_are_unknown_everywhere(key):
    with pytest.raises(InputError, match=f"-{key.split()[0]}: unknown option"):
        resolve(read_words(f"-scene response -{key}".split()))


@pytest.mark.parametrize(
    "text",
    [
        "steady_ksp_type gmres", "steady_comparison_pc_type lu", "log_view", "options_left",
        "steady_pc_factor_mat_solver_type mumps", "steady_mat_mumps_icntl_14 60",
        "steady_mat_mumps_cntl_1 1e-3", "steady_mat_superlu_dist_colperm METIS_AT_PLUS_A",
        "steady_ksp_view", "steady_ksp_monitor", "steady_ksp_converged_reason", "normal_eps_view",
        "steady_ksp_chebyshev_eigenvalues 0.1,-1.5e+2", "steady_ksp_rtol .5",
        "steady_ksp_max_it 999999", "steady_ksp_divtol 1E30", "steady_ksp_pc_side right",
        "steady_pc_composite_pcs ilu,jacobi", "steady_mg_levels_1_pc_type sor",
        "steady_mg_coarse_sub_pc_factor_shift_type NONZERO", "steady_sub_0_ksp_type preonly",
        "normal_eps_all true", "normal_eps_target_magnitude", "normal_ds_method 2",
        "normal_st_pc_type cholesky", "normal_st_mat_mumps_icntl_7 5", "normal_bv_type vecs",
        "normal_count_pc_factor_mat_solver_type mumps", "normal_eps_ciss_ksp_type preonly",
    ],
)  # fmt: skip
def test_files_can_choose_solvers_and_set_numbers(written, text):
    key, _, value = text.partition(" ")
    assert resolve(read_file(written(f"-scene response\n-{text}\n"))).solver == {key: value}


def test_files_of_solvers_hold_the_same_keys(written):
    own = {"relax_window": options_of("relaxation")["relax_window"]}
    path = written("-relax_window 3\n-steady_pc_type lu\n")
    assert read_solver(path, own) == ({"relax_window": 3}, {"steady_pc_type": "lu"})
    for text, said in (("pc_type python", "could load code"), ("relax_window x", "of the type")):
        with pytest.raises(InputError, match=f"line 1.*{said}"):
            read_solver(written(f"-{text}\n".replace("pc_", "steady_pc_")), own)
    with pytest.raises(InputError, match=r"holds -relax_window, -steady_\*, -normal_\* only"):
        read_solver(written("-log_view\n"), own)


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_the_files_that_come_with_pgran_are_accepted(path):
    given = read_file(path)
    if path.parent.name == "solvers":
        scene = path.stem.split("_")[0]
        given += read_words(["-scene", scene if scene in SCENES else "response"])
    resolve(given)
