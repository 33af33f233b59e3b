"""The exact proof of the bounds of a stage: numbers as decimal texts, and their check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import flint
import numpy as np
from scipy.linalg import solve_triangular

from certrack.certificates.bootstrap.box import Region
from certrack.certificates.bootstrap.forms import Forms
from certrack.certificates.bootstrap.inequality import (
    MULTIPLIERS,
    Unknowns,
    corner_form,
    multiplier_counts,
    shared_form,
    target_form,
)
from certrack.certificates.bootstrap.program import Minimiser
from certrack.certificates.exact import decimal_text, from_text

#: How far a solution gives way until exact arithmetic confirms it, in the units of a box's radius.
FUNCTION_BACK_OFF = (1e-7, 1e-6, 1e-5, 1e-4)

#: Where the diagonal stands in the upper triangle of a D_i.
DIAGONAL = (1.0, 0.0, 1.0, 0.0, 0.0, 1.0)

#: Part of it that is added to G, so that W + bound - row is positive definite.
FLOOR_PART = 1e-2


@dataclass(frozen=True)
class RowBound:
    """limsup side * row (z) <= bound, for scale (W + bound/scale) >= side * row (z).

    Attributes
    ----------
    error : int
        Which row: of the n + r + 1 errors, from 0, or the linear row of ubar behind them.
    side : int
        1 for an upper bound, -1 for the bound of what is negated.
    scale, bound : str
    """

    error: int
    side: int
    scale: str
    bound: str


@dataclass(frozen=True)
class FunctionProof:
    """A quadratic function and its multipliers, in decimal texts, and what it bounds."""

    alpha: str
    G: tuple[tuple[str, ...], ...]
    squares: tuple[str, ...]
    inputs: tuple[str, ...]
    sectors: tuple[str, ...]
    mu: tuple[str, ...]
    scales: tuple[str, ...]
    turns: tuple[str, ...]
    claims: tuple[RowBound, ...]

    def unknowns(self) -> Unknowns:
        """The numbers, exact."""
        vectors = [_exact_vector(getattr(self, name)) for name in MULTIPLIERS]
        G = np.array([[from_text(v) for v in row] for row in self.G], dtype=object)
        return Unknowns(from_text(self.alpha), G, *vectors)


@dataclass(frozen=True)
class BootstrapStage:
    """What a stage stands on, and the functions that prove its bounds."""

    region: Region
    functions: tuple[FunctionProof, ...]


def _exact_vector(texts: tuple[str, ...]) -> np.ndarray:
    return np.array([from_text(v) for v in texts], dtype=object)


def row_over_box(forms: Forms, row: np.ndarray) -> np.ndarray:
    """A row over the errors z as one over (zeta, 1)."""
    return np.append(row * forms.radius, _inner(row, forms.middle))


def _inner(row: np.ndarray, values: np.ndarray) -> Any:
    return sum((a * b for a, b in zip(row, values, strict=True)), 0 * values[0])


def failed_part(forms: Forms, proof: FunctionProof, rows: Sequence[np.ndarray]) -> str:
    """Empty if the proof holds exactly, else the first condition that fails.

    `rows` are those that claims may name, over the errors.
    """
    unknowns = proof.unknowns()
    size = forms.size
    lengths = tuple(len(getattr(unknowns, name)) for name in MULTIPLIERS)
    if unknowns.G.shape != (size + 1, size + 1) or lengths != multiplier_counts(forms):
        return "G or the multipliers do not have the shape of the loop"
    if not (unknowns.G == unknowns.G.T).all():
        return "G is not symmetric"
    if not unknowns.alpha > 0:
        return "alpha is not positive"
    if any(v < 0 for v in (*unknowns.squares, *unknowns.inputs, *unknowns.sectors)):
        return "a multiplier is negative"
    if not all(proven_definite(unknowns.scale(i)) for i in range(len(forms.products))):
        return "a multiplier of the regressor is not positive definite"
    for claim in proof.claims:
        if claim.side not in (1, -1) or not 0 <= claim.error < len(rows):
            return "a claim is of no row"
        scale = from_text(claim.scale)
        if not scale > 0:
            return "a scale is not positive"
        row = row_over_box(forms, claim.side * rows[claim.error])
        if not proven_definite(target_form(scale * unknowns.G, row, from_text(claim.bound))):
            return "the function is below what it shall bound"
    shared = shared_form(forms, unknowns)
    for corner in forms.corners:
        if not proven_definite(-(shared + corner_form(forms, corner, unknowns))):
            return "the matrix inequality does not hold at a corner"
    return ""


def prove_function(
    forms: Forms,
    solution: Minimiser,
    wanted: Sequence[tuple[int, int]],
    rows: Sequence[np.ndarray],
) -> FunctionProof | None:
    """Round what the solver returned so that exact arithmetic confirms it; None if it does not.

    Parameters
    ----------
    forms : Forms
        In exact rationals.
    solution : Minimiser
    wanted : pairs (error, side)
    rows : arrays
        Over the errors.
    """
    u, size = solution.unknowns, forms.size
    speed = max(float(np.abs(c.F.astype(float)).sum(axis=1).max()) for c in forms.corners)
    room = len(u.inputs) + len(u.sectors) + len(u.turns)
    for part in FUNCTION_BACK_OFF:
        more = part * speed
        inputs, sectors = (np.maximum(v, 0.0) + more for v in (u.inputs, u.sectors))
        squares = np.maximum(u.squares, 0.0)
        scales = u.scales + more * np.tile(DIAGONAL, len(u.turns) // 3)
        margin = part + 2 * more * room / u.alpha
        G = (u.G + u.G.T) / 2 + FLOOR_PART * part * np.eye(size + 1)
        G[-1, -1] -= margin
        claims = [
            RowBound(
                error, side, decimal_text(scale), decimal_text(scale * (bound + margin + part))
            )
            for (error, side), scale, bound in zip(
                wanted, solution.sizes, solution.bounds, strict=True
            )
        ]
        vectors = (squares, inputs, sectors, u.mu, scales, u.turns)
        texts = {
            name: tuple(map(decimal_text, vector))
            for name, vector in zip(MULTIPLIERS, vectors, strict=True)
        }
        lines = tuple(tuple(decimal_text(v) for v in line) for line in G)
        proof = FunctionProof(alpha=decimal_text(u.alpha), G=lines, claims=tuple(claims), **texts)
        if not failed_part(forms, proof, rows):
            return proof
    return None


def proven_definite(matrix: np.ndarray) -> bool:
    """Whether a rational matrix is proven to be positive definite.

    A congruence by the inverse of its Cholesky factor, in floats, leaves nearly the identity; what
    it leaves exactly must be dominated by its diagonal.
    """
    try:
        factor = np.linalg.cholesky(matrix.astype(float))
        inverse = solve_triangular(factor, np.eye(len(matrix)), lower=True)
    except (np.linalg.LinAlgError, ValueError, OverflowError):
        return False
    if not np.isfinite(inverse).all():
        return False
    left = flint.fmpq_mat(
        [[flint.fmpq(*float(v).as_integer_ratio()) for v in row] for row in inverse]
    )
    product = left * flint.fmpq_mat([list(row) for row in matrix]) * left.transpose()
    rows = product.tolist()
    return all(2 * row[i] > sum((abs(v) for v in row), flint.fmpq(0)) for i, row in enumerate(rows))
