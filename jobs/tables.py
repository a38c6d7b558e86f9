"""What ends pages on options, solvers, files and results, as `bash jobs/manual.sh` writes it."""

import dataclasses
import inspect
import re
import textwrap
from pathlib import Path

from pgran.catalogue import RECORDS, record_kind
from pgran.command.listing import HEADINGS, OPTIONS_FILES, heading_of
from pgran.command.resolve import SCENES, options_of, scene_option
from pgran.run.keys import SOLVERS
from pgran.run.options import text_of

MANUAL = Path(__file__).parents[1] / "pgran" / "manual"
WIDTH = 80  # of a terminal


def options():
    """Yield all options; one that means something else in another scene has all its meanings."""
    same = {}
    for option in (scene_option(), *(o for scene in SCENES for o in options_of(scene).values())):
        same.setdefault(option.name, {})[option] = None
    names = [name for heading in HEADINGS for name in same if heading_of(name) == heading]
    yield from ("| key | default | meaning |", "|---|---|---|")
    for name in names:
        first, *_ = same[name]
        default = "" if first.default is None else text_of(first.default)
        yield f"| `-{name}` | {default} | {'; '.join(map(_meaning, same[name]))} |"


def solvers():
    """Yield the prefixes of solvers."""
    yield from ("| prefix | PETSc's and SLEPc's options of |", "|---|---|")
    for prefix, (of, _) in SOLVERS.items():
        yield f"| `-{prefix}*` | {of} |"


def _meaning(option):
    """Return what an option means, its choices unless that names them, and its unit."""
    meaning = option.meaning
    if not all(choice in meaning for choice in option.choices):
        meaning += f": {', '.join(f'`{choice}`' for choice in option.choices)}"
    return meaning + (f" ({option.unit})" if option.unit else "")


def files():
    """Yield the files of solvers and of extremes: the first sentence of each about itself."""
    for folder in ("solvers", "extreme"):
        yield from (f"| file of `options/{folder}/` | what it is |", "|---|---|")
        for path in sorted((OPTIONS_FILES / folder).glob("*.opts")):
            text = path.read_text("utf-8").removeprefix("# ").replace("\n#", "")
            first = re.split(r"\.\s", text)[0]
            yield f"| `options/{folder}/{path.name}` | {first} |"
        yield ""


def results():
    """Yield what each group of a result holds: the docstrings and declarations of its record."""
    for kind in map(record_kind, RECORDS):
        yield from _group(kind, f"/{kind.group}")


def _group(kind, name):
    """Yield a group as a block of lines that fit a terminal, and then those within it."""
    about = (textwrap.fill(part, WIDTH) for part in inspect.getdoc(kind).split("\n\n"))
    yield from (f"## {name}", "", "```text", *"\n\n".join(about).splitlines(), "")
    parts = [item for item in dataclasses.fields(kind) if "part" in item.metadata]
    own = [item for item in dataclasses.fields(kind) if item not in parts]
    for item in sorted(own, key=lambda item: "axes" not in item.metadata):  # arrays first
        said = item.metadata
        axes = ", ".join(said.get("along", ()) or said.get("axes", ()))
        facts = ["attribute" * ("axes" not in said), f"({axes})" * bool(axes)]
        facts += [{str: "text", complex: "complex"}.get(said.get("dtype"), "")]
        facts = ", ".join(filter(None, [*facts, said["units"] * (said["units"] != "1")]))
        text = f"{item.name + '*' * said['optional']:<26}{said['long_name']} [{facts}]"
        yield from textwrap.wrap(text.replace(" []", ""), WIDTH, subsequent_indent=" " * 26)
    yield from ("```", "")
    for inner in (item.metadata["part"] for item in parts):
        yield from _group(inner, f"{name}/{inner.group}")


TABLES = {"options": options, "solvers": solvers, "files": files, "results": results}

if __name__ == "__main__":
    for name, table in TABLES.items():
        page, lines = MANUAL / f"{name}.md", [*table()]
        text, _, _ = page.read_text().partition(f"\n{lines[0]}\n")
        page.write_text("\n".join([text, *lines]).strip() + "\n")
