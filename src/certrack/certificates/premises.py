"""What a certificate rests on, and the systems for which it would not hold."""

from __future__ import annotations

from certrack.certificates.arithmetic import rational
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.stated import stated_error_system
from certrack.laws.error_system import ErrorSystem, EstimatedParameters, KnownParameters
from certrack.systems.system import System


def refuse(system: System) -> None:
    """Raise NoCertificate, with the reason, where no certificate of this room can hold."""
    plant, stated = system.plant, stated_error_system(system)
    if system.truth.states:
        _refuse_unknown_ranges(system, stated)
    if isinstance(stated, KnownParameters):
        used = (stated.g_n, *stated.theta)
        ranges = (plant.input_gain_range, *(plant.theta_range or (None,) * plant.r))
        if any(
            rational(end) != rational(value)
            for value, box in zip(used, ranges, strict=True)
            for end in box or ()
        ):
            raise NoCertificate(
                "the robust law is proven for the exact input_gain and theta it uses, but "
                "plant.ranges lets them vary; use the adaptive law"
            )


def _refuse_unknown_ranges(system: System, stated: ErrorSystem) -> None:
    """A truth with states of its own tells the adaptive law no true g_n and theta."""
    plant = system.plant
    ranged = plant.input_gain_range and (plant.theta_range or not plant.r)
    if isinstance(stated, EstimatedParameters) and not ranged:
        raise NoCertificate(
            "a truth with states of its own has no g_n and theta to be certified for; state "
            "plant.ranges"
        )


def assumptions(system: System) -> list[str]:
    """What a certificate of `system` rests on, as texts; format 1 of the saved one holds them."""
    plant, truth = system.plant, system.truth
    q = system.law.order(plant)
    bounds = system.reference.bounds(q + 1)
    listed = ", ".join(
        f"|y_d^({i})| <= {value:.6g} ({origin})"
        for i, (value, origin) in enumerate(zip(bounds.values, bounds.origin, strict=True))
    )
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
    if isinstance(stated_error_system(system), KnownParameters):
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


def irrational_numbers(system: System) -> list[str]:
    """Texts of the numbers that exact arithmetic must take by their floats."""
    plant, truth = system.plant, system.truth
    numbers = [*plant.chain, *(v for row in plant.linear or () for v in row), *truth.theta]
    numbers += [*(plant.theta or ()), *filter(None, [truth.input_gain, plant.input_gain])]
    return sorted({v.text for v in numbers if not v.expr.is_Rational})


def _irrational(system: System) -> list[str]:
    rounded = irrational_numbers(system)
    return [f"irrational numbers rounded to 17 digits: {', '.join(rounded)}"] if rounded else []
