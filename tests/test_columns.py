"""Columns of numbers in text files: motions and measurements, and what is refused."""

import pytest

from pgran.errors import FileError
from pgran.store.text import read_columns, read_measured


def test_columns_of_a_file(written):
    """Comments, empty lines, a mark of the encoding, any of three separators."""
    content = "\ufeff# t u\n0, 1\n\n 1;2 # note\n2\t3e-1\n"
    assert read_columns(written(content)).tolist() == [[0, 1], [1, 2], [2, 0.3]]


@pytest.mark.parametrize(
    "text",
    [
        "0.4 2.0 -1\n0.8 0.5 -2\n",
        "\ufeffomega,amplitude,phase\n0.4,2,-1\n0.8,.5,-2\n",
        "# of 1992\n'Phase';'Omega';'Amplitude'\n-1;.4;2 # first\n\n-2;.8;5e-1\n",
    ],
)
def test_measurements(written, text):
    columns = {name: column.tolist() for name, column in read_measured(written(text)).items()}
    assert columns == {"omega": [0.4, 0.8], "amplitude": [2, 0.5], "phase": [-1, -2]}


COLUMNS = {  # text -> what is said of it
    "0\n1\n\n# end\n2 three\n": "a.txt:5: '2 three' is no number; begin comments with #",
    "0 0\n1\n": "a.txt:2: numbers: 1; each line has one, or a time and one",
    "0 0 0\n": "a.txt:1: numbers: 3",
    "0\nnan\n1\n": "a.txt:2: 'nan' is not finite; fill the gap",
    "0,1\n1,1e999": "a.txt:2: '1,1e999' is not finite",
    "# nothing\n\n": "a.txt: holds no numbers",
}
MEASURED = {
    "omega,amplitude\n1,2\n3\n": "a.txt:3: numbers: 1; each line has frequency, amplitude and",
    "1 2\n1 2 3\n": "a.txt:2: numbers: 3",
    "1\n2\n": "a.txt:1: numbers: 1",
    "omega amplitude\n1 2 3\n": "a.txt:2: numbers: 3",
    "f,A\n1,2\n": "a.txt:1: a header names frequency, amplitude and maybe",
    "omega amplitude omega\n1 2 1\n": "a.txt:1: a header names",
    "omega amplitude\n": "a.txt: holds no numbers",
    "": "a.txt: holds no numbers",
    "1 2\n2 x\n": "a.txt:2: '2 x' is no number",
    "1 2\n2 inf\n": "a.txt:2: '2 inf' is not finite",
    "1 2\n0 1\n": "a.txt:2: omega 0 is not > 0",
    "amplitude omega\n1 2\n-3 1\n": "a.txt:3: amplitude -3 is not > 0",
}
REFUSED = [(read, *case) for read, cases in ((read_columns, COLUMNS), (read_measured, MEASURED))
           for case in cases.items()]  # fmt: skip


@pytest.mark.parametrize(("read", "text", "said"), REFUSED)
def test_files_that_are_refused(written, read, text, said):
    with pytest.raises(FileError) as refused:
        read(written(text, "a.txt"))
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)
