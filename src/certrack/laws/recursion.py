"""The design of a law: the recursion of the paper, or the balanced one."""

from __future__ import annotations

import numpy as np

from certrack.core import checks
from certrack.core.errors import DesignError, InputError
from certrack.laws.backstepping import ErrorCoordinates, Gains, carry_out, is_moderate, no_damping
from certrack.laws.balanced import balanced, balancing_weights
from certrack.laws.integral import longer_chain, of_the_plant
from certrack.model.plant import MAX_ORDER


def recursion(
    g: np.ndarray, b: np.ndarray, gains: Gains, q: int = 0, *, beyond: bool = False
) -> ErrorCoordinates:
    """Carry out the recursion in O(n^3).

    Parameters
    ----------
    g : (n-1,) array
        Virtual control coefficients, nonzero.
    b : (n-1, n) array
        Linear couplings b_ij, lower triangular.
    gains : Gains
    q : int
        Feed-forward order, 0 <= q <= n-1.
    beyond : bool
        Whether q may be larger: the recursion has no use for the others, a sampled loop has.

    Returns
    -------
    ErrorCoordinates

    Raises
    ------
    InputError
        If the number of gains or q does not fit the plant.
    DesignError
        If the damping terms overflow (they grow doubly exponentially with n).
    """
    n = len(g) + 1
    if gains.n != n:
        raise InputError("law.c", f"must be a list of {n}: c_1 ... c_n", list(gains.c))
    q = checks.integer("law.feedforward", q, 0, MAX_ORDER - 1 if beyond else n - 1)
    assert gains.k is not None and gains.p is not None
    g, c, b = np.asarray(g, float), np.array(gains.c), np.asarray(b, float)
    k, p = gains.k, gains.p
    if gains.integral is not None:
        g, b, c = longer_chain(g, b, c, gains.integral)
        (k, p), q = no_damping(n + 1), q + 1
    with np.errstate(over="ignore", invalid="ignore"):
        if gains.coupling is None:
            weights = [(0.25 / np.array(row)).reshape(-1, 2).sum(axis=1) for row in k]
            design = carry_out(g, b, c, weights, 0.25 / np.array(p), q)
        else:
            design = balanced(g, b, c, q, balancing_weights(g, c, gains.coupling))
    if not is_moderate(design):
        if gains.is_lean:
            raise DesignError(
                "law.c", "the design overflows", remedy="Lower c, or scale the states (chain)"
            )
        step = int(np.argmin(np.isfinite(design.kappa))) + 1
        raise DesignError(
            "law.k",
            f"the damping overflows at step {step} of {n}: each step squares it",
            remedy="Raise k and p, or leave them out (a lean design)",
        )
    return design if gains.integral is None else of_the_plant(design)
