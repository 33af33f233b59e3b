"""How large a state of the plant becomes in the long run, at most.

As the input, a state is a row over errors and reference,

    x_i = row e + sum_j c_j y_j,    row and c_j from x = A^-1 (e + B Y),    |y_j| <= 1

so of every law whose parameters are known, with V' <= -alpha V + Delta and P >= row^T row,

    limsup |x_i(t)| <= sqrt(2 Delta/alpha) + sum_j |c_j|

which is proven in exact rationals, as the bounds of the input are.
"""

from __future__ import annotations

import numpy as np

from certrack.certificates.arithmetic import exact_float, rational
from certrack.certificates.certificate import NoCertificate, within_floats
from certrack.certificates.formulation import error_coordinates, error_problem
from certrack.certificates.input_bounds import InputBound, ultimate_bound
from certrack.certificates.input_problem import InputProblem, with_all_derivatives
from certrack.references.base import bound_of
from certrack.systems.system import System


def certify_state(system: System, i: int) -> InputBound:
    """A bound on limsup |x_i(t)|, verified exactly.

    It rests on the premises of the certificates of the continuous law.

    Parameters
    ----------
    system : System
    i : int
        Number of the state, from 0.

    Returns
    -------
    InputBound
        Unit of the state.

    Raises
    ------
    NoCertificate
        Where the law does not know its parameters, or no proof is found.
    """
    with within_floats():
        ultimate = ultimate_bound(system, state_problem(system, i))
    if ultimate is None:
        raise NoCertificate("no proof was found")
    return ultimate


def state_problem(system: System, i: int) -> InputProblem:
    """The error system of a system, and a state's row beside it.

    Raises
    ------
    NoCertificate
        If the law does not know its parameters, or the error system is not covered.
    """
    if system.law.online is not None:
        raise NoCertificate("of gains that stand still only, and law.online moves them")
    exact = error_problem(system, rational)
    if exact.adaptation is not None:
        raise NoCertificate("of a law of known parameters only")
    design = error_coordinates(system, rational)
    Y = [exact_float(bound_of(system.reference, j)[0], rational) for j in range(design.q + 2)]
    through = np.zeros(len(Y), dtype=object) + rational(0)
    through[:-1] = (exact.Xe @ design.B)[i] * np.array(Y[:-1], dtype=object)
    problem = with_all_derivatives(exact, design, Y)
    return InputProblem(problem, exact.Xe[i], through, rational(0))
