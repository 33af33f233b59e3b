"""Which systems have a certificate at all, and whether it must hold for more than one loop."""

from __future__ import annotations

from certrack.certificates.arithmetic import rational
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.stated import stated_error_system
from certrack.laws.error_system import ErrorSystem, EstimatedParameters, KnownParameters
from certrack.model.uncertainty import Uncertainty
from certrack.systems.system import System


def refuse(system: System) -> None:
    """Raise NoCertificate, with the reason, where no certificate of the nominal loop can hold."""
    ranged = ranged_names(system, refuse_unknown(system))
    if ranged:
        raise NoCertificate(
            f"plant.ranges lets {', '.join(ranged)} vary: only vertices, cells and peak can cover "
            "it"
        )
    refuse_formulas(system.plant.uncertainty)


def refuse_formulas(uncertainty: Uncertainty) -> None:
    """Raise NoCertificate where a bound of w_k is a formula: of the sampled loop only."""
    if uncertainty.bound is not None:
        raise NoCertificate(
            "plant.uncertainty.bound is covered for the loop as implemented only: state "
            "[implementation], and no plant.ranges"
        )


def ranged_names(system: System, stated: ErrorSystem) -> list[str]:
    """What has a range that the nominal loop does not cover."""
    ranged = [name for name, _, _ in system.plant.constant_ranges]
    if isinstance(stated, KnownParameters):
        ranged += _open_parameters(system, stated)
    return ranged


def refuse_unknown(system: System, *, integral: bool = False) -> ErrorSystem:
    """Raise NoCertificate where no certificate of this room can hold; what the law states.

    With `integral`, a law with integral action is not refused.
    """
    stated = stated_error_system(system, integral=integral)
    if system.truth.states:
        _refuse_unknown_ranges(system, stated)
    return stated


def has_ranges(system: System) -> bool:
    """Whether a certificate must cover more than the nominal loop."""
    if system.plant.constant_ranges:
        return True
    try:
        stated = stated_error_system(system, integral=True)
    except NoCertificate:
        return False
    return isinstance(stated, KnownParameters) and bool(_open_parameters(system, stated))


def _open_parameters(system: System, stated: KnownParameters) -> list[str]:
    """What the robust law takes for known, although it has a range."""
    plant = system.plant
    names = ["input_gain", *(f"theta[{i}]" for i in range(plant.r))]
    boxes = (plant.input_gain_range, *(plant.theta_range or (None,) * plant.r))
    return [
        name
        for name, value, box in zip(names, (stated.g_n, *stated.theta), boxes, strict=True)
        if any(rational(end) != rational(value) for end in box or ())
    ]


def _refuse_unknown_ranges(system: System, stated: ErrorSystem) -> None:
    """A truth with states of its own tells the adaptive law no true g_n and theta."""
    plant = system.plant
    ranged = plant.input_gain_range and (plant.theta_range or not plant.r)
    if isinstance(stated, EstimatedParameters) and not ranged:
        raise NoCertificate(
            "a truth with states of its own has no g_n and theta to be certified for; state "
            "plant.ranges"
        )
