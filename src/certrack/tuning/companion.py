"""The loop in continuous time beside a system's own: without what only its controller has."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from certrack.laws.base import Law
from certrack.model.plant import Plant
from certrack.systems.system import System


def is_memoryless(law: Law) -> bool:
    """Whether nothing of the law belongs to its sampled controller, or is a memory of its own."""
    return law.observer is None and law.integral is None and not law.sampled_feedforward


def plain_law(law: Law, plant: Plant) -> Law:
    """The law without observer, integral action and sampled feed-forward."""
    changes: dict[str, Any] = {}
    if law.observer is not None:
        changes["observer"] = None
    if law.integral is not None:
        changes["integral"] = None
    if law.sampled_feedforward:
        changes |= {
            "sampled_feedforward": False,
            "feedforward": min(law.feedforward, plant.n - 1),
        }
    return replace(law, **changes)


def with_law_of(system: System, law: Law) -> System:
    """The system with another law, and no starts of estimates that this one does not have."""
    settings, population = system.settings, system.population
    if len(law.design(system.plant).states) != len(system.controller.states):
        settings = replace(settings, estimates=None)
        if population is not None:
            population = replace(population, estimates=None)
    return system.replace(law=law, settings=settings, population=population)


def companion(system: System) -> System:
    """The system with the plain law, in continuous time."""
    return with_law_of(system.replace(implementation=None), plain_law(system.law, system.plant))
