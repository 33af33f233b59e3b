"""Speed of sampled loops: `make bench`.

1000 members of example1 over 20 s at 1 kHz, with all metrics and bands, against a loop that calls
SciPy's solve_ivp between the samples, as one would write it by hand. One run with its trajectory
and metrics, against a member of these, eight of which share a vector register, and against the same
run by the maps that are called from Python at every event.
"""

import dataclasses
import time

import numpy as np
from peers import rates
from scipy.integrate import solve_ivp

import certrack
from certrack.simulation import sampled
from certrack.simulation.sampled import SampledSimulator
from certrack.studies.ensembles.engine import Engine
from certrack.studies.ensembles.plan import make_plan
from certrack.studies.ensembles.workers import cores

PERIOD, DURATION, MEMBERS = 1e-3, 20.0, 1000
SAMPLES = round(DURATION / PERIOD)

#: Nanoseconds per member and sample; times faster than SciPy.
WANTED = (60, 500)

#: A single run may take so many times as long as a member; the maps take so many times as long.
MOST_MEMBERS, LEAST_GAIN = 24, 30


def uniform(low, high):
    return certrack.Distribution("uniform", (low, high))


def by_scipy(samples, tolerance=1e-6):
    """Seconds per sample of a hand-written loop around solve_ivp."""

    def plant(t, x, u):
        first, second, *_ = rates(t, np.array([*x, 0.0, 0.0]), 0.0, 2.0)  # without its own input
        return [first, second + 2.0 * u]

    x, z = np.array([0.5, -1.0]), np.zeros(2)
    begin = time.perf_counter()
    for k in range(samples):
        t = k * PERIOD
        e2 = 1.75 * x[0] + x[1] - 0.65 * np.cos(t)
        phi = 1 + x[0] * np.sin(x[1])
        ubar = 0.16015625 * x[0] - 5.265625 * x[1] + 1.54765625 * np.cos(t) - 0.65 * np.sin(t)
        ubar -= z[1] * phi + x[0] ** 2 * x[1]
        u = z[0] * ubar
        leak = np.array([0.6 * (z[0] - 0.4), 0.6 * (z[1] - 2.1)])
        z = z + PERIOD * (np.array([-ubar * e2, phi * e2]) - leak)
        options = {"method": "DOP853", "rtol": tolerance, "atol": tolerance}
        x = solve_ivp(plant, (t, t + PERIOD), x, args=(u,), **options).y[:, -1]
    return (time.perf_counter() - begin) / samples


def sampled_example():
    population = certrack.Population(
        x0=(uniform(-1, 1), uniform(-2, 2)),
        input_gain=uniform(1.5, 2.5),
        theta=(uniform(1.5, 2.5),),
    )
    implementation = certrack.Implementation(period=PERIOD)
    return certrack.load("example1").replace(population=population, implementation=implementation)


def test_one_run_against_a_member(interleaved, report, monkeypatch):
    """All in one thread, processor time; the member at its usual, looser tolerance."""
    system, members = sampled_example(), 256
    engine = Engine(make_plan(system, 0, 1e-6, None, "native"), 1)
    simulator = SampledSimulator(system)

    def by_maps():
        monkeypatch.setattr(sampled, "WORTH_COMPILING", 10**9)
        run = simulator.run(system)
        monkeypatch.undo()
        return run.metrics

    def anew(run):
        return dataclasses.replace(run)  # which remembers nothing

    run = simulator.run(system)
    candidates = {
        "a member of 256, in C": lambda: engine.compute(0, members),
        "one run": lambda: simulator.run(system),
        "one run and its metrics": lambda: simulator.run(system).metrics,
        "states and input at all samples of it": lambda: anew(run).u,
        "one run and its metrics, by the maps": by_maps,
    }
    best = interleaved(candidates, clock=time.process_time)
    best["a member of 256, in C"] /= members
    member = best["a member of 256, in C"]
    report(*(f"{name:38s}{1e3 * s:9.3f} ms{s / member:9.1f}" for name, s in best.items()))
    assert best["one run and its metrics"] < MOST_MEMBERS * member
    assert best["one run and its metrics, by the maps"] > LEAST_GAIN * best["one run"]


def test_sampled_members(report):
    system = sampled_example()
    lines = []
    best = {}
    for method in ("native", "lockstep"):
        engine = Engine(make_plan(system, 0, 1e-6, None, method), cores())
        best[method] = np.inf
        for _ in range(7 if method == "native" else 3):
            begin = time.perf_counter()
            engine.compute(0, MEMBERS)
            best[method] = min(best[method], time.perf_counter() - begin)
        ns = 1e9 * best[method] / MEMBERS / SAMPLES
        lines.append(f"{method:9s} {ns:7.1f} ns per member and sample on {cores()} cores")
    scipy = min(by_scipy(300) for _ in range(3))
    ratio = scipy * SAMPLES * MEMBERS / best["native"]
    lines.append(f"SciPy between the samples: {1e9 * scipy:.0f} ns, {ratio:.0f} times as long")
    lines.append(f"wanted: at most {WANTED[0]} ns, at least {WANTED[1]} times")
    report(*lines)
    assert ratio > WANTED[1]
