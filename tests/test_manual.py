"""The manual: its commands and snippets work, it names all there is, and it is shown."""

import dataclasses
import os
import pty
import re
import runpy
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace

import pytest
from small import copy_options, made_small

import pgran
from pgran import catalogue
from pgran.__main__ import COMMANDS
from pgran.command import manual
from pgran.command.resolve import SCENES, options_of, resolve
from pgran.draw import pages
from pgran.medium import network_file
from pgran.run import keys as solver_keys
from pgran.run.options import files_first, read_file, read_files, read_words
from pgran.store import file

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "pgran" / "manual"
PAGES = [ROOT / "README.md", *sorted(FOLDER.glob("*.md"))]
TEXT = {path: path.read_text(encoding="utf-8") for path in PAGES}
# <!-- slow --> before a block: it is read, not run
BLOCK = re.compile(r"^(<!-- slow -->\n)?```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
OPTIONS = {option.name: option for scene in SCENES for option in options_of(scene).values()}


def name_of(path):
    return path.relative_to(ROOT).with_suffix("").as_posix().replace("/", "-")


def blocks(language):
    """Return the blocks in a language with the names of their pages, and whether they are slow."""
    return [
        SimpleNamespace(page=path, name=f"{name_of(path)}-{n}", slow=bool(slow), lines=lines)
        for path, text in TEXT.items()
        for n, (slow, said, lines) in enumerate(BLOCK.findall(text), 1)
        if said == language
    ]


SHELL = {block.lines: block for block in blocks("sh")}.values()  # each once
PYTHON = blocks("python")
# What takes the place of programs in a shell: the words of each pgran go into a file.
STAND_INS = """
exec 3>words
source() { :; }
mpirun() { "${@:3}"; }
pgran() { echo "${@@Q}" >&3; }
"""


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A folder of the experiments made small, and of their results, each computed once."""
    folder = tmp_path_factory.mktemp("small")
    copy_options(folder)
    return folder


@pytest.fixture
def scratch(small, call, here, tmp_path, monkeypatch):
    """Return what carries out commands, and what brings the results that lines read.

    Figures are made, but not saved, which takes most of the time.
    """
    (tmp_path / "options").symlink_to(small / "options")
    monkeypatch.setattr(pages, "save", lambda made, path: [Path(path)])

    def run(*words):
        done = call(*words)
        assert done.returncode == 0, done.stderr

    def prepare(lines):
        for name in dict.fromkeys(re.findall(r"results/(\w+)\.h5", lines)):
            experiment, made = f"options/{name}.opts", small / "results" / f"{name}.h5"
            if f"run {experiment}" not in lines and (small / experiment).exists():
                if not made.exists():
                    run("run", experiment, "-output_file", str(made))
                shutil.copy(made, tmp_path / "results")

    (tmp_path / "results").mkdir()
    return SimpleNamespace(run=run, prepare=prepare)


@pytest.mark.parametrize("page", dict.fromkeys(b.page for b in SHELL if not b.slow), ids=name_of)
def test_commands_run(scratch, page):
    """Those of one page after each other, in this process; with an echo for pgran in a shell."""
    for block in (block for block in SHELL if block.page == page and not block.slow):
        if ".vtu" in block.lines:
            pytest.importorskip("meshio")
        scratch.prepare(block.lines)
        lines = STAND_INS + made_small(block.lines)
        subprocess.run(["bash", "-euo", "pipefail", "-c", lines], check=True)
        for line in Path("words").read_text().splitlines():
            scratch.run(*shlex.split(line))


@pytest.mark.parametrize("page", dict.fromkeys(b.page for b in PYTHON), ids=name_of)
def test_snippets_run(scratch, page):
    """Those of one page after each other."""
    if "to_xarray" in TEXT[page]:
        pytest.importorskip("xarray")
    names = {}
    for block in (block for block in PYTHON if block.page == page):
        code = compile(made_small(block.lines), block.name, "exec")
        scratch.prepare(block.lines)
        if not block.slow:
            exec(code, names)


def read_command(line):
    """Raise unless a command is one that there is, with files and options that there are."""
    words = [word for word in shlex.split(line) if not re.fullmatch(r"\w+=.*", word)]
    if words[0] == "mpirun":
        assert words[1] == "-n"
        del words[:3]
    while words[0] in ("bash", "python", "sbatch") or words[0].startswith("--"):
        del words[0]
    if words[0] != "pgran":
        assert (ROOT / words[0]).is_file(), line
        if words[0].endswith(".sbatch"):
            resolve(read_file(ROOT / words[1]) + read_words(words[2:4]))  # of a study one value
    elif words[1] == "run":
        files, rest = files_first(words[2:])
        resolve(read_files([ROOT / file for file in files]) + read_words(rest))
    else:
        assert words[1] in COMMANDS, line


@pytest.mark.parametrize("block", [b for b in SHELL if b.slow], ids=lambda b: b.name)
def test_slow_commands_are_possible(block, monkeypatch):
    monkeypatch.chdir(ROOT)
    for line in block.lines.replace("\\\n", " ").splitlines():
        read_command(line)


@pytest.mark.parametrize("path", PAGES, ids=name_of)
def test_nothing_vanishes_on_a_forge(path):
    """Which takes <A> for HTML, unless it is code."""
    prose = re.sub(r"`[^`]*`", "", BLOCK.sub("", TEXT[path]))
    assert re.findall(r"</?\w[^>]*>", prose) == []


@pytest.mark.parametrize("path", PAGES, ids=name_of)
def test_what_is_named_exists(path, monkeypatch):
    """In the midst of sentences: commands, files, options, pages."""
    monkeypatch.chdir(ROOT)
    prose = BLOCK.sub("", TEXT[path])
    spans = [" ".join(span.split()) for span in re.findall(r"`([^`]+)`", prose)]
    for span in spans:
        if re.match(r"(mpirun -n \d |pgran run options|bash jobs|python tests)", span):
            read_command(span.split(" [")[0])
        if re.fullmatch(r"(options|jobs|tests|pgran)/[\w./]+", span):
            assert (ROOT / span).exists(), span
        if key := re.match(r"-([a-z]+_\w+)", span):
            known = key[1] in OPTIONS or key[1].startswith("plot_") or span.endswith("_*")
            solver = solver_keys.is_solver_key(key[1]) or solver_keys.is_petsc_key(key[1])
            assert known or solver or key[1].endswith("_"), span
        if topic := re.match(r"pgran manual ([a-z]\w*)", span):
            assert topic[1] in manual.topics() or any(manual.found(topic[1]))
    for target in re.findall(r"\]\(([^)]+)\)", prose):
        assert (path.parent / target).exists(), target


def test_all_experiments_are_named():
    page = TEXT[FOLDER / "experiments.md"]
    paths = sorted((ROOT / "options").glob("*.opts"))
    assert [p for p in paths if f"`{p.relative_to(ROOT).as_posix()}`" not in page] == []


def test_tables_are_those_of_the_program():
    """As `bash jobs/manual.sh` writes them."""
    for page, lines in runpy.run_path(ROOT / "jobs" / "tables.py")["TABLES"].items():
        assert TEXT[FOLDER / f"{page}.md"].endswith("\n".join(["\n", *lines()]).rstrip() + "\n")


@pytest.mark.parametrize("group", catalogue.RECORDS)
def test_all_that_a_result_holds_has_a_meaning(group):
    """Each name stands in the list of its group on the page, which is as wide as a terminal."""
    kind, page = catalogue.record_kind(group), TEXT[FOLDER / "results.md"]
    parts = [item.metadata["part"] for item in dataclasses.fields(kind) if "part" in item.metadata]
    for each in (kind, *parts):
        place = f"/{each.within}/{each.group}" if each.within else f"/{each.group}"
        listed = page.partition(f"## {place}\n")[2].partition("\n## ")[0]
        for item in dataclasses.fields(each):
            if "part" not in item.metadata:
                assert item.metadata["long_name"], item.name
                assert re.search(rf"^{item.name}\*? +\S", listed, re.MULTILINE), item.name
    assert max(map(len, page.splitlines())) <= 100


def test_all_that_a_file_says_of_its_run_is_named(scratch):
    scratch.prepare("results/response.h5")
    said = pgran.load("results/response.h5").attributes
    assert [name for name in said if f"`{name}`" not in TEXT[FOLDER / "results.md"]] == []


def test_the_readme_is_short():
    assert len(TEXT[ROOT / "README.md"].splitlines()) <= 150
    assert max(path.stat().st_size for path in FOLDER.glob("*.png")) < 80_000


def test_topics_are_the_pages():
    assert {path.stem for path in PAGES if path.parent == FOLDER} == {*manual.topics(), "README"}
    package_data = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    assert package_data["package-data"]["pgran"] == ["manual/*", "options/**/*"]


def test_a_page_is_shown(call):
    assert call("manual", "developing").stdout == manual.page("developing")
    listed = call("manual").stdout
    assert all(f"  {name} " in listed for name in manual.topics())
    for topic, said in (
        ("acuracy", "no page is, or holds, acuracy; see accuracy"),
        ("zzz", "pgran manual lists the pages"),
    ):
        done = call("manual", topic)
        assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
        assert said in done.stderr


def test_words_are_looked_for(call):
    """The definition of a name comes first, then what is said of it; all words, in either case."""
    place, line, *_ = call("manual", "PHASE_SLOPE").stdout.splitlines()
    assert (place, line.split()[0]) == ("results: /response", "phase_slope")
    assert call("manual", "/green").stdout.startswith("results: /green\n")
    assert "solvers: Watch it\n" in call("manual", "-steady_ksp_view").stdout
    assert call("manual", "cite").stdout.startswith("changes: Citing, licence\n")  # not: excites
    for found in call("manual", "sound", "lammps").stdout.splitlines()[:16:2]:
        page = manual.page(found.partition(":")[0]).lower()
        assert page.count("sound") * page.count("lammps")


@pytest.mark.parametrize("topic", manual.topics())
def test_a_page_fits_a_terminal(topic):
    """All but code and formulas; nothing is lost but blanks and the rules below heads of tables."""
    page = manual.page(topic)
    text = manual.fitted(page, 80)
    prose = re.sub(r"^```.*?^```$", "", text, flags=re.DOTALL | re.MULTILINE)
    lines = [line for line in prose.splitlines() if len(line) > 80]
    assert [line for line in lines if not line.startswith(("    ", "- [", "#"))] == []
    words = re.findall(r"[^\s|]+", re.sub(r"^\|[-|]+$", "", page, flags=re.MULTILINE))
    assert [word for word in words if word not in text] == []


def test_a_pager_on_a_terminal_only(call, clean_environment, monkeypatch):
    pager = {"PAGER": "sed s/^/paged:/", "TERM": "xterm", "MANPAGER": ""}
    for name, value in pager.items():
        monkeypatch.setenv(name, value)
    assert call("manual", "curve").stdout.startswith("# The curve")
    master, slave = pty.openpty()
    shown = subprocess.Popen(
        [sys.executable, "-m", "pgran", "manual", "curve"], stdin=slave, stdout=slave,
        env=clean_environment | pager | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    os.close(slave)
    said = b""
    while not said.startswith(b"paged:# The curve") and (more := os.read(master, 4096)):
        said += more
    shown.terminate()
    shown.wait(timeout=60)
    os.close(master)
    assert said.startswith(b"paged:# The curve")


def test_formats_of_files_are_told():
    newest, kind = {}, None
    for name, version in re.findall(r"^\| (\w*) ?\| (\d) \|", manual.page("changes"), re.MULTILINE):
        kind = name or kind
        newest[kind] = int(version)
    assert newest == {"result": file.FORMAT_VERSION, "network": network_file.FORMAT_VERSION}


def test_what_to_cite(call, start):
    """All that PETSc says of a run with MUMPS and of modes, and pgran's own version."""
    text = call("cite").stdout
    assert f"Version {pgran.__version__}" in text
    assert "cond-mat/9301032" in text
    small = "-lattice_shape 6,5 -citations -output_file"
    mumps = "-sweep_method points -steady_pc_type lu -steady_pc_factor_mat_solver_type mumps"
    words = [*mumps.split(), *small.split()]
    found = start("run", "a.opts", *words, "a.h5").stdout
    modes = str(ROOT / "options" / "modes.opts")
    found += start("run", modes, "-modes_detectors", "2,3", *small.split(), "b.h5").stdout
    keys = re.findall(r"^@\w+\{([\w-]+),", found, re.MULTILINE)
    assert {"petsc-user-ref", "MUMPS01", "slepc-toms"} <= {*keys}
    assert [key for key in keys if f"{{{key}," not in text] == []
