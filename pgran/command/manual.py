"""`pgran manual` and `pgran cite`: the pages of the manual, and what to cite."""

import pydoc
import re
import shutil
import sys
import textwrap
from pathlib import Path

import pgran
from pgran.arguments import nearest
from pgran.command.words import Parser
from pgran.errors import DONE, InputError

PAGES = Path(__file__).parents[1] / "manual"
LISTED = re.compile(r"- \[(\w+)\]\(\1\.md\): (.+)")
SECTION = re.compile(r"^##? ([A-Z/].*)\n((?:(?!^##? [A-Z/]).*\n)*)", re.MULTILINE)
FEW = 8  # places of a word that are shown
HIDDEN = re.compile(r"<!--.*?-->\n?", re.DOTALL)  # as on a forge
CODE = re.compile(r"(^```.*?^```$)", re.DOTALL | re.MULTILINE)
TABLE = re.compile(r"^\|.*\n\|[-|]+\n(?:\|.*\n)+", re.MULTILINE)
PARAGRAPH = re.compile(r"^(- )?(?!\|[ -])[^\s#].*(\n(?!- |\|[ -]|[#\n]).+)*", re.MULTILINE)


def run(words):
    """Show a page of the manual, in a pager on a terminal, or where its pages hold a word.

    Without one it lists the pages.
    """
    examples = "pgran manual", "pgran manual accuracy", "pgran manual phase velocity"
    parser = Parser("manual", run.__doc__, *examples)
    parser.add_argument("words", metavar="WORD", nargs="*", help="a page, or words to look for")
    parser.read(words if {"-h", "--help", "-help"} & set(words) else [])
    sought = " ".join(words)  # keys with their dash, too
    if not sought:
        print("pgran manual PAGE shows one of these, pgran manual WORD where they hold a word:\n")
        print("".join(f"  {name:<12} {line}\n" for name, line in topics().items()), end="")
    elif sought in topics():
        text, width = page(sought), shutil.get_terminal_size().columns
        pydoc.pager(fitted(text, width) if sys.stdout.isatty() else text)
    else:
        print("\n".join(found(sought)))
    return DONE


def cite(words):
    """Say how to cite pgran, the paper whose model it computes, and the libraries it stands on."""
    Parser("cite", cite.__doc__, "pgran cite").read(words)
    print((PAGES / "CITATION").read_text("utf-8").replace("VERSION", pgran.__version__), end="")
    return DONE


def topics():
    """Return what each page is about, by its name, in the order of the manual."""
    return dict(LISTED.findall((PAGES / "README.md").read_text(encoding="utf-8")))


def page(topic):
    """Return a page of the manual, Markdown."""
    return HIDDEN.sub("", (PAGES / f"{topic}.md").read_text(encoding="utf-8"))


def fitted(text, width):
    """Return a page whose paragraphs fit a width; the rows of wider tables are paragraphs, too."""

    def fill(paragraph, indent="  "):
        return textwrap.fill(
            " ".join(paragraph.split()), width, subsequent_indent=indent,
            break_long_words=False, break_on_hyphens=False,
        )  # fmt: skip

    def rows(table):
        if max(map(len, table[0].splitlines())) <= width:
            return table[0]
        lines = [line.strip("| ") for line in table[0].splitlines() if line.strip("|-")]
        return "".join(f"{fill(line, '    ')}\n" for line in lines)

    parts = CODE.split(text)  # prose, code, prose, ...
    for place in range(0, len(parts), 2):
        part = PARAGRAPH.sub(lambda each: fill(each[0], "  " * bool(each[1])), parts[place])
        parts[place] = TABLE.sub(rows, part)
    return "".join(parts)


def found(sought):
    """Yield the sections that hold all words sought, best first, with the line that holds most.

    A word is found where one begins so.
    """
    words, places = sought.lower().split(), []
    for name in topics():
        for heading, text in SECTION.findall(page(name)):
            if all(_held([word], f"{heading} {text}") for word in words):
                lines = [line for line in text.splitlines() if line and "```" not in line]
                line = max(lines, key=lambda line: _held(words, line), default="")
                at = line.lower().find(words[0])
                whole = _held([" ".join(words)], " ".join(text.split())) > 0
                rank = (
                    _held(words, heading), whole, _held(words, line), 0 <= at < 5,
                    _held(words, text),
                )  # fmt: skip
                begin = 0 if at < 60 else line.rfind(" ", 0, at - 30) + 1
                places.append((rank, f"{name}: {heading}\n    {line[begin : begin + 96].strip()}"))
    if not places:
        near = nearest(sought, topics())
        hint = f"see {near}" if near else "pgran manual lists the pages"
        raise InputError(f"manual: no page is, or holds, {sought}; {hint}")
    places.sort(key=lambda place: place[0], reverse=True)
    yield from (place for _, place in places[:FEW])
    if len(places) > FEW:
        yield f"and {len(places) - FEW} sections more"


def _held(words, text):
    """Return how often a text holds words, or others that begin so."""
    text = text.lower()
    return sum(len(re.findall(f"(?<![a-z0-9]){re.escape(word)}", text)) for word in words)
