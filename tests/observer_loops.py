"""Random loops on drives whose controllers have observers, integrals and sampled feed-forward."""

from dataclasses import replace

from certrack.core.errors import InputError
from certrack.laws.observer import DOB, ESO, KALMAN, Observer


def with_estimates(system, rng):
    """The system with a random observer, maybe an integral; None where it has no such estimates."""
    law, drive, plant = system.law, system.implementation, system.plant
    states, drift = plant.states, plant.drift.expr
    without = drift - drift.xreplace(dict.fromkeys(plant.symbols, 0))  # a constant is refused
    plant = replace(plant, drift=str(without))
    kind = str(rng.choice([KALMAN, ESO, DOB]))
    speed = round(float(rng.uniform(0.5, 4) * max(law.c)), 3)
    rows = () if kind == KALMAN or rng.random() < 0.6 else (str(rng.choice(states)), states[-1])
    observer = Observer(kind=kind, bandwidth=speed, rows=tuple(dict.fromkeys(rows)))
    if kind != DOB:
        drive = replace(drive, velocity_filter=0.0)
    integral = round(float(rng.uniform(0.3, 1) * min(law.c)), 3) if rng.random() < 0.3 else None
    law = replace(law, observer=observer, integral=integral)
    law = replace(law, sampled_feedforward=bool(rng.random() < 0.5))
    drive = replace(drive, initial_input=float(rng.choice([0, 0.3])))
    try:
        return system.replace(plant=plant, law=law, implementation=drive)
    except InputError:  # what acts on these rows cannot be told apart
        return None
