"""The peak-gain certificate: error bounds from the loop's impulse responses.

e' = M e + sum_j W_j y^(j) + w_o + columns of bounded inputs and channels. For any s <= q + 1 let
e = sum_{j<s} Pi_j y^(j) + zeta with Pi_j = M^-1 (Pi_{j-1} - W_j), Pi_{-1} = 0: the derivatives
below s then act through what they leave in the long run, and y^(s) through W_s - Pi_{s-1}. For an
output z = c e + sum_j d_j y^(j) + d_o

    limsup |z| <= sum_{j<s} |c Pi_j + d_j| Y_j + ||c (W_s - Pi_{s-1})||_1 Y_s
                + sum_{j>s} ||c W_j||_1 Y_j + sum_{j>=s} |d_j| Y_j + |c e_o + d_o| + sum ||c b||_1

with the peak gains of :mod:`certrack.certificates.ranges.kernels`; the best s counts. The channels'
outputs q and, where Assumption 1 grows with ||x||, the states are outputs too:

    v = (|q_1|, ..., |x_1|, ...):   a v > F(v), F(v) = c + G v + sum_k G_k ||S_k x||, in every entry

proves limsup |q|, |x| <= v, for F is monotone, and homogeneous but for c.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from certrack.certificates.arithmetic import rational, solve
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import float_up
from certrack.certificates.formulation import UncertainInputs
from certrack.certificates.ranges.coefficients import Coefficients, largest_brackets
from certrack.certificates.ranges.kernels import NOT_STABLE, peak_gains
from certrack.certificates.ranges.loop import ErrorForm, RangedLoop, error_form
from certrack.certificates.ranges.rational import Interval

#: A value of this size is as good as infinite.
UNBOUNDED = 1e100

#: The fixed point is widened by this before it is checked, and the roundings of the check are less
#: than this; iterations until it stands still, where the gain is 0.985.
WIDENED, FIXED_POINT_ROUNDING, ITERATIONS, LEAST = 1e-9, 1e-12, 2000, 1e-280


#: Why there is no bound.
TOO_MUCH_GAIN = "the loop's gain through the uncertain terms is not below 1, or too near to it"


@dataclass(frozen=True)
class PeakBound:
    """A proven bound.

    Attributes
    ----------
    bound : float
        On limsup |e_1|, rounded up.
    levels : s of each output: e_1, the channels, the states
    """

    bound: float
    levels: tuple[int, ...]


@dataclass(frozen=True)
class _Outputs:
    """z = C e + D (y_d ... y_d^(q+1)) + offset, in rationals."""

    C: np.ndarray
    D: np.ndarray
    offset: np.ndarray


#: From M, rows and columns to the integrals of |c e^{Mt} b|.
Quadrature = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def peak_bound(
    loop: RangedLoop,
    coefficients: Coefficients,
    box: Sequence[Interval],
    gains_of: Quadrature = peak_gains,
) -> PeakBound:
    """Bound on limsup |e_1| for constants that stay in a box, also if they vary in it.

    Parameters
    ----------
    loop : RangedLoop
    coefficients : Coefficients
    box : intervals of its symbols
    gains_of : callable, optional
        Another quadrature, such as an estimate; then what is returned is no bound either.

    Raises
    ------
    NoCertificate
        If the centre is not stable, or the channels may destabilise it.
    """
    channels = coefficients.over(box)
    n, c = loop.n, loop.coordinates
    brackets = largest_brackets(loop, box)
    form = error_form(loop, np.concatenate([channels.centre.ravel(), brackets]))
    outputs = _outputs(loop, channels.rows)
    uncertain = loop.uncertain
    norms = _norms(uncertain, n)
    if not norms:
        count = 1 + len(channels.rows)
        outputs = _Outputs(outputs.C[:count], outputs.D[:count], outputs.offset[:count])
    bounded = list(uncertain.b)
    bounded += [c.A[:, -1] * value * size for value, size in zip(brackets, loop.sizes, strict=True)]
    columns = [
        *bounded,
        *(c.A @ channels.columns).T,
        *uncertain.a,
    ]
    try:
        constant, gains, levels = _responses(form, outputs, loop.bound_on, columns, gains_of)
    except ZeroDivisionError:  # M has no inverse: an eigenvalue is zero
        raise NoCertificate(NOT_STABLE) from None
    nb, nc = len(bounded), len(channels.rows)
    constant = constant + gains[:, :nb].sum(axis=1)
    through, from_norms = gains[:, nb : nb + nc], gains[:, nb + nc :]
    if nc and np.abs(np.linalg.eigvals(through[1 : 1 + nc])).max() >= 1:
        raise NoCertificate(TOO_MUCH_GAIN)  # no v > F(v), of however many steps

    def image(v: np.ndarray) -> np.ndarray:
        sizes = np.array([np.linalg.norm(S @ v[1 + nc :]) for S in norms])
        after: np.ndarray = constant + through @ v[1 : 1 + nc] + from_norms @ sizes
        return np.minimum(after, UNBOUNDED)

    return PeakBound(_bound(image, len(constant)), tuple(levels))


def _norms(uncertain: UncertainInputs, n: int) -> list[np.ndarray]:
    """For each a-input the S with |a| <= ||S x||, its entries as magnitudes rounded up."""
    selections = uncertain.selections or (None,) * len(uncertain.a)
    norms = []
    for selection in selections:
        if selection is None:
            norms.append(np.eye(n))
            continue
        S, _ = selection
        norms.append(np.vectorize(lambda v: float_up(abs(v)), otypes=[float])(S))
    return norms


def _outputs(loop: RangedLoop, rows: np.ndarray) -> _Outputs:
    """e_1, the channels' rows (x, Y', 1), and the states, in error coordinates."""
    c, n = loop.coordinates, loop.n
    width = c.q + 2
    unit = np.array([[rational(int(j == 0)) for j in range(n)]], dtype=object)
    zero = rational(0)
    through_x = np.vstack([rows[:, :n], np.eye(n, dtype=object) + zero])
    C = np.vstack([unit, through_x @ loop.Xe])
    D = np.full((len(C), width), zero, dtype=object)
    D[1:, :-1] = through_x @ (loop.Xe @ c.B)
    D[1 : 1 + len(rows)] = D[1 : 1 + len(rows)] + rows[:, n:-1]
    offset = np.full(len(C), zero, dtype=object)
    offset[1 : 1 + len(rows)] = rows[:, -1]
    return _Outputs(C, D, offset)


def _responses(
    form: ErrorForm,
    outputs: _Outputs,
    bound_on: Callable[[int], Any],
    columns: Sequence[np.ndarray],
    gains_of: Quadrature,
) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """For each output: the part of reference and offset, and its gains from the columns."""
    M, W = form.M, form.W
    width = W.shape[1]
    last, residuals, statics = 0 * form.offset, [], []
    for s in range(width):
        residuals.append(W[:, s] - last)
        last = solve(M, -residuals[-1])  # Pi_s
        statics.append(last)
    unused = [
        not any(np.any(v != 0) for v in (W[:, j], outputs.D[:, j], statics[j], residuals[j]))
        for j in range(width)
    ]
    Y = [rational(0) if unused[j] else bound_on(j) for j in range(width)]
    resting = solve(M, -form.offset)
    table = [*columns, *residuals, *(W[:, j] for j in range(1, width))]
    acting = [i for i, column in enumerate(table) if any(v != 0 for v in column)]
    gains = np.zeros((len(outputs.C), len(table)))
    inputs = np.array([table[i] for i in acting], dtype=object).reshape(len(acting), len(M)).T
    gains[:, acting] = gains_of(M, outputs.C, inputs)
    first, later = len(columns), len(columns) + width
    sizes = [float_up(v) for v in Y]
    constant, levels = [], []
    for row, (C, D, d) in enumerate(zip(outputs.C, outputs.D, outputs.offset, strict=True)):
        options = []
        for s in range(width):
            still = sum((abs(C @ statics[j] + D[j]) * Y[j] for j in range(s)), 0 * d)
            still += sum((abs(D[j]) * Y[j] for j in range(s, width)), 0 * d)
            moving = gains[row, first + s] * sizes[s]
            moving += sum(gains[row, later + j - 1] * sizes[j] for j in range(s + 1, width))
            options.append(float_up(still + abs(C @ resting + d)) + moving)
        levels.append(int(np.argmin(options)))
        constant.append(min(options))
    return np.array(constant) * (1 + FIXED_POINT_ROUNDING), gains[:, :first], levels


def _bound(image: Any, count: int) -> float:
    """Bound on the first output, from a v with v > image(v) in every other entry.

    The first, e_1, acts on no other.
    """
    v = np.zeros(count)
    for _ in range(ITERATIONS):
        after = image(v)
        if after.max() >= UNBOUNDED:
            break
        if (after <= v * (1 + WIDENED / 10)).all():
            wide = v * (1 + WIDENED) + LEAST
            proven = image(wide) * (1 + FIXED_POINT_ROUNDING)
            if (proven[1:] < wide[1:]).all() and proven.max() < UNBOUNDED:
                return float(proven[0])
        v = after  # the nearer the gain is to 1, the nearer to its end the iteration must be
    raise NoCertificate(TOO_MUCH_GAIN)
