"""`pgran manual` and `pgran cite`: the pages of the manual, and what to cite."""

import pydoc
import re
from pathlib import Path

import pgran
from pgran.arguments import nearest
from pgran.command.words import Parser
from pgran.errors import DONE, InputError

PAGES = Path(__file__).parents[1] / "manual"
LISTED = re.compile(r"- \[(\w+)\]\(\1\.md\): (.+)")
HIDDEN = re.compile(r"<!--.*?-->\n?", re.DOTALL)  # as on a forge


def run(words):
    """Show a page of the manual, in a pager on a terminal; without a topic list the topics."""
    parser = Parser("manual", run.__doc__, "pgran manual", "pgran manual accuracy")
    parser.add_argument("topic", metavar="TOPIC", nargs="?", help="a page; pgran manual lists them")
    topic = parser.read(words).topic
    if topic is None:
        print("pgran manual TOPIC shows one of these:\n")
        print("".join(f"  {name:<12} {line}\n" for name, line in topics().items()), end="")
    else:
        pydoc.pager(HIDDEN.sub("", page(topic)))
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
    if topic not in topics():
        about = (name for name, line in topics().items() if topic.lower() in line.lower())
        near = nearest(topic, topics()) or next(about, None)
        hint = f"see {near}" if near else "pgran manual lists the topics"
        raise InputError(f"manual: there is no topic {topic}; {hint}")
    return (PAGES / f"{topic}.md").read_text(encoding="utf-8")
