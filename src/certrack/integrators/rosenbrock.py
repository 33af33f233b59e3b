"""A linearly implicit Rosenbrock method for stiff systems: its table of coefficients.

The C steps of :mod:`certrack.integrators.many` take them from here; a test holds them to the order
conditions of Rosenbrock methods.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from certrack.integrators.pairs import fixed_numbers, lower_triangle


@dataclass(frozen=True, eq=False)
class Rosenbrock:
    """A linearly implicit method of s stages, and what estimates its error.

    A step of length h from x(t), where J = df/dx and d = df/dt at its begin, solves

        (1/gamma - h J) k_i = f(t + c_i h, x + h sum_{j<i} a_ij k_j)
                              + sum_{j<i} coupling_ij k_j + h slope_i d,   i = 1 ... s,

    and ends at x(t + h) = x + h sum_i b_i k_i. In the literature, of which f is
    evaluated at alpha_ij and whose J is multiplied by gamma_ij, k_i stands for sum_j gamma_ij k_j,
    which saves the products with J (Hairer, Wanner, Solving Ordinary Differential Equations II,
    IV.7).

    Attributes
    ----------
    name : str
    order : int
    gamma : float
    A, coupling : (s, s) arrays
        Below the diagonal.
    B, C, slope : (s,) arrays
    errors : (s,) array
        The error estimate is h sum_i errors_i k_i, the difference to a method of `error_order`.
    error_order : int
    dense : (d, s) array
        Inside the step x(t + theta h) = x + h sum_i b_i(theta) k_i; row m - 1 has the coefficients
        of theta^m in b_i(theta).
    """

    name: str
    order: int
    gamma: float
    A: np.ndarray
    coupling: np.ndarray
    B: np.ndarray
    C: np.ndarray
    slope: np.ndarray
    errors: np.ndarray
    error_order: int
    dense: np.ndarray

    @property
    def stages(self) -> int:
        return len(self.B)


# The table of Rodas5P: G. Steinebach, Construction of Rosenbrock-Wanner method Rodas5P and
# numerical benchmarks within the Julia Differential Equations package, BIT Numerical Mathematics
# 63:27 (2023); the numbers are those of OrdinaryDiffEq.jl. It is L-stable and stiffly accurate: the
# last stages are evaluated at the ends of embedded methods, so b, a_8 and a_7 begin alike.
# fmt: off
_RODAS5P_A = (
    (),
    (3.0,),
    (2.849394379747939, 0.45842242204463923),
    (-6.954028509809101, 2.489845061869568, -10.358996098473584),
    (2.8029986275628964, 0.5072464736228206, -0.3988312541770524, -0.04721187230404641),
    (
        -7.502846399306121, 2.561846144803919, -11.627539656261098, -0.18268767659942256,
        0.030198172008377946,
    ),
)
_RODAS5P_COUPLING = (
    (),
    (-14.155112264123755,),
    (-17.97296035885952, -2.859693295451294),
    (147.12150275711716, -1.41221402718213, 71.68940251302358),
    (165.43517024871676, -0.4592823456491126, 42.90938336958603, -5.961986721573306),
    (
        24.854864614690072, -3.0009227002832186, 47.4931110020768, 5.5814197821558125,
        -0.6610691825249471,
    ),
    (
        30.91273214028599, -3.1208243349937974, 77.79954646070892, 34.28646028294783,
        -19.097331116725623, -28.087943162872662,
    ),
    (
        37.80277123390563, -3.2571969029072276, 112.26918849496327, 66.9347231244047,
        -40.06618937091002, -54.66780262877968, -9.48861652309627,
    ),
)
_RODAS5P_GAMMA = 0.21193756319429014
_RODAS5P_C = (
    0.0, 0.6358126895828704, 0.4095798393397535, 0.9769306725060716, 0.4288403609558664, 1.0, 1.0,
    1.0,
)
_RODAS5P_SLOPE = (
    _RODAS5P_GAMMA, -0.42387512638858027, -0.3384627126235924, 1.8046452872882734,
    2.325825639765069, 0.0, 0.0, 0.0,
)
#: Rows h_2, h_3, h_4: inside a step x + theta h sum_i (b_i + (1 - theta) sum_m theta^m h_mi) k_i.
_RODAS5P_INSIDE = (
    (
        25.948786856663858, -2.5579724845846235, 10.433815404888879, -2.3679251022685204,
        0.524948541321073, 1.1241088310450404, 0.4272876194431874, -0.17202221070155493,
    ),
    (
        -9.91568850695171, -0.9689944594115154, 3.0438037242978453, -24.495224566215796,
        20.176138334709044, 15.98066361424651, -6.789040303419874, -6.710236069923372,
    ),
    (
        11.419903575922262, 2.8879645146136994, 72.92137995996029, 80.12511834622643,
        -52.072871366152654, -59.78993625266729, -0.15582684282751913, 4.883087185713722,
    ),
)
# fmt: on


def _dense_rows(B: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Powers of theta from one on of theta b + theta (1 - theta) sum_m theta^m h_m."""
    none = np.zeros((1, len(B)))
    rows = np.vstack([inside, none]) - np.vstack([none, inside])
    rows[0] += B
    rows.setflags(write=False)
    return rows


_RODAS5P_B = fixed_numbers((*_RODAS5P_A[-1], 1.0, 1.0, 1.0))

#: Order 5 with an embedded method of order 4, and a dense output of order 4.
RODAS5P = Rosenbrock(
    "Rodas5P",
    order=5,
    gamma=_RODAS5P_GAMMA,
    A=lower_triangle(
        (*_RODAS5P_A, (*_RODAS5P_A[-1], 1.0), (*_RODAS5P_A[-1], 1.0, 1.0)),
    ),
    coupling=lower_triangle(_RODAS5P_COUPLING),
    B=_RODAS5P_B,
    C=fixed_numbers(_RODAS5P_C),
    slope=fixed_numbers(_RODAS5P_SLOPE),
    errors=fixed_numbers((0.0,) * 7 + (1.0,)),
    error_order=4,
    dense=_dense_rows(_RODAS5P_B, np.array(_RODAS5P_INSIDE)),
)
