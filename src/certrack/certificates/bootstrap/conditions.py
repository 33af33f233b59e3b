"""What must be sums of squares for a polynomial function, in floats, exactly, or of unknowns.

W(zeta) need not be positive. Where the relation is zero its derivative is W' = w_0 + sum_k q_k u_k,
with one q_k for each input u_k in [-1, 1]: with F_k and r_k its columns of zeta' and the relation,
q_k = grad W . F_k + mu r_k, and mu(zeta) is any polynomial. Majorants replace the inputs,

    s_k - q_k >= 0,  s_k + q_k >= 0                      so  q_k u_k <= s_k,
    s_k - q_k a_k + (squares_k + inputs_k) a_k^2 >= 0    for an a-input, |a_k| <= |rows_k w|, 1,
                                    so  q_k a_k <= s_k + squares_k |rows_k w|^2 + inputs_k,

and at every corner, with multipliers that are not negative anywhere,

    w_0 + alpha W + sum s_k + sum squares_k |rows_k w|^2 + sum inputs_k
        + sum sectors_j (1 - (row_j (zeta, 1))^2)  <=  0.

In |rows_k w|^2 a reference y_i that is no variable stands linearly, and so as a part of its q_i,
and in squares, which are at most the sum of the absolute values of their products.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from certrack.certificates.bootstrap.forms import Corner, Forms
from certrack.certificates.bootstrap.monomials import (
    Monomial,
    Polynomial,
    added,
    affine,
    monomials,
    multiplied,
    partial_derivative,
    places,
)


@dataclass(frozen=True)
class InputChannel:
    """One input, or a psi with its products.

    Attributes
    ----------
    entries : pairs (place in w, monomial of zeta that multiplies it)
    square : int or None
        Which a-input it is.
    groups : tuples of corners
        For which its columns are the same, so that they share a majorant.
    """

    entries: tuple[tuple[int, Monomial], ...]
    square: int | None
    groups: tuple[tuple[int, ...], ...]


@dataclass(frozen=True)
class Layout:
    """Of which shape the polynomials are.

    Attributes
    ----------
    degree : int
        Of W, even.
    count : int
        Number of variables.
    squares, sectors : int
    channels : InputChannel
    claims : int
    """

    degree: int
    count: int
    squares: int
    sectors: int
    channels: tuple[InputChannel, ...]
    claims: int

    @property
    def shapes(self) -> tuple[tuple[str, int, int], ...]:
        """Name, number and degree of every kind of polynomial."""
        majorants = sum(len(channel.groups) for channel in self.channels)
        less = self.degree - 2
        return (
            ("W", 1, self.degree),
            ("mu", 1, self.degree - 1),
            ("squares", self.squares, less),
            ("inputs", self.squares, less),
            ("sectors", self.sectors, less),
            ("majorants", majorants, self.degree),
            ("holds", self.claims * self.sectors, less),
        )


@dataclass(frozen=True)
class Polynomials:
    """The polynomials of a function.

    Attributes
    ----------
    W, mu : one polynomial each
    squares, inputs, sectors, majorants : polynomials
    holds : polynomials
        Multipliers of the sectors where claims are shown, claim by claim.
    """

    W: tuple[Polynomial, ...]
    mu: tuple[Polynomial, ...]
    squares: tuple[Polynomial, ...]
    inputs: tuple[Polynomial, ...]
    sectors: tuple[Polynomial, ...]
    majorants: tuple[Polynomial, ...]
    holds: tuple[Polynomial, ...]


@dataclass(frozen=True)
class SumOfSquares:
    """A polynomial that is a sum of squares over a vector of monomials."""

    polynomial: Polynomial
    basis: tuple[Monomial, ...]


def layout_of(forms: Forms, degree: int, claims: int = 1) -> Layout:
    """The shape for exact forms; inputs that act on nothing have no majorant."""
    one = places(forms.size)
    square_of = {place: k for k, (_, place) in enumerate(forms.squares)}
    seen = {i for rows, _ in forms.squares for i in np.flatnonzero((rows != 0).any(axis=0))}
    varying = {place: at for at, times in forms.products for place in times[:1]}
    times_of = {times[0]: times for _, times in forms.products}
    inner = {place for _, times in forms.products for place in times[1:]}
    channels = []
    for place in range(forms.size + 1, forms.width):
        if place in inner:
            continue
        entries: tuple[tuple[int, Monomial], ...] = ((place, one[-1]),)
        if place in varying:
            pairs = zip(times_of[place], varying[place], strict=True)
            entries = tuple((column, one[at]) for column, at in pairs)
        columns = [column for column, _ in entries]
        stacked = [np.vstack([c.F[:, columns], c.relation[columns]]) for c in forms.corners]
        if place not in seen and not any((part != 0).any() for part in stacked):
            continue
        everywhere = tuple(range(len(stacked)))
        same = all((part == stacked[0]).all() for part in stacked)
        groups = (everywhere,) if same else tuple((corner,) for corner in everywhere)
        channels.append(InputChannel(entries, square_of.get(place), groups))
    counts = (len(forms.squares), len(forms.sectors))
    return Layout(degree, forms.size, *counts, tuple(channels), claims)


def sums_of_squares(
    forms: Forms,
    layout: Layout,
    functions: Polynomials,
    alpha: Any,
    claims: Sequence[Polynomial],
) -> list[SumOfSquares]:
    """All of them, in a fixed order; `claims` are scale W + bound - row less scale W."""
    half = layout.degree // 2
    low, high = monomials(layout.count, half - 1), monomials(layout.count, half)
    multipliers = (functions.squares, functions.inputs, functions.sectors, functions.holds)
    conditions = [SumOfSquares(p, low) for kind in multipliers for p in kind]
    W = functions.W[0]
    slopes = [partial_derivative(W, i) for i in range(layout.count)]
    unit = 1 + 0 * forms.middle[0]

    def through(corner: Corner, entries: Sequence[tuple[int, Monomial]]) -> Polynomial:
        """Their part of W' and of mu times the relation."""
        terms: list[tuple[Any, Polynomial]] = []
        for i, slope in enumerate(slopes):
            field = {m: v for place, m in entries if (v := corner.F[i, place]) != 0}
            terms.append((unit, multiplied(field, slope)))
        relation = {m: v for place, m in entries if (v := corner.relation[place]) != 0}
        return added(*terms, (unit, multiplied(relation, functions.mu[0])))

    sums: list[list[tuple[Any, Polynomial]]] = [[] for _ in forms.corners]
    majorants = iter(functions.majorants)
    for channel in layout.channels:
        for group in channel.groups:
            s = next(majorants)
            q = through(forms.corners[group[0]], channel.entries)
            conditions += _bounded(
                functions, channel, _with_squares(forms, functions, channel, q), s
            )
            for at in group:
                sums[at].append((unit, s))
    shared = _shared(forms, functions)
    variables = places(layout.count)
    entries = [(i, variables[i]) for i in range(layout.count + 1)]
    for corner, parts in zip(forms.corners, sums, strict=True):
        falls = added((unit, through(corner, entries)), (alpha, W), *parts, *shared)
        conditions.append(SumOfSquares(added((-unit, falls)), high))
    boxes = [_inside(row, unit) for row in forms.sectors]
    for number, claim in enumerate(claims):
        holds = functions.holds[number * layout.sectors :][: layout.sectors]
        terms = [(-unit, multiplied(box, p)) for box, p in zip(boxes, holds, strict=True)]
        conditions.append(SumOfSquares(added((unit, W), (unit, claim), *terms), high))
    return conditions


def _bounded(
    functions: Polynomials, channel: InputChannel, q: Polynomial, s: Polynomial
) -> list[SumOfSquares]:
    """That s is above what an input can add."""
    count = len(next(iter(s)))
    half = max(map(sum, s)) // 2
    high = monomials(count, half)
    if channel.square is None:
        return [SumOfSquares(added((1, s), (sign, q)), high) for sign in (-1, 1)]
    k = channel.square
    total = added((1, functions.squares[k]), (1, functions.inputs[k]))
    lifted = {(*m, 0): v for m, v in s.items()}
    lifted |= {(*m, 1): -v for m, v in q.items()} | {(*m, 2): v for m, v in total.items()}
    basis = [(*m, 0) for m in high] + [(*m, 1) for m in monomials(count, half - 1)]
    return [SumOfSquares(lifted, tuple(basis))]


def _with_squares(
    forms: Forms, functions: Polynomials, channel: InputChannel, q: Polynomial
) -> Polynomial:
    """q, and what stands with the input in the |rows w|^2 of the a-inputs."""
    (place, _), size = channel.entries[0], forms.size
    terms = [(1, q)]
    for squares, (rows, _) in zip(functions.squares, forms.squares, strict=True):
        for row in rows:
            if row[place] != 0:
                part = affine(2 * row[place] * row[: size + 1])
                terms.append((1, multiplied(part, squares)))
    return added(*terms)


def _shared(forms: Forms, functions: Polynomials) -> list[tuple[Any, Polynomial]]:
    """What all corners have in common."""
    size, unit = forms.size, 1 + 0 * forms.middle[0]
    terms: list[tuple[Any, Polynomial]] = [(unit, p) for p in functions.inputs]
    for squares, (rows, _) in zip(functions.squares, forms.squares, strict=True):
        of_variables, of_inputs = rows[:, : size + 1], rows[:, size + 1 :]
        for row in of_variables:
            terms.append((unit, multiplied(multiplied(affine(row), affine(row)), squares)))
        crossed = np.abs(of_inputs.T @ of_inputs).sum()
        terms.append((unit, multiplied({places(size)[-1]: crossed}, squares)))
    for row, p in zip(forms.sectors, functions.sectors, strict=True):
        terms.append((unit, multiplied(_inside(row, unit), p)))
    return terms


def _inside(row: np.ndarray, unit: Any) -> Polynomial:
    """1 - (row (zeta, 1))^2."""
    square = multiplied(affine(row), affine(row))
    return added((unit, {places(len(row) - 1)[-1]: unit}), (-unit, square))
