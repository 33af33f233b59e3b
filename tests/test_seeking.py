"""Rules that try which gains are best: the certificate is that of any rule, and they find them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from test_online import Moving

import certrack
from certrack.core.errors import InputError
from certrack.laws.online import LEVEL, Online
from certrack.laws.seeking import MIDDLE
from certrack.model.implementation import Implementation

PERIOD = 0.002
TRIES = {"amplitude": 0.15, "frequency": 0.08, "speed": 0.05, "effort": 0.006}
RULES = {"extremum": TRIES | {"seek": "extremum"}, "spsa": TRIES | {"seek": "spsa", "seed": 3}}


def moving(duration=20.0, **online):
    """The dual motor between c = 4 and c = 8, with noise and 500 Hz."""
    base = certrack.load("dual-motor-lean")
    law = certrack.Robust(c=(4,) * 4, feedforward=3, online=Online(c=(8,) * 4, **online))
    drive = Implementation(period=PERIOD, noise=(2e-6, 2e-4, 2e-6, 2e-4))
    system = base.replace(law=law, implementation=drive)
    return system.with_settings(duration=duration, tail=duration / 2)


def cost(system):
    """Mean of J over the second half, by another filter than the rule's own code."""
    run, duration = certrack.simulate(system), system.settings.duration
    t = np.arange(0, duration, PERIOD) + PERIOD / 2
    states = run.trajectory.interpolate(t)
    u = run.input_of(t, states)
    pole = 20 * np.pi * TRIES["frequency"] * PERIOD
    beside = u - lfilter([pole], [1, pole - 1], u)
    e = states[0] - system.reference.values(t, 0)[0]
    J = (e**2 + TRIES["effort"] * beside**2)[t > duration / 2].mean()
    names = list(system.controller.states)
    return J, states[4 + names.index(MIDDLE)] if MIDDLE in names else None, run


@pytest.mark.slow
@pytest.mark.parametrize("kind", RULES)
def test_it_finds_gains_between_the_ends_that_are_better_than_both(kind):
    ends = [cost(moving(60.0, schedule=end))[0] for end in ("0", "1")]
    J, middle, run = cost(moving(400.0, **RULES[kind]))
    assert min(ends) / J > 1.3
    late = (1 + np.tanh(middle[len(middle) // 2 :])) / 2
    assert 0.1 < late.mean() < 0.7
    bound = certrack.certify(moving(**RULES[kind]), "fast").online.bound
    assert run.metrics.tail_error < bound


@pytest.mark.parametrize("kind", RULES)
def test_the_certificate_does_not_know_the_rule(kind):
    still = certrack.certify(moving(schedule="0.5"), "fast").online
    found = certrack.certify(moving(**RULES[kind]), "fast").online
    assert found.verified and found.bound == still.bound
    slow = certrack.certify(moving(rate=1.0, **RULES[kind]), "fast").online
    assert slow.verified and slow.bound < found.bound
    free = certrack.certify(moving(rate=1.0, schedule="0.5"), "fast").online
    assert slow.bound == free.bound


@pytest.mark.parametrize("rate", [None, 2.0])
@pytest.mark.parametrize("kind", ["extremum", pytest.param("spsa", marks=pytest.mark.slow)])
def test_the_level_stays_within_its_ends_whatever_the_rule_remembers(kind, rate):
    system = moving(2.0, rate=rate, **RULES[kind])
    names = list(system.controller.states)
    assert (LEVEL in names) == (rate is not None) and (rate is None or names[-1] == LEVEL)
    wild = [0.0 if z == LEVEL else 50.0 for z in names]
    ends = [moving(2.0, schedule=end).law.online for end in ("0", "1")]
    wanted = system.law.online.wanted(system.controller.signals)
    numbers = dict(zip(system.controller.symbols, system.controller.values, strict=True))
    for z in (-50.0, 0.0, 50.0):
        for t in np.linspace(0, 30, 40):
            known = numbers | {MIDDLE: z, system.controller.signals.t: t}
            assert 0 <= float(wanted.subs(known)) <= 1
    assert len(ends) == 2 and certrack.simulate(system.with_settings(estimates=wild)).e.size


def test_runs_are_repeated_to_the_last_bit_and_seeds_differ():
    one, two = (certrack.simulate(moving(2.0, **RULES["spsa"])) for _ in range(2))
    other = certrack.simulate(moving(2.0, **(RULES["spsa"] | {"seed": 4})))
    assert (one.u == two.u).all() and one.metrics != other.metrics


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"seek": "extremum"}, "amplitude: is missing"),
        ({"schedule": "0", "speed": 1.0}, "belongs to seek"),
        ({**RULES["extremum"], "seed": 1}, "belongs to spsa"),
        ({**RULES["extremum"], "schedule": "0"}, "beside a threshold or a schedule"),
        ({**RULES["extremum"], "seek": "luck"}, "extremum"),
    ],
)
def test_what_does_not_fit_is_refused(keys, said):
    with pytest.raises(InputError, match=said):
        Online(c=(8,) * 4, **keys)


def test_a_period_that_its_own_states_cannot_follow_is_refused():
    with pytest.raises(InputError, match=r"implementation\.period"):
        moving(**(RULES["extremum"] | {"frequency": 20.0}))


@pytest.mark.slow
def test_a_file_can_state_it_and_the_adversary_replaces_it():
    system = moving(4.0, **RULES["spsa"])
    assert certrack.loads(certrack.to_text(system)) == system
    continuous = system.replace(implementation=None)
    found = certrack.falsify(continuous, budget=8)
    assert found.system.law.online.seek is None and found.system.law.online.schedule
    assert certrack.ensemble(system, 8).statistics is not None


@pytest.mark.slow
class TestExtremumSeeking(Moving):
    """Exports carry it: among the tests is that of the C code."""

    base = certrack.load("dual-motor-lean")
    online = Online(c=(6.5,) * 4, **(RULES["extremum"] | {"rate": 2.0}))
    system = base.replace(law=replace(base.law, online=online))


@pytest.mark.slow
class TestSpsa(Moving):
    base = certrack.load("dual-motor-lean")
    online = Online(c=(6.5,) * 4, **RULES["spsa"])
    system = base.replace(law=replace(base.law, online=online))
