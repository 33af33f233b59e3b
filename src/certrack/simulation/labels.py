"""What tables call the metrics of a run and of its moves, with the units of the plant."""

from __future__ import annotations

from collections.abc import Sequence

from certrack.simulation.metrics import METRIC_LABELS
from certrack.simulation.moves import MOVE_LABELS

#: A unit with one of these is put in parentheses before another follows.
COMPOUND = " /*^·"


def unit_of_output(units: Sequence[str] | None) -> str:
    """Unit of y and e_1; empty where none is stated, or it is 1."""
    return _stated(units, 0)


def unit_of_input(units: Sequence[str] | None) -> str:
    """Unit of u; empty where none is stated, or it is 1."""
    return _stated(units, -1)


def with_unit(text: str, unit: str) -> str:
    """A number, or another text, and its unit behind it."""
    return f"{text} {unit}" if unit else text


def labelled(label: str, unit: str) -> str:
    """A label with its unit in brackets.

    >>> labelled("peak input", "N m"), labelled("peak input", "")
    ('peak input [N m]', 'peak input')
    """
    return f"{label} [{unit}]" if unit else label


def metric_labels(units: Sequence[str] | None) -> dict[str, str]:
    """Labels of the metrics.

    Parameters
    ----------
    units : n + 1 texts, optional
        Of the states, then of the input.

    Examples
    --------
    >>> labels = metric_labels(["rad", "rad/s", "N m"])
    >>> labels["tail_error"], labels["integral_abs_error"], labels["input_energy"]
    ('tail error [rad]', 'integral of |e_1| [rad s]', 'input energy [(N m)^2 s]')
    """
    y, u = unit_of_output(units), unit_of_input(units)
    by_metric = {
        "tail_error": y,
        "rms_error": y,
        "integral_abs_error": f"{_factor(y)} s" if y else "",
        "peak_input": u,
        "input_energy": f"{_factor(u)}^2 s" if u else "",
        "input_variation": u,
    }
    return {key: labelled(label, by_metric.get(key, "")) for key, label in METRIC_LABELS.items()}


def move_labels(units: Sequence[str] | None) -> dict[str, str]:
    """Labels of the metrics of moves."""
    lengths = ("origin", "target", "following_error", "overshoot", "rest_error")
    by_metric = dict.fromkeys(lengths, unit_of_output(units))
    return {key: labelled(label, by_metric.get(key, "")) for key, label in MOVE_LABELS.items()}


def _factor(unit: str) -> str:
    return f"({unit})" if any(mark in unit for mark in COMPOUND) else unit


def _stated(units: Sequence[str] | None, place: int) -> str:
    return units[place] if units and units[place] != "1" else ""
