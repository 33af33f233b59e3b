"""K of a linear law from weights, by the algebraic Riccati equation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from certrack.core import checks
from certrack.core.errors import DesignError, InputError
from certrack.core.keys import set_fields
from certrack.core.rounding import in_digits

#: Significant digits of what is computed for a law: an exact decimal, the same for floats,
#: rationals and the file of a certificate.
COMPUTED_DIGITS = 12


@dataclass(frozen=True)
class LqrWeights:
    """int (sum error_i xi_i^2 + input u_xi^2) dt, where u_xi = K xi/g_n is the input's feedback.

    Parameters
    ----------
    error : number, or one per state
        A number is the weight of xi_1 = x_1 - y_d alone. Not all are zero.
    input : number > 0, optional
        1 if left out.
    """

    error: float | tuple[float, ...]
    input: float = 1.0

    def __post_init__(self) -> None:
        key = "law.lqr.error"
        if isinstance(self.error, (str, int, float)):
            error: Any = checks.real(key, self.error, above=0)
        else:
            error = checks.reals(key, self.error, None, "one number per state", least=0)
            if not any(error):
                raise InputError(key, "must not be all zero", list(error))
        set_fields(self, error=error, input=checks.real("law.lqr.input", self.input, above=0))

    @classmethod
    def of(cls, value: Any) -> LqrWeights:
        """Weights from the table of a file."""
        if isinstance(value, LqrWeights):
            return value
        checks.known_keys("law.lqr", value, ("error", "input"), required=("error",))
        return cls(**value)

    def diagonal(self, n: int) -> np.ndarray:
        """The weights of xi_1 ... xi_n."""
        if not isinstance(self.error, tuple):
            return np.append(self.error, np.zeros(n - 1))
        if len(self.error) != n:
            raise InputError("law.lqr.error", f"must be a number or {n} numbers", list(self.error))
        return np.array(self.error)


def lqr_feedback(weights: LqrWeights, F: np.ndarray, g_n: float) -> np.ndarray:
    """K that minimises the weights' integral for xi' = [F; 0] xi + (0 ... 0, g_n u_xi).

    Parameters
    ----------
    weights : LqrWeights
    F : (n-1, n) array
    g_n : float

    Raises
    ------
    DesignError
        If the Riccati equation has no stabilising solution in floats.
    """
    from scipy.linalg import solve_continuous_are

    n = F.shape[1]
    A, b = np.vstack([F, np.zeros(n)]), np.eye(n)[:, -1:]
    cost = np.diag(weights.diagonal(n))
    input_weight = np.array([[weights.input / g_n**2]])
    try:
        with np.errstate(all="ignore"):  # weights that differ too much: the result is checked
            X = solve_continuous_are(A, b, cost, input_weight)
    except (np.linalg.LinAlgError, ValueError) as problem:
        raise DesignError(
            "law.lqr",
            f"the Riccati equation has no stabilising solution ({problem})",
            remedy="Give x_1 a weight, or weights that differ less",
        ) from None
    return -X[-1] / input_weight[0, 0]


def as_computed(value: float) -> float:
    """The float whose decimal text has :data:`COMPUTED_DIGITS` digits."""
    return in_digits(value, COMPUTED_DIGITS)
