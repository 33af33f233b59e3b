"""What a system file may say of a reference: limits, defaults and what is required, key by key."""

from inspect import Parameter, signature

import pytest

import certrack
from certrack.references import samples
from certrack.references.keys import FORMULA_KEYS, REFERENCE_KINDS, TRANSIENT
from certrack.references.piecewise import PiecewiseReference
from certrack.references.samples import TIME_UNITS

#: Of every kind: above which number, from which on, default and whether it is required.
EVERYWHERE = {
    "bound": (0, None, None, False),
    "offset": (None, None, 0.0, False),
    "repeat": (None, None, False, False),
    "dwell": (None, 0, 0.0, False),
    "positions": (None, None, None, True),
    "amplitude": (None, None, None, True),
    "period": (0, None, None, True),
    "rise": (0, None, None, True),
    "times": (None, None, None, True),
    "levels": (None, None, None, True),
    "slope": (0, None, None, True),
    "highest": (None, None, None, True),
    "frequencies": (0, None, None, True),
    "amplitudes": (None, None, None, True),
    "phases": (None, None, None, False),
    "smoothness": (None, 0, 0, False),
    "coefficients": (None, None, None, True),
    "values": (None, None, None, True),
    "interpolation": (None, None, "monotone", False),
    "time_unit": (None, None, "s", False),
    "file": (None, None, None, False),
    "columns": (None, None, None, False),
    "value_unit": (None, None, None, False),
    "signal": (None, None, None, True),
    "bounds": (None, 0, None, False),
    "transient": (None, 1e-6, None, False),
}

LIMITS = ("speed", "acceleration", "jerk", "snap")
FROM_REST = ("moves", "velocity", "scurve", "polynomial")


def expected(kind, name):
    if name in LIMITS:
        return 0, None, None, kind in ("velocity", "scurve")
    if name == "start":
        if kind == "profile":
            return None, None, None, True
        return None, (0 if kind in FROM_REST else None), 0.0, False
    if name == "degree":
        return None, None, (5 if kind == "polynomial" else None), False
    if name == "effort":
        return None, None, None, False
    if name == "duration":
        return 0, None, None, kind == "chirp"
    return EVERYWHERE[name]


KINDS = {kind: of.keys for kind, of in REFERENCE_KINDS.items()} | {"formula": FORMULA_KEYS}


@pytest.mark.parametrize("kind", KINDS)
def test_the_keys_of_a_kind(kind):
    for name, key in KINDS[kind].items():
        found = key.above, key.least, key.default, key.required
        assert found == expected(kind, name), (kind, name)
        assert type(key.default) is type(expected(kind, name)[2])
        assert key.nonzero == (name == "amplitude") and not key.infinite
        assert key.most == (3 if name == "smoothness" else None)
        assert key.otherwise or key.required or key.default is not None


def test_choices_of_keys():
    degrees = [keys["degree"].choices for keys in KINDS.values() if "degree" in keys]
    assert degrees == [(3, 5, 7, 9)] * 2
    assert KINDS["samples"]["interpolation"].choices == ("monotone", "cubic", "spline")
    assert set(KINDS["samples"]["time_unit"].choices) == {"s", "ms", "us", "min"}
    assert (TRANSIENT.least, TRANSIENT.required) == (1e-6, False)


@pytest.mark.parametrize("kind", REFERENCE_KINDS)
def test_what_a_file_leaves_out_is_what_the_function_leaves_out(kind):
    """But for what only a file has, such as a file of samples."""
    parameters = signature(REFERENCE_KINDS[kind].make).parameters
    keys = REFERENCE_KINDS[kind].keys
    assert {name for name, key in keys.items() if key.required} <= set(parameters)
    for name, key in keys.items():
        if name in parameters:
            default = parameters[name].default
            assert default is Parameter.empty if key.required else default == key.default, name


@pytest.mark.parametrize(("columns", "taken"), [(3, False), (4, True), (53, True), (54, False)])
def test_pieces_are_of_degree_3_to_52(columns, taken):
    rows = ((0.0,) * columns,) * 2
    if taken:
        assert len(PiecewiseReference((0.0, 1.0, 2.0), rows, 2).coefficients[0]) == columns
        return
    with pytest.raises(certrack.InputError, match=r"reference\.coefficients"):
        PiecewiseReference((0.0, 1.0, 2.0), rows, 2)


@pytest.mark.parametrize("bound", [0, -0.5, float("inf")])
def test_a_declared_bound_is_a_positive_number(bound):
    still = {"knots": (0.0, 1.0), "coefficients": ((0.0,) * 4,), "smoothness": 2}
    with pytest.raises(certrack.InputError, match=r"reference\.bound"):
        PiecewiseReference(**still, bound=bound)
    assert PiecewiseReference(**still, bound=1e-9).bound == 1e-9
    for repeated in (0, -1.0):
        with pytest.raises(certrack.InputError, match=r"reference\.period"):
            PiecewiseReference(**still, period=repeated)


def test_units_of_the_times_of_samples():
    assert TIME_UNITS == {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0}
    for unit, seconds in TIME_UNITS.items():
        assert samples((0, 1, 2), (0, 1, 0), time_unit=unit).knots == (0, seconds, 2 * seconds)
