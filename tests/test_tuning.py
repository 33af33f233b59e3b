"""Tuning: gradients against differences, quantities against simulation, the search as a whole."""

import json
import math
import signal
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import direct
from test_cli import invoke, result

import certrack
from certrack.certificates.arithmetic import decimal
from certrack.certificates.estimates.loop_data import PlainLoop
from certrack.certificates.estimates.peak_gains import peak_estimate
from certrack.certificates.formulation import error_problem
from certrack.certificates.methods import certify_peak
from certrack.core.errors import InputError
from certrack.loops.stability import linear_loop
from certrack.systems.edit import with_law
from certrack.tuning.candidate import Candidate
from certrack.tuning.conflict import conflict
from certrack.tuning.exceeded import broken_limits
from certrack.tuning.limits import Limit, Task
from certrack.tuning.measure import FOUND, SIMULATED, figures_of
from certrack.tuning.problem import Requirements, TuningProblem
from certrack.tuning.quantities import NoiseGain, PeakGainError, Quantity, SemidefiniteError
from certrack.tuning.registry import tuning_family
from certrack.tuning.responses import BoxPeak, BoxResponse, Grid, LinearEnergy, LinearPlant
from certrack.tuning.search import GainSearch, Price
from certrack.tuning.stability import StabilityEdge

#: What a gradient may differ from central differences by, over its largest entry.
GRADIENT = 1e-4


def random_system(seed, n, kind="robust", coupling=None):
    """A lean design of a random plant; some uncertain terms grow with the state, others do not."""
    rng = np.random.default_rng([seed, n])
    known = {"input_gain": 1.3, "theta": [0.4]} if kind != "adaptive" else {}
    plant = certrack.Plant(
        states=[f"x{i + 1}" for i in range(n)],
        chain=list(rng.uniform(0.6, 2.0, n - 1).round(3)),
        linear=[list(rng.uniform(-0.5, 0.5, i + 1).round(3)) for i in range(n - 1)],
        drift="-0.3*x1",
        regressor=["x1"],
        gain_sign=1,
        uncertainty=certrack.Uncertainty([1] * n, [0.002] * n, list(rng.uniform(0, 0.2, n))),
        **known,
    )
    c = tuple(rng.uniform(1.5, 4.0, n).round(3))
    own = {"coupling": coupling, "feedforward": int(rng.integers(n))}
    law = {
        "robust": certrack.Robust(c=c, **own),
        "adaptive": certrack.Adaptive(
            c=c, gain_rate=2.0, leak_gain=0.5, leak_theta=0.4, Gamma=[3.0], delta0=0.8, **own
        ),
    }[kind]
    return certrack.System(
        plant=plant,
        law=law,
        reference=certrack.SymbolicReference("0.2*sin(t) + 0.1*cos(2*t)"),
        truth=certrack.Truth(1.3, theta=[0.4]),
        settings=certrack.Settings([0.5] * n, 5),
    )


def candidate_of(system, shift=0.0):
    law = system.law
    family = tuning_family(system, law.kind, law.feedforward)
    base = system.replace(law=family.law(family.start))
    return Candidate(family, base, family.start + shift)


def differences(value, v, step):
    slopes = []
    for unit in step * np.eye(len(v)):
        slopes.append((value(v + unit) - value(v - unit)) / (2 * step))
    return np.array(slopes)


def agree(gradient, expected):
    return np.abs(gradient - expected).max() <= GRADIENT * np.abs(expected).max()


@pytest.mark.parametrize("n", range(1, 7))
@pytest.mark.parametrize("coupling", [None, 0.7])
def test_peak_gain_gradient_in_the_gains(n, coupling):
    """Chained through the recursion, with the grid of the quadrature held fixed."""
    point = candidate_of(random_system(1, n, coupling=coupling))
    loop, step = PlainLoop.of(point.base), 2e-3

    def log_bound(v):
        design = Candidate(point.family, point.base, v).design
        return math.log(peak_estimate(loop.with_design(design), gradient=False, step=step).bound)

    error = PeakGainError(point.base)
    found = peak_estimate(loop.with_design(point.design), step=step)
    error._last = point, found
    assert agree(error.log_gradient(point), differences(log_bound, point.v, 1e-4))


@pytest.mark.parametrize("n", range(1, 7))
def test_peak_estimate_is_what_is_proven(n):
    system = random_system(2, n)
    found = peak_estimate(PlainLoop.of(system).problem)
    proven, _ = certify_peak(system)
    assert found.bound == pytest.approx(proven.bound, rel=3e-4)
    assert found.shares.sum() == pytest.approx(found.bound)


def test_adaptive_quantity_is_the_problem_of_the_system():
    """The problem that the search makes is that of the system with these gains."""
    point = candidate_of(random_system(4, 3, "adaptive"), shift=0.1)
    ours = SemidefiniteError(point.base).problem(point)
    theirs = error_problem(point.system, decimal)
    for name in ("M", "Ua", "Ub", "Uy", "Xe", "Xy"):
        assert np.allclose(getattr(ours, name), getattr(theirs, name), rtol=1e-12, atol=0)
    assert ours.leakage(0.1) == pytest.approx(theirs.leakage(0.1), rel=1e-12)


def in_other_units(system, factors):
    """The same system with x_i in other units; x_1 keeps its own."""
    factors = [1.0, *factors]
    plant, n = system.plant, system.plant.n
    chain = [float(g) * factors[i] / factors[i + 1] for i, g in enumerate(plant.g)]
    linear = [
        [float(plant.b[i, j]) * factors[i] / factors[j] for j in range(i + 1)] for i in range(n - 1)
    ]
    u = plant.uncertainty
    beta = [b * f for b, f in zip(u.beta, factors, strict=True)]
    other = replace(
        plant,
        chain=chain,
        linear=linear,
        drift=f"-0.3*x1*{factors[-1]!r}",
        regressor=[f"x1*{factors[-1]!r}"],
        input_gain=1.3 * factors[-1],
        uncertainty=certrack.Uncertainty(u.tau, [0.0] * n, beta),
    )
    truth = certrack.Truth(1.3 * factors[-1], theta=[0.4])
    x0 = [0.5 * f for f in factors]
    return system.replace(plant=other, truth=truth, settings=certrack.Settings(x0, 5))


def test_units_change_nothing_of_a_balanced_design():
    system = random_system(5, 4, coupling=0.6)
    plain, other = (in_other_units(system, f) for f in ([1, 1, 1], [1e3, 0.02, 50.0]))
    points = [candidate_of(each) for each in (plain, other)]
    errors = [PeakGainError(point.base) for point in points]
    bounds, slopes = (
        [ask(error, point) for error, point in zip(errors, points, strict=True)]
        for ask in (PeakGainError.value, PeakGainError.log_gradient)
    )
    assert bounds[0] == pytest.approx(bounds[1], rel=1e-9)
    # the weights are decimals of 12 digits, and the differences steps of 1e-5
    assert slopes[0] == pytest.approx(slopes[1], rel=1e-6)


class TestQuantities:
    system = certrack.load("dual-motor-lean")

    def test_box_peak_is_that_of_the_worst_corner(self):
        """Nominal runs: never above it, and the worst corner reaches it."""
        point = candidate_of(self.system)
        nominal = point.base.replace(truth=replace(point.base.truth, omega=None))
        box = np.array([[-1.0, 1.0]] * 4)
        peak = BoxPeak(BoxResponse(LinearPlant.of(point.base), Grid.of(point.base), box)).value(
            point
        )
        simulator = certrack.Simulator(nominal)
        signs = np.array(np.meshgrid(*[[-1, 1]] * 4)).reshape(4, -1).T
        peaks = [
            simulator.run(nominal.with_settings(x0=tuple(map(float, s)), duration=3)).metrics
            for s in signs
        ]
        largest = max(metrics.peak_input for metrics in peaks)
        assert largest == pytest.approx(peak, rel=1e-3)
        rng = np.random.default_rng(0)
        for x0 in rng.uniform(-1, 1, (8, 4)):
            run = simulator.run(nominal.with_settings(x0=tuple(x0), duration=3))
            assert run.metrics.peak_input <= peak * (1 + 1e-6)

    def test_energy_is_that_of_the_nominal_run(self):
        point = candidate_of(self.system)
        nominal = point.base.replace(truth=replace(point.base.truth, omega=None))
        energy = LinearEnergy(
            LinearPlant.of(point.base), Grid.of(point.base), np.array([-1.0, 1, 1, 0])
        )
        run = certrack.simulate(nominal)
        assert energy.value(point) == pytest.approx(run.metrics.input_energy, rel=1e-4)

    def test_edge_and_its_gradient(self):
        point = candidate_of(self.system)
        drive = certrack.Implementation(0.003)
        loop = linear_loop(point.base.replace(implementation=drive))
        edge = StabilityEdge(loop, 0.01)
        assert loop.radius(0.999 * edge.value(point), 0.0) < 1
        assert loop.radius(1.001 * edge.value(point), 0.0) > 1
        assert edge.first(point) == pytest.approx(edge.value(point))

        def log_edge(v):
            return math.log(edge.value(Candidate(point.family, point.base, v)))

        assert agree(edge.log_gradient(point), differences(log_edge, point.v, 1e-4))

    def test_noise_gain_of_the_shipped_design(self):
        assert NoiseGain(self.system).value(candidate_of(self.system)) == pytest.approx(
            21.893, 1e-4
        )


@pytest.fixture(scope="module")
def tuned():
    system = certrack.load("dual-motor-lean")
    return certrack.tune(system, peak_input=39.1, period=0.087, starts=2)


class TestTune:
    def test_the_main_case(self, tuned):
        """Better than the hand-tuned design, exactly verified, within every limit."""
        assert tuned.after.certified <= 0.00124 < 0.00128 < tuned.before.certified
        assert tuned.after.certified == certrack.certify(tuned.system).best.bound
        assert tuned.after.worst_found <= tuned.after.certified
        assert tuned.after.peak_input <= 39.1
        assert tuned.after.period >= 0.087
        assert {entry.limit for entry in tuned.active} == {"peak input", "period"}
        assert all(0 < entry.price < 1 for entry in tuned.active)
        assert max(tuned.programs_per_start) <= 40

    @pytest.mark.slow
    def test_the_price_is_what_easing_the_limit_buys(self, tuned):
        """The multiplier against a second search with 2 % more of the limit."""
        price = {entry.limit: entry.price for entry in tuned.active}
        exponent = -math.log1p(-price["period"]) / -math.log(0.9)
        eased = certrack.tune(tuned.system, peak_input=39.1, period=0.98 * 0.087, starts=1)
        bought = -math.log(eased.after.certified / tuned.after.certified)
        assert bought == pytest.approx(-exponent * math.log(0.98), rel=0.25)

    @pytest.mark.slow
    def test_same_seed_same_answer(self, tuned):
        again = certrack.tune(
            certrack.load("dual-motor-lean"), peak_input=39.1, period=0.087, starts=2
        )
        assert again.system == tuned.system
        assert again.programs == tuned.programs

    @pytest.mark.slow
    def test_an_interruption_keeps_the_best(self):
        calls = []

        def interrupt(done, total, best):
            calls.append(best)
            if best is not None and done >= 1:
                raise KeyboardInterrupt

        system = certrack.load("dual-motor-lean")
        found = certrack.tune(system, peak_input=39.1, period=0.087, starts=5, progress=interrupt)
        assert found.stopped
        assert len(found.programs_per_start) == 1
        assert found.after.certified <= found.before.certified

    @pytest.mark.slow
    def test_peak_as_the_objective(self):
        found = certrack.tune(certrack.load("dual-motor-lean"), objective="peak", starts=1)
        assert found.after.peak_input < 0.97 * found.before.peak_input
        assert found.after.certified <= found.before.certified


class TestRefusals:
    def refusal(self, capfd, *arguments):
        code, _, err = invoke(capfd, "tune", *arguments)
        assert code == 2
        assert err.count("\n") == 1, err
        return err

    @pytest.mark.slow
    def test_what_conflicts_and_how_far_it_goes(self, capfd):
        err = self.refusal(capfd, "dual-motor-lean", "--peak-input", "5", "--starts", "1")
        assert "--peak-input: peak input <= 5 conflicts with period >= 0.003" in err
        assert "the best peak input found is" in err

    @pytest.mark.parametrize(
        ("arguments", "said"),
        [
            (["dual-motor-lean", "--error", "0.1"], "--error: is what is optimised"),
            (["dual-motor-lean", "--box", "1"], "--box: must be low:high"),
            (["dual-motor-lean", "--box", "-1:1"], "--box: must be a list of 4"),
            (["dual-motor-lean", "--box", "1:-1,0:1,0:1,0:1"], "--box[0]"),
            (["dual-motor-lean", "--peak-input", "-1"], "--peak-input: must be"),
            (["dual-motor-lean", "--feedforward", "7"], "--feedforward: must be"),
            (["dual-motor-lean", "--law", "pid"], "law.kind: has no gains that tune knows"),
            (["example1-classic"], "without leakage no bound exists"),
            (["example1", "--objective", "period"], "no exact longest period"),
            (["dual-motor-lean", "--plot", "p"], "--plot: draws a front"),
            (["dual-motor-lean", "--front", "colour", "--starts", "1"], "--front: must be one of"),
        ],
    )
    def test_one_clear_line(self, capfd, arguments, said):
        assert said in self.refusal(capfd, *arguments)

    def test_a_peak_without_a_box(self, capfd, tmp_path):
        system = certrack.load("dual-motor-lean").replace(population=None)
        certrack.save(system, tmp_path / "plain.toml")
        err = self.refusal(capfd, str(tmp_path / "plain.toml"), "--peak-input", "40")
        assert "must hold over a box of starts" in err and "--box -1:1" in err
        with pytest.raises(InputError, match=r"State ensemble\.x0") as refused:
            certrack.tune(system, peak_input=40)
        assert "--" not in str(refused.value)  # a page has no options


def test_only_the_law_is_another():
    """The heading of the next table, which a parser counts to the law, and remarks beside keys."""
    system = certrack.load("dual-motor-lean")
    run = "\n# ---- the run ----\n# 20 s\n\n[simulation]\nx0 = [0, 0, 0, 0] # at rest\n"
    for rest in (run, "\n# the end", "\n[law.lqr]\nQ = [1]\n# of the next\n\n[ensemble]\n"):
        text = f"# mine\n[law]\nkind = 'robust'   # by hand\nc = [1, 2] # 1/s\n{rest}"
        out = with_law(text, system, ["how it was made"])
        assert out.startswith('# mine\n[law]\n# how it was made\nkind = "robust" # by hand\nc = [')
        assert "] # 1/s\n" in out
        assert out.rstrip().endswith(rest.split("Q = [1]")[-1].rstrip())
        again = with_law(out, system, ["later"])
        assert again == out.replace("how it was made", "later")


def test_figures_that_exceed_their_limits_are_told():
    """The search knows some corners and the loop without its drive; the figures know more."""
    system = certrack.load("dual-motor-lean")
    figures = figures_of(system, None, 0)
    assert figures.peak_is == SIMULATED
    named = [type("Named", (), {"name": name})() for name in ("error", "peak input", "noise")]
    limits = [Limit(quantity, 1e-3) for quantity in named]
    (said,) = broken_limits(limits, figures)  # a run's peak is not that of a box
    assert said.startswith("error <= 0.001 is not kept: certified error 0.0012")
    found = replace(figures, certified=math.inf, peak_is=FOUND)
    assert [line.split(" is not")[0] for line in broken_limits(limits, found)] == [
        "error <= 0.001",
        "peak input <= 0.001",
    ]
    assert not broken_limits([Limit(named[0], figures.certified)], figures)


def test_what_has_no_certificate_is_no_design():
    """It keeps every limit, and is neither the best nor the nearest."""

    class Nothing(Quantity):
        name = "error"

        def value(self, candidate):
            return math.inf

    system = certrack.load("dual-motor-lean")
    family = tuning_family(system, "robust", 1)
    search = GainSearch(system, Task(Nothing(), True, (), lambda candidate: True))
    search.run(family, family.start)
    assert search.state.best is None and search.state.nearest is None
    problem = TuningProblem(system, system, Requirements(), "error")
    assert "has a certificate" in str(conflict(problem, family, search))


def test_the_price_of_a_longer_period():
    """Of what is made large, a price is what it grows by; of what is made small, what it falls."""
    price = Price(Limit(NoiseGain(certrack.load("dual-motor-lean")), 2.0), 2.0, 3.0)
    assert math.isclose(price.gain(0.1, -1.0), 1.1**3 - 1)
    assert math.isclose(price.gain(0.1, 1.0), 1 - 1.1**-3)


def test_the_tuned_file(capfd, tmp_path):
    """It loads, says how it was made, and keeps the comments of the file it was made from."""
    source, out = tmp_path / "mine.toml", tmp_path / "tuned.toml"
    source.write_text(certrack.starter("dual-motor-lean"))
    arguments = ["--peak-input", "39.1", "--starts", "1", "--out", str(out)]
    found = result(capfd, "tune", str(source), *arguments)
    text = out.read_text()
    assert "# inertia of the load" in text  # the user's own
    assert "error optimised within\n#   peak input <= 39.1" in text
    assert "10 % more peak input buys" in text
    assert certrack.load(out).law.c == tuple(found["law"]["c"])
    assert tomllib.loads(text)["law"]["kind"] == "robust"
    loaded = certrack.load(out)
    certrack.save(loaded, tmp_path / "again.toml")
    assert certrack.load(tmp_path / "again.toml") == loaded
    assert found["after"]["certified"] < found["before"]["certified"]
    assert set(found["active"][0]) == {"limit", "value", "price"}
    assert json.dumps(found["programs_per_start"]) == f"[{found['programs']}]"


@pytest.mark.slow
def test_goals_of_the_dual_motor():
    system = certrack.load("dual-motor-lean")
    first = certrack.tune(system, peak_input=39.1, period=0.087)
    assert first.after.certified <= 0.00150
    assert first.programs <= 250 and np.median(first.programs_per_start) <= 30
    third = certrack.tune(system, peak_input=39.1, period=0.087, feedforward=3)
    assert third.after.certified <= 0.00034
    assert third.programs <= 250 and np.median(third.programs_per_start) <= 30


@pytest.mark.slow
def test_goals_of_any_linear_law():
    """Random starts are backstepping designs; the result is none."""
    system = certrack.load("dual-motor-lean")
    found = certrack.tune(system, peak_input=39.1, period=0.087, law="linear")
    assert found.after.certified <= 0.00120
    assert found.after.peak_input <= 39.1 and found.after.period >= 0.087
    assert found.programs <= 250 and np.median(found.programs_per_start) <= 30
    again = certrack.tune(found.system, peak_input=39.1, period=0.087, starts=1)
    assert again.after.certified <= found.after.certified * (1 + 1e-6)
    back = certrack.tune(found.system, peak_input=60, period=0.05, law="robust", starts=1)
    assert back.system.law.kind == "robust" and back.after.certified < 0.0013


@pytest.mark.parametrize("n", [2, 4])
def test_a_linear_family_holds_the_backstepping_designs(n):
    """The start is the design itself, and a random start a design with other rates."""
    system = random_system(8, n)
    point = candidate_of(system)
    error = PeakGainError(point.base)
    q = system.law.feedforward
    family = tuning_family(point.base, "linear", q)
    base = point.base.replace(law=family.law(family.start))
    linear = Candidate(family, base, family.start)
    assert PeakGainError(base).value(linear) == pytest.approx(error.value(point), rel=1e-9)
    moved = Candidate(family, base, family.random(np.random.default_rng(0)))
    assert np.linalg.eigvals(moved.design.error_matrix).real.max() < 0
    assert moved.law.feedforward == q


@pytest.mark.slow
def test_goals_of_example1():
    system = certrack.load("example1")
    first = certrack.tune(system, peak_input=15.9, feedforward=1, starts=1)
    assert first.after.certified <= 0.0255 and first.after.method == "bootstrap"
    proven = certrack.certify(first.system)
    assert proven.semidefinite.bound <= 0.0455
    assert first.after.certified == proven.best.bound
    assert first.after.peak_input <= 15.9
    plant = replace(system.plant, input_gain_range=(1.5, 2.5), theta_range=((1.5, 2.5),))
    ranged = certrack.tune(system.replace(plant=plant), peak_input=15.9, feedforward=1, starts=1)
    assert ranged.after.certified <= 0.0698
    assert ranged.after.peak_input <= 15.9


@pytest.mark.slow
def test_a_drive_is_tuned_as_it_runs():
    """The sampled loop's own bound gets smaller, and its limits stay proven never to be met."""
    system = certrack.load("dual-motor-drive")
    found = certrack.tune(system, starts=1)
    assert found.before.method == found.after.method == "implemented"
    assert found.after.certified < 0.9 * found.before.certified
    assert certrack.certify(found.system).implemented.saturation == "inactive"


@pytest.mark.slow
def test_an_optimum_is_not_improved_by_a_global_search(tuned):
    """SciPy's `direct`, about the optimum, with the same limits as penalties."""
    system = certrack.load("dual-motor-lean")
    wanted = Requirements(peak_input=39.1, period=0.087)
    point = candidate_of(system)
    problem = TuningProblem(point.base, system, wanted, "error")
    family = point.family
    centre = np.log(tuned.system.law.c)

    def penalised(v):
        each = Candidate(family, point.base, v)
        excess = max(limit.excess(each) for limit in problem.task.limits)
        return math.log(problem.error.value(each)) + 100 * max(0.0, excess)

    bounds = list(zip(centre - 0.4, centre + 0.4, strict=True))
    found = direct(penalised, bounds, maxfun=300)
    assert found.fun >= penalised(centre) - 1e-3


@pytest.mark.slow
def test_a_front_and_its_picture(capfd, tmp_path):
    arguments = ["--peak-input", "39.1", "--starts", "1", "--front", "period"]
    found = result(capfd, "tune", "dual-motor-lean", *arguments, "--plot", str(tmp_path))
    points = [p for p in found["front"]["points"] if p["objective"] is not None]
    errors = [p["objective"] for p in points]
    assert len(points) >= 4
    assert all(a <= b * (1 + 1e-3) for a, b in zip(errors, errors[1:], strict=False))
    assert (tmp_path / "front.png").stat().st_size < 300_000


@pytest.mark.slow
def test_signals_are_left_alone():
    """The search catches an interruption, it does not install a handler."""
    before = signal.getsignal(signal.SIGINT)
    certrack.tune(certrack.load("dual-motor-lean"), starts=1)
    assert signal.getsignal(signal.SIGINT) is before
