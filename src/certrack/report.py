"""What the command line prints: tables for people, JSON for programs."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table


def to_json(values: Any) -> str:
    """JSON with arrays as lists and missing numbers as null."""
    return json.dumps(_plain(values), indent=2, allow_nan=False)


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, Mapping):
        return {str(name): _plain(entry) for name, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> Table:
    """A table of text; numbers are shown with five digits."""
    made = Table(title=title or None, title_justify="left", title_style="bold")
    for i, column in enumerate(columns):
        made.add_column(column, overflow="fold", justify="left" if i == 0 else "default")
    for row in rows:
        made.add_row(*(_cell(value) for value in row))
    return made


def _cell(value: object) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.5g}"
    return str(value)


def console(*, error: bool = False) -> Console:
    """Console on standard output or standard error."""
    return Console(stderr=error, highlight=False, markup=False)


METRIC_ROWS = {
    "settling_time": "settling time [s]",
    "tail_error": "tail error",
    "rms_error": "RMS error",
    "integral_abs_error": "integral of |e_1|",
    "peak_input": "peak input",
    "input_energy": "input energy",
    "input_variation": "variation of input",
}


def metrics_table(summaries: Mapping[str, Mapping[str, Any]]) -> Table:
    """Metrics of one or several runs, one column each."""
    rows = [
        [label, *(summary[key] for summary in summaries.values())]
        for key, label in METRIC_ROWS.items()
    ]
    rows.append(["outcome", *(summary["outcome"] for summary in summaries.values())])
    rows.append(["integrator", *(summary["integrator"] for summary in summaries.values())])
    return table("", ["metric", *summaries], rows)
