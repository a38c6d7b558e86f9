"""What is told on the command line without a run: help, lists, and what was meant by a word."""

import re
import sys

import pytest

import pgran.__main__ as program
from pgran import __version__, errors
from pgran.command.resolve import SCENES


def assert_one_line(done, code, said):
    """One line that says so, and the exit code."""
    (line,) = done.stderr.splitlines()
    assert done.returncode == code
    assert line.startswith("pgran")
    assert said in line


def test_questions(call):
    for words in ("", "run", "run -scene response", "rum"):
        assert call(*words.split()).returncode == 2
    assert_one_line(call("options", "respons"), 2, "did you mean response?")
    assert call("--version").stdout == f"pgran {__version__}\n"
    for words in ("--help", "-help", "-h", "help"):
        done = call(*words.split())
        assert (done.returncode, done.stderr) == (0, "")
        assert [name for name in program.COMMANDS if f"  pgran {name} " not in done.stdout] == []
    for scene in SCENES:
        assert scene in call("options").stdout
        assert scene in call("options", scene).stdout


@pytest.mark.parametrize("command", program.COMMANDS)
def test_every_command_has_a_help_of_one_style(call, command):
    """Usage, what it does, and examples, which it could carry out."""
    done = call(command, "--help")
    assert (done.returncode, done.stderr) == (0, "")
    assert call("help", command).stdout == done.stdout
    usage, does, *_ = done.stdout.split("\n\n")
    assert usage.startswith(f"usage: pgran {command}")
    assert does[0].isupper()
    assert does[-1] == "."
    examples = done.stdout.partition("\nexamples:\n")[2].partition("\n\n")[0].splitlines()
    assert examples
    for line in examples:
        assert re.match(f"  (mpirun -n 2 )?pgran {command}( |$)", line)
    assert max(map(len, done.stdout.splitlines())) <= 90


def test_the_help_of_a_run(call):
    """Exit codes, and where the options of a scene are listed."""
    text = call("run", "a.opts", "--help").stdout
    for code in (errors.DONE, errors.BAD_INPUT, errors.INACCURATE, errors.BAD_FILE, errors.STOPPED):
        assert f"\n  {code:<3} " in text


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ("rn a.opts", 2, "rn: no such command; did you mean pgran run?"),
        ("a.opts", 2, "did you mean pgran run a.opts?"),
        ("results/a.h5", 2, "did you mean pgran plot results/a.h5?"),
        ("--verison", 2, "did you mean pgran --version?"),
        ("zzz", 2, "pgran --help lists them"),
        ("run", 2, "run: an options file comes first"),
        ("run respons", 4, "No such file or directory; did you mean options/response.opts?"),
        ("run zzz.opts", 4, "zzz.opts: No such file or directory"),
        ("run options", 4, "options: is a directory"),
        ("run b.h5", 4, "b.h5: not a text file, as options files are, but a result"),
        ("run a.opts -relax_steps 3", 2, "but accuracy, ensemble and relaxation do"),
        ("run a.opts -accuracy_repeats 2", 2, "but accuracy does"),
        ("run a.opts b.opts", 4, "b.opts: No such file"),
        ("run a.opts -detectors 2,3 b.opts", 2, "b.opts: options files come first, before"),
        ("run a.opts -seed 7", 2, "-seed: unknown option; did you mean -bonds_seed?"),
        ("run a.opts -output b", 2, "-output: unknown option; did you mean -output_file?"),
        ("plot b.h5 --out c", 2, "plot: --out: unknown option; did you mean --output?"),
        ("plot b.h5 c.png", 2, "plot: c.png: is no result; a figure to write comes after -o"),
        ("units -material glas", 2, "'acrylic'); did you mean glass?"),
        ("verify bb.h5", 4, "bb.h5: No such file or directory; did you mean b.h5?"),
        ("options modes pulse", 2, "options: unrecognized arguments: pulse; see pgran options"),
        ("export b.h5", 2, "export: the following arguments are required: TO; see pgran export"),
    ],
)  # fmt: skip
def test_what_was_meant_is_told(call, place, shared_path, world, words, code, said):
    if world.rank == 0:
        (shared_path / "options").mkdir()
        (shared_path / "b.h5").write_bytes(b"\x89HDF\r\n\x1a\n")
    place("options/response.opts", "-scene response")
    assert_one_line(call(*words.split()), code, said)


QUESTION = """
import sys, warnings
import pgran.__main__ as program
def ask(words, main=program.main):
    warnings.warn("a first line\\nand another", RuntimeWarning)
    codes = [main([word]) for word in words]
    print("LOADED", {"petsc4py.PETSc", "mpi4py.MPI", "h5py", "scipy"} & set(sys.modules))
    return max(codes)
program.main = ask
program.console()
"""


def test_questions_load_no_library(start):
    """And a library's warning is one line."""
    done = start("options", "--help", "--version", program=[sys.executable, "-c", QUESTION])
    assert done.stdout.endswith("LOADED set()\n")
    assert done.stderr == "pgran: warning: RuntimeWarning: a first line and another\n"
