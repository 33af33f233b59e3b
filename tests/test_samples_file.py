"""Files of samples: what is read, and how the rest is named."""

import pytest

from certrack.core.errors import InputError
from certrack.systems.samples_file import check_time_unit, read_samples

SAME = [
    b"0,0\n1,0.5\n2,-1.5e-1\n",
    b"\xef\xbb\xbf0;0\r\n1;0,5\r\n2;-1,5e-1\r\n",
    b"time [s]\ty\n0\t0\n1\t0,5\n2\t-0,15\n",
    b"# by hand\n\n0 0\n1 0.5 # a comment\n  2   -.15\n",
    b'"t";"y"\n"s";"rad"\n"0";"0";\n"1";"0,5";\n"2";"-0,15";\n',
    "0 0\n1 0,5\n2 -0,15\n".encode("utf-16"),
    b"0, 0\r1, 0.5\r2, -0.15",
]


@pytest.mark.parametrize("data", SAME)
def test_the_same_samples_however_they_are_written(data):
    found = read_samples("a.csv", data)
    assert (found.times, found.values) == ([0, 1, 2], [0, 0.5, -0.15])


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"t,y\n0,0\n1,x\n2,3\n", r"row 3, cell 2 of a\.csv: must be a number; got x"),
        (b"0,0\n1,1\n2,3,4\n", r"row 3 of a\.csv: .*two columns.*3 cells: 2,3,4"),
        (b"0,0,1\n1,1,1\n", r"row 1 of a\.csv: .*3 cells"),
        (b"1\n2\n", r"row 1 of a\.csv: .*1 cell: 1"),
        (b"0;0.5\n1;0,5\n", r"row 2, cell 2 of a\.csv: .*Use one decimal mark"),
        (b"0;\n1;2\n", r"row 1, cell 2 of a\.csv: .*an empty cell"),
        (b"", "no sample"),
        (b"a;b\n", "no sample"),
        (b"0,0\n1,\xb5\n", r"row 2 of a\.csv: is not text in UTF-8"),
    ],
)
def test_what_cannot_be_read_is_named_by_row_and_cell(data, message):
    with pytest.raises(InputError, match=message) as caught:
        read_samples("a.csv", data)
    assert "\n" not in str(caught.value)


def test_units_of_time_are_noticed():
    header = read_samples("a.csv", b"t [ms];y\n0;0\n10;1\n")
    with pytest.raises(InputError, match=r'times are in ms.*time_unit = "ms"'):
        check_time_unit("a.csv", header, 10)
    long = read_samples("a.csv", b"0,0\n9000,1\n")
    with pytest.raises(InputError, match=r'row 2, cell 1 .*900 times .*time_unit = "ms"'):
        check_time_unit("a.csv", long, 10)
    check_time_unit("a.csv", read_samples("a.csv", b"time [s];y\n0;0\n99;1\n"), 10)
