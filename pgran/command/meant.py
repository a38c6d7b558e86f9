"""What may have been meant by a word that is no command, or no options file."""

from pathlib import Path

from pgran.errors import FileError
from pgran.run.options import nearest


def command(word, commands):
    """Return in words which command may have been meant. Not collective."""
    for ending, name in ((".opts", "run"), (".h5", "plot")):
        if word.endswith(ending):
            return f"did you mean pgran {name} {word}?"
    near = nearest(word, [*commands, "--help", "--version"])
    for path in sorted(Path("options").glob(f"{word}*.opts"))[:1]:
        near = f"run {path}"
    return f"did you mean pgran {near}?" if near else "pgran --help lists them"


def read(path):
    """Return what an options file gives.

    Not collective.

    Raises
    ------
    FileError, InputError
        As `pgran.run.reading.read_file`; it says what may have been meant.
    """
    from pgran.run.reading import read_file

    try:
        return read_file(path)
    except FileError as error:
        hint = _file(Path(path))
        raise FileError(f"{error}; {hint}" if hint else error) from None


def _file(path):
    """Return what may have been meant by the name of what is no options file, or None."""
    from pgran.command.listing import FILES
    from pgran.command.resolve import SCENES

    if path.is_file():
        return f"pgran plot {path} draws a result" if path.suffix == ".h5" else None
    if path.is_dir():
        return f"pgran run takes one options file, {path}/NAME.opts"
    folders = (path.parent, Path("options"))
    files = {each.stem: each for folder in folders for each in folder.glob("*.opts")}
    if near := nearest(path.stem, sorted(files)):
        return f"did you mean {files[near]}?"
    if (FILES / path.name).is_file():
        return f"pgran options --copy {path.parent} copies that of pgran"
    if path.name in SCENES:
        return f"{path} is a scene; pgran run takes an options file that says -scene {path}"
    return None
