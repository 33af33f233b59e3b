"""The exact proof of a bound by a polynomial function: decimal texts, and their check."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from certrack.certificates.bootstrap.conditions import (
    Polynomials,
    layout_of,
    sums_of_squares,
)
from certrack.certificates.bootstrap.forms import Forms
from certrack.certificates.bootstrap.gram import gram_matrix, gram_pattern
from certrack.certificates.bootstrap.loop import AdaptiveLoop
from certrack.certificates.bootstrap.monomials import (
    Polynomial,
    affine,
    monomials,
    with_coefficients,
)
from certrack.certificates.bootstrap.polynomial_program import PolynomialMinimiser
from certrack.certificates.bootstrap.proof import RowBound, proven_definite, row_over_box
from certrack.certificates.bootstrap.variables import knows_reference, with_reference
from certrack.certificates.exact import decimal_text, from_text

#: Monomials of the vector of a Gram matrix that a proof may have.
MOST_MONOMIALS = 130

#: Digits of a coefficient or an entry of a Gram matrix.
GRAM_DIGITS = 9

Texts = tuple[str, ...]


@dataclass(frozen=True)
class PolynomialProof:
    """A polynomial function, its multipliers and Gram matrices, and what it bounds.

    Attributes
    ----------
    degree : int
        4, 6, ...
    reference : bool
        Whether y_0 ... y_q are among the variables.
    alpha : str
    W, mu : coefficients
        In the order of :func:`monomials`.
    squares, inputs, sectors, majorants, holds : coefficients of many
        As of :class:`Polynomials`.
    grams : texts
        The free entries of every Gram matrix, in the order of the conditions.
    claims : RowBound
    """

    degree: int
    reference: bool
    alpha: str
    W: Texts
    mu: Texts
    squares: tuple[Texts, ...]
    inputs: tuple[Texts, ...]
    sectors: tuple[Texts, ...]
    majorants: tuple[Texts, ...]
    holds: tuple[Texts, ...]
    grams: tuple[Texts, ...]
    claims: tuple[RowBound, ...]


def failed_sum(
    loop: AdaptiveLoop, forms: Forms, proof: PolynomialProof, rows: Sequence[np.ndarray]
) -> str:
    """Empty if the proof holds exactly, else what fails; `rows` are those that claims may name."""
    if proof.degree < 4 or proof.degree % 2:
        return "the degree of a function is not even, or below 4"
    if proof.reference:
        if not knows_reference(loop):
            return "a reference that does not move is no variable"
        forms = with_reference(loop, forms)
    half = proof.degree // 2
    if math.comb(forms.size + half, half) > MOST_MONOMIALS:
        return "a function has too many monomials"
    layout = layout_of(forms, proof.degree, len(proof.claims))
    parts = {}
    for name, count, degree in layout.shapes:
        value = getattr(proof, name)
        lists = (value,) if name in ("W", "mu") else value
        length = len(monomials(forms.size, degree))
        if len(lists) != count or any(len(texts) != length for texts in lists):
            return "a function does not have the shape of the loop"
        parts[name] = tuple(_read_polynomial(texts, forms.size, degree) for texts in lists)
    alpha = from_text(proof.alpha)
    if not alpha > 0:
        return "alpha is not positive"
    claims = []
    for claim in proof.claims:
        if claim.side not in (1, -1) or not 0 <= claim.error < len(rows):
            return "a claim is of no row"
        if not from_text(claim.scale) > 0:
            return "a scale is not positive"
        claims.append(claim_polynomial(forms, claim, rows[claim.error]))
    conditions = sums_of_squares(forms, layout, Polynomials(**parts), alpha, claims)
    if len(conditions) != len(proof.grams):
        return "a function does not have the Gram matrices of the loop"
    for condition, texts in zip(conditions, proof.grams, strict=True):
        if len(texts) != len(gram_pattern(condition.basis).free):
            return "a Gram matrix does not have the shape of its condition"
        free = [from_text(text) for text in texts]
        matrix = gram_matrix(condition.polynomial, condition.basis, free)
        if matrix is None or not proven_definite(matrix):
            return "a polynomial is not shown to be a sum of squares"
    return ""


def _read_polynomial(texts: Texts, count: int, degree: int) -> Polynomial:
    return with_coefficients([from_text(text) for text in texts], count, degree)


def claim_polynomial(forms: Forms, claim: RowBound, row: np.ndarray) -> Polynomial:
    """(bound - side row z) / scale, which W must be above the negative of."""
    wide = np.append(row, [0 * row[0]] * (len(forms.middle) - len(row)))
    scale, bound = from_text(claim.scale), from_text(claim.bound)
    over = -claim.side * row_over_box(forms, wide)
    over[-1] = over[-1] + bound
    result: dict[Any, Any] = dict(affine(over / scale))
    return result


def prove_polynomial(
    loop: AdaptiveLoop,
    forms: Forms,
    solution: PolynomialMinimiser,
    wanted: Sequence[tuple[int, int]],
    rows: Sequence[np.ndarray],
    *,
    degree: int,
    reference: bool,
) -> PolynomialProof | None:
    """Round what the solver returned; None if exact arithmetic does not confirm it.

    The bounds stand as they are: the margin of the program covers the rounding.
    """
    texts = {
        name: tuple(tuple(map(_short_text, values)) for values in lists)
        for name, lists in solution.parts.items()
    }
    claims = tuple(
        RowBound(error, side, _short_text(scale), decimal_text(scale * bound))
        for (error, side), scale, bound in zip(
            wanted, solution.scales, solution.bounds, strict=True
        )
    )
    proof = PolynomialProof(
        degree=degree,
        reference=reference,
        alpha=_short_text(solution.alpha),
        W=texts.pop("W")[0],
        mu=texts.pop("mu")[0],
        grams=tuple(tuple(map(_short_text, values)) for values in solution.grams),
        claims=claims,
        **texts,
    )
    return None if failed_sum(loop, forms, proof, rows) else proof


def _short_text(value: float) -> str:
    """The margin of the program is far above what is left out, and most of a file are these."""
    return f"{value:.{GRAM_DIGITS}g}"
