"""What is known of the centred stage of a design nearby, and when it is tried or searched again.

A look beside a known cascade is quick because it does not search: it goes on from the centre that
was best. That centre moves with the gains, and by more than they do where it ends at a kink.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from certrack.certificates.problem import ErrorProblem
from certrack.certificates.semidefinite import Solution

#: A quick look follows a centred stage that lowers the bound of e_n by at least this part; another
#: one once that bound has moved by so much since the stage was tried.
LEAST_WORTH, TRIED_AGAIN = 3e-3, 0.03

#: Where the logarithm of a gain has changed by so much since the stage was searched for, it is
#: searched for anew, since the best kappa may have ten times the size; a quick look waits longer.
SEARCHED_AGAIN, QUICKLY_AGAIN = 0.25, 0.7


@dataclass(frozen=True)
class KnownStage:
    """The centred stage where it was tried last.

    Attributes
    ----------
    shift : float
        kappa; 0 where none is better than no centre.
    alpha : float, 1/s
    worth : float
        The part by which it lowered the bound of e_n; 0 where it did not, or helped no one.
    without : float
        That bound without it.
    searched : array
        What the gains were (:func:`sizes_of_gains`) where all of kappa was searched.
    """

    shift: float
    alpha: float
    worth: float
    without: float
    searched: np.ndarray = field(compare=False)

    def is_followed(self, last: Solution) -> bool:
        """Whether a quick look tries it beside `last`, which bounds e_n without it."""
        moved = abs(last.bound - self.without) > TRIED_AGAIN * self.without
        return self.shift != 0 and (self.worth > LEAST_WORTH or moved)

    def is_far(self, sizes: np.ndarray, quick: bool) -> bool:
        """Whether all of kappa is searched again, for gains of these sizes."""
        if len(sizes) != len(self.searched):
            return True
        moved = np.abs(sizes - self.searched).max()
        return bool(moved > (QUICKLY_AGAIN if quick else SEARCHED_AGAIN))


def sizes_of_gains(problem: ErrorProblem) -> np.ndarray:
    """Numbers that change by about the part by which a gain does, logarithms but for the guesses.

    Parameters
    ----------
    problem : ErrorProblem
        Of the adaptive law.
    """
    adaptation = problem.adaptation
    assert adaptation is not None
    rates = adaptation.gain_rate, adaptation.leak_gain, adaptation.leak_theta
    positive = np.concatenate([np.diag(problem.M), rates, np.diag(adaptation.Gamma)])
    guesses = np.append(adaptation.theta0, adaptation.delta0 * adaptation.gains[0])
    return np.append(np.log(np.abs(positive.astype(float))), np.arcsinh(guesses.astype(float)))
