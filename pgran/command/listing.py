"""`pgran options`: every option of one scene, or of all, under headings, within 80 columns.

And `pgran options --copy`: the options files that come with pgran, where there is no clone of it.
"""

import re
import shlex
import shutil
import textwrap
from pathlib import Path

from pgran.command.resolve import SCENES, options_of, scene_option
from pgran.command.words import WIDTH, Parser
from pgran.errors import DONE, FileError, InputError
from pgran.run import keys as solver_keys
from pgran.run.options import text_of
from pgran.store.paths import writing

OPTIONS_FILES = Path(__file__).parents[1] / "options"
NAMED = re.compile(r"^(#?-\w+ )(options/.*)$", re.MULTILINE)  # values of options that are files
OWN = "what the scene does"
# What options are about, by what their names begin with; all others are a scene's own.
HEADINGS = {
    "the sample": ("lattice_", "bonds_", "network_"),
    "detectors and sweep": ("detectors", "sweep_"),
    OWN: (),
    "accuracy and solvers": ("error_", "steady_"),
    "output and run": ("output_", "units_", "ranks_", "dry_run"),
}


def list_options(words):
    """List every option of one scene, or of all: type, unit, range, default, meaning."""
    examples = "pgran options", "pgran options response", "pgran options --copy options"
    parser = Parser("options", list_options.__doc__, *examples)
    scenes = ", ".join(SCENES)
    parser.add_argument("scene", metavar="SCENE", nargs="?", type=scene_option().read, help=scenes)
    copies = "copy the options files of pgran into a folder"
    parser.add_argument("--copy", metavar="DIR", type=Path, help=copies)
    asked = parser.read(words)
    if asked.copy is not None:
        copy_files(asked.copy)
        print(f"to run one of them: pgran run {shlex.quote(str(asked.copy / 'response.opts'))}")
    else:
        print(describe_options(asked.scene), end="")
    return DONE


def copy_files(folder):
    """Copy the options files, and what they name, into a folder, whose files they name then."""
    if "," in str(folder):  # which ends a name in a list
        raise InputError(f"--copy {folder}: has a comma, which ends a name in a list; take another")
    sources = [path for path in sorted(OPTIONS_FILES.rglob("*")) if path.is_file()]
    targets = [folder / path.relative_to(OPTIONS_FILES) for path in sources]
    for target in filter(Path.exists, targets):
        raise FileError(f"{target}: exists already; nothing was copied")

    def named_there(line):
        return line[1] + shlex.quote(line[2].replace("options/", f"{folder}/"))

    with writing(folder):
        for source, target in zip(sources, targets, strict=True):
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, target)
            if target.suffix == ".opts":
                target.write_text(NAMED.sub(named_there, source.read_text("utf-8")))


def describe_options(scene=None):
    """Return a table of the options of one scene, or of all."""
    names = [scene] if scene else SCENES
    options = dict.fromkeys(option for name in names for option in options_of(name).values())
    lines = [_row("key", "default", "unit", "type and range")]
    lines += describe(scene_option())
    for heading in HEADINGS:
        below = [option for option in options if heading_of(option.name) == heading]
        users = [users_of(option, scene) for option in below]
        same = users[0] if len(set(users)) == 1 and users[0] else None  # said once
        if below:
            lines += ["", heading + (f" ({same})" if same else "")]
        for option, who in zip(below, users, strict=True):
            lines += describe(option, "" if same else who)
    lines += ["", "PETSc's and SLEPc's options of these solvers"]
    for prefix, (what, _) in solver_keys.SOLVERS.items():
        lines += _filled(f"{f'-{prefix}*':<20} {what}", 2, 23)
    if scene:
        everywhere = dict.fromkeys(name for each in SCENES for name in options_of(each))
        others = [name for name in everywhere if name not in options_of(scene)]
        unused = [f"-{name}" for name in others if heading_of(name) != OWN]
        if unused:
            lines += ["", f"not used by {scene}", *_filled(", ".join(unused), 2)]
    return "\n".join(lines) + "\n"


def describe(option, users=""):
    """Return the lines of an option; `users` says which scenes use it, if not all do."""
    default = "" if option.default is None else text_of(option.default)
    facts = f"{option.kind.name} {option.range().replace(' and ', ', ')}"
    lines = [_row(f"-{option.name}", default, option.unit, facts)]
    if len(lines[0]) > WIDTH:  # of a long default
        lines = [_row(f"-{option.name}", default, "", ""), _row("", "", option.unit, facts)]
    lines += _filled(option.meaning, 6)
    if option.choices:
        lines += _filled(f"choices: {', '.join(option.choices)}", 6)
    return lines + _filled(users, 6)


def heading_of(name):
    """Return the heading that an option stands under."""
    return next((h for h, begins in HEADINGS.items() if begins and name.startswith(begins)), OWN)


def users_of(option, scene=None):
    """Return in words which scenes use an option, or which experiments that a scene repeats.

    Nothing where all do.
    """
    of = options_of(scene).get(f"{scene}_of") if scene else None
    if scene and of is None:
        return ""
    possible = of.choices if of else SCENES
    users = [name for name in possible if options_of(name).get(option.name) == option]
    if not users or len(users) == len(possible):
        return ""
    if len(users) > len(possible) / 2:
        return f"not of {', '.join(name for name in possible if name not in users)}"
    return f"only of {', '.join(users)}"


def _row(key, default, unit, facts):
    """Return a line of the table."""
    return f"{f'  {key:<20} {default}':<32} {unit:<20} {facts}".rstrip()


def _filled(text, indent, later=None):
    """Return a text in lines of at most 80 characters, whole words, maybe of a later indent."""
    margin, others = " " * indent, " " * (indent if later is None else later)
    indents = {"initial_indent": margin, "subsequent_indent": others}
    return textwrap.wrap(text, WIDTH, **indents, break_on_hyphens=False)
