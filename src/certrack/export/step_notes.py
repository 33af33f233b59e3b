"""What the code says of the steps before the law: differences, and an observer's."""

from __future__ import annotations

import sympy

#: What is computed before the law, by the begin of its symbol's name and by its end.
BEFORE_NOTES = {
    ("ctl_time", ""): "time of the sample, s",
    ("ctl_begun_", ""): "own state; at the first sample what is measured counts",
    ("ctl_filtered_", ""): "filtered difference of the state before it",
    ("ctl_expected_", ""): "what the observer expects of it; at rest at the first sample",
    ("ctl_miss_", ""): "by how much it differs from what was expected",
    ("ctl_d_", "_hat"): "what acts on the rate of this state, estimated",
    ("ctl_", "_hat"): "estimate: what was expected, corrected by what was missed",
    ("ctl_", "_less"): "without what its disturbances make of it in the long run",
    ("ctl_u_", ""): "command of an earlier sample, which still acts",
    ("ctl_remainder", ""): "what the observer's plant has besides linear terms",
    ("ctl_value_", ""): "not measured: (difference - sum_j b_ij x_j)/g_i",
}


def note_before_the_law(name: sympy.Symbol) -> str:
    """One line on a step; empty where it needs none."""
    for (begin, end), note in BEFORE_NOTES.items():
        if name.name.startswith(begin) and name.name.endswith(end):
            return note
    return ""
