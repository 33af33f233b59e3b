"""The gains of an observer: by how much what it missed corrects what it estimates.

``kalman`` and ``eso`` have the stationary gains of the Riccati equation

    S = F (S - S C' (C S C' + I)^-1 C S) F' + Q,    L = S C' (C S C' + I)^-1,

found by doubling, with Q the squares of the signals' weights. ``dob`` corrects what acts on its
rows by the share of what was missed that its bandwidth leaves per period.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from itertools import pairwise
from typing import Any

import flint
import sympy

from certrack.core.ball_matrices import beside, identity
from certrack.core.errors import DesignError, InputError
from certrack.core.rationals import exact_rational
from certrack.laws.observer import Observer
from certrack.model.plant import Plant

#: Doublings of the Riccati equation at most, its last relative change, and what is no solution.
RICCATI_DOUBLINGS, RICCATI_CHANGE, LARGEST_SOLUTION = 80, 1e-40, 1e200

#: Weight of a signal that need not move by itself: the equation has a solution then.
SMALLEST_WEIGHT = Fraction(1, 1000)


def gains_of_dob(
    observer: Observer, G: flint.arb_mat, rows: Sequence[int], T: flint.arb
) -> flint.arb_mat:
    """(1 - e^{-w T}) of each row, times the inverse of what d does to the rows in a period."""
    count = len(rows)
    seen = flint.arb_mat(count, count, [G[i, j] for i in rows for j in range(count)])
    speeds = observer.bandwidth
    assert isinstance(speeds, tuple)
    share = flint.arb_mat(count, count)
    for j, speed in enumerate(speeds):
        share[j, j] = 1 - (-ball_of_number(speed) * T).exp()
    try:
        return share * seen.inv()
    except ZeroDivisionError:
        raise unseen(observer.rows) from None


def signal_weights(
    plant: Plant,
    observer: Observer,
    A: flint.arb_mat,
    period: float,
    measured: Sequence[int],
    rows: Sequence[int],
) -> list[flint.arb]:
    """One per state and row: how much it moves by itself in a period.

    By a bandwidth w: from a measured state a chain of integrators leads to the states after it that
    are not measured, and to what acts on the last of them. The last integrator of the chain, with
    the gain g to the measured state and of order k, moves by w^k T/g: then the estimates of the
    chain have poles at w, as those of Butterworth's filter.
    """
    n, smallest = (
        plant.n,
        flint.arb(flint.fmpq(SMALLEST_WEIGHT.numerator, SMALLEST_WEIGHT.denominator)),
    )
    weights = [smallest] * (n + len(rows))
    if observer.weights is not None:
        signals = [i for i in range(n) if i not in measured] + [n + j for j in range(len(rows))]
        for signal, weight in zip(signals, observer.weights, strict=True):
            weights[signal] = ball_of_number(weight)
        return weights
    assert isinstance(observer.bandwidth, float)
    speed, T = ball_of_number(observer.bandwidth), ball_of_number(period)
    for first, end in pairwise([*measured, n]):
        named = [i for i in rows if first <= i < end]
        if len(named) > 1:
            names = ", ".join(plant.states[i] for i in named)
            remedy = "State law.observer.weights, or measure the states before them"
            raise InputError("law.observer.bandwidth", f"cannot share {names}", remedy=remedy)
        last = named[0] if named else end - 1
        gain, order = flint.arb(1), last - first + 1 + len(named)
        for i in range(first, last):
            gain = gain * abs(A[i, i + 1])
        weights[n + rows.index(last) if named else last] = speed**order * T / gain
    return weights


def stationary_gains(
    F: flint.arb_mat, G: flint.arb_mat, measured: Sequence[int], weights: Sequence[flint.arb]
) -> flint.arb_mat:
    """L of the module's text, for the states and d."""
    n, size = F.nrows(), F.nrows() + G.ncols()
    eye = identity(size)
    over = flint.arb_mat(eye)
    for i in range(n):
        for j in range(n):
            over[i, j] = F[i, j]
        for j in range(size - n):
            over[i, n + j] = G[i, j]
    C = flint.arb_mat(len(measured), size, [int(i == j) for i in measured for j in range(size)])
    a, g, h = over.transpose(), C.transpose() * C, flint.arb_mat(size, size)
    for i, weight in enumerate(weights):
        h[i, i] = weight**2
    for _ in range(RICCATI_DOUBLINGS):
        try:
            through = (eye + g * h).solve(beside(a, g * a.transpose()))
        except ZeroDivisionError:
            break
        left, right = _split(through, size)
        before = h
        g = (g + a * right).mid()
        h = (h + a.transpose() * h * left).mid()
        a = (a * left).mid()
        change, scale = _largest(h - before), _largest(h)
        if change <= RICCATI_CHANGE * scale:
            seen = C * h * C.transpose() + identity(len(measured))
            try:
                return h * C.transpose() * seen.inv()
            except ZeroDivisionError:  # weights that differ too much for the precision
                break
        if not math.isfinite(scale) or scale > LARGEST_SOLUTION:
            break
    return flint.arb_mat(size, len(measured), [flint.arb("nan")] * (size * len(measured)))


def _split(table: flint.arb_mat, size: int) -> tuple[flint.arb_mat, flint.arb_mat]:
    rows = table.tolist()
    return flint.arb_mat([r[:size] for r in rows]), flint.arb_mat([r[size:] for r in rows])


def _largest(matrix: flint.arb_mat) -> float:
    return max(float(abs(v.mid())) for v in matrix.entries())


def unseen(rows: Sequence[str]) -> DesignError:
    """What is said where there is no estimate, or no compensation of it."""
    return DesignError(
        "law.observer",
        f"what acts on {', '.join(rows) or 'the states'} cannot be told from what is measured"
        + (", or not be compensated by the input" if rows else ""),
        remedy="Measure more states, estimate fewer rows, or take weights that differ less",
    )


def ball_of_number(value: Any) -> flint.arb:
    """A float, a rational or a formula that is one, as a ball."""
    if isinstance(value, float):
        exact = exact_rational(value)
        return flint.arb(flint.fmpq(exact.numerator, exact.denominator))
    value = sympy.sympify(value)
    if value.is_Rational:
        return flint.arb(flint.fmpq(int(value.p), int(value.q)))
    return flint.arb(str(sympy.N(value, 130)))
