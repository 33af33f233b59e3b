"""The exact proof of one bound of a stage: numbers as decimal texts, and their check."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import flint
import numpy as np
from scipy.linalg import solve_triangular

from certrack.certificates.bootstrap.box import Ground
from certrack.certificates.bootstrap.forms import Forms
from certrack.certificates.bootstrap.inequality import (
    Unknowns,
    corner_form,
    shared_form,
    target_form,
)
from certrack.certificates.bootstrap.program import Found
from certrack.certificates.exact import decimal_text, from_text

#: How far a solution gives way until exact arithmetic confirms it, in the units of a box's radius.
BACK_OFF = (1e-7, 1e-6, 1e-5, 1e-4)

#: Part of it that is added to G, so that W + bound - row is positive definite.
FLOOR_PART = 1e-2


@dataclass(frozen=True)
class BoundProof:
    """limsup side * row (z) <= bound, in decimal texts.

    Attributes
    ----------
    error : int
        Which row: of the n + r + 1 errors, from 0, or the linear row of ubar behind them.
    side : int
        1 for an upper bound, -1 for the bound of what is negated.
    bound, alpha : str
    G : rows of texts
    squares, inputs, sectors, mu : texts
    """

    error: int
    side: int
    bound: str
    alpha: str
    G: tuple[tuple[str, ...], ...]
    squares: tuple[str, ...]
    inputs: tuple[str, ...]
    sectors: tuple[str, ...]
    mu: tuple[str, ...]

    def unknowns(self) -> Unknowns:
        """The numbers, exact."""
        vectors = [_vector(getattr(self, name)) for name in ("squares", "inputs", "sectors", "mu")]
        G = np.array([[from_text(v) for v in row] for row in self.G], dtype=object)
        return Unknowns(from_text(self.alpha), G, *vectors)


@dataclass(frozen=True)
class BootstrapStage:
    """What a stage stands on, and what it proves."""

    ground: Ground
    bounds: tuple[BoundProof, ...]


def _vector(texts: tuple[str, ...]) -> np.ndarray:
    return np.array([from_text(v) for v in texts], dtype=object)


def row_over_box(forms: Forms, row: np.ndarray) -> np.ndarray:
    """A row over the errors z as one over (zeta, 1)."""
    return np.append(row * forms.radius, _inner(row, forms.middle))


def _inner(row: np.ndarray, values: np.ndarray) -> Any:
    return sum((a * b for a, b in zip(row, values, strict=True)), 0 * values[0])


def failed_condition(forms: Forms, proof: BoundProof, row: np.ndarray) -> str:
    """Empty if the proof holds (exactly) for the side of `row`, else the first that fails."""
    unknowns = proof.unknowns()
    size, width = forms.size, forms.width
    counts = (len(forms.squares), width - size - 1, len(forms.sectors), width)
    found = [len(getattr(unknowns, name)) for name in ("squares", "inputs", "sectors", "mu")]
    if unknowns.G.shape != (size + 1, size + 1) or tuple(found) != counts:
        return "G or the multipliers do not have the shape of the loop"
    if not (unknowns.G == unknowns.G.T).all():
        return "G is not symmetric"
    if not unknowns.alpha > 0:
        return "alpha is not positive"
    if any(v < 0 for v in (*unknowns.squares, *unknowns.inputs, *unknowns.sectors)):
        return "a multiplier is negative"
    target = target_form(unknowns.G, row_over_box(forms, row), from_text(proof.bound))
    if not proven_definite(target):
        return "the function is below what it shall bound"
    shared = shared_form(forms, unknowns)
    for corner in forms.corners:
        if not proven_definite(-(shared + corner_form(forms, corner, unknowns))):
            return "the matrix inequality does not hold at a corner"
    return ""


def prove(forms: Forms, found: Found, error: int, side: int, row: np.ndarray) -> BoundProof | None:
    """Round what the solver found so that exact arithmetic confirms it; None if it does not.

    Parameters
    ----------
    forms : Forms
        In exact rationals.
    found : Found
    error, side : int
    row : array
        Over the errors, with its side.
    """
    u, size = found.unknowns, forms.size
    speed = max(
        float(np.abs(corner.F.astype(float)).sum(axis=1).max()) for corner in forms.corners
    )
    radius = float(np.abs((row * forms.radius).astype(float)).sum())
    for part in BACK_OFF:
        extra = part * radius
        floor = FLOOR_PART * extra / max(speed, u.alpha)
        inputs, sectors = (np.maximum(v, 0.0) + extra * speed for v in (u.inputs, u.sectors))
        squares = np.maximum(u.squares, 0.0)
        margin = extra * (1 + 2 * speed * (len(inputs) + len(sectors)) / u.alpha)
        G = (u.G + u.G.T) / 2 + floor * np.eye(size + 1)
        G[-1, -1] -= margin
        proof = BoundProof(
            error=error,
            side=side,
            bound=decimal_text(found.bound + margin + extra),
            alpha=decimal_text(u.alpha),
            G=tuple(tuple(decimal_text(v) for v in line) for line in G),
            squares=tuple(map(decimal_text, squares)),
            inputs=tuple(map(decimal_text, inputs)),
            sectors=tuple(map(decimal_text, sectors)),
            mu=tuple(map(decimal_text, u.mu)),
        )
        if not failed_condition(forms, proof, row):
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
    except (np.linalg.LinAlgError, ValueError):
        return False
    if not np.isfinite(inverse).all():
        return False
    left = flint.fmpq_mat(
        [[flint.fmpq(*float(v).as_integer_ratio()) for v in row] for row in inverse]
    )
    product = left * flint.fmpq_mat([list(row) for row in matrix]) * left.transpose()
    rows = product.tolist()
    return all(
        2 * row[i] > sum((abs(v) for v in row), flint.fmpq(0)) for i, row in enumerate(rows)
    )


