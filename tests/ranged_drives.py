"""Random drives whose constants have ranges, and members of them, attacked by their kernels."""

import json
from dataclasses import replace

import numpy as np
from sampled_attack import worst_error

from certrack.systems.reader import loads


def random_ranged_drive(rng):
    """A plant of order 2 or 3 with one to three ranged constants; its reference's numbers."""
    n = int(rng.integers(2, 4))
    names = [f"x{i + 1}" for i in range(n)]
    count = int(rng.integers(1, 4))
    nominal = [round(float(rng.uniform(0.6, 2.0)), 3) for _ in range(3)]
    half = [round(float(rng.uniform(0.03, 0.2)), 3) for _ in range(3)]
    gain = round(float(rng.choice([-1, 1]) * rng.uniform(1, 4)), 3)
    chain = [round(float(rng.uniform(0.5, 2)), 3) for _ in names[1:]]
    linear = [
        [round(float(rng.uniform(-2, 2) * (rng.random() < 0.6)), 3) for _ in range(i + 1)]
        for i in range(n - 1)
    ]
    drift = " + ".join(f"({rng.uniform(-4, 4):.3f})*{x}" for x in names)
    drift += f" + {rng.uniform(-2, 2):.3f}*k1*x1"
    drift += f" - {rng.uniform(0, 1):.3f}/k1" if rng.random() < 0.5 else ""
    formula = f"{gain}*k2" if rng.random() < 0.5 else f"{gain}/k2"
    if count > 2:
        chain[0] = f"{chain[0]}*k3" if rng.random() < 0.5 else f"{chain[0]}/k3"
        linear[-1][0] = f"{linear[-1][0]}*k3"
    amplitude, frequency = 0.1, round(float(rng.uniform(0.2, 2)), 2)
    differenced = [name for name in names[1:] if rng.random() < 0.3]
    tables = {
        "plant": {
            "states": names,
            "chain": chain,
            "linear": linear,
            "drift": drift,
            "regressor": [],
            "gain_sign": int(np.sign(gain)),
            "input_gain": formula,
        },
        "plant.constants": {f"k{i + 1}": v for i, v in enumerate(nominal)},
        "plant.ranges": {
            f"k{i + 1}": [round(v * (1 - h), 6), round(v * (1 + h), 6)]
            for i, (v, h) in enumerate(zip(nominal, half, strict=True))
            if i < count
        },
        "plant.uncertainty": {
            "tau": [0.5 * (rng.random() < 0.5) for _ in names[1:]] + [0.5],
            "gamma": [0.01 * (rng.random() < 0.3) for _ in names],
            "beta": [round(float(rng.uniform(0, 0.1)), 3) for _ in names],
        },
        "truth": {"input_gain": formula, "omega": [0] * n},
        "reference": {"signal": f"{amplitude}*sin({frequency}*t)"},
        "law": {
            "kind": "robust",
            "c": [round(float(rng.uniform(4, 10)), 3) for _ in names],
            "feedforward": int(rng.integers(0, n)),
        },
        "simulation": {"x0": [0] * n, "duration": 10},
        "implementation": {
            "period": float(rng.choice([5, 10, 20])) * 1e-3,
            "delay": float(rng.choice([0, 0.5, 0.7, 1, 1.3])),
            "measurement_quantum": [
                0.0 if x in differenced else float(rng.choice([0, 1e-4])) for x in names
            ],
            "velocity": differenced,
            "velocity_filter": 0.01 if differenced else 0.0,
        },
    }
    lines = []
    for name, table in tables.items():
        lines.append(f"[{name}]")
        lines += [f"{key} = {json.dumps(value)}" for key, value in table.items()]
    return loads("\n".join(lines), "ranged"), amplitude, frequency


def members(system, rng, count):
    """The system with constants at corners of its ranges, and in them."""
    boxes = system.plant.constant_boxes
    for _ in range(count):
        corner = rng.random() < 0.5
        values = {
            name: float(rng.choice([low, high]) if corner else rng.uniform(low, high))
            for name, (low, high) in boxes.items()
        }
        truth = replace(system.truth, constants=tuple(values.items()))
        yield system.replace(truth=truth), values


def worst_member(system, rng, count, amplitude, frequency):
    """The largest error of members under the signs of their kernels, and its constants."""
    return max(
        (
            (worst_error(m, amplitude, frequency), values)
            for m, values in members(system, rng, count)
        ),
        key=lambda found: found[0],
    )
