"""Shared strategies and fixtures."""

import math
import os
import shutil
import sys
import tempfile

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st

import certrack
from certrack.laws import Adaptive, Classic, Robust
from certrack.model.plant import Plant
from certrack.model.truth import Truth
from certrack.model.uncertainty import Uncertainty
from certrack.references import SymbolicReference
from certrack.systems.system import Settings, System


def pytest_configure(config):
    """Tests keep compiled libraries in a folder of their own, which all their processes share."""
    if "PYTEST_XDIST_WORKER" not in os.environ:
        config.compiled = tempfile.mkdtemp(prefix="certrack-tests-")
        os.environ["CERTRACK_CACHE"] = config.compiled


def pytest_unconfigure(config):
    if hasattr(config, "compiled"):
        shutil.rmtree(config.compiled, ignore_errors=True)


settings.register_profile(
    "certrack",
    deadline=None,
    max_examples=30,
    derandomize=True,
    phases=[Phase.explicit, Phase.generate],  # a failing system is small enough to read
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
settings.register_profile(  # other examples in every run: `make hunt`
    "hunt",
    parent=settings.get_profile("certrack"),
    max_examples=300,
    derandomize=False,
    phases=[Phase.explicit, Phase.reuse, Phase.generate, Phase.shrink],
    print_blob=True,
)
settings.load_profile("certrack")

SHIPPED = (
    "axis",
    "axis-load",
    "dual-motor",
    "dual-motor-drag",
    "dual-motor-drive",
    "dual-motor-lean",
    "dual-motor-linear",
    "dual-motor-observer",
    "dual-motor-physical",
    "dual-motor-strong",
    "example1",
    "example1-classic",
    "flexible-joint",
    "motor-shaft-load",
    "point-to-point",
    "stiction",
    "theorem1-counterexample",
)


NOT_LONG = (
    *("axis", "axis-load", "dual-motor-drag", "dual-motor-drive", "dual-motor-linear"),
    *("dual-motor-observer", "point-to-point", "theorem1-counterexample"),
)

#: Those whose controller is not sampled and whose runs last 20 s; test_papers.py has another, and
#: test_moves.py the moves.
CONTINUOUS = [name for name in SHIPPED if name not in NOT_LONG]


@pytest.fixture(params=CONTINUOUS)
def shipped(request):
    return certrack.load(request.param)


def numbers(low, high):
    return st.floats(low, high).map(lambda value: float(f"{value:.4g}"))


def nonzero(size):
    return st.tuples(numbers(0.3, size), st.sampled_from([-1, 1])).map(math.prod)


@st.composite
def systems(draw, orders=st.integers(1, 8), kinds=("adaptive", "robust", "classic")):
    """Random admissible systems with bounded random design parameters."""
    n = draw(orders)
    kind = draw(st.sampled_from(kinds))
    states = [f"x{i + 1}" for i in range(n)]
    last = states[-1]
    r = draw(st.integers(0, 2))
    regressor = draw(
        st.permutations([f"1 + x1*sin({last})", f"cos({last})", "x1", "x1**2/(1 + x1**2)"])
    )[:r]
    sign = draw(st.sampled_from([-1, 1]))
    gain = sign * draw(numbers(0.3, 3))
    theta = [draw(numbers(-2, 2)) for _ in range(r)]
    vector = st.lists(numbers(0, 0.5), min_size=n, max_size=n)
    plant = Plant(
        states=states,
        chain=[draw(nonzero(2)) for _ in range(n - 1)],
        linear=[[draw(numbers(-1, 1)) for _ in range(i + 1)] for i in range(n - 1)],
        drift=draw(st.sampled_from(["0", f"x1*{last}", f"sin({last}) - 0.5*x1**3"])),
        regressor=regressor,
        gain_sign=sign,
        input_gain=gain,
        theta=theta,
        uncertainty=Uncertainty(draw(vector), draw(vector), draw(vector)),
    )
    norm = "sqrt(0.01 + " + " + ".join(f"{x}**2" for x in states) + ")"
    omega = [f"{draw(numbers(0, 0.3))}*{norm}*sin(t + {i})" for i in range(n)]
    common = {"c": [draw(numbers(0.5, 3)) for _ in range(n)]}
    if kind != "classic":
        if draw(st.booleans()) and n <= 4:
            damping = st.one_of(st.just(math.inf), numbers(0.5, 5))
            common["k"] = [[draw(damping) for _ in range(2 * m)] for m in range(1, n + 1)]
            common["p"] = [draw(damping) for _ in range(n - 1)]
        common["feedforward"] = draw(st.integers(0, n - 1))
    rates = {"gain_rate": draw(numbers(0.2, 3)), "Gamma": [draw(numbers(0.2, 3)) for _ in range(r)]}
    law = {
        "adaptive": lambda: Adaptive(
            **common,
            **rates,
            leak_gain=draw(numbers(0.1, 1)),
            leak_theta=draw(numbers(0.1, 1)),
            delta0=draw(numbers(-1, 1)),
            theta0=[draw(numbers(-1, 1)) for _ in range(r)],
        ),
        "robust": lambda: Robust(**common),
        "classic": lambda: Classic(**common, **rates),
    }[kind]()
    return System(
        plant=plant,
        law=law,
        reference=SymbolicReference(f"{draw(numbers(0.1, 1))}*sin({draw(numbers(0.2, 2))}*t)"),
        truth=Truth(gain, theta, omega),
        settings=Settings(x0=[draw(numbers(-1, 1)) for _ in range(n)], duration=2),
    )


def relative(found, expected):
    found, expected = np.asarray(found, float), np.asarray(expected, float)
    return float(np.abs(found - expected).max() / (1 + np.abs(expected).max()))


def pytest_terminal_summary(terminalreporter):
    """Print what tests measured."""
    reports = [r for group in terminalreporter.stats.values() for r in group]
    lines = [
        value
        for report in reports
        if getattr(report, "when", None) == "call"
        for name, value in report.user_properties
        if name.startswith("microcontroller")
    ]
    if lines:
        terminalreporter.section("Cortex-M4F: instructions, code, state, stack")
        for line in sorted(lines):
            terminalreporter.line(line)


@pytest.fixture(autouse=True)
def no_progress_lines(monkeypatch):
    """A slow machine does not add lines to what a command says."""
    lines = sys.modules.get("certrack.cli.progress_lines")
    if lines is not None:
        monkeypatch.setattr(lines, "SECONDS_BETWEEN_LINES", 3600.0)
