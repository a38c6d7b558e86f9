"""Studies and tables: a run for each value of an option, and their numbers beside each other."""

import os

import numpy as np
import pytest

import pgran
from pgran import errors
from pgran.command import study
from pgran.command.resolve import resolve
from pgran.command.table import in_words
from pgran.errors import FileError
from pgran.run.options import read_words
from pgran.store import file as store
from pgran.store.record import Result

WORDS = "a.opts", "b.opts", "-sweep_omega", ".4", "-lattice_damping"
VALUES = ".01", ".1", "1e-3"


def test_a_study_is_its_single_runs(start, place, shared_path, call):
    """By parts or as a whole; one that fails stops no other, what is done is left as it is."""
    place("b.opts", "-sweep_method points")
    paths = [f"results/a-damping_{value}.h5" for value in VALUES]
    done = start("study", *WORDS, *VALUES, SLURM_ARRAY_TASK_ID="2")
    assert (done.returncode, done.stdout) == (0, "")
    assert done.stderr.startswith(f"pgran: part 2 of 3, {paths[1]}\npgran: response of a 6 x 5")
    (shared_path / f"{paths[2]}.unfinished").mkdir()
    done = start("study", *WORDS, *VALUES, PGRAN_LAUNCH="mpirun -n 2")
    assert done.returncode == 4
    assert f"part 2 of 3, {paths[1]}: is there already\n" in done.stderr
    assert f"part 3 of 3, {paths[2]}: failed, with exit code 4\n" in done.stderr
    (shared_path / f"{paths[2]}.unfinished").rmdir()
    for words, variables, said in (
        ("", {"ranks": 2}, "study: starts ranks itself"),
        ("", {"PGRAN_LAUNCH": "nowhere -n 2"}, "PGRAN_LAUNCH: there is no nowhere"),
        ("", {"PGRAN_LAUNCH": "'"}, "PGRAN_LAUNCH: No closing quotation"),
        ("x", {}, "-lattice_damping x: needs a number"),
        ("-bonds_seed 1 2", {}, "has several values; here: -lattice_damping, -bonds_seed"),
        ("", {"SLURM_ARRAY_TASK_ID": "4"}, "the parts are 1 to 3"),
        ("-error_floor 0", {}, "was made with -error_floor 1e-20, and now it is -error_floor 0.0"),
        ("", {}, f"part 1 of 3, {paths[0]}: is there already"),
    ):
        done = start("study", *WORDS, *VALUES, *words.split(), **variables)
        assert said in done.stderr
    assert done.returncode == 0
    call("run", *WORDS, ".1", "-output_file", "alone.h5")
    *found, alone = [pgran.load(path) for path in [*paths, "alone.h5"]]
    assert [result.mpi_size for result in found] == [2, 1, 1]
    assert np.array_equal(found[1].response.displacement, alone.response.displacement)

    table = pgran.table([found[0], *paths[1:]])
    assert table.index.tolist() == ["1", *paths[1:]]
    assert table.lattice_damping.tolist() == [0.01, 0.1, 0.001]
    assert table.amplitude_2_3.tolist() == [each.response.amplitude[0, 0] for each in found]
    assert np.isnan(table.phase_velocity_2_3).all()
    assert "amplitude_2_3" in done.stdout
    assert "omega" not in done.stdout  # which is the same in all
    assert "amplitude" not in start("study", *WORDS, *VALUES, "-dry_run").stdout
    call("table", *paths, "--columns", "amplitude,seconds", "-o", "t.csv")
    head, *rows = (shared_path / "t.csv").read_text().splitlines()
    assert head == "result,lattice_damping,amplitude_2_3,failures,seconds"
    assert [float(row.split(",")[2]) for row in rows] == table.amplitude_2_3.tolist()
    assert "did you mean seconds?" in call("table", *paths, "--columns", "secnds").stderr
    assert "the name of a table ends in .csv" in call("table", *paths, "-o", "a.h5").stderr


def test_what_was_made_of_a_file_that_has_changed_since_is_refused(tmp_path):
    network, result = tmp_path / "a.h5", tmp_path / "b.h5"
    options = resolve(read_words(["-scene", "response", "-network_file", str(network)]))
    network.touch()
    facts = {"scene": "response", "status": "complete", "options": options.text()}
    store.write(result, facts, [])
    assert study._code_of_result(result, options) == errors.DONE
    os.utime(network, (0, result.stat().st_mtime + 1))
    with pytest.raises(FileError, match=f"made with an older {network}, and now it is a newer"):
        study._code_of_result(result, options)
    assert study._code_of_result(result, options.changed(output_overwrite=True)) is None
    os.utime(network, (0, 0))
    store.write(result, {**facts, "pgran_version": "1.0"}, [])
    with pytest.raises(FileError, match=r"made with pgran 1\.0, and now it is pgran"):
        study._code_of_result(result, options)


def test_a_table_tells_options_that_differ_in_their_digits_alone():
    results = [Result([], scene="a", options=f"-steady_ksp_rtol {x}") for x in ("1e-3", ".001")]
    told = in_words(pgran.table(results))
    assert told.splitlines()[1].startswith("result steady_ksp_rtol")
