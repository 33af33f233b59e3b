"""A step of a Runge-Kutta pair in plain Python numbers, for one member."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from certrack.integrators.pairs import DORMAND_PRINCE, Pair

#: Pairs (stage, weight), without those of weight zero.
Weights = Sequence[tuple[int, float]]


class ScalarPair:
    """The weights of a pair that are not zero.

    Parameters
    ----------
    pair : Pair

    Attributes
    ----------
    stages : pairs (c, weights)
        Of every stage but the first.
    end, error : weights
    """

    def __init__(self, pair: Pair) -> None:
        nodes, table = pair.C[1 : pair.stages], pair.A[1 : pair.stages]
        self.stages = [(float(c), _weights(row)) for c, row in zip(nodes, table, strict=True)]
        self.end, self.error = _weights(pair.B), _weights(pair.errors[0])

    def step(
        self, h: float, x: Sequence[float], rates: Callable[[float, Sequence[float]], list[float]]
    ) -> tuple[list[list[float]], list[float]]:
        """Slopes and end of a step, as :func:`certrack.integrators.pairs.numpy_step` has them."""
        slopes = [rates(0.0, x)]
        for c, row in self.stages:
            slopes.append(rates(c, _moved(x, h, row, slopes)))
        end = _moved(x, h, self.end, slopes)
        slopes.append(rates(1.0, end))
        return slopes, end

    def error_of(self, h: float, slopes: list[list[float]], row: int) -> float:
        """Estimated error of one row."""
        return h * sum(w * slopes[j][row] for j, w in self.error)


def _weights(row: np.ndarray) -> Weights:
    return [(j, float(weight)) for j, weight in enumerate(row) if weight]


def _moved(
    x: Sequence[float], h: float, weights: Weights, slopes: list[list[float]]
) -> list[float]:
    return [v + h * sum(w * slopes[j][i] for j, w in weights) for i, v in enumerate(x)]


#: That of Dormand and Prince.
SCALAR_DORMAND_PRINCE = ScalarPair(DORMAND_PRINCE)
