"""Collocation: states as polynomials on elements, the input a line on each.

On every element of a mesh the input is a straight line, which may jump to the next one, and each
state is a polynomial of degree d that obeys x' = f(t, x, u) at d points inside; it is continuous
from element to element. Integrals are sums over the same points. With Gauss points both are of
order 2 d; with those of Radau, the last of which is the end, of order 2 d - 1, and what decays
within an element decays in the polynomials, too: dry friction, rounded, is as stiff as that.

Source: L. T. Biegler, Nonlinear Programming, SIAM 2010, chapter 10.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import Legendre, Polynomial

from certrack.core.arrays import Array

#: Degree of the polynomials, and Gauss points in an element.
COLLOCATION_DEGREE = 3


@dataclass(frozen=True)
class CollocationScheme:
    """Collocation on [0, 1].

    Attributes
    ----------
    nodes : (d,) array
        The points.
    slopes : (d + 1, d) array
        Weights that give x' at the nodes from x at 0 and at the nodes.
    last : (d + 1,) array
        Weights that give x at 1 from the same.
    weights : (d,) array
        Of the quadrature.
    """

    nodes: Array
    slopes: Array
    last: Array
    weights: Array


def gauss_scheme(degree: int = COLLOCATION_DEGREE) -> CollocationScheme:
    """The scheme of a degree.

    Parameters
    ----------
    degree : int
    """
    points, weights = np.polynomial.legendre.leggauss(degree)
    return _scheme((points + 1) / 2, weights / 2)


def radau_scheme(degree: int = COLLOCATION_DEGREE) -> CollocationScheme:
    """The scheme of a degree whose last point is the end: stiffly accurate.

    Parameters
    ----------
    degree : int
    """
    points = Legendre([*(0.0,) * (degree - 1), -1.0, 1.0]).roots().real
    nodes = np.append((np.sort(points)[:-1] + 1) / 2, 1.0)
    integrals = [polynomial.integ() for polynomial in _lagrange_basis(nodes)]
    return _scheme(nodes, np.array([integral(1.0) - integral(0.0) for integral in integrals]))


def _scheme(nodes: Array, weights: Array) -> CollocationScheme:
    basis = _lagrange_basis(np.append(0.0, nodes))
    slopes = np.array([polynomial.deriv()(nodes) for polynomial in basis])
    last = np.array([polynomial(1.0) for polynomial in basis])
    return CollocationScheme(nodes, slopes, last, weights)


def _lagrange_basis(points: Array) -> list[Polynomial]:
    """Polynomials that are 1 at one of the points and 0 at the others."""
    basis = []
    for j, at in enumerate(points):
        through_others = Polynomial.fromroots(np.delete(points, j))
        basis.append(through_others / through_others(at))
    return basis


@dataclass(frozen=True)
class CollocationGrid:
    """A mesh with its collocation points.

    Attributes
    ----------
    ends : (E + 1,) array, s
        Of the elements.
    scheme : CollocationScheme
    """

    ends: Array
    scheme: CollocationScheme

    @property
    def elements(self) -> int:
        """Their number E."""
        return len(self.ends) - 1

    @cached_property
    def lengths(self) -> Array:
        """Of the elements, s."""
        return np.diff(self.ends)

    @cached_property
    def times(self) -> Array:
        """The collocation points, (d, E) array, s."""
        return self.ends[:-1] + self.scheme.nodes[:, None] * self.lengths
