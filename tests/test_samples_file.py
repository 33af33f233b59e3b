"""Files of samples: what is read, and how the rest is named."""

import math

import numpy as np
import pytest

import certrack
from certrack.core.errors import InputError
from certrack.systems.samples_file import check_time_unit, read_samples
from certrack.systems.value_units import check_value_unit, converted

SAME = [
    b"0,0\n1,0.5\n2,-1.5e-1\n",
    b"\xef\xbb\xbf0;0\r\n1;0,5\r\n2;-1,5e-1\r\n",
    b"time [s]\ty\n0\t0\n1\t0,5\n2\t-0,15\n",
    b"# by hand\n\n0 0\n1 0.5 # a comment\n  2   -.15\n",
    b'"t";"y"\n"s";"rad"\n"0";"0";\n"1";"0,5";\n"2";"-0,15";\n',
    "0 0\n1 0,5\n2 -0,15\n".encode("utf-16"),
    b"0, 0\r1, 0.5\r2, -0.15",
    b"sep=;\r\n0;0\r\n1;0,5\r\n2;-0,15\r\n",
    b'"t","y"\n"0","0"\n"1","0,5"\n"2","-0,15"\n',
    "0;0\n1;0,5\n2;\N{MINUS SIGN}0,15\n".encode(),
    b"".join(b"note %c\n" % (65 + i) for i in range(20)) + b"0,0\n1,.5\n2,-.15\n",
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
        (b"0\0,\0000\0\n\0", r"row 1 of a\.csv: is not text in UTF-8"),
        (b"0;1\n1;1.234,5\n", r"row 2, cell 2 of a\.csv: .*1\.234,5.*without marks of thousands"),
        (b"0;1\n2024-01-01;1\n", r"row 2, cell 1 of a\.csv: must be a number; got 2024-01-01"),
    ],
)
def test_what_cannot_be_read_is_named_by_row_and_cell(data, message):
    with pytest.raises(InputError, match=message) as caught:
        read_samples("a.csv", data)
    assert "\n" not in str(caught.value)


MANY = b"t [ms];velocity;position [mm]\n0;9;0\n10;9;1,5\n20;9;2\n"


@pytest.mark.parametrize("columns", [("t", "position"), ("t [ms]", "position [mm]"), ("1", "3")])
def test_two_of_many_columns_are_chosen(columns):
    found = read_samples("a.csv", MANY, columns)
    assert (found.times, found.values) == ([0, 10, 20], [0, 1.5, 2])
    with pytest.raises(InputError, match=r'times are in ms.*time_unit = "ms"'):
        check_time_unit("a.csv", found, 10)
    assert read_samples("a.csv", MANY, ("1", "2")).values == [9, 9, 9]


@pytest.mark.parametrize(
    ("data", "columns", "message"),
    [
        (MANY, None, r"row 2 of a\.csv: .*3 cells.*state columns = "),
        (MANY, ("t", "x"), r"columns\[1\]: must be the name.*got x\. Its columns: t \[ms\], vel"),
        (MANY, ("t", "4"), r"row 2 of a\.csv: has no cell 4; got 3 cells"),
        (MANY + b"30;9\n", ("1", "3"), r"row 5 of a\.csv: has no cell 3; got 2 cells"),
        (MANY + b"30;9;z\n", ("1", "3"), r"row 5, cell 3 of a\.csv: must be a number; got z"),
        (b"0;1;2\n1;1;2\n", ("t", "x"), r"columns\[0\].*It has no names"),
    ],
)
def test_columns_that_cannot_be_chosen(data, columns, message):
    with pytest.raises(InputError, match=message) as caught:
        read_samples("a.csv", data, columns)
    assert "\n" not in str(caught.value)


def test_values_are_converted_to_the_unit_of_the_output():
    assert converted([100.0, 1.0], "mm", "m") == [0.1, 0.001]
    assert converted([180.0], "deg", "rad") == pytest.approx([math.pi])
    assert converted([0.5], "rev", "deg") == pytest.approx([180.0])
    assert converted([3.0], "V", "V") == [3.0]


@pytest.mark.parametrize(
    ("unit", "output", "message"),
    [
        ("mm", "", "value_unit: needs the unit of the output; got mm. State plant.units"),
        ("mm", "rad", "value_unit: must measure the output, which is in rad; got mm"),
        ("ell", "m", "value_unit: must be one of m, cm, mm"),
        ("mm", "ell", "units\\[0\\]: must be one of m, cm, mm"),
    ],
)
def test_units_of_values_that_do_not_fit(unit, output, message):
    with pytest.raises(InputError, match=message):
        converted([1.0], unit, output)


def test_units_of_values_are_asked_for():
    header = read_samples("a.csv", MANY, ("t", "position")).header
    with pytest.raises(InputError, match=r'values are in mm, the output is in m.*"mm" beside'):
        check_value_unit("a.csv", header, "m")
    check_value_unit("a.csv", header, "mm")
    check_value_unit("a.csv", header, "")
    check_value_unit("a.csv", "t;y [V]", "m")
    check_value_unit("a.csv", "", "m")


def test_a_system_file_chooses_columns_and_units(tmp_path):
    (tmp_path / "log.csv").write_bytes(MANY)
    text = certrack.starter("point-to-point")
    begin, end = text.index('kind = "scurve"'), text.index("[law]")
    stated = """kind = "samples"
file = "log.csv"
columns = ["t", "position"]
time_unit = "ms"
value_unit = "mm"
interpolation = "spline"
degree = 5

"""
    path = tmp_path / "a.toml"
    path.write_text(text[:begin] + stated + text[end:])
    system = certrack.load(path)
    assert system.reference.knots == (0.0, 0.01, 0.02)
    assert system.reference.values(np.array([0.01]), 0)[0, 0] == pytest.approx(0.0015)
    assert certrack.loads(certrack.to_text(system)) == system
    path.write_text(path.read_text().replace('value_unit = "mm"\n', ""))
    with pytest.raises(InputError, match="values are in mm"):
        certrack.load(path)
    path.write_text(path.read_text().replace('file = "log.csv"', "times = [0, 1]\nvalues = [0, 1]"))
    with pytest.raises(InputError, match="columns: is for a file of samples"):
        certrack.load(path)


def test_units_of_time_are_noticed():
    header = read_samples("a.csv", b"t [ms];y\n0;0\n10;1\n")
    with pytest.raises(InputError, match=r'times are in ms.*time_unit = "ms"'):
        check_time_unit("a.csv", header, 10)
    long = read_samples("a.csv", b"0,0\n9000,1\n")
    with pytest.raises(InputError, match=r'row 2, cell 1 .*900 times .*time_unit = "ms"'):
        check_time_unit("a.csv", long, 10)
    check_time_unit("a.csv", read_samples("a.csv", b"time [s];y\n0;0\n99;1\n"), 10)


@pytest.mark.parametrize("columns", [("1", "1"), ("y", "2"), ("y", "y [mm]")])
def test_one_column_is_not_time_and_value(columns):
    with pytest.raises(InputError, match=r"columns\[1\]: must be another column than that of time"):
        read_samples("a.csv", b"t,y [mm]\n0,1\n1,2\n", columns)
