"""Options files and command lines: what is accepted, what is refused, and what it is told."""

import os
import re
from pathlib import Path

import pytest

from pgran.command.resolve import SCENES, describe_options, resolve
from pgran.errors import FileError, InputError
from pgran.files import reading
from pgran.files.options import FLAG, TEXT, nearest
from pgran.files.reading import read_environment, read_file, read_words
from pgran.files.solver_keys import SOLVER_PREFIXES

ALL = {option.name: option for options in SCENES.values() for option in options}


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


def test_defaults_of_the_paper():
    found = options("-scene response")
    assert found.scene == "response"
    assert found.lattice_shape == (20, 20)
    assert (found.lattice_mass, found.lattice_damping, found.bonds_kmax) == (1.0, 0.003, 0.25)
    assert (found.sweep_min, found.sweep_max, found.sweep_points) == (0.01, 1.3, 1291)
    assert found.detectors == (8, 10)
    assert found.error_tolerance == 1e-4
    assert (found.phase_fit_min, found.phase_fit_max) == (0.3, 1.0)
    assert found.solver == {}
    found = options("-scene relaxation")
    assert (found.relax_omega, found.spectrum_fit_min, found.spectrum_fit_max) == (0.6, 0.01, 0.3)
    found = options("-scene continuum")
    assert (found.continuum_point, found.continuum_size) == ((0.47, 0.52), (1.0, 1.0))
    assert (found.continuum_mass, found.continuum_stiffness, found.continuum_damping) == (
        1,
        1,
        0.003,
    )


@pytest.mark.parametrize("scene", SCENES)
def test_every_default_is_possible(scene):
    """Writing and reading a default gives it back, and its own bounds allow it."""
    for option in SCENES[scene]:
        if option.default is not None:
            _, _, text = option.write(option.default).partition(" ")
            assert option.read(text) == option.default


def outside(option):
    """Values just outside each bound that an option declares."""
    step = 1 if option.kind.name.startswith("integer") else 1e-6
    if option.low is not None:
        yield option.low - step
    if option.above is not None:
        yield option.above
        yield option.above - step
    if option.high is not None:
        yield option.high + step


def inside(option):
    """The bounds themselves where they belong to the range."""
    if option.low is not None:
        yield option.low
    if option.high is not None:
        yield option.high


BOUNDED = [
    pytest.param(option, value, id=f"{option.name}={value}")
    for option in ALL.values()
    for value in outside(option)
]


@pytest.mark.parametrize(("option", "value"), BOUNDED)
def test_values_outside_the_range_are_refused(option, value):
    with pytest.raises(InputError) as caught:
        option.read(repr(value))
    assert f"-{option.name}" in str(caught.value)
    assert option.range() in str(caught.value)


ALLOWED = [
    pytest.param(option, value, id=f"{option.name}={value}")
    for option in ALL.values()
    for value in inside(option)
]


@pytest.mark.parametrize(("option", "value"), ALLOWED)
def test_bounds_themselves_are_allowed(option, value):
    read = option.read(repr(value))
    assert value in (read if isinstance(read, tuple) else (read,))


WRONG = {
    "integer": ["1.5", "x", "", "1,2", "1e3", "nan"],
    "real": ["x", "", "1,2", "nan", "inf", "-inf", "1e999"],
    "integers": ["x", "", "1,,2", "1.5,2", "1,"],
    "reals": ["x", "", "1,,2", "1,nan", "inf", ","],
    "flag": ["maybe", "2", "tru"],
    "text": [],
    "texts": ["", ",", "a,,b", "a,"],
}


@pytest.mark.parametrize("option", ALL.values(), ids=lambda option: option.name)
def test_wrong_types_are_refused(option):
    assert option.kind.name in WRONG
    for text in WRONG[option.kind.name]:
        with pytest.raises(InputError, match=f"-{option.name}"):
            option.read(text, " (somewhere)")
    if option.choices:
        with pytest.raises(InputError, match="choose"):
            option.read("nothing_like_it")


def test_texts_need_a_value():
    texts = [option for option in ALL.values() if option.kind is TEXT]
    assert len(texts) > 5
    for option in texts:
        with pytest.raises(InputError, match=f"-{option.name} : needs a value"):
            option.read("")


def test_flags():
    for text in ("", " true", " YES", " 1", " on"):
        assert options(f"-scene response -output_fields{text}").output_fields is True
    for text in (" false", " no", " 0", " off"):
        assert options(f"-scene response -output_fields{text}").output_fields is False
    assert any(option.kind is FLAG for option in ALL.values())


def test_negative_numbers_are_values_and_not_keys():
    assert "-1" in refusal("-scene response -lattice_damping -1", "lattice_damping")
    assert "-.5" in refusal("-scene response -sweep_min -.5", "sweep_min")


# Keys


@pytest.mark.parametrize(
    ("key", "meant"),
    [
        ("latice_shape", "-lattice_shape"),
        ("bond_seed", "-bonds_seed"),
        ("sweep_point", "-sweep_points"),
        ("detector", "-detectors"),
        ("ksp_type", "-steady_ksp_type"),
        ("pc_type", "-steady_pc_type"),
        ("pc_factor_mat_solver_type", "-steady_pc_factor_mat_solver_type"),
        ("stedy_ksp_type", None),
    ],
)
def test_unknown_keys_suggest_the_nearest(key, meant):
    message = refusal(f"-scene response -{key} 1", key)
    assert "unknown" in message
    if meant:
        assert f"did you mean {meant}?" in message


def test_key_like_nothing_suggests_nothing():
    assert "did you mean" not in refusal("-scene response -qqqqqqq 1", "qqqqqqq")


def test_missing_and_wrong_scene():
    assert "response" in refusal("-lattice_shape 3,3", "scene")
    assert "did you mean response?" in refusal("-scene respons", "scene")


def test_key_of_another_scene():
    """A key that only another scene has is refused, and that scene is named."""
    for scene, its in SCENES.items():
        mine = {option.name for option in its}
        for name, other in SCENES.items():
            for option in other:
                if option.name not in mine:
                    text = option.kind.write(option.default) if option.default else "1"
                    message = refusal(f"-scene {scene} -{option.name} {text}", option.name)
                    assert "does not use it" in message
                    assert name in message


@pytest.mark.parametrize("prefix", SOLVER_PREFIXES)
def test_solver_keys_pass(prefix):
    found = options(f"-scene response -{prefix}ksp_type gmres -log_view -{prefix}pc_type lu")
    assert found.solver == {f"{prefix}ksp_type": "gmres", "log_view": "", f"{prefix}pc_type": "lu"}


def test_prefix_alone_is_no_key():
    refusal("-scene response -steady_ 3", "steady_")


@pytest.mark.parametrize(
    "key", ["dll_append x.so", "options_file x", "options_file_yaml x", "python x", "f x"]
)
def test_keys_that_make_petsc_read_or_load_files_are_refused(key):
    refusal(f"-scene response -{key}", key.split()[0])


def test_unknown_attribute_names_the_option():
    with pytest.raises(AttributeError, match="-nonsense"):
        options("-scene response").nonsense  # noqa: B018


def test_value_without_a_key():
    with pytest.raises(InputError, match="value without a key"):
        read_words(["5"])
    with pytest.raises(InputError, match="value without a key"):
        read_words(["-lattice_shape", "5", "6"])


@pytest.mark.parametrize(
    ("line", "hint"),
    [
        ("-lattice_shape 2, 2", "a list has no blanks: -lattice_shape 2,2"),
        ("-detectors 3 4", "a list has no blanks: -detectors 3,4"),
        ("-detectors 3 ,4", "a list has no blanks: -detectors 3,4"),
        ("-sweep_points=3", "-sweep_points=3.* write -sweep_points 3"),
        ("-detectors=", "-detectors=.* write -detectors"),
        ("scene response", "did you mean -scene?"),
        ("Sweep_Points 3", "did you mean -sweep_points?"),
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
def test_what_to_write_instead(tmp_path, line, hint):
    with pytest.raises(InputError, match=rf"{hint}|{re.escape(hint)}") as caught:
        read_file(write(tmp_path / "a.opts", f"-sweep_max 2\n{line}\n"))
    assert "a.opts, line 2" in str(caught.value)


@pytest.mark.parametrize("odd", ["\n", "\r", "\x1b", "\x85", "\u2028", "\udcff"])
@pytest.mark.parametrize("word", ["-output_file a{}b.h5", "-steady_ksp_type b{}", "{}", "-a{}b"])
def test_words_that_no_file_could_hold(word, odd):
    """The result repeats its options as a file, where these would end a line, or could not be."""
    with pytest.raises(InputError, match="line break, a control character, or a byte that"):
        read_words(word.format(odd).split(" "))


@pytest.mark.parametrize(
    "name", ["a b", "a'b", 'a"b', "a#b", "a\\b", "a\tb", "\u00e4\u00a0b", "$a;b"]
)
def test_names_of_files_come_back_from_the_text(tmp_path, name):
    found = resolve(read_words(["-scene", "response", "-output_file", name]))
    again = resolve(read_file(write(tmp_path / "a.opts", found.text())))
    assert again.output_file == name


# Contradictions


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("-lattice_shape 2,2,2,2", "lattice_shape"),
        ("-sweep_min 1 -sweep_max 1", "sweep_min"),
        ("-sweep_min 2", "sweep_min"),
        ("-phase_fit_min 1", "phase_fit_min"),
        ("-sweep_omega 1,2 -sweep_points 3", "sweep_points"),
        ("-sweep_omega 1,2 -sweep_min .1", "sweep_min"),
        ("-sweep_omega 1,2 -sweep_max 3", "sweep_max"),
        ("-sweep_omega 2,1", "sweep_omega"),
        ("-sweep_omega 1,1", "sweep_omega"),
        ("-bonds_law file", "bonds_file"),
        ("-bonds_file x.h5", "bonds_file"),
        ("-bonds_law file -bonds_file x.h5 -lattice_shape 3,3", "lattice_shape"),
        ("-bonds_law file -bonds_file x.h5 -bonds_kmax 1", "bonds_kmax"),
        ("-bonds_law file -bonds_file x.h5 -bonds_kmin 0", "bonds_kmin"),
        ("-scene relaxation -spectrum_fit_min .3", "spectrum_fit_min"),
        ("-scene modes -modes_omega_min .5 -modes_omega_max .4", "modes_omega_min"),
        ("-scene modes -modes_omega_min .5", "modes_omega_max"),
        ("-scene modes -modes_target .5", "modes_count"),
        ("-scene modes -modes_count 3", "modes_target"),
        ("-scene modes -modes_omega_min 0 -modes_omega_max 1 -modes_count 3", "modes_count"),
    ],
)
def test_contradictions(text, key):
    refusal(f"-scene response {text}", key)


# Precedence, files, environment


def test_later_keys_win():
    found = options("-scene response -bonds_seed 1 -bonds_seed 2 --BONDS_SEED 3")
    assert found.bonds_seed == 3


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return path


def test_command_line_wins_over_the_file(tmp_path):
    path = write(tmp_path / "a.opts", "-scene response\n-bonds_seed 5 -sweep_points 7\n")
    found = resolve(read_file(path) + read_words(["-bonds_seed", "6"]))
    assert (found.bonds_seed, found.sweep_points) == (6, 7)


def test_file_syntax(tmp_path):
    path = write(
        tmp_path / "a.opts",
        "# a comment\n\n  -scene response # another\n-lattice_shape 3,4 -bonds_seed 9\n"
        "-output_fields\n-output_file 'a folder/b#c.h5'\n-steady_ksp_type \"gmres\"\n",
    )
    found = resolve(read_file(path))
    assert found.lattice_shape == (3, 4)
    assert found.bonds_seed == 9
    assert found.output_fields is True
    assert found.output_file == "a folder/b#c.h5"
    assert found.solver == {"steady_ksp_type": "gmres"}


def test_a_mark_in_front_of_a_file(tmp_path):
    (tmp_path / "a.opts").write_text("-scene response\n-bonds_seed 5\n", encoding="utf-8-sig")
    assert resolve(read_file(tmp_path / "a.opts")).bonds_seed == 5


def test_refusals_name_file_and_line(tmp_path):
    path = write(tmp_path / "a.opts", "-scene response\n\n-sweep_points many\n")
    with pytest.raises(InputError, match=r"-sweep_points many .*a\.opts, line 3"):
        resolve(read_file(path))
    path = write(tmp_path / "b.opts", "-scene response\nlattice_shape 3,3\n")
    with pytest.raises(InputError, match=r"b\.opts, line 2"):
        read_file(path)
    path = write(tmp_path / "c.opts", "-scene 'response\n")
    with pytest.raises(InputError, match=r"c\.opts, line 1"):
        read_file(path)


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(FileError, match=r"missing\.opts: No such file"):
        read_file(tmp_path / "missing.opts")
    with pytest.raises(FileError, match="directory"):
        read_file(tmp_path)
    for odd in (b"\0", b"\x1b[2J", b"\xff", b"\xc3", b"\xed\xa0\x80", b"\x7f", b"\xc2\x85"):
        (tmp_path / "binary.opts").write_bytes(b"-scene response\n-output_file a" + odd + b"b\n")
        with pytest.raises(FileError, match=r"binary\.opts: not a text file \(line 2\)"):
            read_file(tmp_path / "binary.opts")


def test_files_without_end(tmp_path):
    """Pipes and devices are not even opened; of large files no more is read than may be."""
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", "/dev/zero"):
        with pytest.raises(FileError, match="is a pipe or a device"):
            read_file(path)
    with pytest.raises(FileError, match="no name of a file"):
        read_file("a\0b")
    with open(tmp_path / "large.opts", "wb") as stream:
        stream.truncate(10 * 2**30)
    with pytest.raises(FileError, match="at most 1048576 bytes"):
        read_file(tmp_path / "large.opts")
    (tmp_path / "large.opts").unlink()
    filler = 2**20 - len("-scene response\n")
    assert resolve(read_file(write(tmp_path / "a.opts", "-scene response\n" + filler * "\n")))


def test_empty_file(tmp_path):
    with pytest.raises(InputError, match="-scene is missing"):
        resolve(read_file(write(tmp_path / "a.opts", "# nothing\n")))


def test_environment_is_read_once_and_checked(monkeypatch):
    monkeypatch.setenv("PETSC_OPTIONS", "-bonds_seed 3 -steady_ksp_type gmres")
    given = read_environment()
    found = resolve([*given, *read_words(["-scene", "response"])])
    assert found.bonds_seed == 3
    assert found.solver == {"steady_ksp_type": "gmres"}
    assert read_environment() == []  # PETSc finds nothing either
    monkeypatch.setenv("PETSC_OPTIONS", "-dll_append evil.so")
    with pytest.raises(InputError, match=r"-dll_append .*PETSC_OPTIONS"):
        resolve([*read_words(["-scene", "response"]), *read_environment()])


# What no file may say


HARMFUL = [
    "steady_pc_type python", "steady_PC_Type PYTHON", "steady_ksp_type shell",
    "steady_pc_python_type m.f", "steady_ksp_monitor_python m.f", "steady_sub_pc_type mypython",
    "steady_ksp_view ascii:a.txt", "steady_ksp_view :a.txt", "steady_ksp_view binary",
    "steady_ksp_view_mat hdf5:a.h5", "steady_ksp_monitor draw", "steady_ksp_view saws",
    "steady_ksp_view socket:5000", "steady_mat_view matlab", "normal_eps_view_vectors vtk:a.vts",
    "normal_eps_error_relative ::ascii_info_detail", "normal_eps_view_values xbinary",
    "steady_mat_mumps_ooc_tmpdir here", "steady_mat_mumps_icntl_22 1", "steady_mat_mumps_icntl_3 7",
    "steady_sub_mat_mumps_icntl_1 8", "steady_pc_mg_dump_binary", "steady_pc_bddc_save 5",
    "steady_pc_asm_print_subdomains out", "steady_mat_factor_dump_on_error 1",
    "steady_pc_type ../lib", "steady_pc_type ~/lib", "steady_x $HOME", "steady_x é", "steady_x a;b",
    "log_view :a.txt", "log_view a.txt", "log_trace", "log_all", "log a", "log_mpe a", "info a",
    "history", "history a.txt", "citations a.bib", "malloc_dump", "malloc_view a.txt",
    "objects_dump a", "start_in_debugger", "on_error_attach_debugger gdb", "stop_for_debugger",
    "viewer_binary_filename a", "viewer_socket_machine a", "options_left a", "options_view a",
]  # fmt: skip


@pytest.mark.parametrize("text", HARMFUL)
def test_files_cannot_load_code_start_programs_or_write_files(tmp_path, monkeypatch, text):
    """Nor can the environment; who gives the same on the command line means it."""
    path = write(tmp_path / "a.opts", f"-scene response\n-{text}\n")
    monkeypatch.setenv("PETSC_OPTIONS", f"-scene response -{text}")
    key, _, value = text.partition(" ")
    for given, where in (
        (read_file(path), "a.opts, line 2"),
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
    "text",
    [
        "steady_ksp_type gmres", "steady_pc_factor_mat_solver_type mumps", "log_view",
        "steady_mat_mumps_icntl_14 60", "steady_mat_mumps_icntl_4 2", "steady_mat_mumps_icntl_3 6",
        "steady_mat_mumps_cntl_1 1e-3", "steady_ksp_view", "steady_ksp_monitor", "options_left",
        "steady_ksp_chebyshev_eigenvalues 0.1,-1.5e+2", "normal_eps_all true", "normal_ds_method 2",
        "steady_pc_composite_pcs ilu,jacobi", "memory_view", "steady_ksp_rtol .5",
        "steady_ksp_pc_side right",
    ],
)  # fmt: skip
def test_files_can_choose_solvers_and_set_numbers(tmp_path, text):
    path = write(tmp_path / "a.opts", f"-scene response\n-{text}\n")
    key, _, value = text.partition(" ")
    assert resolve(read_file(path)).solver == {key: value}


SHIPPED = sorted((Path(__file__).parents[1] / "options").rglob("*.opts"))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_the_files_that_come_with_pgran_are_accepted(path):
    given = read_file(path)
    if path.parent.name == "solvers":
        scene = path.stem.split("_")[0]
        given += read_words(["-scene", scene if scene in SCENES else "response"])
    resolve(given)


@pytest.mark.parametrize(
    "key",
    ["options_file a", "options_file_yaml a", "prefix_push steady_", "dll_append a", "python"],
)
def test_keys_that_are_read_recursively_are_unknown(tmp_path, key):
    with pytest.raises(InputError, match="unknown option"):
        resolve(read_file(write(tmp_path / "a.opts", f"-scene response\n-{key}\n")))


def test_yaml_of_the_environment_is_refused(monkeypatch):
    monkeypatch.setenv("PETSC_OPTIONS_YAML", "steady_pc_type: python")
    with pytest.raises(InputError, match="PETSC_OPTIONS_YAML: not read"):
        read_environment()
    assert "PETSC_OPTIONS_YAML" not in os.environ


# What no machine can do


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("response -lattice_shape 1000000000,1000000000", "lattice_shape"),
        ("modes -lattice_shape 10000000,10000,10000", "lattice_shape"),
        ("response -sweep_points 1000000000000000", "sweep_points"),
        ("response -lattice_shape 2000,2000 -sweep_points 1000000 -output_fields", "sweep_points"),
        ("continuum -sweep_points 100000000000000", "sweep_points"),
        ("projection -lattice_shape 3000,3000 -sweep_points 1000000", "sweep_points"),
        ("modes -lattice_shape 5000,5000 -output_fields", "output_fields"),
        ("relaxation -relax_steps 1000000000000000", "relax_steps"),
        ("relaxation -relax_trajectories 1000000000000", "relax_steps"),
        ("relaxation -relax_trajectories 10000000 -relax_steps 10000000", "relax_steps"),
    ],
)
def test_more_than_fits_into_memory(text, key):
    message = refusal(f"-scene {text}", key)
    assert "this machine has" in message
    assert "GB" in message


@pytest.mark.parametrize(
    ("scene", "key", "each", "more"),
    [
        ("response", "sweep_points", 32 + 40, 0),
        ("response -output_fields", "sweep_points", 32 + 40 + 16 * 400, 0),
        ("projection", "sweep_points", 40 + 16 * 400, 0),
        ("projection -modes_count 7", "sweep_points", 40 + 16 * 7, 0),
        ("relaxation", "relax_steps", 16 + 16 + 16, 100),
    ],
)
def test_memory_that_is_needed(monkeypatch, scene, key, each, more):
    """Of each frequency, amplitudes, fields or coefficients; of each step; and a copy."""
    monkeypatch.setattr(reading, "machine_memory", lambda: 2 * (more + each * 1000))
    options(f"-scene {scene} -{key} 1000")
    with pytest.raises(InputError, match=f"-{key}: too much"):
        options(f"-scene {scene} -{key} 1001")


def test_memory_of_modes_that_are_not_asked_for(monkeypatch):
    monkeypatch.setattr(reading, "machine_memory", lambda: 2 * 72 * 1000)
    options("-scene modes -lattice_shape 3000 -modes_omega_min 0 -modes_omega_max 1 -output_fields")


@pytest.mark.parametrize("digits", [30, 400, 5000])
@pytest.mark.parametrize("name", ["bonds_seed", "lattice_shape", "sweep_points", "lattice_mass"])
def test_numbers_beyond_the_machine(name, digits):
    with pytest.raises(InputError) as caught:
        options(f"-scene response -{name} {'9' * digits}{'' if name != 'lattice_mass' else 'e999'}")
    assert str(caught.value).startswith(f"-{name} 999")
    assert len(str(caught.value)) < 1100


# The resolved text


@pytest.mark.parametrize(
    "text",
    [
        "",
        "-lattice_shape 3,4,5 -detectors 1,1,1,2,2,2 -bonds_law loguniform -bonds_kmin 1e-3",
        "-sweep_omega 0.1,0.30000000000000004,7",
        "-bonds_law file -bonds_file bonds.h5",
        "-output_fields -steady_ksp_type gmres -steady_ksp_monitor -log_view",
        "-bonds_seed 9223372036854775807 -lattice_mass 0.1 -lattice_damping 0",
        "-bonds_law hertz -bonds_force 2.5e-7 -bonds_hertz 1e300",
    ],
)
def test_resolved_text_gives_the_same_options(tmp_path, text):
    first = options(f"-scene response {text}", output_file="results/a.h5")
    path = write(tmp_path / "a.opts", first.text())
    second = resolve(read_file(path))
    for option in SCENES["response"]:
        assert getattr(second, option.name) == getattr(first, option.name), option.name
    assert second.solver == first.solver
    assert second.text() == first.text()


def test_resolved_text_repeats_neither_leave_to_overwrite_nor_a_dry_run():
    text = options("-scene response -output_overwrite -dry_run").text()
    assert text == options("-scene response").text()


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


@pytest.mark.parametrize("name", ["a folder/b.h5", "it's#1.h5", "a\\b.h5", '"q".h5'])
def test_resolved_text_keeps_any_file_name(tmp_path, name):
    first = options("-scene response", output_file=name)
    second = resolve(read_file(write(tmp_path / "a.opts", first.text())))
    assert second.output_file == name


def test_resolved_text_keeps_solver_values_with_spaces(tmp_path):
    """What only the command line may say is in the text, and is refused from there."""
    words = ["-scene", "response", "-steady_ksp_view", "ascii:a b.txt"]
    first = resolve(read_words(words))
    assert first.solver == {"steady_ksp_view": "ascii:a b.txt"}
    given = read_file(write(tmp_path / "b.opts", first.text()))
    assert [item.text for item in given if item.key == "steady_ksp_view"] == ["ascii:a b.txt"]
    with pytest.raises(InputError, match="command line if you mean it"):
        resolve(given)


# The list of options


def test_list_names_every_option_with_its_default():
    text = describe_options()
    for option in ALL.values():
        assert f"-{option.name}\n" in text
        assert option.meaning in text
        assert option.range() in text
    assert "default 20,20" in text
    assert "-steady_*" in text


@pytest.mark.parametrize("scene", SCENES)
def test_list_of_one_scene(scene):
    """Each with its meaning, type, unit, range, default and choices."""
    entries = {e.split("\n")[0]: e for e in ("\n" + describe_options(scene)).split("\n-")}
    for option in SCENES[scene]:
        entry = entries[option.name]
        default = "" if option.default is None else option.kind.write(option.default)
        facts = option.meaning, option.kind.name, option.unit, option.range(), *option.choices
        assert all(fact in entry for fact in facts)
        assert (f"default {default})" in entry) == bool(default)
    assert not set(entries) - {option.name for option in SCENES[scene]} - {
        "", "scene", *(f"{prefix}*" for prefix in SOLVER_PREFIXES)
    }  # fmt: skip


def test_every_option_is_documented():
    for option in ALL.values():
        assert option.meaning
        assert option.low is None or option.above is None
        bound = option.low if option.above is None else option.above
        assert bound is None or option.high is None or bound < option.high


def test_nearest():
    assert nearest("respons", ["response", "modes"]) == "response"
    assert nearest("zzz", ["response", "modes"]) is None


@pytest.mark.parametrize(
    ("file", "words", "kept", "gone"),
    [
        ("-sweep_min .1", "-sweep_omega .5", "sweep_omega", "sweep_min"),
        ("-sweep_omega .5", "-sweep_min .1", "sweep_min", "sweep_omega"),
        ("-lattice_shape 4,4", "-bonds_law file -bonds_file a.h5", "bonds_file", "lattice_shape"),
    ],
)
def test_of_two_ways_to_say_the_same_the_command_line_wins(tmp_path, file, words, kept, gone):
    (tmp_path / "a.opts").write_text(f"-scene response\n{file}\n")
    given = read_file(tmp_path / "a.opts")
    options = resolve(given + read_words(words.split()))
    assert getattr(options, kept) is not None
    assert getattr(options, gone) is None
    with pytest.raises(InputError, match="contradicts"):
        resolve(read_words(f"-scene response {file} {words}".split()))


def test_relaxation_needs_a_law_to_draw_from():
    with pytest.raises(InputError, match="needs a law"):
        resolve(read_words(["-scene", "relaxation", "-bonds_law", "file", "-bonds_file", "a.h5"]))


@pytest.mark.parametrize("scene", ["modes", "projection", "continuum"])
def test_only_driven_lattices_are_shared(scene):
    resolve(read_words(f"-scene {scene} -ranks_per_lattice 1".split()))
    with pytest.raises(InputError, match="ranks_per_lattice"):
        resolve(read_words(f"-scene {scene} -ranks_per_lattice 2".split()))
