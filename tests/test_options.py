"""Options: what each may be, how they are written and listed.

tests/test_contradictions.py has what they cannot be together.
"""

import re

import numpy as np
import pytest

from pgran.command.listing import HEADINGS, describe, describe_options, heading_of, users_of
from pgran.command.resolve import SCENES, options_of, resolve
from pgran.errors import InputError
from pgran.medium.sample import make_lattice
from pgran.run.frequencies import driving_frequencies
from pgran.run.keys import SOLVERS
from pgran.run.options import INTEGER, INTEGERS, read_environment, read_file, read_words, text_of

OPTIONS = list(dict.fromkeys(o for scene in SCENES for o in options_of(scene).values()))
each_option = pytest.mark.parametrize("option", OPTIONS, ids=lambda option: option.name)


def options(text):
    """Resolve a command line."""
    return resolve(read_words(text.split()))


def refusal(text, key):
    """Return the message that a command line is refused with; it names the key."""
    with pytest.raises(InputError) as caught:
        options(text)
    assert f"-{key}" in str(caught.value)
    return str(caught.value)


@each_option
def test_range(option):
    """The bounds belong to it or not, as declared; what is refused is told the range."""
    step = 1 if option.kind in (INTEGER, INTEGERS) else 1e-6 * max(1, option.high or 1)
    for bound in (option.low, option.high):
        assert bound is None or option.read(text_of(bound)) in (bound, (bound,))
    for bound, beyond in ((option.above, 0), (option.low, -step), (option.high, step)):
        if bound is not None:
            with pytest.raises(InputError, match=f"^-{option.name} ") as caught:
                option.read(text_of(bound + beyond))
            assert str(caught.value).endswith(f" is not {option.range()}")


WRONG = {  # as a text, and as a value given in Python
    "integer": (["1.5", "x", "", "1,2", "9" * 30, "9" * 5000], ["3", 3.0, None, True, (3,)]),
    "real": (["x", "", "1,2", "nan", "-inf", "1e999"], ["1.0", None, np.nan, 1j, True, (1.0,)]),
    "integers": (["x", "", "1,,2", "1.5,2", "1,"], ["8,10", 8, None, (1.5, 2), (), (8, None)]),
    "reals": (["x", "", "1,,2", "1,nan", ","], ["0.5", 0.5, None, (0.5, np.inf), ()]),
    "flag": (["maybe", "2", "tru"], ["true", None, 2, 0.5]),
    "text": ([""], [5, None, ("window",), ""]),
    "file": ([""], [5, None, ("a.h5",), ""]),
    "files": (["", ",", "a,,b", "a,"], [5, None, "a.opts,b.opts", ("a,b",), ()]),
}


@each_option
def test_wrong_types_are_refused(option):
    """A text, and a value given in Python, which is never read as if it were a text."""
    texts, values = WRONG[option.kind.name]
    for text in texts:
        with pytest.raises(InputError) as caught:
            option.read(text, " (here)")
        message = str(caught.value)
        assert message.startswith(f"-{option.name} {text[:99]}".rstrip())
        assert " (here): needs " in message
        assert option.choices or option.kind.words in message
        assert len(message) < 1100
    for value in values:
        with pytest.raises(InputError, match=f"^-{option.name}[ :]"):
            option.check(value)
    if option.choices:
        with pytest.raises(InputError, match="choose"):
            option.read("nothing_like_it")


@each_option
def test_default_is_possible(option):
    """It comes back from the line that sets it, and from NumPy, as its own type."""
    if option.default is None:
        return
    numpy = {"integer": np.int64, "real": np.float64, "integers": np.array, "reals": list}
    given = numpy.get(option.kind.name, type(option.default))(option.default)
    for found in (option.read(text_of(option.default)), option.check(given)):
        assert (found, type(found)) == (option.default, type(option.default))


def test_what_a_scene_has_not():
    with pytest.raises(AttributeError, match="scene response has no option -relax_steps"):
        options("-scene response").relax_steps  # noqa: B018


def test_flags():
    """Words for yes and no, in any case."""
    for word in ("", "true", "YES", "1", "on", "no", "0", "Off"):
        wanted = word not in ("no", "0", "Off")
        assert options(f"-scene response -output_fields {word}").output_fields is wanted


def test_more_than_fits_into_memory():
    asked = options("-scene response -lattice_shape 10000000,10000 -sweep_points 10000000000000")
    with pytest.raises(InputError, match=r"-lattice_shape: too much: .* this machine has .* GB"):
        make_lattice(asked, None)
    with pytest.raises(InputError, match=r"-sweep_points: too much: .* this machine has .* GB"):
        driving_frequencies(asked)


@pytest.mark.parametrize("scene", SCENES)
def test_keys_of_other_scenes(scene):
    """They are refused, and a scene that has them is named."""
    foreign = {name: other for other in SCENES for name in options_of(other)}
    for name in foreign.keys() - options_of(scene).keys():
        message = refusal(f"-scene {scene} -{name} 1", name)
        assert re.search(rf"does not use it, but .*\b{foreign[name]}\b", message)


def test_later_keys_win(written, monkeypatch):
    """The command line over the file over the environment, which is read once."""
    monkeypatch.setenv("PETSC_OPTIONS", "-bonds_seed 3 -sweep_omega 4 -steady_ksp_type gmres")
    given = read_environment() + read_file(written("-scene response\n-bonds_seed 5 -sweep_max 7\n"))
    found = resolve(given + read_words(["-sweep_max", "8", "--SWEEP_MAX", "9"]))
    assert (found.bonds_seed, found.sweep_omega, found.sweep_max) == (5, None, 9.0)
    assert found.solver == {"steady_ksp_type": "gmres"}
    assert read_environment() == []  # PETSc finds nothing either


@pytest.mark.parametrize(
    ("first", "second", "kept", "gone"),
    [
        ("-sweep_min .1", "-sweep_omega .5", "sweep_omega", "sweep_min"),
        ("-sweep_omega .5", "-sweep_min .1", "sweep_min", "sweep_omega"),
        ("-lattice_shape 4,4", "-bonds_law file -bonds_file a.h5", "bonds_file", "lattice_shape"),
    ],
)
def test_of_two_ways_to_say_the_same_the_later_source_wins(written, first, second, kept, gone):
    found = resolve(read_file(written(f"-scene response {first}")) + read_words(second.split()))
    assert getattr(found, kept) is not None
    assert getattr(found, gone) is None
    assert "contradicts" in refusal(f"-scene response {first} {second}", gone)


@pytest.mark.parametrize(
    ("scene", "first", "second"),
    [
        ("response", "network_file a.h5", "lattice_damping .01"),
        ("response", "network_file a.h5", "lattice_shape 20,20"),
        ("relaxation", "network_file a.h5", "bonds_seed 2"),
        ("pulse", "pulse_file a.txt", "pulse_width 9"),
        ("modes", "modes_density 9", "modes_method dense"),
        ("modes", "modes_target .5 -modes_count 3", "modes_omega_max .7"),
    ],
)
def test_a_later_source_that_says_a_part_replaces_nothing(written, first, second, scene):
    """Else one word would make a lattice of a network, with defaults for all that is not said."""
    path = written(f"-scene {scene} -{first}")
    with pytest.raises(InputError) as caught:
        resolve(read_file(path) + read_words(f"-{second}".split()))
    for key, source in ((first, path), (second, "command line")):
        assert re.search(rf"-{key.split()[0]} \({re.escape(str(source))}", str(caught.value))


def test_counting_modes_instead_of_computing_them(written):
    """The later source wins here, too; counts have no shapes to store."""
    text = "-scene modes -modes_target .5 -modes_count 3 -output_fields"
    found = resolve(read_file(written(text)) + read_words(["-modes_density", "9"]))
    kept = (found.modes_density, found.modes_target, found.modes_count, found.output_fields)
    assert kept == (9, None, None, False)
    later = read_words(["-modes_target", ".5", "-modes_count", "3"])
    assert resolve(read_file(written("-scene modes -modes_density 9")) + later).modes_count == 3


def test_a_list_of_frequencies_is_solved_for_where_a_file_makes_a_curve_of_its_grid(written):
    """Three frequencies given later would else take the factorizations of all between them."""
    path = written("-scene response\n-sweep_method curve\n-sweep_resolve 1e-3\n-sweep_points 99")

    def resolved(words):
        found = resolve(read_file(path) + read_words(words.split()))
        return found.sweep_method, found.sweep_resolve

    assert resolved("") == ("curve", 1e-3)
    assert resolved("-sweep_points 3") == ("curve", 1e-3)
    assert resolved("-sweep_omega .3,.6,.9") == ("auto", None)
    assert resolved("-sweep_omega .3,.6,.9 -sweep_method curve") == ("curve", None)
    assert options("-scene response -sweep_omega .3,.6 -sweep_method curve").sweep_method == "curve"


@pytest.mark.parametrize(
    "words",
    [
        "-lattice_shape 3,4,5 -detectors 1,1,1,2,2,2 -bonds_law loguniform -bonds_kmin 1e-3",
        "-sweep_omega 0.1,0.30000000000000004,7",
        "-bonds_law file -bonds_file bonds.h5",
        "-output_fields -steady_ksp_type gmres -steady_ksp_monitor -log_view",
        "-bonds_seed 9223372036854775807 -bonds_law hertz -bonds_hertz 1e300 -output_overwrite",
        "-output_file|it's#1", '-output_file|a"\t\\b', "-output_file|\u00e4\u00a0$a;b",
    ],
)  # fmt: skip
def test_resolved_text_gives_the_same_options(written, words):
    """But for leave to overwrite, which was for that run alone."""
    words = words.split("|") if "|" in words else words.split()
    first = resolve(read_words(["-scene", "response", *words]), output_file="results/a.h5")
    second = resolve(read_file(written(first.text())))
    for name in options_of("response").keys() - {"output_overwrite"}:
        assert getattr(second, name) == getattr(first, name), name
    assert not second.output_overwrite
    assert (second.solver, second.text()) == (first.solver, first.text())


def test_a_run_is_what_decides_its_numbers():
    """It goes on with other ranks, files and words on the terminal, and with nothing else."""
    run = options("-scene response").identity()
    how = "-ranks_per_lattice 1 -output_file b.h5 -output_log b.log -output_progress none -log_view"
    assert options(f"-scene response {how}").identity() == run
    solver = "-steady_pc_type lu", "-damped_st_mat_mumps_icntl_14 60"
    for what in ("-bonds_seed 2", "-error_tolerance 1e-3", "-output_fields", *solver):
        key, _, value = what[1:].partition(" ")
        other = options(f"-scene response {what}").identity()
        assert {k for k in other if other[k] != run.get(k)} == {key}
        assert other[key] == (value or "true").replace("1e-3", "0.001")


@pytest.mark.parametrize("scene", [None, *SCENES])
def test_list(scene):
    """Each option of a scene, or of all, with meaning, type, unit, range, default and choices."""
    text = describe_options(scene)
    declared = [o for o in OPTIONS if scene is None or options_of(scene).get(o.name) == o]
    for option in declared:
        lines = describe(option)
        assert "\n".join(lines) in text
        said = " ".join(" ".join(lines).split())
        default = "" if option.default is None else text_of(option.default)
        for fact in (option.meaning, option.kind.name, option.unit, default, *option.choices):
            assert fact in said
        assert option.range().replace(" and ", ", ") in said
    prefixes = {f"{prefix}*" for prefix in SOLVERS}
    names = {"scene", *(o.name for o in declared), *prefixes}
    used = text.partition("\nnot used by")[0]
    assert set(re.findall(r"^  -([\w*]+) ", used + " ", re.MULTILINE)) == names
    assert max(map(len, text.splitlines())) <= 80


def test_a_list_stands_under_headings():
    """And says what a scene does not use, though others do."""
    text = describe_options("modes")
    sections = {part.partition("\n")[0]: part for part in text.split("\n\n")}
    used = [heading_of(name) for name in options_of("modes")]
    assert {*sections} & {*HEADINGS} == {*used}
    for name in options_of("modes"):
        assert f"  -{name} " in sections[heading_of(name)]
    unused = sections["not used by modes"]
    assert {"-detectors,", "-sweep_max,"} < {*unused.split()}
    assert not re.search("-(lattice_|pulse_|modes_)", unused)


def test_a_list_says_of_what_an_option_is():
    """Where experiments are repeated, of which; in the list of all, of which scenes."""
    options = options_of("ensemble")
    assert users_of(options["relax_steps"], "ensemble") == "only of relaxation"
    assert users_of(options["lattice_mass"], "ensemble") == ""
    assert users_of(options["ensemble_keep"], "ensemble") == ""
    assert users_of(options["lattice_mass"]) == "not of continuum"
    assert users_of(options["relax_steps"]) == "only of accuracy, ensemble, relaxation"
    assert users_of(options["relax_steps"], "relaxation") == ""
    assert "\nthe sample (not of continuum)\n" in describe_options()
    assert "\n      only of relaxation\n" in describe_options("ensemble")
