"""Collocation at Gauss points: states as polynomials on elements, the input a line on each.

On every element of a mesh the input is a straight line, which may jump to the next one, and each
state is a polynomial of degree d that obeys x' = f(t, x, u) at the d Gauss points inside; it is
continuous from element to element. Integrals are sums over the same points. Both are of order 2 d.

Source: L. T. Biegler, Nonlinear Programming, SIAM 2010, chapter 10.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import Polynomial

from certrack.core.arrays import Array

#: Degree of the polynomials, and Gauss points in an element.
COLLOCATION_DEGREE = 3


@dataclass(frozen=True)
class CollocationScheme:
    """Collocation on [0, 1].

    Attributes
    ----------
    nodes : (d,) array
        The Gauss points.
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
    nodes = (points + 1) / 2
    basis = []
    for j, at in enumerate(every := np.append(0.0, nodes)):
        through_others = Polynomial.fromroots(np.delete(every, j))
        basis.append(through_others / through_others(at))
    slopes = np.array([polynomial.deriv()(nodes) for polynomial in basis])
    last = np.array([polynomial(1.0) for polynomial in basis])
    return CollocationScheme(nodes, slopes, last, weights / 2)


@dataclass(frozen=True)
class CollocationGrid:
    """A mesh with its Gauss points.

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
        """The Gauss points, (d, E) array, s."""
        return self.ends[:-1] + self.scheme.nodes[:, None] * self.lengths
