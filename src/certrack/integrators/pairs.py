"""Embedded pairs of explicit Runge-Kutta methods: the one table that every stepper is made from.

NumPy steps, heyoka expressions and C tables of the steppers in :mod:`certrack.integrators.many`
and :mod:`certrack.integrators.sampled` take their coefficients from here; a test holds them to
Butcher's order conditions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True, eq=False)
class Pair:
    """A method of s stages, and what estimates its error.

    A step of length h from x(t) computes the slopes

        k_i = f(t + c_i h, x + h sum_{j<i} a_ij k_j),   i = 1 ... s,
        k_{s+1} = f(t + h, x(t + h)),   x(t + h) = x + h sum_i b_i k_i;

    the last one begins the next step. An error estimate is h sum_i e_i k_i over all s + 1 slopes,
    the difference to a method of lower order.

    Attributes
    ----------
    name : str
    order : int
    A : (s, s) array
    B, C : (s,) arrays
    errors : tuple of (s+1,) arrays
        The weights e of each error estimate.
    error_orders : tuple of int
        Order of the method that each estimate is the difference to.
    dense : (d, s+1) array, optional
        Inside the step x(t + theta h) = x + h sum_i b_i(theta) k_i; row m - 1 has the coefficients
        of theta^m in b_i(theta).
    """

    name: str
    order: int
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    errors: tuple[np.ndarray, ...]
    error_orders: tuple[int, ...]
    dense: np.ndarray | None = None

    @property
    def stages(self) -> int:
        return len(self.B)


def numpy_step(
    pair: Pair,
    h: float | np.ndarray,
    x: np.ndarray,
    rates: Callable[[float, np.ndarray], np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """Slopes and end of a step.

    Parameters
    ----------
    pair : Pair
    h : float or (N,) array, s
    x : (n, N) array
        States of N members.
    rates : callable
        Gets c and the states at t + c h; returns x' in its first n rows, and in further rows what
        else is wanted at every stage.

    Returns
    -------
    slopes : (s+1, rows, N) array
    end : (n, N) array
    """
    n, s = len(x), pair.stages
    first = rates(0.0, x)
    slopes = np.empty((s + 1, *first.shape))
    slopes[0] = first
    for i in range(1, s):
        inner = x + h * np.einsum("s,sij->ij", pair.A[i, :i], slopes[:i, :n])
        slopes[i] = rates(pair.C[i], inner)
    end = x + h * np.einsum("s,sij->ij", pair.B, slopes[:s, :n])
    slopes[s] = rates(1.0, end)
    return slopes, end


def heyoka_step(
    pair: Pair,
    h: Any,
    x: Sequence[Any],
    first: Sequence[Any],
    rates: Callable[[float, Sequence[Any]], Sequence[Any]],
) -> tuple[list[Sequence[Any]], list[Any]]:
    """Slopes and end of a step, as heyoka expressions.

    Parameters
    ----------
    pair, h, x, rates
        As for :func:`numpy_step`.
    first : sequence of expressions
        What `rates` gives at the begin, which the step before may have computed.

    Returns
    -------
    slopes : s + 1 sequences of expressions
    end : list of expressions
    """
    slopes = [first]
    for i in range(1, pair.stages):
        inner = [v + heyoka_sum(h, pair.A[i, :i], [k[j] for k in slopes]) for j, v in enumerate(x)]
        slopes.append(rates(float(pair.C[i]), inner))
    end = [v + heyoka_sum(h, pair.B, [k[j] for k in slopes]) for j, v in enumerate(x)]
    return [*slopes, rates(1.0, end)], end


def heyoka_sum(h: Any, weights: Sequence[float] | np.ndarray, values: Sequence[Any]) -> Any:
    """The expression h sum_i w_i v_i."""
    import heyoka as hy

    terms = [float(w) * v for w, v in zip(weights, values, strict=True) if w]
    return h * hy.sum(terms) if terms else hy.expression(0.0)


def fixed_numbers(values: Sequence[float]) -> np.ndarray:
    """Coefficients that nobody can change."""
    return _read_only(np.array(values, dtype=float))


def lower_triangle(rows: Sequence[Sequence[float]]) -> np.ndarray:
    """A square table that nobody can change, from its rows left of the diagonal."""
    table = np.zeros((len(rows), len(rows)))
    for i, row in enumerate(rows):
        table[i, :i] = row
    return _read_only(table)


def _of_columns(columns: Mapping[int, Sequence[float]], count: int) -> np.ndarray:
    """A table of `count` columns of which the others are zero."""
    table = np.zeros((len(next(iter(columns.values()))), count))
    for i, column in columns.items():
        table[:, i] = column
    return _read_only(table)


def _read_only(table: np.ndarray) -> np.ndarray:
    table.setflags(write=False)
    return table


#: Dormand and Prince (1980), 5(4) with first-same-as-last.
DORMAND_PRINCE = Pair(
    "Dormand-Prince 5(4)",
    order=5,
    A=lower_triangle(
        (
            (),
            (1 / 5,),
            (3 / 40, 9 / 40),
            (44 / 45, -56 / 15, 32 / 9),
            (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
            (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
        )
    ),
    B=fixed_numbers((35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84)),
    C=fixed_numbers((0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1)),
    errors=(
        fixed_numbers((-71 / 57600, 0, 71 / 16695, -71 / 1920, 17253 / 339200, -22 / 525, 1 / 40)),
    ),
    error_orders=(4,),
)

# fmt: off
_DOP853_A = (
    (),
    (0.05260015195876773,),
    (0.0197250569845379, 0.0591751709536137),
    (0.02958758547680685, 0.0, 0.08876275643042054),
    (0.2413651341592667, 0.0, -0.8845494793282861, 0.924834003261792),
    (0.037037037037037035, 0.0, 0.0, 0.17082860872947386, 0.12546768756682242),
    (0.037109375, 0.0, 0.0, 0.17025221101954405, 0.06021653898045596, -0.017578125),
    (
        0.03709200011850479, 0.0, 0.0, 0.17038392571223998, 0.10726203044637328,
        -0.015319437748624402, 0.008273789163814023,
    ),
    (
        0.6241109587160757, 0.0, 0.0, -3.3608926294469414, -0.868219346841726, 27.59209969944671,
        20.154067550477894, -43.48988418106996,
    ),
    (
        0.47766253643826434, 0.0, 0.0, -2.4881146199716677, -0.590290826836843,
        21.230051448181193, 15.279233632882423, -33.28821096898486, -0.020331201708508627,
    ),
    (
        -0.9371424300859873, 0.0, 0.0, 5.186372428844064, 1.0914373489967295, -8.149787010746927,
        -18.52006565999696, 22.739487099350505, 2.4936055526796523, -3.0467644718982196,
    ),
    (
        2.273310147516538, 0.0, 0.0, -10.53449546673725, -2.0008720582248625, -17.9589318631188,
        27.94888452941996, -2.8589982771350235, -8.87285693353063, 12.360567175794303,
        0.6433927460157636,
    ),
)
_DOP853_B = (
    0.054293734116568765, 0.0, 0.0, 0.0, 0.0, 4.450312892752409, 1.8915178993145003,
    -5.801203960010585, 0.3111643669578199, -0.1521609496625161, 0.20136540080403034,
    0.04471061572777259,
)
_DOP853_C = (
    0.0, 0.05260015195876773, 0.0789002279381516, 0.1183503419072274, 0.2816496580927726,
    0.3333333333333333, 0.25, 0.3076923076923077, 0.6512820512820513, 0.6, 0.8571428571428571,
    1.0,
)
_DOP853_E5 = (
    0.01312004499419488, 0.0, 0.0, 0.0, 0.0, -1.2251564463762044, -0.4957589496572502,
    1.6643771824549864, -0.35032884874997366, 0.3341791187130175, 0.08192320648511571,
    -0.022355307863886294, 0.0,
)
_DOP853_E3 = (
    -0.18980075407240762, 0.0, 0.0, 0.0, 0.0, 4.450312892752409, 1.8915178993145003,
    -5.801203960010585, -0.4226823213237919, -0.1521609496625161, 0.20136540080403034,
    0.02265179219836082, 0.0,
)
# fmt: on

# The dense output of DOP853 in the literature, of order 7, needs three more evaluations of the
# rates in every step. Without them order 6 is possible: the slopes of the twelve stages and of the
# end of the step give the states at every part theta of a step. For order 6 the weights have to
# meet the order conditions of the rooted trees of up to 6 nodes, sum_i b_i Phi_i = theta^r / gamma:
# 37 conditions of rank 12, linear in b for a fixed theta. The one direction in which the 13 weights
# are still free goes into the conditions of order 7, which are then met within 1e-5; stages 2 to 5
# have no weight. On example1 the error is a tenth of that of the dense output of order 7.
# tests/test_pairs.py derives these numbers.
# fmt: off
_DOP853_DENSE = {
    0: (
        0.9999999999999661, -6.958943759474855, 26.877329786449433, -61.299871305048526,
        79.8034543082699, -54.041838911014565, 14.674163614932903,
    ),
    5: (
        8.48229212563334e-12, 303.231825771285, -2696.350996207401, 9747.072975335393,
        -16575.41835827449, 13210.014836764818, -3984.099970496878,
    ),
    6: (
        2.6194713173728623e-12, 136.39977814734385, -1043.7898062352776, 3410.9487114097033,
        -5454.41516436229, 4182.385153994669, -1229.6371550548868,
    ),
    7: (
        -1.0678033544181398e-11, -425.8638172694999, 3632.514239793129, -12746.865256198193,
        21282.289030691718, -16765.328593333168, 5017.453192356078,
    ),
    8: (
        8.880548206524619e-13, 8.409240642741462, -146.08819089214714, 727.1255166612191,
        -1465.8824134584916, 1294.8729878569854, -418.1259764433302,
    ),
    9: (
        -1.2443892758676883e-12, -15.30946174902519, 222.5908013543211, -1048.3471125049177,
        2073.087171877812, -1816.0140295607466, 583.8404696328719,
    ),
    10: (
        -3.3943319007845134e-14, 0.17281430978051326, 4.354411503244408, -31.012214991536894,
        65.37340703025254, -54.58232884215387, 15.895276391215594,
    ),
    11: (
        4.2070024312414366e-16, 1.251897240392213, -5.663344658913959, 7.377251595146854,
        -2.5037944807105976, -0.4172990802393632, 5.0695802392580846e-11,
    ),
    12: (
        1.4730922474280772e-16, -1.3333333333493944, 5.555555555624636, -5.000000000070823,
        -2.33333333338298, 3.1111111112371814, -5.643279828818618e-11,
    ),
}
# fmt: on

#: DOP853's estimate is e_5^2 / sqrt(e_5^2 + 0.01 e_3^2) of its two errors (Hairer, Norsett, Wanner,
#: II.10): of order 8 like the method, and never above the fifth-order one.
THIRD_ORDER_WEIGHT = 0.01

#: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I (1993), II.5 and II.10: order
#: 8, error estimates of orders 5 and 3, and the dense output above, of order 6.
DOP853 = Pair(
    "DOP853",
    order=8,
    A=lower_triangle(_DOP853_A),
    B=fixed_numbers(_DOP853_B),
    C=fixed_numbers(_DOP853_C),
    errors=(fixed_numbers(_DOP853_E5), fixed_numbers(_DOP853_E3)),
    error_orders=(5, 3),
    dense=_of_columns(_DOP853_DENSE, 13),
)
