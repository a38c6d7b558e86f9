"""The lines of each room are within its budget: a table, a line a room."""

from pathlib import Path

import pytest

HOUSE = Path(__file__).parents[1]
BUDGETS = {  # lines of Python, docstrings and blank ones too
    "pgran": 25000,
    "pgran/*.py": 300,
    "pgran/run": 1550,
    "pgran/command": 1560,
    "pgran/store": 900,
    "pgran/medium": 3250,
    "pgran/driven": 2500,
    "pgran/balance": 1050,
    "pgran/foreign": 720,
    "pgran/draw": 1060,
    "pgran/experiments/accuracy": 400,
    "pgran/experiments/continuum": 300,
    "pgran/experiments/ensemble": 1850,
    "pgran/experiments/green": 250,
    "pgran/experiments/likeness": 340,
    "pgran/experiments/modes": 2550,
    "pgran/experiments/pulse": 1350,
    "pgran/experiments/relaxation": 930,
    "pgran/experiments/response": 1450,
    "pgran/experiments/sensitivity": 1750,
    "pgran/experiments/structure": 520,
    "tests": 15500,
}


@pytest.mark.parametrize("room", BUDGETS)
def test_a_room_is_within_its_budget(room):
    files = HOUSE.glob(room) if "*" in room else (HOUSE / room).rglob("*.py")
    lines = sum(len(path.read_text().splitlines()) for path in files)
    assert lines <= BUDGETS[room], (
        f"{room} has {lines} lines, {lines - BUDGETS[room]} above its budget: what is new pays "
        "with something that goes, or raises its line of this table in the same commit"
    )


def test_every_room_has_a_budget():
    for folder in (HOUSE / "pgran", HOUSE / "pgran" / "experiments"):
        rooms = {path.parent for path in folder.glob("*/__init__.py")}
        rooms = {str(room.relative_to(HOUSE)) for room in rooms} - {"pgran/experiments"}
        assert rooms <= BUDGETS.keys(), "a new room has a line in the table"
