"""What may have been meant by a word that is no command, or by a file that is not there."""

from pathlib import Path

from pgran.errors import FileError
from pgran.run.options import nearest


def command(word, commands):
    """Return in words which command may have been meant."""
    drawn = {".opts": f"run {word}", ".h5": f"plot {word}"}.get(Path(word).suffix)
    near = drawn or nearest(word, [*commands, "--help", "--version"])
    return f"did you mean pgran {near}?" if near else "pgran --help lists them"


def read(path):
    """Return what an options file gives; where there is none, name one that is called alike."""
    from pgran.run.reading import read_file

    try:
        return read_file(path)
    except FileError as error:
        folders = [] if Path(path).exists() else (Path(path).parent, Path("options"))
        files = {each.stem: each for folder in folders for each in folder.glob("*.opts")}
        near = nearest(Path(path).stem, sorted(files))
        raise FileError(f"{error}; did you mean {files[near]}?" if near else error) from None
