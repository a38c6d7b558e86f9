"""Options files and command lines: what is accepted, what is refused, and what it is told."""

import os
import re
from pathlib import Path

import numpy as np
import pytest

from pgran.command.resolve import SCENES, describe_options, options_of, resolve
from pgran.errors import FileError, InputError
from pgran.files.options import FLAG, INTEGER, INTEGERS, REAL, TEXT, nearest, text_of
from pgran.files.reading import read_environment, read_file, read_solver, read_words
from pgran.files.solver_keys import SOLVER_PREFIXES
from pgran.scenes.common import check_values, driving_frequencies, make_lattice

OPTIONS = list(dict.fromkeys(o for scene in SCENES for o in options_of(scene).values()))
SHIPPED = sorted((Path(__file__).parents[1] / "options").rglob("*.opts"))
each_option = pytest.mark.parametrize("option", OPTIONS, ids=lambda option: option.name)


def options(text, **more):
    """Resolve a command line."""
    return resolve(read_words(text.split()), **more)


def refusal(text, key):
    """Return the message that a command line is refused with; it names the key."""
    with pytest.raises(InputError) as caught:
        options(text)
    message = str(caught.value)
    assert f"-{key}" in message
    assert "\n" not in message
    return message


@pytest.fixture
def written(tmp_path):
    """Return what writes an options file."""

    def write(text, name="a.opts"):
        (tmp_path / name).write_text(text, encoding="utf-8")
        return tmp_path / name

    return write


# One option


def test_defaults_of_the_paper():
    found = options("-scene response")
    assert found.scene == "response"
    assert found.lattice_shape == (20, 20)
    assert (found.lattice_mass, found.lattice_damping, found.bonds_kmax) == (1.0, 0.003, 0.25)
    assert (found.sweep_min, found.sweep_max, found.sweep_points) == (0.01, 1.3, 1291)
    assert (found.detectors, found.error_tolerance, found.solver) == ((8, 10), 1e-4, {})
    assert (found.phase_fit_min, found.phase_fit_max) == (0.3, 1.0)
    found = options("-scene relaxation")
    assert (found.relax_omega, found.spectrum_fit_min, found.spectrum_fit_max) == (0.6, 0.01, 0.3)
    found = options("-scene continuum")
    assert (found.continuum_point, found.continuum_size) == ((0.47, 0.52), (1.0, 1.0))


@each_option
def test_default_is_possible(option):
    """It comes back from the line that sets it, and from Python."""
    if option.default is not None:
        assert option.read(option.write(option.default).partition(" ")[2]) == option.default
        assert option.check(option.default) == option.default


@each_option
def test_range(option):
    """The bounds belong to it or not, as declared; what is refused is told the range."""
    assert option.low is None or option.above is None
    step = 1 if option.kind in (INTEGER, INTEGERS) else 1e-6
    inside = [bound for bound in (option.low, option.high) if bound is not None]
    outside = [option.above] if option.above is not None else []
    outside += [option.low - step] if option.low is not None else []
    outside += [option.high + step] if option.high is not None else []
    for value in inside:
        assert option.read(text_of(value)) in (value, (value,))
    for value in outside:
        with pytest.raises(InputError) as caught:
            option.read(text_of(value))
        assert str(caught.value).startswith(f"-{option.name} {value!r}: ")
        assert str(caught.value).endswith(f" is not {option.range()}")


WRONG = {
    "integer": ["1.5", "x", "", "1,2", "1e3", "nan"],
    "real": ["x", "", "1,2", "nan", "inf", "-inf", "1e999"],
    "integers": ["x", "", "1,,2", "1.5,2", "1,"],
    "reals": ["x", "", "1,,2", "1,nan", "inf", ","],
    "flag": ["maybe", "2", "tru"],
    "text": [""],
    "texts": ["", ",", "a,,b", "a,"],
}


@each_option
def test_wrong_types_are_refused(option):
    for text in WRONG[option.kind.name]:
        said = f"-{option.name} {text} (here): needs a value of the type `{option.kind.name}`"
        with pytest.raises(InputError, match=re.escape(said)):
            option.read(text, " (here)")
    if option.choices:
        with pytest.raises(InputError, match="choose"):
            option.read("nothing_like_it")


WRONG_IN_PYTHON = {
    "integer": ["3", 3.0, None, True, (3,), [3]],
    "real": ["1.0", None, np.nan, float("inf"), 1j, True, (1.0,)],
    "integers": ["8,10", 8, None, (1.5, 2), (), (8, None)],
    "reals": ["0.5", 0.5, None, (0.5, np.inf), ()],
    "flag": ["true", None, 2, 0.5],
    "text": [5, None, ("window",), ""],
    "texts": [5, None, "a.opts,b.opts", ("a,b",), ()],
}


@each_option
def test_values_given_in_python(option):
    """Those of NumPy are taken; a wrong type is refused, and never read as if it were a text."""
    for value in WRONG_IN_PYTHON[option.kind.name]:
        with pytest.raises(InputError, match=f"^-{option.name} "):
            option.check(value)
    numbers = {"integer": np.int64, "real": np.float64, "integers": np.array, "reals": list}
    if option.default is not None and option.kind.name in numbers:
        found = option.check(numbers[option.kind.name](option.default))
        assert found == option.default
        assert type(found) is type(option.default)


def test_python_is_told_the_same_as_the_command_line():
    for name, value in (("relax_steps", 0), ("relax_omega", -1.0), ("relax_method", "windw")):
        with pytest.raises(InputError) as caught:
            check_values(SCENES["relaxation"].options, **{name: value})
        assert str(caught.value) == refusal(f"-scene relaxation -{name} {value}", name)
    omega = options_of("relaxation")["relax_omega"]
    assert omega.kind is REAL
    assert omega.check(np.int32(2)) == 2.0
    check_values(SCENES["relaxation"].options, relax_omega=1, nothing=None)


def test_flags():
    for text in ("", " true", " YES", " 1", " on"):
        assert options(f"-scene response -output_fields{text}").output_fields is True
    for text in (" false", " no", " 0", " off"):
        assert options(f"-scene response -output_fields{text}").output_fields is False


def test_negative_numbers_are_values_and_not_keys():
    assert "-1" in refusal("-scene response -lattice_damping -1", "lattice_damping")
    assert "-.5" in refusal("-scene response -sweep_min -.5", "sweep_min")


@pytest.mark.parametrize("digits", [30, 5000])
@pytest.mark.parametrize("name", ["bonds_seed", "lattice_shape", "lattice_mass"])
def test_numbers_beyond_the_machine(name, digits):
    more = "e999" if name == "lattice_mass" else ""
    message = refusal(f"-scene response -{name} {'9' * digits}{more}", name)
    assert message.startswith(f"-{name} 999")
    assert len(message) < 1100


@pytest.mark.parametrize(
    ("decide", "text"),
    [
        (lambda o: make_lattice(o, None), "-scene modes -lattice_shape 10000000,10000,10000"),
        (driving_frequencies, "-scene response -sweep_points 1000000000000000"),
    ],
)
def test_more_than_fits_into_memory(decide, text):
    with pytest.raises(
        InputError, match=rf"{text.split()[2]}: too much: .* this machine has .* GB"
    ):
        decide(options(text))


# Keys


@pytest.mark.parametrize(
    ("key", "meant"),
    [
        ("latice_shape", "lattice_shape"),
        ("sweep_point", "sweep_points"),
        ("detector", "detectors"),
        ("ksp_type", "steady_ksp_type"),
        ("pc_factor_mat_solver_type", "steady_pc_factor_mat_solver_type"),
        ("eps_tol", "normal_eps_tol"),
        ("qqqqqqq", None),
        ("steady_", None),
    ],
)
def test_unknown_keys_suggest_the_nearest(key, meant):
    message = refusal(f"-scene response -{key} 1", key)
    assert "unknown option" in message
    assert "pgran options response lists all" in message
    assert meant is None or f"did you mean -{meant}?" in message
    assert key != "qqqqqqq" or "did you mean" not in message


def test_nearest():
    assert nearest("respons", ["response", "modes"]) == "response"
    assert nearest("zzz", ["response", "modes"]) is None


def test_missing_and_wrong_scene():
    assert "-scene is missing" in refusal("-lattice_shape 3,3", "scene")
    assert "did you mean response?" in refusal("-scene respons", "scene")


@pytest.mark.parametrize("scene", SCENES)
def test_keys_of_other_scenes(scene):
    """They are refused, and a scene that has them is named."""
    foreign = {name: other for other in SCENES for name in options_of(other)}
    for name in foreign.keys() - options_of(scene).keys():
        message = refusal(f"-scene {scene} -{name} 1", name)
        assert re.search(rf"does not use it, but .*\b{foreign[name]}\b", message)


def test_unknown_attribute_names_the_option():
    with pytest.raises(AttributeError, match="-nonsense"):
        options("-scene response").nonsense  # noqa: B018


# Words


@pytest.mark.parametrize(
    ("line", "hint"),
    [
        ("-lattice_shape 2, 2", "a list has no blanks: -lattice_shape 2,2"),
        ("-detectors 3 ,4", "a list has no blanks: -detectors 3,4"),
        ("-accuracy_solvers a.opts b.opts", "no blanks: -accuracy_solvers a.opts,b.opts"),
        ("-sweep_points=3", "-sweep_points=3.* write -sweep_points 3"),
        ("-detectors=", "-detectors=.* write -detectors"),
        ("scene response", "did you mean -scene?"),
        ("Sweep_Points 3", "did you mean -sweep_points?"),
        ("-output_fields true sweep_points 3", "did you mean -sweep_points?"),
        ("// it's the paper's", "a comment begins with #"),
        ("-sweep_points 3 // few", "a comment begins with #"),
        ("%few", "a comment begins with #"),
        ("; few", "a comment begins with #"),
        ("\u2013scene response", "long dash; keys begin with -"),
        ("-sc\u00e8ne response", "no key has such a name"),
        ("-steady_a'b 3", "No closing quotation"),
        ("'-steady_a b' 3", "no key has such a name"),
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


# Files, environment, precedence


def test_file_syntax(written):
    text = (
        "\ufeff# a mark and a comment\n\n  -scene response # another\n-lattice_shape 3,4 "
        "-bonds_seed 9\n-output_fields\n-output_file 'a folder/b#c.h5'\n-steady_ksp_type \"gmres\"\n"
    )
    found = resolve(read_file(written(text)))
    assert (found.lattice_shape, found.bonds_seed, found.output_fields) == ((3, 4), 9, True)
    assert found.output_file == "a folder/b#c.h5"
    assert found.solver == {"steady_ksp_type": "gmres"}


def test_refusals_name_file_and_line(written):
    path = written("-scene response\n\n-sweep_points many\n")
    with pytest.raises(InputError, match=r"-sweep_points many .*a\.opts, line 3"):
        resolve(read_file(path))
    with pytest.raises(InputError, match="-scene is missing"):
        resolve(read_file(written("# nothing\n")))


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
    filler = 2**20 - len("-scene response\n")
    assert resolve(read_file(written("-scene response\n" + filler * "\n")))


def test_later_keys_win(written, monkeypatch):
    """The command line over the file over the environment, which is read once."""
    monkeypatch.setenv("PETSC_OPTIONS", "-bonds_seed 3 -sweep_points 4 -steady_ksp_type gmres")
    given = read_environment() + read_file(written("-scene response\n-bonds_seed 5 -sweep_max 7\n"))
    found = resolve(given + read_words("-sweep_max 8 --SWEEP_MAX 9".split()))
    assert (found.bonds_seed, found.sweep_points, found.sweep_max) == (5, 4, 9.0)
    assert found.solver == {"steady_ksp_type": "gmres"}
    assert read_environment() == []  # PETSc finds nothing either


def test_yaml_of_the_environment_is_refused(monkeypatch):
    monkeypatch.setenv("PETSC_OPTIONS_YAML", "steady_pc_type: python")
    with pytest.raises(InputError, match="PETSC_OPTIONS_YAML: not read"):
        read_environment()
    assert "PETSC_OPTIONS_YAML" not in os.environ


@pytest.mark.parametrize(
    ("first", "second", "kept", "gone"),
    [
        ("-sweep_min .1", "-sweep_omega .5", "sweep_omega", "sweep_min"),
        ("-sweep_omega .5", "-sweep_min .1", "sweep_min", "sweep_omega"),
        ("-lattice_shape 4,4", "-bonds_law file -bonds_file a.h5", "bonds_file", "lattice_shape"),
    ],
)
def test_of_two_ways_to_say_the_same_the_later_source_wins(
    written, monkeypatch, first, second, kept, gone
):
    monkeypatch.setenv("PETSC_OPTIONS", f"-scene response {first}")
    environment = read_environment()
    for given in (
        environment + read_file(written(second, "PETSC_OPTIONS")),
        read_file(written(f"-scene response {first}")) + read_words(second.split()),
    ):
        found = resolve(given)
        assert getattr(found, kept) is not None
        assert getattr(found, gone) is None
    assert "contradicts" in refusal(f"-scene response {first} {second}", gone)


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("-lattice_shape 2,2,2,2", "lattice_shape"),
        ("-sweep_min 1 -sweep_max 1", "sweep_min"),
        ("-phase_fit_min 1", "phase_fit_min"),
        ("-sweep_omega 1,2 -sweep_points 3", "sweep_points"),
        ("-sweep_omega 1,2 -sweep_max 3", "sweep_max"),
        ("-sweep_omega 2,1", "sweep_omega"),
        ("-sweep_omega 1,1", "sweep_omega"),
        ("-bonds_law file", "bonds_file"),
        ("-bonds_file x.h5", "bonds_file"),
        ("-bonds_law file -bonds_file x.h5 -bonds_kmax 1", "bonds_kmax"),
        ("-bonds_law file -bonds_file x.h5 -bonds_kmin 0", "bonds_kmin"),
        ("-scene relaxation -spectrum_fit_min .3", "spectrum_fit_min"),
        ("-scene relaxation -bonds_law file -bonds_file a.h5", "bonds_law"),
        ("-scene modes -modes_omega_min .5 -modes_omega_max .4", "modes_omega_min"),
        ("-scene modes -modes_omega_min .5", "modes_omega_max"),
        ("-scene modes -modes_target .5", "modes_count"),
        ("-scene modes -modes_count 3", "modes_target"),
        ("-scene modes -modes_omega_min 0 -modes_omega_max 1 -modes_count 3", "modes_count"),
        ("-scene modes -ranks_per_lattice 2", "ranks_per_lattice"),
        ("-scene projection -ranks_per_lattice 2", "ranks_per_lattice"),
        ("-scene continuum -ranks_per_lattice 2", "ranks_per_lattice"),
    ],
)
def test_contradictions(text, key):
    refusal(f"-scene response {text}", key)


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
    assert "unknown option" in refusal(f"-scene response -{key}", key.split()[0])


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


# The resolved text


@pytest.mark.parametrize(
    "words",
    [
        "",
        "-lattice_shape 3,4,5 -detectors 1,1,1,2,2,2 -bonds_law loguniform -bonds_kmin 1e-3",
        "-sweep_omega 0.1,0.30000000000000004,7",
        "-bonds_law file -bonds_file bonds.h5",
        "-output_fields -steady_ksp_type gmres -steady_ksp_monitor -log_view",
        "-bonds_seed 9223372036854775807 -lattice_mass 0.1 -lattice_damping 0",
        "-bonds_law hertz -bonds_force 2.5e-7 -bonds_hertz 1e300",
        *(f"-output_file|{name}" for name in ("a b", "it's#1", 'a"b', "a\\b", "a\tb", "\u00e4\u00a0b")),
    ],
)  # fmt: skip
def test_resolved_text_gives_the_same_options(written, words):
    words = words.split("|") if "|" in words else words.split()
    first = resolve(read_words(["-scene", "response", *words]), output_file="results/a.h5")
    second = resolve(read_file(written(first.text())))
    for name in options_of("response"):
        assert getattr(second, name) == getattr(first, name), name
    assert second.solver == first.solver
    assert second.text() == first.text()


def test_resolved_text_repeats_neither_leave_to_overwrite_nor_a_dry_run():
    text = options("-scene response -output_overwrite -dry_run").text()
    assert text == options("-scene response").text()


def test_what_only_the_command_line_may_say_is_in_the_text_and_refused_from_there(written):
    words = ["-scene", "response", "-steady_ksp_view", "ascii:a b.txt"]
    first = resolve(read_words(words))
    assert first.solver == {"steady_ksp_view": "ascii:a b.txt"}
    given = read_file(written(first.text()))
    assert [item.text for item in given if item.key == "steady_ksp_view"] == ["ascii:a b.txt"]
    with pytest.raises(InputError, match="command line if you mean it"):
        resolve(given)


def test_a_run_is_what_decides_its_numbers():
    """It goes on with other ranks, files and words on the terminal, and with nothing else."""
    run = options("-scene response").identity()
    how = "-ranks_per_lattice 1 -output_file b.h5 -output_log b.log -output_progress none -log_view"
    assert options(f"-scene response {how}").identity() == run
    for what in ("-bonds_seed 2", "-error_tolerance 1e-3", "-output_fields", "-steady_pc_type lu"):
        key, _, value = what[1:].partition(" ")
        other = options(f"-scene response {what}").identity()
        assert {k for k in other if other[k] != run.get(k)} == {key}
        assert other[key] == (value or "true").replace("1e-3", "0.001")


# The list of options


@pytest.mark.parametrize("scene", [None, *SCENES])
def test_list(scene):
    """Each option of a scene, or of all, with meaning, type, unit, range, default and choices."""
    entries = ("\n" + describe_options(scene)).split("\n-")[1:]
    declared = [o for o in OPTIONS if scene is None or options_of(scene).get(o.name) == o]
    for option in declared:
        default = "" if option.default is None else f"default {text_of(option.default)})"
        facts = option.meaning, option.kind.name, option.unit, option.range(), *option.choices
        (entry,) = (e for e in entries if e.startswith(f"{option.name}\n    {option.meaning}\n"))
        assert option.meaning
        assert all(fact in entry for fact in (*facts, default))
        assert ("default" in entry.split("(")[-1]) == bool(default)
    names = {"scene", *(o.name for o in declared), *(f"{prefix}*" for prefix in SOLVER_PREFIXES)}
    assert {entry.partition("\n")[0] for entry in entries} == names
