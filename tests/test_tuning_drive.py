"""Tuning of what a drive has besides: observers, integral action, ranges, limits that conflict."""

import math
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from test_cli import invoke

import certrack
from certrack.app import long_tasks
from certrack.app.task_progress import TaskProgress
from certrack.certificates.certificate import Certificate
from certrack.laws.observer import Observer
from certrack.loops.stability import linear_loop
from certrack.reports.tuning import remarks, tuned_bounds, tuned_notes, tuned_table, warnings
from certrack.systems.edit import with_law
from certrack.tuning import measure as measure_room
from certrack.tuning import tune as module
from certrack.tuning.candidate import Candidate
from certrack.tuning.certified import certified_or_why
from certrack.tuning.companion import companion, is_memoryless, with_law_of
from certrack.tuning.drive_family import DriveFamily
from certrack.tuning.exceeded import broken_limits
from certrack.tuning.families import AdaptiveFamily
from certrack.tuning.limits import Limit
from certrack.tuning.measure import UNMEASURED, ContinuousFigures, _Fixed, alike, box_peak
from certrack.tuning.problem import Requirements
from certrack.tuning.quantities import Largest, NoiseGain, PeakGainError
from certrack.tuning.ranged import RangedError
from certrack.tuning.responses import Grid
from certrack.tuning.result import Tuned
from certrack.tuning.sampled_responses import SampledPlant, input_plant
from certrack.tuning.stability import DelayEdge, EstimatesPeriod
from certrack.tuning.stages import searches_of
from certrack.tuning.tune import ONE_PROOF

DRIVE = certrack.Implementation(period=0.002, delay=1.5, initial_input=0.3)


def observed(**changes):
    """A shipped system with an observer, its sensors exact, nothing disturbing it."""
    system = certrack.load("dual-motor-observer")
    drive = replace(system.implementation, measurement_quantum=None, **changes)
    settings = replace(system.settings, duration=0.4, tail=0.2)
    truth = replace(system.truth, omega=None)
    return system.replace(implementation=drive, settings=settings, truth=truth)


def with_integral(integral=3.0, drive=DRIVE):
    system = certrack.load("dual-motor-lean")
    law = replace(system.law, integral=integral)
    settings = replace(system.settings, duration=0.4, tail=0.2)
    truth = replace(system.truth, omega=None)
    return system.replace(law=law, implementation=drive, settings=settings, truth=truth)


@pytest.mark.parametrize(
    "system",
    [observed(), observed(delay=1.3, offset=0.0004), with_integral()],
    ids=["observer", "late", "integral"],
)
def test_the_input_over_a_box_is_that_of_simulations(system):
    """From the middle, and from a corner: what the box adds is reached there."""
    plant = SampledPlant.of(system)
    centre, radius = np.array(system.settings.x0), np.array([0.3, 0.1, 0.2, 0.5])
    found = plant.response(_Fixed(system), Grid((), ()), centre, radius)
    u, spread = found.u[0], found.spread[0]

    def simulated(x0):
        settings = replace(system.settings, x0=tuple(x0))
        run = certrack.simulate(system.replace(settings=settings))
        return run.input_of(acts, run.trajectory.interpolate(acts))

    times = float(system.implementation.offset) + found.steps[0] * np.arange(len(u))
    acts = times + float(system.implementation.run_delay) * found.steps[0] + 1e-6
    inside = acts < system.settings.duration
    acts, u, spread = acts[inside], u[inside], spread[inside]
    assert np.abs(simulated(centre) - u).max() < 1e-5 * np.abs(u).max()
    largest = 0.0
    for signs in ([1, 1, 1, 1], [1, -1, 1, -1], [1, 1, -1, -1]):
        off = np.abs(simulated(centre + radius * np.array(signs)) - u)
        largest = max(largest, (off / spread).max())
        assert (off - spread).max() < 1e-5 * spread.max()
    assert largest > 0.3


def test_the_input_of_a_plain_law_is_that_of_the_continuous_loop():
    assert isinstance(input_plant(certrack.load("dual-motor-observer")), SampledPlant)
    assert not isinstance(input_plant(certrack.load("dual-motor-drive")), SampledPlant)


def test_a_family_of_drives_begins_at_the_files_own_law():
    system = certrack.load("dual-motor-observer")
    *_, last = searches_of(system, Requirements(), "error", None, None)
    family = last.family
    law = family.law(family.start)
    np.testing.assert_allclose(law.observer.weights, system.law.observer.weights)
    np.testing.assert_allclose(law.c, system.law.c)
    assert law.sampled_feedforward and law.feedforward == 3
    moved = family.written(family.start + 0.1)
    assert moved.observer.weights == (33.1551, 17.6827, 4337.8)
    again = family.random(np.random.default_rng(1))
    assert again.shape == family.start.shape and (again != family.start).all()


@pytest.mark.parametrize(
    ("observer", "numbers"),
    [
        ({"kind": "dob", "bandwidth": 40.0}, 1),
        ({"kind": "dob", "bandwidth": (40.0, 30.0), "rows": ("x2", "x4")}, 2),
        ({"kind": "kalman", "bandwidth": 200.0}, 1),
    ],
)
def test_bandwidths_are_tuned(observer, numbers):
    system = certrack.load("dual-motor-observer")
    law = replace(system.law, observer=Observer(**observer), integral=2.0)
    inner = searches_of(system, Requirements(), "error", None, None)[0].family
    family = DriveFamily(inner, law, 3)
    assert len(family.start) == len(inner.start) + numbers + 1
    double = family.law(family.start + math.log(2))
    assert np.ravel(double.observer.bandwidth) == pytest.approx(2 * np.ravel(observer["bandwidth"]))
    assert double.integral == pytest.approx(4.0)


def test_the_companion_has_what_the_continuous_loop_has():
    system = certrack.load("dual-motor-observer")
    plain = companion(system)
    assert (
        is_memoryless(plain.law) and not is_memoryless(system.law) and plain.implementation is None
    )
    example = certrack.load("example1")
    estimating = example.replace(settings=replace(example.settings, estimates=(0.4, 2.0)))
    plant = replace(example.plant, input_gain=2, theta=[2])
    known = with_law_of(estimating.replace(plant=plant), certrack.Robust(c=(1, 1)))
    assert known.settings.estimates is None
    again = replace(example.law, leak_gain=0.7)
    assert with_law_of(estimating, again).settings.estimates == (0.4, 2.0)


def test_ranges_are_tuned_for_their_worst_corner():
    """What the linear program of `certify` attains there, and hardly below a proof of all."""
    system = certrack.load("axis")
    error = RangedError(system).value(_Fixed(system))
    found = certrack.certify(system, "fast")
    assert error == pytest.approx(found.attainable, rel=0.01)
    assert found.attainable < found.best.bound < 1.3 * error
    nominal = system.replace(plant=replace(system.plant, constant_ranges=()))
    assert error > 2 * PeakGainError(nominal).value(_Fixed(nominal))


def test_a_delay_that_no_loop_bears_is_found_without_thousands_of_states():
    system = certrack.load("dual-motor-lean")
    drive = certrack.Implementation(0.003)
    loop = linear_loop(system.replace(implementation=drive))
    near = DelayEdge(loop, 0.01, period=0.003).value(_Fixed(system))
    assert near == pytest.approx(DelayEdge(loop, 0.2, period=0.003).value(_Fixed(system)))
    assert 0.01 < near < 0.2


def test_estimates_forget_within_their_period():
    """1/(gain_rate leak_gain) of the faster estimate: there a step leaves nothing."""
    system = certrack.load("example1")
    law = replace(system.law, gain_rate=4.0, leak_gain=5.0)
    assert EstimatesPeriod().value(_Fixed(system.replace(law=law))) == pytest.approx(1 / 20)


def test_the_largest_of_several():
    system = certrack.load("dual-motor-lean")
    noise = NoiseGain(system)

    class Half(NoiseGain):
        def value(self, candidate):
            return super().value(candidate) / 2

    both = Largest([Half(system), noise])
    point = Candidate(
        searches_of(system, Requirements(), "error", None, None)[0].family,
        system,
        np.log(system.law.c),
    )
    assert both.name == "noise" and both.value(point) == noise.value(point)
    np.testing.assert_array_equal(both.log_gradient(point), noise.log_gradient(point))


def test_what_was_found_is_kept_where_its_measurement_is_interrupted(monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "figures_of", interrupted)
    system = certrack.load("stiction")
    found = certrack.tune(system, starts=1)
    assert found.stopped and math.isnan(found.after.certified)
    assert found.system.law != system.law
    assert not found.broken
    named = type("Named", (), {"name": "error"})()
    assert not broken_limits([Limit(named, 1e-9)], UNMEASURED)


class TestPlaces:
    """Nothing is computed for a file that could not be written, or not be read again."""

    def refusal(self, capfd, monkeypatch, *arguments):
        monkeypatch.setattr(module, "searches_of", None)  # no search begins
        code, _, err = invoke(capfd, "tune", *arguments)
        assert code == 2 and err.count("\n") == 1, err
        return err

    def test_a_folder_that_is_not_there(self, capfd, monkeypatch, tmp_path):
        out = tmp_path / "none" / "tuned.toml"
        assert "cannot be written" in self.refusal(
            capfd, monkeypatch, "dual-motor-lean", "--out", str(out)
        )

    def test_a_link_to_the_file_itself(self, capfd, monkeypatch, tmp_path):
        source, link = tmp_path / "mine.toml", tmp_path / "link.toml"
        source.write_text(certrack.starter())
        link.symlink_to(source)
        err = self.refusal(capfd, monkeypatch, str(source), "--out", str(link))
        assert "would be written over" in err
        assert source.read_text() == certrack.starter() and not list(tmp_path.glob(".certrack*"))

    def test_samples_that_the_tuned_file_would_not_find(self, capfd, monkeypatch, tmp_path):
        (tmp_path / "moves.csv").write_text("0,0\n1,0.1\n2,0\n")
        head, rest = certrack.starter().split('signal = "0.5*sin(t)"', 1)
        text = f'{head}kind = "samples"\nfile = "moves.csv"\n{rest}'
        source, other = tmp_path / "mine.toml", tmp_path / "other"
        other.mkdir()
        source.write_text(
            text.replace("feedforward = 1", "feedforward = 0").replace(
                "duration = 20", "duration = 2"
            )
        )
        err = self.refusal(capfd, monkeypatch, str(source), "--out", str(other / "tuned.toml"))
        assert "would not find the samples" in err and str(tmp_path) in err


def test_tables_in_the_law_keep_their_comments():
    system = certrack.load("dual-motor-observer")
    text = certrack.starter("dual-motor-observer")
    law = replace(system.law, observer=replace(system.law.observer, weights=(1.0, 2.0, 3.0)))
    out = with_law(text, system.replace(law=law), ["made"])
    assert "weights = [1.0, 2.0, 3.0] # x2, x4 and what acts on the rate of x4" in out
    assert tomllib.loads(out)["law"]["sampled_feedforward"] is True
    assert certrack.loads(out).law == law


class TestRefusals:
    def refusal(self, system, **wanted):
        with pytest.raises(certrack.InputError) as problem:
            certrack.tune(system, starts=1, **wanted)
        return str(problem.value)

    def test_integral_action_without_a_certificate(self):
        lean, example = certrack.load("dual-motor-lean"), certrack.load("example1")
        continuous = lean.replace(law=replace(lean.law, integral=3.0))
        assert "law.integral: has a certificate as implemented only" in self.refusal(continuous)
        law = replace(example.law, k=None, p=None, integral=3.0)
        estimating = example.replace(law=law, implementation=DRIVE)
        assert "law.integral: has no certificate together" in self.refusal(estimating)
        driven = continuous.replace(implementation=DRIVE)
        assert "law.integral: is not known to the linear law" in self.refusal(driven, law="linear")

    def test_a_formula_as_a_bound_without_a_drive(self):
        drag = certrack.load("dual-motor-drag").replace(implementation=None)
        assert "as implemented only: state [implementation]" in self.refusal(drag)

    @pytest.mark.slow
    def test_a_limit_does_not_conflict_with_itself(self):
        """Of a nonlinear loop the corners of the box have a limit each."""
        said = self.refusal(certrack.load("example1"), peak_input=0.5)
        assert said.count("peak input <=") == 1


def test_the_gains_of_a_new_file_are_those_of_a_tuned_one():
    """Rules for the guesses; a third of the error that the earlier gains certified."""
    system = certrack.loads(certrack.starter())
    family = AdaptiveFamily(system, system.law.feedforward)
    assert family.base.delta0 == pytest.approx(system.law.delta0, rel=1e-5)
    assert family.base.theta0 == system.law.theta0
    assert certrack.certify(system).best.bound < 0.036


@pytest.mark.slow
def test_a_new_file_is_certified_within_twice_what_a_search_finds():
    system = certrack.loads(certrack.starter())
    assert box_peak(system, np.array([[-0.5, 0.5]] * 2), 0) <= 15
    certified = certrack.certify(system).best.bound
    assert certified < 2 * certrack.falsify(system, budget=1500).worst_error


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "method"),
    [
        ("dual-motor-observer", "implemented"),
        ("dual-motor-drag", "implemented"),
        ("flexible-joint", ""),
        ("axis", ""),
        ("theorem1-counterexample", ""),
    ],
)
def test_shipped_systems_are_tuned(name, method):
    """A smaller error, proven, and not below the worst that is found of the same loop."""
    found = certrack.tune(certrack.load(name), starts=1)
    assert found.after.certified < found.before.certified
    assert found.after.method == method or not method
    for figures in (found.before, found.after):
        assert figures.worst_found is None or figures.worst_found <= figures.certified


@pytest.mark.slow
def test_an_observer_and_an_integral_are_tuned_within_the_peak_of_the_sampled_loop():
    system = certrack.load("dual-motor-lean")
    drive = certrack.Implementation(period=0.001, delay=0.5)
    law = replace(system.law, integral=3.0)
    driven = system.replace(law=law, implementation=drive)
    found = certrack.tune(driven, peak_input=40.0, starts=1)
    assert found.after.peak_input <= 40.0 < found.before.peak_input
    assert found.system.law.integral != 3.0
    assert found.after.method == "implemented"


@pytest.mark.parametrize(
    ("name", "starts"),
    [
        ("dual-motor-drive", "from x0 and the proven polytope"),
        ("dual-motor-drag", "from x0 and the box of starts"),
        ("dual-motor-lean", ""),
    ],
)
def test_a_bound_from_some_starts_says_so(name, starts):
    proven = certified_or_why(certrack.load(name))
    assert proven.best.verified and proven.starts == starts
    figures = replace(UNMEASURED, certified=proven.best.bound, starts=proven.starts)
    tuned = Tuned(certrack.load(name), "error", UNMEASURED, figures, (), (), 1, (1,), 0)
    told = [line for line in tuned_notes(tuned) if "holds" in line]
    assert told == ([f"the certified error after holds {starts}"] if starts else [])


OF_DRIVE = replace(UNMEASURED, certified=0.5, worst_found=0.3, method="implemented")
OF_LAW = replace(
    UNMEASURED, certified=0.125, worst_found=0.1, method="cells", continuous_only="not yet"
)


@pytest.mark.parametrize("turned", [False, True])
def test_before_and_after_are_bounds_of_the_same_loop(monkeypatch, turned):
    """One that is of the drive gets what its continuous law has, and both are printed."""
    system, asked = certrack.load("dual-motor-drive"), []

    def proof(of, **_):
        asked.append(of.implementation)
        return Certificate("cells", 0.25, verified=True)

    monkeypatch.setattr(measure_room, "certified", proof)
    monkeypatch.setattr(measure_room, "_falsified", lambda of, seed, as_implemented: 0.2)
    pairs = [(system, OF_DRIVE), (system, OF_LAW)]
    before, after = alike(*(pairs[::-1] if turned else pairs), 0)
    drive, law = (after, before) if turned else (before, after)
    assert asked == [None]
    assert drive == replace(OF_DRIVE, continuous=ContinuousFigures(0.25, 0.2))
    assert law == replace(OF_LAW, continuous=ContinuousFigures(0.125, 0.1))
    found = Tuned(system, "error", before, after, (), (), 1, (1,), 0)
    columns = [["0.5", "-"], ["0.3", "-"], ["0.25", "0.125"], ["0.2", "0.1"]]
    rows = [list(row[1:]) for row in tuned_table(found, None).rows[:4]]
    assert rows == [column[::-1] if turned else column for column in columns]
    labels = [pair[0][0] for pair in tuned_bounds(found)]
    assert labels == [f"certified error, {of}" for of in ("as the drive runs it", "continuous law")]
    smaller = "0.25" if turned else "0.125"
    assert any(f"certified {smaller} (" in line for line in remarks(found, "a file"))
    assert any("not better" in line for line in warnings(found)) == turned
    assert smaller in repr(found)
    assert found.summary()["before"]["continuous"]["certified"] == before.continuous.certified


@pytest.mark.parametrize(
    ("figures", "of"),
    [(OF_DRIVE, ", as the drive runs it"), (OF_LAW, ", continuous law")],
    ids=["drive", "law"],
)
def test_bounds_of_one_loop_stand_in_one_row(figures, of):
    system = certrack.load("dual-motor-drive")
    none = replace(UNMEASURED, certified=math.inf)
    for other in (figures, none):
        assert alike((system, other), (system, figures), 0) == (other, figures)
        found = Tuned(system, "error", other, figures, (), (), 1, (1,), 0)
        (((label, *_), _),) = tuned_bounds(found)
        assert label == f"certified error{of}"
    nothing = Tuned(system, "error", none, none, (), (), 1, (1,), 0)
    assert tuned_bounds(nothing)[0][0][0] == "certified error"


def test_the_continuous_law_of_a_drive_is_certified_and_attacked():
    """The real figures: not below what is found of that law, nor above the loop's of the drive."""
    system = certrack.load("dual-motor-drive")
    proven = certified_or_why(system).best
    of_drive = replace(UNMEASURED, certified=proven.bound, method=proven.kind)
    found = alike((system, of_drive), (system, OF_LAW), 0)[0].continuous
    assert found.worst_found <= found.certified < proven.bound


def test_the_designer_shows_the_same_rows(monkeypatch):
    system = certrack.load("dual-motor-drive")
    both = [replace(f, continuous=ContinuousFigures(0.25, 0.2)) for f in (OF_DRIVE, OF_LAW)]
    found = Tuned(system, "error", *both, (), (), 1, (1,), 0)
    monkeypatch.setattr(module, "tune", lambda *_, **__: found)
    header, _ = long_tasks._tune(system, {}, TaskProgress("tune", 1, [].append), None)
    labels = ["certified error", "worst error found"]
    of = [", as the drive runs it", ", continuous law"]
    assert [row[0] for row in header["table"][:4]] == [label + o for o in of for label in labels]
    assert header["table"][0][1] == "0.5" and header["table"][2][1:] == ["0.25", "0.25"]


#: A motor and a load whose inertia is known within 30 %, on a drive.
RANGED_DRIVE = """
[plant]
states = ["q", "v"]
chain = [1]
drift = "0"
gain_sign = 1
input_gain = "0.2/(2e-4 + JL)"
[plant.constants]
JL = 1e-3
[plant.ranges]
JL = ["0.7*1e-3", "1.3*1e-3"]
[plant.uncertainty]
tau = [0, 1]
gamma = [0, 0]
beta = [0, 22]
[truth]
input_gain = "0.2/(2e-4 + JL)"
[reference]
signal = "0.5*sin(6*t)"
[law]
kind = "robust"
c = [40, 40]
feedforward = 1
[simulation]
x0 = [0, 3]
duration = 1
[implementation]
period = 0.001
delay = 0.5
"""


def test_a_note_tells_that_cells_prove_less():
    """Of the drive with ranges: its bounds in a tuning are of one proof for all of them."""
    found = certrack.tune(certrack.loads(RANGED_DRIVE), starts=1)
    assert found.after.method == "implemented" and ONE_PROOF in found.notes
    sampled = certrack.certify(found.system).implemented
    assert sampled.cells > 1 and sampled.bound < found.after.certified
