"""The tables of the pages on options, solvers and files, as `bash jobs/manual.sh` writes them."""

import re
from pathlib import Path

from pgran.command.listing import HEADINGS, OPTIONS_FILES, heading_of
from pgran.command.resolve import SCENES, options_of, scene_option
from pgran.run.keys import SOLVERS
from pgran.run.options import text_of

MANUAL = Path(__file__).parents[1] / "pgran" / "manual"


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


TABLES = {"options": options, "solvers": solvers, "files": files}

if __name__ == "__main__":
    for name, lines in TABLES.items():
        page = MANUAL / f"{name}.md"
        text, _, _ = page.read_text().partition("\n| ")
        page.write_text("\n".join([text, *lines()]).strip() + "\n")
