"""What a certificate rests on, as texts, and the numbers that are rounded for it."""

from __future__ import annotations

from collections.abc import Mapping

import sympy

from certrack.certificates.stated import stated_error_system
from certrack.core.errors import InputError
from certrack.laws.error_system import KnownParameters
from certrack.references.base import bound_of
from certrack.systems.system import System


def assumptions(system: System) -> list[str]:
    """What a certificate of `system` rests on, as texts; format 1 of the saved one holds them."""
    plant, truth = system.plant, system.truth
    q = system.law.order(plant)
    listed = ", ".join(_known_bounds(system, q + 1)) or "whatever values"
    premises = [
        "|w_k| <= gamma_k ||x|| + beta_k (Assumption 1) with the file's tau, gamma, beta",
        f"every reference with {listed}",
        "chain, linear, drift and regressor exactly as in the file",
    ]
    if truth.states:
        premises.append(
            "the simulated plant, which has states of its own, differing from the design's by no "
            "more than w, that is within gamma and beta; nothing here checks this"
        )
    if isinstance(stated_error_system(system, integral=True, moving=True), KnownParameters):
        premises.append("g_n and theta exactly as the law uses them")
        return premises + _irrational(system)
    if plant.input_gain_range:
        low, high = plant.input_gain_range
        premises.append(f"every g_n in [{low:g}, {high:g}]")
    else:
        premises.append(f"the true g_n = {truth.input_gain} (the file gives no range)")
    if plant.r:
        premises.append(
            "every theta in its range"
            if plant.theta_range
            else "the true theta of the file (it gives no range)"
        )
    return premises + _irrational(system)


def _known_bounds(system: System, order: int) -> list[str]:
    """Bounds of the derivatives that have one; of others no certificate has made use."""
    texts = []
    for i in range(order + 1):
        try:
            value, origin = bound_of(system.reference, i)
        except InputError:
            continue
        texts.append(f"|y_d^({i})| <= {value:.6g} ({origin})")
    return texts


def irrational_numbers(system: System) -> list[str]:
    """Texts of the numbers that exact arithmetic must take by their floats."""
    plant, truth = system.plant, system.truth
    numbers = [*plant.chain, *(v for row in plant.linear or () for v in row), *truth.theta]
    numbers += [*(plant.theta or ()), *filter(None, [truth.input_gain, plant.input_gain])]
    texts = {v.text for v in numbers if not v.expr.is_Rational}
    if plant.constant_ranges:  # only then does a proof take the numbers of drift and regressor
        values = plant.constant_values
        texts |= {
            f"{name} = {value}"
            for name, value in plant.constants
            if name in plant.constant_boxes and not values[name].is_Rational
        }
        numbers = [plant.drift, *plant.regressor]
        texts |= {v.text for v in numbers if _has_irrational_numbers(v.expr, values)}
    return sorted(texts)


def _has_irrational_numbers(formula: sympy.Expr, values: Mapping[str, sympy.Expr]) -> bool:
    used = [values[str(s)] for s in formula.free_symbols if str(s) in values]
    parts = (part for expr in (formula, *used) for part in sympy.preorder_traversal(expr))
    return any(part.is_number and not part.is_Rational for part in parts)


def _irrational(system: System) -> list[str]:
    rounded = irrational_numbers(system)
    return [f"irrational numbers rounded to 17 digits: {', '.join(rounded)}"] if rounded else []
