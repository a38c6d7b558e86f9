"""Options files: how they are read, and that they can choose solvers and set numbers only."""

import os
from pathlib import Path

import pytest

from pgran.command.resolve import SCENES, options_of, resolve
from pgran.errors import FileError, InputError
from pgran.run.keys import SOLVERS, read_solver
from pgran.run.options import read_environment, read_file, read_files, read_words

SHIPPED = sorted((Path(__file__).parents[1] / "options").rglob("*.opts"))


@pytest.mark.parametrize(
    ("line", "hint"),
    [
        ("-detectors 3 ,4", "a list has no blanks: -detectors 3,4"),
        ("-detectors = 3,4", "write -detectors 3,4"),
        ("-detectors 3,4 units lj", "keys look like -key"),
        ("-sweep_points=3", "-sweep_points=3 (a.opts, line 2): write -sweep_points 3"),
        ("-output_fields true Sweep_points 3", "did you mean -sweep_points?"),
        ("// it's the paper's", "a comment begins with #"),
        ("-sweep_points 3 % few", "a comment begins with #"),
        ("\u2013scene response", "long dash; keys begin with -"),
        ("-sc\u00e8ne response", "no key has such a name"),
        ("-steady_a'b 3", "No closing quotation"),
        ("'-detectors 3,4'", "leave out the quotes around a key and its value"),
        ("7", "keys look like -key"),
    ],
)
def test_what_to_write_instead(written, line, hint):
    path = written(f"-sweep_max 2\n{line}\n")
    with pytest.raises(InputError) as caught:
        read_file(path)
    message = str(caught.value).replace(str(path), "a.opts")
    assert hint in message
    assert "(a.opts, line 2)" in message


@pytest.mark.parametrize("odd", ["\n", "\x1b", "\x85", "\u2028", "\udcff"])
def test_words_that_no_file_could_hold(odd):
    """The result repeats its options as a file, where these would end a line, or could not be."""
    with pytest.raises(InputError, match="line break, a control character, or a byte that"):
        read_words(["-output_file", f"a{odd}b.h5"])


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


def test_later_files_win_as_the_command_line_does(written):
    first = written("-scene response\n-lattice_damping 1\n-sweep_points 7\n")
    other = written("-network_file a.h5\n-sweep_points 8\n-steady_pc_type python", "b.opts")
    given = read_files([first, other])
    found = resolve([*given, *read_words(["-steady_pc_type", "lu"])])
    assert (found.network_file, found.lattice_damping, found.sweep_points) == (("a.h5",), None, 8)
    assert found.solver == {"steady_pc_type": "lu"}
    with pytest.raises(InputError, match=r"b\.opts, line 3.*not on the list"):
        resolve(given)
    misspelt = written("-scene response\n-normal_st_pc_typ lu", "c.opts")
    with pytest.raises(InputError, match="did you mean -normal_st_pc_type"):
        resolve(read_files([misspelt]))


def test_files_that_cannot_be_read(tmp_path):
    """Pipes and devices are not even opened; of large files no more is read than may be."""
    os.mkfifo(tmp_path / "pipe")
    with open(tmp_path / "large.opts", "wb") as stream:
        stream.truncate(10 * 2**30)
    for path, said in (
        ("missing.opts", r"missing\.opts: No such file"), ("", "is a directory"),
        ("a\0b", "no name of a file"), ("pipe", "is a pipe or a device"),
        ("/dev/zero", "is a pipe or a device"), ("large.opts", "at most 1048576 bytes"),
    ):  # fmt: skip
        with pytest.raises(FileError, match=said):
            read_file(tmp_path / path)
    for odd in (b"\0", b"\x1b[2J", b"\xff", b"\xed\xa0\x80", b"\xc2\x85"):
        (tmp_path / "binary.opts").write_bytes(b"-scene response\n-output_file a" + odd + b"b\n")
        with pytest.raises(FileError, match=r"binary\.opts: not a text file \(line 2\)"):
            read_file(tmp_path / "binary.opts")


def test_yaml_of_the_environment_is_refused(monkeypatch):
    monkeypatch.setenv("PETSC_OPTIONS_YAML", "steady_pc_type: python")
    with pytest.raises(InputError, match="PETSC_OPTIONS_YAML: not read"):
        read_environment()
    assert "PETSC_OPTIONS_YAML" not in os.environ


HARMFUL = [
    # code that is loaded, programs that are started
    "steady_PC_Type PYTHON", "steady_pc_python_type m.f", "steady_ksp_type shell",
    "steady_sub_pc_type mypython", "steady_pc_composite_pcs ilu,python",
    "steady_pc_factor_mat_solver_type matlab", "on_error_attach_debugger gdb",
    # files, sockets and windows
    "steady_ksp_view ascii:a.txt", "steady_ksp_view binary", "steady_ksp_view_mat",
    "steady_ksp_monitor draw", "normal_eps_view_vectors vtk:a.vts",
    "normal_eps_error_relative ::ascii_info_detail", "steady_pc_mg_dump_binary",
    "steady_mat_mumps_ooc_tmpdir here", "steady_mat_mumps_icntl_22 1",
    "steady_sub_mat_mumps_icntl_1 8", "log_view :a.txt", "log a", "info a", "history",
    "steady_pc_asm_print_subdomains a", "steady_pc_gamg_esteig_ksp_view_mat binary",
    "normal_eps_ciss_ksp_view_mat binary", "normal_eps_ciss_mat_mumps_icntl_1 7",
    "normal_eps_ciss_pc_python_type m.f", "steady_pc_gamg_esteig_pc_python_type m.f",
    "normal_eps_power_snes_monitor binary", "steady_pc_factor_mat_solver_package matlab",
    "citations a.bib", "malloc_dump", "memory_view a", "viewer_socket_machine a", "options_left a",
    # what is no name, number or flag, or no key that pgran knows
    "steady_pc_type ../lib", "steady_ksp_rtol $HOME", "steady_ksp_max_it \u0663",
    "steady_ksp_norm_type a;b", "steady_ksp_typo gmres", "normal_count_eps_tol 1",
    # work without end
    "steady_pc_mg_levels 1000", "steady_ksp_max_it 1000000", "steady_pc_type mg",
]  # fmt: skip


@pytest.mark.parametrize("text", HARMFUL)
def test_files_cannot_load_code_start_programs_or_write_files(written, monkeypatch, text):
    """Nor can the environment; who gives the same on the command line means it."""
    monkeypatch.setenv("PETSC_OPTIONS", f"-scene response -{text}")
    key, _, value = text.partition(" ")
    path = written(f"-scene response\n-{text}\n")
    said = f"-{key.lower()} {value}".rstrip()
    given_by = {f"{path}, line 2": read_file(path), "PETSC_OPTIONS": read_environment()}
    for where, given in given_by.items():
        with pytest.raises(InputError, match="on the command line if you mean it") as caught:
            resolve(given)
        assert str(caught.value).startswith(f"{said} ({where}): ")
        overridden = resolve([*given, *read_words([f"-{key}", *value.split()])])
        assert overridden.solver == {key.lower(): value}


@pytest.mark.parametrize("key", ["options_file a", "prefix_push steady_", "dll_append a", "f x"])
def test_keys_that_make_petsc_read_or_load_files_are_unknown_everywhere(key):
    with pytest.raises(InputError, match=f"-{key.split()[0]}: unknown option"):
        resolve(read_words(f"-scene response -{key}".split()))


HARMLESS = [
    "steady_comparison_pc_type lu", "log_view", "steady_pc_factor_mat_solver_type mumps",
    "steady_mat_mumps_icntl_14 60", "steady_mat_superlu_dist_colperm METIS_AT_PLUS_A",
    "steady_ksp_view", "steady_ksp_monitor", "steady_ksp_chebyshev_eigenvalues 0.1,-1.5e+2",
    "steady_ksp_max_it 999999", "steady_ksp_divtol 1E30", "steady_pc_composite_pcs ilu,jacobi",
    "steady_mg_levels_1_pc_type sor", "steady_sub_0_pc_factor_shift_type NONZERO",
    "normal_eps_all true", "normal_eps_target_magnitude", "normal_st_pc_type cholesky",
    "normal_st_type sinvert", "normal_ds_method 2", "normal_st_mat_mumps_icntl_7 5",
    "normal_count_pc_factor_mat_solver_type mumps", "normal_eps_ciss_ksp_type preonly",
    "loud_pc_type lu", "loud_eps_ncv 40",
    "damped_pep_tol 1e-10", "damped_pep_toar_restart 0.5", "damped_st_pc_type lu",
]  # fmt: skip


def test_files_can_choose_solvers_and_set_numbers(written):
    lines = "".join(f"-{text}\n" for text in HARMLESS)
    expected = {key: text for key, _, text in (line.partition(" ") for line in HARMLESS)}
    assert resolve(read_file(written(f"-scene response\n{lines}"))).solver == expected
    assert all(any(key.startswith(prefix) for key in HARMLESS) for prefix in SOLVERS)


def test_files_of_solvers_hold_the_same_keys(written):
    own = {"relax_window": options_of("relaxation")["relax_window"]}
    path = written("-relax_window 3\n-steady_pc_type lu\n")
    assert read_solver(path, own) == ({"relax_window": 3}, {"steady_pc_type": "lu"})
    for text, said in (
        ("pc_type python", "could load code"),
        ("relax_window x", "needs a whole number"),
    ):
        with pytest.raises(InputError, match=f"line 1.*{said}"):
            read_solver(written(f"-{text}\n".replace("pc_", "steady_pc_")), own)
    with pytest.raises(InputError, match=r"holds -relax_window, -steady_\*, .*-loud_\* only"):
        read_solver(written("-log_view\n"), own)


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_the_files_that_come_with_pgran_and_what_results_hold_of_them_are_accepted(path, written):
    given = read_file(path)
    if path.parent.name == "solvers":
        scene = path.stem.split("_")[0]
        given += read_words(["-scene", scene if scene in SCENES else "response"])
    text = resolve(given).text()
    assert resolve(read_file(written(text))).text() == text
