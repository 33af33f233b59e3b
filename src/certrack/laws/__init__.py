"""Control laws: one law, one file, side by side with its equations.

Whoever writes a law finds all names here: :class:`Law` with :class:`Equations` and
:class:`Signals`, the fields :func:`gain`, :func:`theta_vector` and :func:`theta_metric` with the
values :func:`vector` and :func:`metric`, :func:`symbol`, :func:`dot`, :class:`Plant`, the errors,
:func:`register`, and the error systems that a law may state: :class:`KnownParameters`,
:class:`EstimatedParameters` and :class:`OwnErrors`.
"""

from certrack.core.errors import DesignError, InputError
from certrack.core.expressions import TIME, symbol
from certrack.laws.adaptive import Adaptive
from certrack.laws.base import Controller, Law, gain, theta_metric, theta_vector
from certrack.laws.classic import Classic
from certrack.laws.equations import Equations
from certrack.laws.error_system import EstimatedParameters, KnownParameters, OwnErrors
from certrack.laws.linear import Linear
from certrack.laws.lqr import LqrWeights
from certrack.laws.numbers import metric, vector
from certrack.laws.online import Online
from certrack.laws.registry import LAWS, known_laws
from certrack.laws.registry import register_law as register
from certrack.laws.robust import Robust
from certrack.laws.signals import Signals, dot
from certrack.model.plant import Plant

__all__ = [
    "LAWS",
    "TIME",
    "Adaptive",
    "Classic",
    "Controller",
    "DesignError",
    "Equations",
    "EstimatedParameters",
    "InputError",
    "KnownParameters",
    "Law",
    "Linear",
    "LqrWeights",
    "Online",
    "OwnErrors",
    "Plant",
    "Robust",
    "Signals",
    "dot",
    "gain",
    "known_laws",
    "metric",
    "register",
    "symbol",
    "theta_metric",
    "theta_vector",
    "vector",
]
