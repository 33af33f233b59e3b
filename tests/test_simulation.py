"""Runs against independent trajectories, kinks, stiffness, escapes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import sympy
import xarray
from conftest import systems
from hypothesis import given, settings
from hypothesis import strategies as st

import certrack
from certrack.core.branches import may_branch
from certrack.core.errors import InputError
from certrack.integrators.base import Outcome
from certrack.laws import Adaptive, Robust
from certrack.loops import continuous as continuous_loops
from certrack.loops import sampled as sampled_loops
from certrack.model.implementation import Implementation
from certrack.model.plant import Plant
from certrack.model.truth import Truth
from certrack.model.uncertainty import Uncertainty
from certrack.references import SymbolicReference, samples, steps, trapezoid, triangle
from certrack.simulation.simulator import Simulator, simulate
from certrack.systems.system import Settings, System

DATA = Path(__file__).parent / "data"
TRAJECTORIES = {
    "example1": "example1_improved",
    "example1-classic": "example1_classic",
    "dual-motor": "example2_tau1",
    "dual-motor-strong": "example2_tau5",
}


@pytest.mark.parametrize("integrator", ["taylor", "scipy"])
@pytest.mark.parametrize("name", TRAJECTORIES)
def test_independent_trajectories_are_met(name, integrator):
    table = np.genfromtxt(DATA / f"{TRAJECTORIES[name]}.csv", delimiter=",", names=True)
    run = simulate(certrack.load(name), integrator=integrator, tolerance=1e-11)
    states = run.trajectory.interpolate(table["t"])
    columns = [table[name] for name in table.dtype.names[1:-1]]
    assert np.abs(states[: len(columns)] - columns).max() < 1e-7
    assert np.abs(run.input_of(table["t"], states) - table["u"]).max() < 1e-7


def kinked(reference):
    """abs, min, max and sign in drift, regressor and disturbance."""
    plant = Plant(
        states=["x1", "x2"],
        chain=[2],
        linear=[[-3]],
        drift="abs(x2)*x1 + min(x1, x2, 0.3)",
        regressor=["1 + max(x1, sin(x2))"],
        uncertainty=Uncertainty((0.1, 0.2), (1, 1), (1, 1)),
    )
    omega = ("0.5*abs(x1)*sign(sin(3*t))", "max(x1, x2) - min(x2, 0.1) + abs(sin(2*t))")
    return System(
        plant=plant,
        law=certrack.load("example1").law,
        reference=reference,
        truth=Truth(2.0, (2.0,), omega),
        settings=Settings(x0=(1, 2), duration=10),
    )


REFERENCES = {
    "smooth": SymbolicReference("0.2*cos(t)"),
    "kinked": SymbolicReference("0.2*abs(sin(t)) + max(0, 0.1*cos(t))"),
    "triangle": triangle(0.2, 4.0),
    "trapezoid": trapezoid(0.2, 5, 0.5),
    "steps": steps([1, 4, 8], [0, 0.2, -0.1, 0.3], 1.0),
    "samples": samples([0, 1, 2, 3.5, 5], [0, 0.1, 0.3, 0.2, 0.2]),
}


@pytest.mark.parametrize("reference", REFERENCES)
def test_kinks_lose_no_accuracy(reference):
    system = kinked(REFERENCES[reference])
    taylor = simulate(system, integrator="taylor", tolerance=1e-11)
    tight = simulate(system, integrator="scipy", tolerance=3e-14)
    t = np.linspace(0, 10, 1001)
    assert taylor.outcome is Outcome.finished
    difference = taylor.trajectory.interpolate(t) - tight.trajectory.interpolate(t)
    assert np.abs(difference[:4]).max() < 1e-7
    assert taylor.metrics.integral_abs_error == pytest.approx(
        tight.metrics.integral_abs_error, abs=1e-7
    )


def test_error_falls_with_the_tolerance():
    """The Taylor method claims its tolerance: three decades less, three decades better."""
    system = certrack.load("example1")
    t = np.linspace(0, 20, 400)
    exact = simulate(system, tolerance=1e-14).trajectory.interpolate(t)[:4]
    worst = [
        np.abs(simulate(system, tolerance=tol).trajectory.interpolate(t)[:4] - exact).max()
        for tol in (1e-5, 1e-8, 1e-11)
    ]
    assert worst[0] < 1e-4
    assert worst[1] < 1e-2 * worst[0]
    assert worst[2] < 1e-2 * worst[1]


@settings(max_examples=12)
@given(systems(orders=st.integers(1, 4)))
def test_taylor_and_scipy_agree_on_random_systems(system):
    runs = [simulate(system, integrator=m, tolerance=1e-10) for m in ("taylor", "scipy")]
    end = min(run.trajectory.end for run in runs)
    t = np.linspace(0, 0.9 * end, 50)
    first, second = (run.trajectory.interpolate(t)[: system.plant.n] for run in runs)
    assert np.abs(first - second).max() < 1e-6 * (1 + np.abs(first).max())


def test_integrals_equal_quadrature_and_do_not_depend_on_samples(shipped):
    run = simulate(shipped, tolerance=1e-11)
    later = np.linspace(1, run.trajectory.end, 100_001)
    t = np.concatenate([np.linspace(0, 1, 200_001), later[1:]])
    states = run.trajectory.interpolate(t)
    u = run.input_of(t, states)
    e = states[0] - shipped.reference.values(t, 0)[0]
    assert run.metrics.input_energy == pytest.approx(np.trapezoid(u**2, t), rel=1e-5)
    assert run.metrics.integral_squared_error == pytest.approx(np.trapezoid(e**2, t), rel=1e-7)
    assert run.metrics.integral_abs_error == pytest.approx(np.trapezoid(abs(e), t), rel=1e-7)
    assert run.metrics.peak_input == pytest.approx(np.abs(u).max(), rel=1e-5)
    assert run.metrics.input_variation == pytest.approx(np.abs(np.diff(u)).sum(), rel=2e-3)


def test_new_gains_truth_and_start_do_not_recompile(monkeypatch):
    import heyoka as hy

    made = []
    original = hy.taylor_adaptive
    monkeypatch.setattr(hy, "taylor_adaptive", lambda *a, **k: made.append(1) or original(*a, **k))
    system = certrack.load("example1")
    simulator = Simulator(system)
    variants = [
        system,
        system.replace(law=replace(system.law, c=(3, 2), gain_rate=2.0)),
        system.replace(truth=replace(system.truth, input_gain=1.5, theta=(1.0,))),
        system.with_settings(x0=(0.3, 0.1), duration=30),
    ]
    for variant in variants:
        warm = simulator.run(variant).final_state
        assert warm == Simulator(variant).run().final_state or len(made) > 1
    count = len(made)
    for variant in variants:
        simulator.run(variant)
    assert len(made) == count
    assert count == 1 + len(variants)  # one per fresh Simulator, one for the shared one


def test_other_structure_is_refused():
    simulator = Simulator(certrack.load("example1"))
    with pytest.raises(InputError, match="another structure"):
        simulator.run(certrack.load("dual-motor"))


@pytest.mark.slow
def test_stiff_design_switches_to_the_implicit_method_and_says_so():
    plant = Plant(states=["x1", "x2", "x3"], chain=[1, 1], input_gain=1)
    system = System(
        plant,
        Robust(c=(1, 1, 1e6)),
        SymbolicReference("0.1*sin(t)"),
        Truth(1),
        Settings((0, 0, 0), 20),
    )
    run = simulate(system)
    assert run.outcome is Outcome.finished
    assert run.trajectory.method == "implicit"
    assert "stiff" in run.notes[0]
    slower = simulate(system.replace(law=Robust(c=(1, 1, 1e3))))
    assert slower.trajectory.method == "taylor"
    assert run.metrics.tail_error == pytest.approx(slower.metrics.tail_error, rel=0.01)


def test_implicit_method_agrees_with_taylor():
    system = certrack.load("dual-motor")
    a, b = (simulate(system, integrator=m).metrics for m in ("taylor", "implicit"))
    assert a.tail_error == pytest.approx(b.tail_error, rel=1e-6)
    assert a.input_energy == pytest.approx(b.input_energy, rel=1e-6)


@pytest.mark.parametrize("integrator", ["taylor", "scipy", "implicit"])
def test_finite_escape_ends_with_outcome_and_remedy(integrator):
    plant = Plant(states=["x1"], drift="x1**3", input_gain=1)
    weak = Truth(1e-9)  # the input does next to nothing: x' = x^3, x = (1/9 - 2 t)^(-1/2)
    system = System(plant, Robust(c=[1]), SymbolicReference("0.2*cos(t)"), weak, Settings([3], 20))
    run = simulate(system, integrator=integrator)
    assert run.outcome is Outcome.escaped
    assert run.trajectory.end == pytest.approx(1 / 18, rel=1e-6)
    assert "Raise c" in run.outcome.value
    assert run.metrics.as_dict()["tail_error"] is None


@pytest.mark.parametrize("integrator", ["auto", "scipy", "implicit"])
def test_leaving_a_domain_is_said(integrator):
    plant = Plant(states=["x1"], drift="log(x1)", regressor=["1"])
    system = System(
        plant,
        Adaptive(c=[0.1], gain_rate=1e-3),
        SymbolicReference("0.2*cos(t)"),
        Truth(1, (-3.0,)),
        Settings([1], 20),
    )
    run = simulate(system, integrator=integrator)
    assert run.outcome is Outcome.undefined
    assert 0.2 < run.trajectory.end < 0.3


def test_start_without_a_taylor_series_is_run_by_scipy_with_a_note():
    run = simulate(certrack.load("dual-motor-lean"), x0=(0, 0, 0, 0))  # sqrt(x^T x) at 0
    assert run.outcome is Outcome.finished
    assert run.trajectory.method == "scipy"
    assert "no Taylor series" in run.notes[0]


def test_symmetric_series_does_not_fool_the_step_size():
    """From x = 0 the series of x' = 1 + x^3 has only every third term; the last two vanish."""
    plant = Plant(states=["x1"], drift="x1**3 + 1", input_gain=1)
    system = System(plant, Robust(c=[0.5]), SymbolicReference("0"), Truth(1), Settings([0], 5))
    never = replace(system, truth=Truth(1e-12))  # the input does next to nothing
    exact = simulate(never, duration=1.1, integrator="scipy", tolerance=3e-14).final_state["x1"]
    for tolerance in (1e-9, 1e-10, 1e-11, 1e-12, 1e-13):  # orders 12 to 16
        run = simulate(never, duration=1.1, integrator="taylor", tolerance=tolerance)
        assert run.final_state["x1"] == pytest.approx(exact, rel=max(100 * tolerance, 1e-10))


def test_a_plant_that_sticks_under_its_law_is_simulated():
    plant = Plant(states=["x1", "x2"], chain=[1], input_gain=1)
    truth = Truth(1, omega=("0", "-3*sign(x2)"), tau=(0, 1))
    system = System(
        plant, Robust(c=[1, 1]), SymbolicReference("0.2*cos(t)"), truth, Settings((1, 0), 20)
    )
    run = simulate(system)
    assert run.outcome is Outcome.finished
    assert run.notes[0].startswith("Stuck at x2 = 0")


def test_dataset_has_labels_units_and_provenance(tmp_path):
    system = certrack.load("dual-motor-lean")
    run = simulate(system)
    run.save(tmp_path / "run.nc")
    with xarray.open_dataset(tmp_path / "run.nc", engine="h5netcdf") as data:
        assert data["x"].dims == ("time", "state")
        assert data["time"].attrs["units"] == "s"
        assert data["state_units"].values.tolist() == ["rad", "rad/s", "rad", "rad/s"]
        assert data["y_d"].attrs["units"] == "rad"
        assert data.attrs["source"].startswith("certrack ")
        assert certrack.loads(data.attrs["system"]) == system
        assert data.attrs["tail_error"] == pytest.approx(run.metrics.tail_error)
        assert float(np.abs(data["u"]).max()) == pytest.approx(run.metrics.peak_input)
    sampled = simulate(certrack.load("example1")).dataset(samples=101)
    assert sampled["time"].values.tolist() == np.linspace(0, 20, 101).tolist()
    assert sampled["estimate"].dims == ("time", "parameter")
    assert not list(tmp_path.glob("*.part"))


def test_missing_heyoka_falls_back_to_scipy_with_one_warning(monkeypatch):
    monkeypatch.setattr("certrack.simulation.continuous.has_heyoka", lambda: False)
    system = certrack.load("example1").with_settings(duration=1, tail=None)
    with pytest.warns(UserWarning, match="heyoka is not installed") as caught:
        run = simulate(system)
    assert len(caught) == 1
    assert run.trajectory.method == "scipy"
    with pytest.raises(InputError, match="needs heyoka"):
        simulate(system, integrator="taylor")


def test_truth_with_other_constants_changes_the_plant_not_the_law():
    system = certrack.load("dual-motor-lean")
    stiffer = system.replace(truth=replace(system.truth, constants={"K_L": 3.6}))
    a, b = simulate(system), simulate(stiffer)
    assert a.metrics.tail_error != b.metrics.tail_error
    by_hand = system.replace(plant=system.plant.with_constants(K_L=3.6))
    assert by_hand.plant.g[1] == pytest.approx(14.4)
    x = np.array([0.1, 0.2, 0.3, 0.4])
    rate = Simulator(stiffer).run().trajectory.interpolate(np.array([0.0, 1e-6]))
    speed = (rate[1, 1] - rate[1, 0]) / 1e-6
    assert speed == pytest.approx(14.4 * (1 - -1), abs=0.1)
    assert x.size == 4


def test_peak_of_a_jumping_input_is_not_overshot():
    """The corners of a triangle make u jump; both sides are sampled, nothing is fitted across."""
    plant = Plant(states=["x1", "x2"], chain=[1], input_gain=1)
    law = Robust(c=(2, 2))
    for reference in (triangle(1, 3.3), SymbolicReference("max(sin(t), 0.3)")):
        system = System(plant, law, reference, Truth(1), Settings((0, 0), 10))
        run = simulate(system)
        assert run.metrics.peak_input == pytest.approx(np.abs(run.u).max(), rel=1e-6)
        scipy = simulate(system, integrator="scipy").metrics
        assert run.metrics.peak_input == pytest.approx(scipy.peak_input, rel=1e-6)
        assert run.metrics.tail_error == pytest.approx(scipy.tail_error, rel=1e-5)
        assert run.metrics.input_variation == pytest.approx(scipy.input_variation, rel=1e-3)


def test_constants_that_only_the_chain_uses_are_fine():
    plant = Plant(states=["x1", "x2"], chain=["1/M"], input_gain=1, constants={"M": 2})
    system = System(
        plant, Robust(c=(2, 2)), SymbolicReference("exp(-t)**2"), Truth(1), Settings((0, 0), 5)
    )
    assert simulate(system).outcome is Outcome.finished


def test_rest_on_a_kink_is_left(capfd):
    plant = Plant(states=["x1", "x2"], chain=[1], drift="-0.5*x2*abs(x2)", input_gain=1)
    system = System(
        plant, Robust(c=(2, 2)), SymbolicReference("1 - cos(t)"), Truth(1), Settings((0, 0), 10)
    )
    run = simulate(system)
    assert run.outcome is Outcome.finished
    tight = simulate(system, integrator="scipy", tolerance=1e-13)
    assert run.final_state["x1"] == pytest.approx(tight.final_state["x1"], abs=1e-7)
    assert capfd.readouterr().out == ""  # heyoka's warnings would break --json


def test_branch_points_are_left_to_scipy():
    base = certrack.load("dual-motor-lean")
    omega = ("0", "0.01*atan2(sin(3*t), cos(3*t))", "0", "0")
    system = base.replace(truth=replace(base.truth, omega=omega))
    run = simulate(system.with_settings(duration=3, tail=None))
    assert run.trajectory.method == "scipy"
    assert "branch points" in run.notes[0]


def test_long_run_is_not_called_stiff():
    plant = Plant(states=["x1", "x2"], chain=[1], input_gain=1)
    law = Robust(c=(2, 2), feedforward=1)
    system = System(plant, law, SymbolicReference("sin(t)"), Truth(1), Settings((0, 0), 8e4))
    run = simulate(system, tolerance=1e-6)
    assert run.trajectory.method == "taylor"
    assert run.outcome is Outcome.finished


def test_other_formulas_of_a_law_are_not_run_on_the_compiled_loop():
    from dataclasses import dataclass

    from certrack.laws.base import Equations

    @dataclass(frozen=True, kw_only=True)
    class Boosted(Robust):
        boost: bool = False

        def equations(self, s):
            u = super().equations(s).u
            return Equations(u=2 * u if self.boost else u)

    system = certrack.load("dual-motor-lean").replace(law=Boosted(c=(4, 4, 4, 4)))
    simulator = Simulator(system)
    with pytest.raises(InputError, match="another structure"):
        simulator.run(system.replace(law=Boosted(c=(4, 4, 4, 4), boost=True)))


@pytest.mark.parametrize("sampled", [False, True])
def test_only_the_loop_that_runs_is_built(monkeypatch, sampled):
    """Once, and not again for other numbers; checks of the structure build none either."""
    built = []

    def count(module, name):
        original = getattr(module, name)
        monkeypatch.setattr(module, name, lambda **k: built.append(name) or original(**k))

    count(continuous_loops, "ClosedLoop")
    count(sampled_loops, "SampledLoop")
    system = certrack.load("example1").with_settings(duration=0.1, tail=None)
    if sampled:
        system = system.replace(implementation=Implementation(0.01))
    simulator = Simulator(system)
    simulator.run()
    simulator.run(system.replace(law=replace(system.law, c=(3, 2))))
    simulator.run(system.with_settings(x0=(0.3, 0.1)))
    assert built == (["SampledLoop"] if sampled else ["ClosedLoop"])


def test_settling_band_of_a_run_that_ends_early_is_that_of_the_whole():
    """A sine that has hardly risen when the run escapes; an ensemble has the same band."""
    system = certrack.load("example1").replace(reference=certrack.SymbolicReference("sin(t)"))
    early = certrack.simulate(system.with_settings(max_state=2.0))
    assert early.outcome is Outcome.escaped and np.abs(early.y_d).max() < 0.1
    assert early.metrics.band == certrack.simulate(system).metrics.band
    assert early.metrics.band == pytest.approx(0.05, rel=1e-6)


def test_an_arcsine_away_from_its_branch_points_has_a_taylor_series():
    """Its run agrees with SciPy's, whose steps need none."""
    reference = certrack.SymbolicReference("0.2*asin(0.9*sin(t))")
    system = certrack.load("example1").replace(reference=reference).with_settings(duration=5)
    run, checked = simulate(system), simulate(system, integrator="scipy")
    assert (run.trajectory.method, run.notes) == ("taylor", ())
    times = np.linspace(0, 5, 101)
    found, expected = (one.trajectory.interpolate(times) for one in (run, checked))
    assert np.abs(found - expected).max() < 1e-8
    x = sympy.Symbol("x", real=True)
    sine, functions = sympy.sin(x), (sympy.asin, sympy.acos, sympy.tan)
    away = [sympy.asin(0.9 * sine), x * sympy.acos(-sympy.tanh(x) / 2), sine]
    near = [sympy.asin(sine), sympy.acos(-sine), sympy.asin(x / 2), sympy.tan(sine / 2)]
    assert [may_branch(formula, functions) for formula in away + near] == [False] * 3 + [True] * 4
