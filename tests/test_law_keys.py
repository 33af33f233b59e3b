"""What a system file may say of a law: limits, defaults and what is required, key by key."""

from dataclasses import fields

import pytest

import certrack
from certrack.core.keys import keys_of
from certrack.laws.balanced import balancing_weights
from certrack.laws.numbers import _listed
from certrack.laws.registry import LAWS

#: Above which number, from which on, whether infinite, default, and whether it is required.
RECURSION = {
    "c": (0, None, False, None, True),
    "k": (0, None, True, None, False),
    "p": (0, None, True, None, False),
    "feedforward": (None, 0, False, 0, False),
    "coupling": (0, None, False, None, False),
    "sampled_feedforward": (None, None, False, False, False),
    "integral": (0, None, False, None, False),
}
UPDATE = {"gain_rate": (0, None, False, 1.0, False), "Gamma": (0, None, False, None, False)}
LEAKAGE = {
    "leak_gain": (0, None, False, 0.1, False),
    "leak_theta": (0, None, False, 0.1, False),
    "delta0": (None, None, False, 0.0, False),
    "theta0": (None, None, False, None, False),
}
LINEAR = dict.fromkeys(("K", "r", "lqr"), (None, None, False, None, False))

INF = float("inf")

KEYS = {
    "adaptive": RECURSION | UPDATE | LEAKAGE,
    "robust": RECURSION,
    "classic": RECURSION | UPDATE,
    "linear": {"feedforward": RECURSION["feedforward"]} | LINEAR,
}


@pytest.mark.parametrize("kind", KEYS)
def test_the_keys_of_a_law(kind):
    keys = keys_of(LAWS[kind])
    found = {
        name: (key.above, key.least, key.infinite, key.default, key.required)
        for name, key in keys.items()
    }
    assert found == KEYS[kind] and set(LAWS) >= set(KEYS)
    for name, key in keys.items():
        assert type(key.default) is type(KEYS[kind][name][3]), name
        assert key.most == (49 if name == "feedforward" else None)
        assert not key.nonzero and (key.otherwise or key.required or key.default is not None)


def test_defaults_of_fields_are_those_of_their_keys():
    """None stands for what `otherwise` says."""
    for kind in KEYS:
        keys, given = keys_of(LAWS[kind]), {f.name: f.default for f in fields(LAWS[kind])}
        for name, key in keys.items():
            assert key.required or given[name] == key.default


@pytest.mark.parametrize(
    ("changed", "key"),
    [
        ({"c": (5, 0)}, "law.c"),
        ({"p": (0,)}, "law.p"),
        ({"integral": 0}, "law.integral"),
        ({"coupling": 0}, "law.coupling"),
        ({"gain_rate": 0}, "law.gain_rate"),
        ({"leak_gain": 0}, "law.leak_gain"),
        ({"leak_theta": 0}, "law.leak_theta"),
        ({"feedforward": -1}, "law.feedforward"),
        ({"c": (5, INF)}, "law.c"),
    ],
)
def test_a_gain_at_its_limit_is_refused(changed, key):
    with pytest.raises(certrack.InputError, match=key):
        certrack.Adaptive(**({"c": (5, 5)} | changed))


def test_a_gain_just_inside_its_limit_is_taken():
    damped = certrack.Adaptive(c=(1e-9, 5), p=(INF,), k=((1e-9, INF), (1, 1, 1, 1)))
    assert damped.c == (1e-9, 5) and damped.k[0] == (1e-9, INF)
    assert certrack.Adaptive(c=(5, 5), integral=1e-9, gain_rate=1e-9).integral == 1e-9


def test_what_a_message_shows_of_a_metric_is_a_list():
    assert _listed(((1, 2), [3, (4,)])) == [[1, 2], [3, [4]]]
    assert _listed(1.5) == 1.5 and _listed(()) == []


def test_an_observer_is_an_observer():
    for wrong in ("kalman", {"kind": "eso"}, 1):
        with pytest.raises(certrack.InputError, match=r"law\.observer: must be an Observer"):
            certrack.Robust(c=(5, 5), observer=wrong)
    assert certrack.Robust(c=(5, 5)).observer is None


@pytest.mark.parametrize("g", [(0.0,), (1e-200, 1e-200), (1e200, 1e200), (INF,)])
def test_weights_that_leave_the_floats_are_refused(g):
    with pytest.raises(certrack.DesignError, match="range of floating point"):
        balancing_weights(g, (1.0,) * (len(g) + 1), 0.5)
    assert balancing_weights((4.0,), (1.0, 4.0), 0.5) == [1, 4]
