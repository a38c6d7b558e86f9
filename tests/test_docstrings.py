"""Every public function shows itself: an example that runs as it stands, and types of arguments."""

import doctest
import inspect

import numpy as np
import pytest

import pgran

ERRORS = {"InputError", "PgranError"}
PUBLIC = sorted(set(pgran.__all__) - ERRORS)


@pytest.mark.parametrize("name", PUBLIC)
def test_examples_run_as_they_stand(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = doctest.DocTestFinder(exclude_empty=True).find(
        getattr(pgran, name), name, globs={"pgran": pgran, "np": np}
    )
    examples = [test for test in found if test.examples]
    assert examples, f"pgran.{name} has no example"
    said = []
    for test in examples:
        doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(test, out=said.append)
    assert not said, "".join(said)


@pytest.mark.parametrize("name", PUBLIC)
def test_arguments_have_types(name):
    """Those of options are said by their declarations; crew and solver are the same everywhere."""
    public, empty = getattr(pgran, name), inspect.Parameter.empty
    signature, declared = inspect.signature(public), getattr(public, "declared", {})
    own = [p for p in signature.parameters.values() if p.name not in {"crew", "solver", *declared}]
    bare = [p.name for p in own if p.annotation is empty and p.default in (empty, None)]
    assert not bare, f"pgran.{name}: {', '.join(bare)}"
    assert inspect.isclass(public) or signature.return_annotation is not empty
