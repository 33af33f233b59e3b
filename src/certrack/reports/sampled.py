"""What is said of the loop as the drive runs it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from certrack.certificates.implemented.certify import (
    INACTIVE,
    MAY_ACT,
    NO_LIMITS,
    ImplementedCertificate,
)
from certrack.certificates.implemented.step_search import RATES_PART
from certrack.certificates.sampled_adaptive.certify import SampledAdaptiveCertificate
from certrack.core.rounding import rounded_down, rounded_up


def for_starts(sampled: ImplementedCertificate) -> str:
    """For which starts a bound is proven, in words; nothing for all."""
    if sampled.starts == "x0":
        return ", from x0" + (" and the proven polytope" if sampled.polytope is not None else "")
    if sampled.starts == "box":
        return ", from x0 and the proven box of starts"
    return ""


def implemented_summary(sampled: ImplementedCertificate) -> dict[str, Any]:
    """What a certificate of the implemented loop has besides others, ready for JSON."""
    return {
        "peak_input": sampled.peak_input,
        "states": list(sampled.states),
        "saturation": sampled.saturation,
        "starts": sampled.starts,
        "peaks": None if sampled.peaks is None else asdict(sampled.peaks),
        "polytope": _polytope(sampled),
        "parts": dict(sampled.parts),
        "cells": sampled.cells,
        "margins": None if sampled.margins is None else asdict(sampled.margins),
        "slow": list(sampled.slow),
        "rates_unused": sampled.rates_unused,
    }


def _polytope(sampled: ImplementedCertificate) -> dict[str, Any] | None:
    """Starts from which no limit is met, without its rows."""
    polytope = sampled.polytope
    if polytope is None:
        return None
    return {
        "half_spaces": len(polytope.rows),
        "region": polytope.region,
        "largest_box": polytope.largest_box(),
    }


def sampled_summary(sampled: SampledAdaptiveCertificate) -> dict[str, Any]:
    """What a certificate of the adaptive law as implemented has besides others."""
    return {
        "starts": list(sampled.starts),
        "estimates": [list(pair) for pair in sampled.estimates],
        "from_file": sampled.from_file,
    }


def from_its_starts(sampled: SampledAdaptiveCertificate) -> str:
    """For which starts it is, in words."""
    return "from its start" if sampled.from_file else "from starts near the reference"


def sampled_notes(sampled: SampledAdaptiveCertificate, digits: int) -> list[str]:
    """What is proven of the adaptive law as the drive runs it."""
    if not sampled.verified:
        return []
    errors = [f"|e_{i + 1}(0)| <= {rounded_down(v, 4)}" for i, v in enumerate(sampled.starts)]
    delta, *thetas = (f"[{low:g}, {high:g}]" for low, high in sampled.estimates)
    named = [f"delta_hat(0) in {delta}"]
    named += [f"theta_hat_{i + 1}(0) in {pair}" for i, pair in enumerate(thetas)]
    whose = "the file's own start is one of them"
    if not sampled.from_file:
        whose = "the file's own start is not proven to be one of them, and nothing is said of it"
    return [
        f"the adaptive law as implemented: limsup |e_1| <= {rounded_up(sampled.bound, digits)}, "
        f"between its samples too, from {', '.join((*errors, *named))}; {whose}"
    ]


def implemented_notes(sampled: ImplementedCertificate, digits: int) -> list[str]:
    """What is known of the loop as the drive runs it, and which bound to ship with."""
    contradicted = not sampled.verified and not sampled.reason
    if not sampled.exists or contradicted:  # nothing to ship with where a premise is broken
        return []
    bound, peak, *states = (
        rounded_up(v, digits) for v in (sampled.bound, sampled.peak_input, *sampled.states)
    )
    ship = (
        f"ship with implemented: limsup |e_1| <= {bound} holds for the sampled loop, between its "
        f"samples too{for_starts(sampled)}; the others speak of the continuous law"
    )
    if not sampled.verified:
        ship = (
            f"the sampled loop is not verified: {sampled.reason}; |e_1| <= {bound} in the long "
            "run where no limit is met any more"
        )
    if sampled.cells:
        count = "one cell" if sampled.cells == 1 else f"{sampled.cells} cells"
        ship += f"; proven for all constants in plant.ranges, in {count}"
    return [
        ship,
        f"as implemented, in the long run: |u| <= {peak}, {_listed(states)}",
        *_rate_notes(sampled, digits),
        *_margin_notes(sampled, digits),
        *_start_notes(sampled, digits),
    ]


def _rate_notes(sampled: ImplementedCertificate, digits: int) -> list[str]:
    """Which uncertain terms are slow, and what that takes off the bound."""
    if sampled.rates_unused:
        return [f"plant.uncertainty.rate takes nothing off the bound: {sampled.rates_unused}"]
    if not sampled.slow:
        return []
    terms = f"{', '.join(sampled.slow)} {'is' if len(sampled.slow) == 1 else 'are'}"
    plain = rounded_up(sampled.bound - sampled.parts[RATES_PART], digits)
    return [f"as implemented, {terms} slow and estimated: without the rates |e_1| <= {plain}"]


def _margin_notes(sampled: ImplementedCertificate, digits: int) -> list[str]:
    """The slowest and the fastest period."""
    margins = sampled.margins
    if margins is None:
        return []
    slow = "slowest tried" if margins.slower_untried else "slowest"
    fast = "fastest tried" if margins.faster_untried else "fastest"
    return [
        "as implemented, sampling margins: in the long run also proven, within "
        f"{rounded_up(margins.bound, digits)}, at a period of {margins.slowest:g} s ({slow}) and "
        f"of {margins.fastest:g} s ({fast})"
    ]


def _start_notes(sampled: ImplementedCertificate, digits: int) -> list[str]:
    """Peaks from x0, and from where the limits of the input are never met."""
    lines, peaks, polytope = [], sampled.peaks, sampled.polytope
    if peaks is not None:
        error, size, *states = (
            rounded_up(v, digits) for v in (peaks.error, peaks.input, *peaks.states)
        )
        limits = {INACTIVE: "; its limits are never met", MAY_ACT: ", if no limit acts"}
        lines.append(
            f"as implemented, from x0, at all times: |u| <= {size}, |e_1| <= {error}, "
            f"{_listed(states)}{limits.get(sampled.saturation, '')}"
        )
    if polytope is not None:
        region = " x ".join(_ends(*pair) for pair in polytope.region)
        if sampled.saturation == NO_LIMITS:
            lines.append(f"largest box of starts that is proven, for any reference: {region}")
        elif polytope.is_region:
            lines.append(f"no limit of the input is met from any start of the proven box {region}")
        elif (box := polytope.largest_box()) is not None:
            ends = (_ends(*pair) for pair in box)
            lines.append(
                "no limit of the input is met from starts in the proven polytope, whose largest "
                f"box is {' x '.join(ends)}; from elsewhere they may be met"
            )
    return lines


def _ends(low: float, high: float) -> str:
    return f"[{-float(rounded_down(-low, 4)):g}, {rounded_down(high, 4)}]"


def _listed(states: Sequence[str]) -> str:
    return ", ".join(f"|x_{i + 1}| <= {v}" for i, v in enumerate(states))
