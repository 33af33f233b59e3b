"""The laws as Section 5 prints them, (47), (48), (54), with the signs that algebra restores.

They are written out by hand here, letter by letter, to be compared with what our recursion gives.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from certrack.papers.liu2025.claim import Claim, judged
from certrack.papers.liu2025.runs import AS_SHIPPED, PaperRuns
from certrack.simulation.run import Run


def printed_law_claims(runs: PaperRuns) -> Iterator[Claim]:
    """Whether the printed laws are those of Section 3 for the examples' systems."""
    improved, classic = runs.example1[AS_SHIPPED]
    for where, text, run, law in (
        ("Example 1, (44)-(47)", "(47) is (25), (26) for system (43)", improved, law_47),
        ("Example 1, (48)", "(48) is the classic adaptive law for system (43)", classic, law_48),
        (
            "Example 2, (49)-(54)",
            "(54) is Corollary 1's law for system (4)",
            runs.weak,
            law_54,
        ),
    ):
        u = law(run)
        apart = float(np.abs(u - run.u).max() / np.abs(run.u).max())
        yield Claim(
            where,
            text,
            "u by the printed formula, minus signs restored, beside u of our recursion along the "
            "run, as a part of the largest |u|",
            f"largest difference {apart:.1g}",
            judged(apart < 1e-9),
        )


def law_47(run: Run) -> np.ndarray:
    """u of the improved adaptive law [47] along a run of Example 1."""
    (x1, x2), (delta_hat, theta_hat) = run.x, run.z[:2]
    y_d, dy_d = run.system.reference.values(run.t, 1)
    c_1 = k_21 = k_23 = k_24 = 1.0
    k_11 = c_2 = 0.5
    p_1 = 0.05
    eta_11 = (3 - c_1 - 1 / (4 * k_11) - 1 / (4 * p_1)) / 2
    d_1 = (c_1 + 1 / (4 * k_11) + 1 / (4 * p_1)) / 2
    e_1 = x1 - y_d
    lambda_1 = (-c_1 * e_1 + 3 * x1 - e_1 / (4 * k_11) - e_1 / (4 * p_1)) / 2
    e_2 = x2 - lambda_1
    ubar = -c_2 * e_2 - 2 * e_1 - x1**2 * x2 - (1 + x1 * np.sin(x2)) * theta_hat + d_1 * dy_d
    ubar += (2 * x2 - 3 * x1) * eta_11 - e_2 / (4 * k_21) * eta_11**2
    ubar -= e_2 / (4 * k_23) + e_2 / (4 * k_24)
    return delta_hat * ubar


def law_48(run: Run) -> np.ndarray:
    """u of the classic adaptive law [48] along a run of Example 1."""
    (x1, x2), (delta_hat, theta_hat) = run.x, run.z[:2]
    y_d, dy_d, ddy_d = run.system.reference.values(run.t, 2)
    c_1, c_2 = 1.0, 0.5
    e_1 = x1 - y_d
    e_2 = x2 - (-c_1 * e_1 + 3 * x1 + dy_d) / 2
    ubar = -c_2 * e_2 - 2 * e_1 - x1**2 * x2 - (1 + x1 * np.sin(x2)) * theta_hat
    ubar += c_1 / 2 * dy_d + ddy_d / 2 + (3 - c_1) / 2 * (2 * x2 - 3 * x1)
    return delta_hat * ubar


def law_54(run: Run) -> np.ndarray:
    """u of the robust law [54] along a run of Example 2."""
    x1, x2, x3, x4 = run.x
    y_d, dy_d = run.system.reference.values(run.t, 1)
    L, l_11, l_2 = 3 / 0.5, 4 / (2 * 0.1), 3 / 0.1  # [2]
    c_1 = c_2 = c_3 = c_4 = 1.0
    k_23 = k_33 = k_43 = k_47 = k_48 = 0.3
    p_1, p_2, p_3 = 0.1, 0.5, 0.5
    eta_11, d_1 = -c_1 - 1 / (4 * p_1), c_1 + 1 / (4 * p_1)
    M_1 = c_2 + 1 / (4 * k_23) + d_1**2 / (4 * p_2)
    eta_21 = (M_1 * eta_11 + 2 * L - 1) / (2 * L)
    eta_22, d_2 = (eta_11 - M_1) / (2 * L), (M_1 * d_1 + 1) / (2 * L)
    M_2 = c_3 + eta_22**2 / (4 * k_33) + d_2**2 / (4 * p_3)
    eta_31 = M_2 * eta_21 + 2 * L * (eta_11 - eta_22)
    eta_32, eta_33 = M_2 * eta_22 - 2 * L + eta_21, 2 * L * eta_22 - M_2
    d_3 = M_2 * d_2 + 2 * L * d_1
    e_3 = x3 - eta_21 * x1 - eta_22 * x2 - d_2 * y_d
    e_4 = x4 - eta_31 * x1 - eta_32 * x2 - eta_33 * x3 - d_3 * y_d
    bracket = -c_4 * e_4 - e_3 - e_4 / (4 * k_43) * eta_32**2 - e_4 / (4 * k_47)
    bracket += -e_4 / (4 * k_48) + eta_31 * x2 - (l_2 + 2 * L * eta_32) * (x1 - x3)
    return (bracket + eta_33 * x4 + d_3 * dy_d) / l_11
