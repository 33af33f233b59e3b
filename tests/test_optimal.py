"""The best possible trajectories: exact optima, the laws beside them, and bad input."""

import json
import math
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import sympy
from click.testing import CliRunner

import certrack
from certrack.cli import cli
from certrack.core.casadi_forms import casadi, casadi_callable
from certrack.core.errors import Cancelled, InputError, MissingExtra
from certrack.core.expressions import parse
from certrack.core.lowering import numpy_callable
from certrack.core.progress import silent
from certrack.reports.optima import optima_notes
from certrack.studies.optimal.collocation import gauss_scheme, radau_scheme
from certrack.studies.optimal.goal import Goal
from certrack.studies.optimal.law_run import law_run_of
from certrack.studies.optimal.mesh import mesh
from certrack.studies.optimal.optimal import optimal
from certrack.studies.optimal.replay import replay

#: x'' = u from x = 1 at rest to the origin.
DOUBLE_INTEGRATOR = """
[plant]
states = ["x1", "x2"]
chain = [1]
linear = [[0]]
drift = "0"
regressor = []
gain_sign = 1
input_gain = 1
[plant.uncertainty]
tau = [0, 1]
gamma = [0, 0]
beta = [0, 20]
[truth]
input_gain = 1
omega = ["0", "{disturbance}"]
[reference]
signal = "{reference}"
[law]
kind = "robust"
c = [2, 2]
feedforward = 0
[simulation]
x0 = [1, 0]
duration = {duration}
band = 0.05
"""


def double_integrator(duration=12, disturbance="0", reference="0*t"):
    text = DOUBLE_INTEGRATOR.format(duration=duration, disturbance=disturbance, reference=reference)
    return certrack.loads(text)


# exact optima


@pytest.mark.parametrize("limit", [1.0, 4.0])
def test_the_shortest_time_of_the_double_integrator(limit):
    """Full force, then full brake: T = 2 sqrt(x/U)."""
    (converged,) = optimal(double_integrator(), "time", peak_input=limit).optima
    assert converged.converged
    assert converged.cost.time == pytest.approx(2 / math.sqrt(limit), rel=1e-4)
    assert converged.cost.peak == pytest.approx(limit, rel=1e-6)
    half = converged.cost.time / 2
    assert (converged.inputs[:, converged.ends[1:] < 0.98 * half] < -0.99 * limit).all()
    assert (converged.inputs[:, converged.ends[:-1] > 1.02 * half] > 0.99 * limit).all()


def quadratic_optimum(weight):
    """int x^2 and int u^2 of the regulator of x'' = u that minimises int (x^2 + weight u^2)."""
    a, b = 1 / math.sqrt(weight), math.sqrt(2) * weight**-0.25  # u = -a x - b x'
    closed = np.array([[0.0, 1.0], [-a, -b]])
    kept = []
    for cost in (np.diag([1.0, 0.0]), np.outer([a, b], [a, b])):
        eye = np.eye(2)
        operator = np.kron(eye, closed.T) + np.kron(closed.T, eye)
        kept.append(float(np.linalg.solve(operator, -cost.reshape(-1))[0]))
    return kept


@pytest.mark.parametrize("weight", [1.0, 0.05])
def test_the_linear_quadratic_regulator_is_found(weight):
    """Where int e^2 is as the regulator's, the least energy is its, and the other way round."""
    squared_error, energy = quadratic_optimum(weight)
    system = double_integrator()
    (least,) = optimal(system, "energy", squared_error=squared_error).optima
    assert least.cost.energy == pytest.approx(energy, rel=1e-3)
    (least,) = optimal(system, "squared_error", energy=energy).optima
    assert least.cost.squared_error == pytest.approx(squared_error, rel=1e-3)


def test_the_least_peak_and_the_least_error_are_duals():
    """The least peak at an error is the peak at which that error is the least."""
    system = double_integrator(duration=6)
    (first,) = optimal(system, "squared_error", peak_input=2.0, elements=120).optima
    error = first.cost.squared_error
    (second,) = optimal(system, "peak", squared_error=error, elements=120).optima
    assert second.cost.peak == pytest.approx(2.0, rel=1e-2)


# kinks


def quickest(system, limit=2.0):
    (found,) = optimal(system, "time", peak_input=limit).optima
    assert found.converged and 0 < found.smoothing <= 3e-3 and found.deviation < 1e-3
    assert found.cost.peak == pytest.approx(limit, rel=1e-5)
    return found.cost.time


@pytest.mark.parametrize("friction", [0.5, 1.2])
def test_the_shortest_time_against_dry_friction(friction):
    """It drives with U - F and brakes with U + F: T = 2 sqrt(U x/(U^2 - F^2)).

    Friction that is rounded is smaller near rest: the time is below this, by the rounding's size.
    """
    time = quickest(double_integrator(8, f"-{friction}*sign(x2)"))
    exact = 2 * math.sqrt(2.0 / (4.0 - friction**2))
    assert 0.999 * exact < time < exact


@pytest.mark.parametrize("drift", ["-abs(x1)", "min(-x1, x1)", "-max(x1, -x1, -3)"])
def test_the_shortest_time_with_a_kink_in_the_drift(drift):
    """x'' = u - |x|: two arcs of circles, about -U and U, which meet at x = 5/8 for U = 2."""
    time = quickest(double_integrator(8, drift))
    assert time == pytest.approx(math.acos(2.625 / 3) + math.acos(1.375 / 2), rel=1e-4)


def test_the_shortest_time_to_a_reference_with_a_kink():
    """y_d = |t - 1/2| is met at rest in its own frame after full force and full brake."""
    time = quickest(double_integrator(8, reference="abs(t - 0.5)"))
    assert time == pytest.approx(math.sqrt(3.5) - 0.5, rel=1e-4)


@pytest.mark.slow
def test_no_law_is_better_on_an_axis_with_dry_friction():
    system = double_integrator(6, "-0.5*sign(x2)")
    found = optimal(system, elements=240)
    assert found.converged
    for entry in found.optima:
        assert found.excess(entry) > 1.0 and 0 < entry.smoothing < 0.1
    assert any("kinks are rounded over" in line for line in optima_notes(found))


def test_nothing_is_smoothed_where_nothing_has_a_kink_in_the_states():
    system = double_integrator(3, "0.5*sign(t - 1)")
    (found,) = optimal(system, "squared_error", peak_input=20.0, elements=120).optima
    assert found.smoothing == 0 and found.record()["smoothing"] == 0


# the laws beside them


SLOWER = [pytest.param(name, marks=pytest.mark.slow) for name in ("dual-motor-lean", "axis-load")]


@pytest.mark.parametrize("name", ["example1", *SLOWER])
def test_no_law_is_better_than_the_optimum(name):
    converged = optimal(certrack.load(name), horizon=4)
    assert converged.converged and len(converged.optima) == 3
    for entry in converged.optima:
        assert converged.excess(entry) > 1.0
        assert entry.deviation < 1e-2
        for quantity, limit in entry.goal.limits.items():
            assert getattr(entry.cost, quantity) <= limit * (1 + 1e-3)


@pytest.mark.slow
def test_the_dual_motor_as_in_the_study():
    """Figures of an independent study: 240 Runge-Kutta intervals by multiple shooting over 6 s."""
    converged = optimal(certrack.load("dual-motor-lean"), horizon=6)
    within_both, least_energy, within_peak = (entry.cost for entry in converged.optima)
    assert within_both.squared_error == pytest.approx(0.1297, rel=0.01)
    assert least_energy.energy == pytest.approx(0.796, rel=0.02)
    assert within_peak.squared_error == pytest.approx(0.1221, rel=0.01)


def test_the_replay_notices_another_input():
    """It integrates what it is given: a little more input is another trajectory."""
    system = double_integrator(duration=4)
    (found,) = optimal(system, "squared_error", peak_input=2.0).optima
    run = law_run_of(system, 4.0, silent)
    begins = found.states[:, :: (len(found.times) - 1) // (len(found.ends) - 1)]
    assert replay(run, found.ends, found.inputs, begins, arrival=False).deviation < 1e-8
    assert replay(run, found.ends, 1.01 * found.inputs, begins, arrival=False).deviation > 1e-5


def test_an_unstable_plant_has_an_optimum():
    """Open loop its rounding would grow by exp(5 t), so each element begins anew."""
    text = DOUBLE_INTEGRATOR.format(duration=20, disturbance="0", reference="sin(t)")
    system = certrack.loads(text.replace('drift = "0"', 'drift = "25*x1"'))
    result = optimal(system, elements=240)
    assert result.converged
    for entry in result.optima:
        assert 1.0 < result.excess(entry) < 20 and entry.deviation < 1e-4


def test_at_rest_on_the_reference_nothing_is_left_to_gain():
    text = DOUBLE_INTEGRATOR.format(duration=3, disturbance="0", reference="0*t")
    system = certrack.loads(text.replace("x0 = [1, 0]", "x0 = [0, 0]"))
    (entry,) = (result := optimal(system, "squared_error", peak_input=1.0, elements=120)).optima
    assert result.excess(entry) is None and entry.minimum < 1e-12
    with pytest.raises(InputError, match="begins at the reference"):
        optimal(system, "time", peak_input=1.0)


def test_a_slow_arrival_is_found_beyond_the_laws():
    """The law settles long before a weak input can arrive."""
    (found,) = optimal(double_integrator(duration=10), "time", peak_input=0.02).optima
    assert found.cost.time == pytest.approx(2 / math.sqrt(0.02), rel=1e-3)


def test_arrival_is_with_the_speed_of_the_reference():
    """From x = 1 at rest to y_d = 1 + 0.5 t with |u| <= 2: full force, then full brake."""
    system = double_integrator(duration=6, reference="1 + 0.5*t").replace()
    (found,) = optimal(system, "time", peak_input=2.0).optima
    assert found.cost.time == pytest.approx(0.25 + 2 * math.sqrt(0.03125), rel=1e-3)
    assert found.states[:, -1] == pytest.approx([1 + 0.5 * found.cost.time, 0.5], rel=1e-4)


def test_the_excess_is_of_laws_that_keep_the_limits():
    result = optimal(double_integrator(), "squared_error", peak_input=2.0, elements=120)
    (entry,) = result.optima
    assert result.law.peak > 2 and result.excess(entry) is None and entry.mesh_error is None
    lines = optima_notes(result)
    assert any("the law exceeds |u| <= 2" in line for line in lines)
    assert not any("needs less" in line or "still changed" in line for line in lines)


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_search(tmp_path, number):
    """CasADi swallows the exception of one that arrives in its own evaluations."""
    program = (
        "import certrack, signal, sys\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # a shell may ignore it
        "def tell(*news): print(*news, file=sys.stderr, flush=True)\n"
        "certrack.optimal(certrack.load('dual-motor-physical'), elements=960, progress=tell)\n"
    )
    with subprocess.Popen([sys.executable, "-c", program], stderr=subprocess.PIPE) as process:
        for _ in range(12):
            process.stderr.readline()
        time.sleep(0.05)
        process.send_signal(number)
        assert process.wait(60) == (1 if number == signal.SIGINT else -signal.SIGTERM) or (
            number == signal.SIGINT and process.returncode == -signal.SIGINT
        )
        assert b"searches" not in process.stderr.read()


def test_a_disturbance_that_jumps_is_met_by_the_mesh():
    """Without a limit of the energy a pulse that is known beforehand is cancelled."""
    pulse = "0.5*(sign(t - 1.03) - sign(t - 1.37))"
    system = double_integrator(duration=3, disturbance=pulse)
    (converged,) = optimal(system, "squared_error", peak_input=20.0).optima
    for jump in (1.03, 1.37):
        assert np.abs(converged.ends - jump).min() < 1e-12
    assert converged.deviation < 1e-6


# parts


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_the_scheme_is_of_order_twice_its_degree(degree):
    """x' = -x over one element, against exp."""
    scheme = gauss_scheme(degree)
    errors = []
    for h in (0.4, 0.2):
        matrix = scheme.slopes[1:].T + h * np.eye(degree)
        inner = np.linalg.solve(matrix, -scheme.slopes[0])
        errors.append(abs(scheme.last[0] + scheme.last[1:] @ inner - math.exp(-h)))
    assert math.log2(errors[0] / errors[1]) == pytest.approx(2 * degree + 1, abs=0.3)


@pytest.mark.parametrize("degree", [2, 3])
def test_radaus_scheme_ends_at_its_last_point_and_decays_as_what_is_stiff(degree):
    scheme = radau_scheme(degree)
    assert scheme.nodes[-1] == 1.0 and scheme.weights.sum() == pytest.approx(1.0)
    for power in range(2 * degree - 1):
        assert scheme.weights @ scheme.nodes**power == pytest.approx(1 / (power + 1))
    ends = []
    for stiff in (0.1, 1e4):
        matrix = scheme.slopes[1:].T + stiff * np.eye(degree)
        inner = np.linalg.solve(matrix, -scheme.slopes[0])
        ends.append(scheme.last[0] + scheme.last[1:] @ inner)
    assert ends[0] == pytest.approx(math.exp(-0.1), abs=1e-4)
    assert abs(ends[1]) < 1e-3


def test_where_the_time_is_over_the_last_optimum_counts_and_a_line_says_so():
    system = certrack.load("example1")
    found = optimal(system, "squared_error", peak_input=12.9, horizon=2, time_limit=1e-3)
    (entry,) = found.optima  # the first mesh has a second, whatever is left
    assert entry.timed_out and entry.record()["timed_out"]
    lines = optima_notes(found)
    assert any("--time-limit" in line for line in lines)
    if entry.converged:
        assert entry.mesh_error is None
    unhurried = optimal(system, "squared_error", peak_input=12.9, horizon=2, elements=120)
    assert not unhurried.optima[0].timed_out
    with pytest.raises(InputError, match="time_limit"):
        optimal(system, time_limit=0)


@pytest.mark.slow
def test_an_axis_that_sticks_has_optima():
    """Over the first turn of the reference, where friction holds the axis at rest."""
    system = certrack.load("stiction")
    found = optimal(system, "energy", squared_error=2.7e-4, horizon=4, time_limit=120)
    (entry,) = found.optima
    assert entry.converged and entry.deviation <= 1e-3 and 0 < entry.smoothing <= 0.1
    assert entry.cost.energy < found.law.energy


def test_formulas_are_the_same_in_casadi():
    """Every function that a file may use, but for what is added below roots."""
    ca = casadi("a test")
    text = (
        "sin(x1) + cos(x2) + tan(x1/4) + asin(x1/9) + acos(x2/9) + atan(x1) + atan2(x1, x2)"
        " + sinh(x1) + cosh(x2) + tanh(x1) + exp(x2) + log(x1**2 + 2) + sqrt(x2**2 + 3)"
        " + abs(x1) + sign(x2) + max(x1, x2) + min(x1, 2*x2, 3) + x1**3 + abs(x2)**(1/3)"
    )
    formula = parse("drift", text, ("x1", "x2")).expr
    names = [sympy.Symbol(name, real=True) for name in ("x1", "x2")]
    numeric = numpy_callable([names], [formula])
    x = ca.SX.sym("x", 2)
    function = ca.Function("f", [x], casadi_callable(ca, [names], [formula])(ca.vertsplit(x)))
    for point in ([0.3, -0.7], [-1.2, 2.1], [2.5, 0.4]):
        expected = numeric(np.array(point))[0]
        assert float(function(point)) == pytest.approx(expected, rel=1e-12)


def test_a_norm_has_a_slope_at_rest():
    ca = casadi("a test")
    names = [sympy.Symbol(name, real=True) for name in ("x1", "x2")]
    formula = sympy.sqrt(names[0] ** 2 + names[1] ** 2)
    x = ca.SX.sym("x", 2)
    value = casadi_callable(ca, [names], [formula])(ca.vertsplit(x))[0]
    slopes = ca.Function("g", [x], [ca.gradient(value, x)])([0.0, 0.0])
    assert np.array(slopes).tolist() == [[0.0], [0.0]]


def test_the_mesh_has_every_break_and_is_dense_where_the_input_moves():
    times = np.linspace(0.0, 10.0, 2001)
    ends = mesh(times, np.exp(-5 * times), 100, np.array([3.0, 7.77]))
    assert {0.0, 3.0, 7.77, 10.0} <= set(ends.tolist())
    assert (np.diff(ends) > 0).all()
    assert (ends < 1).sum() > 55
    still = mesh(times, np.ones_like(times), 100, np.empty(0))
    assert np.diff(still) == pytest.approx(0.1)


# bad input


@pytest.mark.parametrize(
    ("wanted", "words"),
    [
        ({"objective": "speed"}, "objective: must be one of squared_error, energy, peak, time"),
        ({"objective": "time"}, "peak_input: must be given for the shortest time"),
        ({"objective": "squared_error"}, "peak_input: or energy must be given for the least"),
        ({"objective": "energy"}, "squared_error: must be given for the least integral of u"),
        ({"objective": "energy", "energy": 1.0, "squared_error": 1.0}, "energy: is what is min"),
        ({"objective": "peak", "peak_input": 1.0, "squared_error": 1.0}, "peak_input: is what"),
        ({"squared_error": -1.0}, "squared_error: must be"),
        ({"energy": math.nan}, "energy: must be"),
        ({"peak_input": 0.0}, "peak_input: must be"),
        ({"horizon": 0.0}, "horizon: must be"),
        ({"elements": 3}, "elements: must be"),
    ],
)
def test_bad_arguments_are_refused_by_name(wanted, words):
    with pytest.raises(InputError, match="^" + words.replace("^", r"\^")):
        optimal(double_integrator(), **wanted)


def test_limits_that_nothing_keeps_are_told(tmp_path):
    system = double_integrator(duration=1)
    (converged,) = optimal(system, "energy", squared_error=1e-3, peak_input=1.0).optima
    assert not converged.converged and converged.reason
    path = tmp_path / "mass.toml"
    path.write_text(certrack.to_text(system))
    limits = ["--squared-error", "1e-3", "--peak-input", "1"]
    result = CliRunner().invoke(cli, ["optimal", str(path), "--objective", "energy", *limits])
    assert result.exit_code == 1
    assert "none found: " in result.stdout


def test_the_shortest_time_needs_one_formula():
    text = certrack.to_text(double_integrator())
    pieces = 'kind = "velocity"\npositions = [0, 1]\nspeed = 1\nacceleration = 1'
    system = certrack.loads(text.replace('signal = "0*t"', pieces))
    with pytest.raises(InputError, match="one formula, not pieces"):
        optimal(system, "time", peak_input=3.0)


def test_a_law_that_ends_early_is_told():
    system = double_integrator(disturbance="20*x1**3")
    with pytest.raises(InputError, match="horizon: the law's own run ends before it"):
        optimal(system)


def test_a_goal_records_the_limits_that_are_given():
    record = Goal("squared_error", peak=2.0).record()
    assert record == {"minimised": "squared_error", "limits": {"peak": 2.0}}


def test_without_casadi_there_is_a_hint(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "casadi", None)
    with pytest.raises(MissingExtra, match=r"pip install 'certrack\[optimal\]'"):
        optimal(double_integrator())


def test_a_search_can_be_cancelled():
    calls = []

    def stop(done, total, best):
        calls.append((done, total))
        if len(calls) == 5:
            raise Cancelled

    with pytest.raises(Cancelled):
        optimal(double_integrator(), progress=stop)
    assert len(calls) == 5


# the command


@pytest.mark.slow
def test_the_command_prints_draws_and_reports(tmp_path):
    command = ["optimal", "example1", "--horizon", "2"]
    result = CliRunner().invoke(cli, [*command, "--plot", str(tmp_path)])
    assert result.exit_code == 0, result.output
    assert "the law needs" in result.stdout
    assert {path.suffix for path in tmp_path.iterdir()} == {".png", ".svg", ".pdf"}
    shown = CliRunner().invoke(cli, [*command, "--json"])
    record = json.loads(shown.stdout)["example1"]
    assert record["horizon"] == 2.0 and len(record["optima"]) == 3
    assert all(entry["law_over_minimum"] > 1 for entry in record["optima"])


def test_refusals_name_the_option():
    result = CliRunner().invoke(cli, ["optimal", "example1", "--objective", "time"])
    assert str(result.exception).startswith("--peak-input: must be given")
