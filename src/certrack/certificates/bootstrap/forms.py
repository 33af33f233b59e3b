"""The loop at the ends of pi = v ubar: everything affine in one vector.

w = (zeta, 1, a, b, y, rho, t, o, psi v): the errors z = m + r zeta in the box, the inputs scaled to
their bounds on the box, the remainder h - k x + phi^T (theta - theta_m) = c + r_h rho, and
theta = theta_m + r_t t. If g_n has a range, two entries say where 1/v is in [1/v_1, 1], and v
between its chord and what is below it. For each phi_i that is not constant, phi_i = phi_m + r_i
psi, there are the three entries of psi v, v = (1, zeta_n, zeta of theta_tilde_i). Where something
more acts on the rates of z, such as what a sampled loop adds, each of it is one more entry, scaled
to its bound. All of w but the 1 is in [-1, 1]. At a corner

    zeta' = F w,    0 = relation of w    (both affine in pi for every w).

Every other condition is a quadratic form in w that is not negative where the state is in the box,
or zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from certrack.certificates.bootstrap.box import RegionNumbers
from certrack.certificates.bootstrap.loop import AdaptiveLoop


@dataclass(frozen=True)
class Corner:
    """F, and the relation of ubar: (its formula) - pi/v."""

    F: np.ndarray
    relation: np.ndarray


@dataclass(frozen=True)
class Forms:
    """The loop on a box.

    Attributes
    ----------
    size : int
        Of the errors; w begins with them and 1.
    width : int
        Of w.
    corners : sequence of Corner
        One for each end of pi; one alone where they are the same.
    squares : pairs (rows, place)
        |rows w|^2 - w_place^2 >= 0, of the a-inputs.
    products : pairs (places of v, places of psi v)
        (psi v)^T D (psi v) <= v^T D v for D >= 0, and v^T K (psi v) = 0 for K = -K^T.
    sectors : rows over (zeta, 1)
        In [-1, 1]: the errors and the linear row of ubar.
    middle, radius : arrays
        Of the errors.
    """

    size: int
    width: int
    corners: tuple[Corner, ...]
    squares: tuple[tuple[np.ndarray, int], ...]
    products: tuple[tuple[tuple[int, ...], tuple[int, ...]], ...]
    sectors: np.ndarray
    middle: np.ndarray
    radius: np.ndarray


def forms_of(loop: AdaptiveLoop, region: RegionNumbers, acting: np.ndarray | None = None) -> Forms:
    """All forms, in the arithmetic of the arguments.

    Parameters
    ----------
    loop : AdaptiveLoop
    region : RegionNumbers
    acting : (size,) array, optional
        Bounds of what else acts on the rates of the errors z; nothing if left out.
    """
    n, r, size = loop.n, loop.r, loop.size
    zero = 0 * loop.leak_gain
    na, nb, ny = loop.Ua.shape[1], loop.Ub.shape[1], len(loop.Y)
    ranged = [i for i in range(r) if loop.theta_radius[i] > 0]
    varying = [i for i in range(r) if region.regressor[i][0] != region.regressor[i][1]]
    scales = 2 if loop.largest_scale > 1 else 0
    begin = size + 1 + na + nb + ny + 1 + len(ranged) + scales
    more = [] if acting is None else [i for i in range(size) if acting[i] != 0]
    width = begin + 3 * len(varying) + len(more)
    unit = np.eye(width, dtype=loop.M.dtype) + zero
    counts = [1, na, nb, ny, 1, len(ranged)]
    one, a, b, y, rho, t, of_scale = np.split(unit[size:begin], np.cumsum(counts))
    one, rho, y, a = one[0], rho[0], loop.Y[:, None] * y, region.reach[:, None] * a
    middle, radius = region.box.sum(axis=1) / 2, (region.box[:, 1] - region.box[:, 0]) / 2
    z = middle[:, None] * one + radius[:, None] * unit[:size]
    e, theta_tilde, d = z[:n], z[n : n + r], z[-1]
    x = loop.Xe @ e + loop.AB @ y[:-1]
    linear = (loop.nu_x - region.slope) @ x + loop.nu_Y @ y
    sizes = np.abs(region.regressor).max(axis=1, initial=zero)
    remainder = region.drift.sum() / 2 * one
    reached = (region.drift[1] - region.drift[0]) / 2 + _weighted_sum(
        sizes, loop.theta_radius, zero
    )
    remainder = remainder + reached * rho
    offset = (loop.theta_middle - loop.theta0)[:, None] * one
    for row, i in enumerate(ranged):
        offset[i] = offset[i] + loop.theta_radius[i] * t[row]
    known = loop.M @ e + loop.Ua @ a + loop.Ub @ b - loop.R[:, None] * y[-1]
    phi = [(low + high) / 2 for low, high in region.regressor]
    spread = [(high - low) / 2 for low, high in region.regressor]
    linear = linear - remainder
    drive = loop.leak_theta * (theta_tilde - offset)
    products: list[tuple[tuple[int, ...], tuple[int, ...]]] = []
    for i in range(r):  # phi_i times theta_tilde_i, e_n and 1
        of_estimate, of_error, of_one = phi[i] * theta_tilde[i], phi[i] * e[-1], phi[i] * one
        if i in varying:
            at = begin + 3 * len(products)
            products.append(((size, n - 1, n + i), (at, at + 1, at + 2)))
            first, second, third = unit[at : at + 3]
            of_one = of_one + spread[i] * first
            of_error = of_error + spread[i] * (middle[n - 1] * first + radius[n - 1] * second)
            of_estimate = of_estimate + spread[i] * (middle[n + i] * first + radius[n + i] * third)
        known[-1] = known[-1] + of_estimate
        drive[i] = drive[i] + of_error
        linear = linear + of_estimate - loop.theta_middle[i] * of_one
    inverse, prior = _scale_and_prior(loop, one, of_scale)
    corners = []
    for pi in _different_ends(scaled_ubar(loop, region)):
        rates = known.copy()
        rates[-1] = rates[-1] - loop.gain_sign * loop.smallest_gain * pi * d
        pulled = loop.gain_sign * pi * e[-1] - loop.leak_gain * (d - prior)
        parts = [rates, -loop.Gamma @ drive, [loop.gain_rate * pulled]]
        F = np.vstack([part for part in parts if len(part)])
        for column, i in zip(unit[width - len(more) :], more, strict=True):
            assert acting is not None
            F[i] = F[i] + acting[i] * column
        F = F / radius[:, None]
        corners.append(Corner(F, linear - pi * inverse))
    places = range(size + 1, size + 1 + na)
    return Forms(
        size=size,
        width=width,
        corners=tuple(corners),
        squares=tuple(
            (S @ x / reach, i)
            for S, reach, i in zip(loop.selections, region.reach, places, strict=True)
        ),
        products=tuple(products),
        sectors=_sectors(loop, region, middle, radius),
        middle=middle,
        radius=radius,
    )


def scaled_ubar(loop: AdaptiveLoop, region: RegionNumbers) -> tuple[Any, Any]:
    """Bounds of pi = v ubar."""
    low, high = region.ubar(loop)
    return min(low, low * loop.largest_scale), max(high, high * loop.largest_scale)


def _scale_and_prior(loop: AdaptiveLoop, one: np.ndarray, of_scale: np.ndarray) -> tuple[Any, Any]:
    """1/v, and s/(g_0 v) - v delta_0, what d is pulled to."""
    end, inverse, below = loop.largest_scale, one, 0 * one
    if len(of_scale):
        inverse = (1 + 1 / end) / 2 * one + (1 - 1 / end) / 2 * of_scale[0]
        below = (end - 1) * (end - 1) / 8 * (one + of_scale[1])
    v = (1 + end) * one - end * inverse - below
    return inverse, loop.gain_sign / loop.smallest_gain * inverse - loop.delta0 * v


def _weighted_sum(numbers: np.ndarray, rows: np.ndarray, zero: Any) -> Any:
    """Their inner product; `zero` where there are none."""
    return sum((v * row for v, row in zip(numbers, rows, strict=True)), zero)


def _different_ends(pair: Any) -> tuple[Any, ...]:
    return (pair[0],) if pair[0] == pair[1] else (pair[0], pair[1])


def _sectors(
    loop: AdaptiveLoop, region: RegionNumbers, middle: np.ndarray, radius: np.ndarray
) -> np.ndarray:
    """The errors, and the row of ubar where it is not zero, as what is in [-1, 1]."""
    size = loop.size
    rows = np.eye(size + 1, dtype=loop.M.dtype)[:size] + 0 * middle[0]
    row = region.linear_row(loop)
    if not (row != 0).any():
        return rows
    low, high = region.row
    extra = np.append(row * radius, row @ middle - (low + high) / 2) / ((high - low) / 2)
    return np.vstack([rows, extra])
