"""Columns of numbers in text files: motions and measurements, and what is refused."""

import pytest

from pgran.errors import FileError
from pgran.store.columns import read_columns, read_measured


def test_columns_of_a_file(written):
    """Comments, empty lines, a mark of the encoding, any of three separators."""
    content = "\ufeff# t u\n0, 1\n\n 1;2 # note\n2\t3e-1\n"
    assert read_columns(written(content)).tolist() == [[0, 1], [1, 2], [2, 0.3]]


@pytest.mark.parametrize(
    ("read", "text", "said"),
    [
        (
            read_columns,
            "0\n1\n\n# end\n2 three\n",
            "a.txt:5: '2 three' is no number; begin comments with #",
        ),
        (read_columns, "0 0\n1\n", "a.txt:2: 1 numbers; each line has one, or a time and one"),
        (read_columns, "0 0 0\n", "a.txt:1: 3 numbers"),
        (read_columns, "0\nnan\n1\n", "a.txt:2: 'nan' is not finite; fill the gap"),
        (read_columns, "0,1\n1,1e999", "a.txt:2: '1,1e999' is not finite"),
        (read_columns, "# nothing\n\n", "a.txt: holds no numbers"),
        (
            read_measured,
            "omega,amplitude\n1,2\n3\n",
            "a.txt:3: 1 numbers; each line has omega, amplitude and",
        ),
        (read_measured, "1 2\n1 2 3\n", "a.txt:2: 3 numbers"),
        (read_measured, "1\n2\n", "a.txt:1: 1 numbers"),
        (read_measured, "omega amplitude\n1 2 3\n", "a.txt:2: 3 numbers"),
        (read_measured, "f,A\n1,2\n", "a.txt:1: a header names omega, amplitude and maybe phase"),
        (read_measured, "omega amplitude omega\n1 2 1\n", "a.txt:1: a header names"),
        (read_measured, "omega amplitude\n", "a.txt: holds no numbers"),
        (read_measured, "", "a.txt: holds no numbers"),
        (read_measured, "1 2\n2 x\n", "a.txt:2: '2 x' is no number"),
        (read_measured, "1 2\n2 inf\n", "a.txt:2: '2 inf' is not finite"),
        (read_measured, "1 2\n0 1\n", "a.txt:2: omega 0 is not > 0"),
        (read_measured, "amplitude omega\n1 2\n-3 1\n", "a.txt:3: amplitude -3 is not > 0"),
    ],
)
def test_files_that_are_refused(written, read, text, said):
    with pytest.raises(FileError) as refused:
        read(written(text, "a.txt"))
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)
