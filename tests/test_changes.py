"""Files that change under a run: it goes on with what it began with, or not at all."""

import os
import signal

import h5py
import numpy as np
import pytest
import scipy
from campaigns import changes
from petsc4py import PETSc

from pgran.command import run as running
from pgran.command.resolve import SCENES, options_of
from pgran.run.journal import Journal
from pgran.run.options import FILE, FILES, TEXT

OPTIONS = dict(pair for scene in SCENES for pair in options_of(scene).items())
JOURNAL = "a.h5.unfinished"
LIBRARIES = {"NumPy": np.__version__, "SciPy": scipy.__version__}
LIBRARIES["PETSc"] = ".".join(map(str, PETSc.Sys.getVersion()))


def test_what_names_a_file_that_is_read_is_of_the_kind_whose_contents_count():
    """A text that may be any is where to write, or words: a file that is read has its own kind."""
    directions = {"drive_direction", "drive_force", "green_direction"}
    free = {n for n, o in OPTIONS.items() if o.kind == TEXT and not o.choices}
    assert free == {"output_file", "output_log", "drive_part", "lattice_free"} | directions
    read = {name for name, option in OPTIONS.items() if option.kind in (FILE, FILES)}
    assert read == {*changes.WRITERS} == {*map(changes.option_of, changes.SCENES)}


@pytest.fixture
def stopped(call, place, monkeypatch, world):
    """Return what runs a scene, or its last command again, which is stopped after one more unit."""
    write = Journal.write

    def stopping(*arguments):
        write(*arguments)
        os.kill(os.getpid(), signal.SIGUSR1)

    monkeypatch.setattr(Journal, "write", stopping)

    def run(scene, seed, *more):
        place("b.opts", changes.SCENES[scene].replace("FILE", "read"))
        place("read", changes.WRITERS[changes.option_of(scene)], np.random.default_rng(seed))
        words = ["-output_file", "a.h5", "-output_progress", "none", *more]
        return call("run", "b.opts", *words)

    return run


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("scene", {changes.option_of(s): s for s in changes.SCENES}.values())
def test_a_run_whose_file_has_changed_is_refused(stopped, shared_path, scene, world):
    """By the name of the option, and loses nothing: with the old file it goes on."""
    assert stopped(scene, 1).returncode == 75
    before = (shared_path / JOURNAL).read_bytes()
    refused = stopped(scene, 2)
    assert refused.returncode == 2
    assert f"-{changes.option_of(scene)}: {JOURNAL} holds an unfinished run" in refused.stderr
    assert (shared_path / JOURNAL).read_bytes() == before
    assert "going on from there" in stopped(scene, 1).stderr


@pytest.mark.usefixtures("here")
def test_a_dry_run_foretells_how_the_run_begins(stopped, shared_path, world):
    """It says what the run needs, and is refused by what refuses the run; nothing changes."""
    assert stopped("response", 1).returncode == 75
    before = (shared_path / JOURNAL).read_bytes()
    for seed, code, said in ((1, 0, "going on from there"), (2, 2, "holds an unfinished run")):
        dry = stopped("response", seed, "-dry_run")
        assert (dry.returncode, said in dry.stderr, "\nmemory " in dry.stdout) == (code, True, True)
    if world.rank == 0:
        (shared_path / "a.h5").touch()
    dry = stopped("response", 1, "-dry_run")
    assert (dry.returncode, "\nmemory " in dry.stdout) == (4, True)
    assert {path.name for path in shared_path.glob("*a.h5*")} == {"a.h5", JOURNAL}
    assert (shared_path / JOURNAL).read_bytes() == before


@pytest.mark.usefixtures("here")
def test_a_file_that_changes_while_it_is_read(stopped, shared_path, monkeypatch, world):
    """Between its checksum and the reader: the run ends before it keeps anything."""
    start = Journal.__enter__

    def changing(journal):
        if world.rank == 0:
            with h5py.File(shared_path / "read", "r+") as file:
                file["network/stiffness"][0] *= 2
        return start(journal)

    monkeypatch.setattr(Journal, "__enter__", changing)
    done = stopped("response", 1)
    assert done.returncode == 4
    assert "-network_file read" in done.stderr
    assert "has changed since the run started; start it again" in done.stderr
    assert not (shared_path / JOURNAL).exists()


def test_a_run_goes_on_with_the_libraries_that_it_began_with(stopped, monkeypatch):
    assert stopped("bonds", 1).returncode == 75
    identity = running._run_identity
    for name, version in LIBRARIES.items():
        changed = {name: "0.1"}
        monkeypatch.setattr(running, "_run_identity", lambda *of, c=changed: identity(*of) | c)
        done = stopped("bonds", 1)
        assert done.returncode == 2
        said = f"{name}: {JOURNAL} holds an unfinished run with {version}, and now it is 0.1; "
        assert said in done.stderr
    assert running._installed_version("no such package") == "unknown"
