"""What users add in a notebook works to the end: laws, a reference, disturbances, distributions."""

import dataclasses
import re
import shutil
import subprocess
from dataclasses import dataclass

import extensions
import numpy as np
import pytest
import scipy.stats
import sympy
from extensions import SYSTEMS, PrescribedPerformance, Spline, dynamic_surface
from pace import within

import certrack
from certrack import laws, references
from certrack.core.errors import InputError
from certrack.core.latex import latex_number, latex_table, latex_text
from certrack.export.c.export import export_c
from certrack.export.fmu import fmu
from certrack.laws import Equations, symbol
from certrack.loops.controller import sampled_controller, starting_state
from certrack.model.disturbance import DisturbanceFamily, register_disturbance
from certrack.testing import LawConformance, ReferenceConformance


class TestDynamicSurface(LawConformance):
    system = dynamic_surface()


class TestPrescribedPerformance(LawConformance):
    system = extensions.prescribed_performance()
    points = [
        (0.0, {}),
        (0.7, {"x1": 0.4, "x2": -0.3, "bias": 0.1}),
        (3.0, {"x1": -0.15, "x2": 0.2, "bias": -0.4}),
    ]


class TestSpline(ReferenceConformance):
    reference = extensions.spline().reference
    duration = 5.0


@pytest.fixture(params=SYSTEMS)
def make(request):
    return SYSTEMS[request.param]


def test_initial_values_are_those_the_law_states_and_the_file_overrides_them():
    system = extensions.prescribed_performance()
    assert certrack.simulate(system).z[:, 0].tolist() == [0.25]
    other = system.with_settings(estimates=(0.5,))
    assert certrack.simulate(other).z[:, 0].tolist() == [0.5]
    sampled = other.replace(implementation=certrack.Implementation(period=0.01, offset=0.005))
    implementation = sampled.implementation
    made = sampled_controller(sampled.plant, sampled.controller, implementation)
    assert made.states[-1].name == "ctl_sample"
    assert starting_state(made, sampled.estimates, implementation).tolist() == [0.5, 0.5]


def test_the_barrier_holds_and_time_counts():
    """|e_1| < rho(t) in continuous time; a rho that stood still would not do what this one does."""
    run = certrack.simulate(extensions.prescribed_performance())
    law = run.system.law
    rho = (law.rho_0 - law.rho_end) * np.exp(-law.speed * run.t) + law.rho_end
    assert np.all(np.abs(run.e[0]) < rho)
    slow = run.system.replace(law=dataclasses.replace(law, speed=1e-6))
    assert abs(certrack.simulate(slow).metrics.tail_error / run.metrics.tail_error - 1) > 0.05


def test_sampled_runs_tend_to_the_continuous_one(make):
    continuous = certrack.simulate(make()).metrics.tail_error
    found = [
        certrack.simulate(make(implementation=certrack.Implementation(period=T))).metrics.tail_error
        for T in (2e-3, 1e-3)
    ]
    errors = [abs(value - continuous) for value in found]
    assert errors[1] < 0.02 * continuous
    assert errors[1] < 0.75 * errors[0]


@pytest.mark.parametrize("implementation", [None, certrack.Implementation(period=1e-3)])
def test_members_agree_however_they_are_computed(make, implementation):
    system = make(implementation=implementation).with_settings(duration=1)
    found = [
        certrack.ensemble(system, 4, method=method, limit=1.0).per_member()[0]
        for method in ("native", "lockstep", "alone")
    ]
    for other in found[1:]:
        np.testing.assert_allclose(other, found[0], rtol=1e-3, atol=1e-5)


def test_files_hold_them(make, tmp_path):
    system = make()
    certrack.save(system, tmp_path / "mine.toml")
    assert certrack.load(tmp_path / "mine.toml") == system
    run = certrack.simulate(system, duration=1)
    run.save(tmp_path / "run.nc")
    again = certrack.Run.load(tmp_path / "run.nc")
    assert again.system == run.system
    assert again.metrics == run.metrics
    assert again.final_state == run.final_state
    for name in ("t", "x", "z", "u", "e", "y_d"):
        np.testing.assert_array_equal(getattr(again, name), getattr(run, name))


@pytest.mark.parametrize("name", ["dual-motor-physical", "dual-motor-drive"])
def test_runs_of_other_plants_and_drives_come_back(name, tmp_path):
    run = certrack.simulate(certrack.load(name), duration=0.05)
    run.save(tmp_path / "run.nc")
    again = certrack.Run.load(tmp_path / "run.nc")
    assert again.metrics.as_dict() == run.metrics.as_dict()  # NaN is not equal to itself
    assert again.final_state == run.final_state
    assert again.system == run.system
    assert (again.outcome, again.notes) == (run.outcome, run.notes)
    middle, n = np.array([(run.t[10] + run.t[11]) / 2]), run.system.plant.n
    found, expected = (each.trajectory.interpolate(middle)[:n] for each in (again, run))
    np.testing.assert_allclose(found, expected, rtol=0.05, atol=1e-3)


def test_what_is_no_saved_run_is_refused(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        certrack.Run.load(tmp_path / "none.nc")
    (tmp_path / "text.nc").write_text("no data")
    with pytest.raises(InputError, match=r"text.nc: cannot be read \(it is no NetCDF file\)"):
        certrack.Run.load(tmp_path / "text.nc")
    certrack.ensemble(
        certrack.load("example1").with_settings(duration=1), 4, method="lockstep", limit=1.0
    ).dataset().to_netcdf(tmp_path / "bands.nc", engine="h5netcdf")
    with pytest.raises(InputError, match="holds no run of certrack"):
        certrack.Run.load(tmp_path / "bands.nc")


def test_c_passes_its_acceptance_test(make, tmp_path):
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    limited = {"saturation": (-30.0, 30.0), "rate_limit": 5000.0, "offset": 0.0005}
    system = make(implementation=certrack.Implementation(period=1e-3, **limited))
    system = system.with_settings(duration=1)
    export_c(system, tmp_path, "mine")
    command = [compiler, "-std=c99", "-Wall", "-Wextra", "-Werror", "mine.c", "mine_test.c", "-lm"]
    subprocess.run([*command, "-o", "a.out"], cwd=tmp_path, check=True)
    done = subprocess.run([tmp_path / "a.out"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("version", ["2", "3"])
def test_fmu_gives_the_run_of_python(make, version, tmp_path):
    """The FMU, stepped by FMPy beside the plant of python-control, follows our own run."""
    fmpy = pytest.importorskip("fmpy")
    pytest.importorskip("control")
    from fmpy.fmi2 import FMU2Slave
    from fmpy.fmi3 import FMU3Slave

    T, steps = 1e-3, 300
    system = make(implementation=certrack.Implementation(period=T)).with_settings(duration=1)
    path = tmp_path / "mine.fmu"
    path.write_bytes(fmu(system, "mine", version=version))
    description = fmpy.read_model_description(str(path))
    names = {v.name: v.valueReference for v in description.modelVariables}
    controller = (FMU2Slave if version == "2" else FMU3Slave)(
        guid=description.guid,
        unzipDirectory=fmpy.extract(str(path), tmp_path / "unzipped"),
        modelIdentifier="mine",
        instanceName="controller",
    )
    controller.instantiate()
    if version == "2":
        controller.setupExperiment()
    controller.enterInitializationMode()
    controller.exitInitializationMode()
    read = controller.getReal if version == "2" else controller.getFloat64
    write = controller.setReal if version == "2" else controller.setFloat64
    blocks = certrack.to_control(system)
    x, inputs = blocks.X0[: system.plant.n], blocks.controller.input_labels
    for k in range(steps):
        measured = blocks.plant.output(k * T, x, [0])
        values = [*measured, *blocks.reference.output(k * T, [], [])]
        write([names[name] for name in inputs], values)
        controller.doStep(currentCommunicationPoint=k * T, communicationStepSize=T)
        x = blocks.plant.dynamics(k * T, x, read([names["u"]]))
    controller.terminate()
    controller.freeInstance()
    run = certrack.simulate(system, duration=steps * T)
    np.testing.assert_allclose(x, list(run.final_state.values())[: system.plant.n], atol=1e-8)


def test_discrete_blocks_of_python_control_follow_the_run(make):
    control = pytest.importorskip("control")
    T, steps = 1e-3, 300
    system = make(implementation=certrack.Implementation(period=T)).with_settings(duration=1)
    blocks = certrack.to_control(system)
    times = T * np.arange(steps + 1)
    found = control.input_output_response(blocks.loop, times, X0=blocks.X0)
    run = certrack.simulate(system, duration=steps * T)
    expected = list(run.final_state.values())[: system.plant.n]
    np.testing.assert_allclose(found.states[: system.plant.n, -1], expected, atol=1e-8)


def test_a_law_with_the_time_in_it_has_no_exact_edge_of_stability():
    """The number of the sample grows, which is no instability of the loop."""
    from certrack.loops.stability import linear_loop

    system = certrack.load("dual-motor-lean")
    system = system.replace(implementation=certrack.Implementation(period=1e-3))

    @dataclass(frozen=True, kw_only=True)
    class Ramped(laws.Robust):
        kind = "ramped"

        def equations(self, s):
            return Equations(super().equations(s).u + s.t)

    assert linear_loop(system).radius(1e-3, 0.0) < 1
    law = system.law
    gains = {"c": law.c, "k": law.k, "p": law.p, "feedforward": law.feedforward}
    assert linear_loop(system.replace(law=Ramped(**gains))) is None


# What is refused, early and in one line.


def law_of(formula, start=None, **fields):
    """example1 with a law that adds a formula of its signals to the classic one."""

    @dataclass(frozen=True, kw_only=True)
    class Odd(laws.Classic):
        kind = "odd"

        def equations(self, s):
            found = super().equations(s)
            return Equations(found.u + formula(s), found.update, **fields)

        def initial_states(self, plant):
            return start or {}

    return certrack.load("example1").replace(
        law=Odd(c=(1, 1)), reference=certrack.SymbolicReference("0.2*cos(t)")
    )


def test_powers_with_gains_as_exponents_are_supported():
    @dataclass(frozen=True, kw_only=True)
    class Terminal(laws.Classic):
        kind = "terminal"
        power: float = laws.gain(above=0, default=0.5)

        def equations(self, s):
            found = super().equations(s)
            soft = sympy.sqrt(s.e_n**2 + sympy.Rational(1, 100))
            return Equations(found.u - soft ** s.parameter("power") * s.e_n, found.update)

        def parameters(self, plant):
            return {**super().parameters(plant), "power": self.power}

    system = certrack.load("example1-classic").replace(law=Terminal(c=(1, 1)))
    ends = [
        certrack.simulate(system, integrator=method, duration=2).final_state["x1"]
        for method in ("taylor", "scipy")
    ]
    assert ends[0] == pytest.approx(ends[1], abs=1e-6)


@pytest.mark.parametrize(
    ("formula", "message"),
    [
        (lambda s: sympy.erf(s.x[0]), "law: u contains erf, which has no compiled form"),
        (lambda s: sympy.Piecewise((s.t, s.t > 1), (0, True)), "u contains Piecewise"),
        (lambda s: symbol("x9"), "law: u contains unknown symbols; got x9"),
        (lambda s: sympy.I * s.x[0], "law: u is not a finite real formula"),
    ],
)
def test_what_no_export_could_hold_is_refused_at_once(formula, message):
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        law_of(formula)
    assert "\n" not in str(caught.value)


def test_wrong_initial_values_and_filters_are_refused():
    with pytest.raises(InputError, match="law.initial_states: names no state of the law; got z"):
        law_of(lambda s: 0, start={"z": 1.0})
    with pytest.raises(InputError, match="filters and first values must be of own states"):
        law_of(lambda s: 0, filters=(symbol("z"),))


def test_registration_refuses_what_it_cannot_hold():
    with pytest.raises(InputError, match="is that of a shipped law"):
        laws.register(dataclasses.make_dataclass("A", [], bases=(laws.Classic,), frozen=True))
    with pytest.raises(InputError, match="must be a frozen dataclass"):
        laws.register(type("B", (laws.Classic,), {"kind": "b"}))
    with pytest.raises(InputError, match="must be a subclass"):
        laws.register(dict)
    with pytest.raises(InputError, match="is that of a shipped reference"):
        references.register("triangle")
    with pytest.raises(InputError, match=r"size has no key. Declare a field"):
        references.register("mine")(lambda size: None)


def test_registration_refuses_what_equality_leaves_out():
    @dataclass(frozen=True)
    class Table:
        data: list = dataclasses.field(compare=False)

    @dataclass(frozen=True, kw_only=True)
    class Tabled(laws.Classic):
        kind = "tabled"
        data: list = dataclasses.field(default=(), compare=False)

    with pytest.raises(InputError, match="reference: of equal ones data may differ"):
        references.register("table")(Table)
    with pytest.raises(InputError, match="law: of equal ones data may differ"):
        laws.register(Tabled)


def test_a_law_that_is_not_registered_runs_but_is_not_saved(tmp_path):
    system = law_of(lambda s: 0)
    assert certrack.simulate(system, duration=1).outcome.name == "finished"
    with pytest.raises(InputError, match="law.kind: is not registered"):
        certrack.save(system, tmp_path / "mine.toml")


def test_a_reference_that_breaks_its_duties_is_refused_when_a_system_gets_it():
    @dataclass(frozen=True)
    class Unregistered(Spline):
        pass

    @references.register("wrong")
    @dataclass(frozen=True)
    class Wrong(Spline):
        def values(self, t, order):
            return 1.01 * super().values(t, order)

    data = ((0.5, 1.5, 2.5, 4.0), (0.0, 0.3, -0.2, 0.1))
    system = certrack.load("example1").with_settings(duration=5)
    with pytest.raises(InputError, match="is of a class that is not registered; got Unregistered"):
        system.replace(reference=Unregistered(*data))
    with pytest.raises(InputError, match=r"values and formulas of y_d\^\(0\) differ at t = "):
        system.replace(reference=Wrong(*data))
    with pytest.raises(InputError, match="reference: lacks"):
        system.replace(reference="0.2*cos(t)")


class Unlisted(ReferenceConformance):
    """Its spline conceals the last knot inside."""

    duration = 5.0


def test_the_kit_notices_a_missing_break_and_a_low_bound():
    @references.register("concealing")
    @dataclass(frozen=True)
    class Concealing(Spline):
        def breaks(self, start, end):
            return super().breaks(start, end)[:-1]

        def bounds(self, order):
            found = super().bounds(order)
            return references.Bounds(tuple(0.5 * v for v in found.values), found.origin)

    kit = Unlisted()
    kit.reference = Concealing((0.5, 1.5, 2.5, 4.0), (0.0, 0.3, -0.2, 0.1))
    with pytest.raises(AssertionError):
        kit.test_every_break_is_listed()
    with pytest.raises(AssertionError, match="exceeds"):
        kit.test_bounds_hold()


def test_the_kit_notices_a_gain_that_stands_as_a_number():
    @dataclass(frozen=True, kw_only=True)
    class Frozen(PrescribedPerformance):
        kind = "numbers"

        def equations(self, s):
            found = super().equations(s)
            return Equations(found.u + self.k_w * s.x[0], found.update)

    kit = LawConformance()
    kit.system = extensions.prescribed_performance()
    kit.system = kit.system.replace(law=Frozen(c=(1, 1)))
    with pytest.raises(AssertionError, match="k_w stands in the formulas as a number"):
        kit.test_gains_are_symbols()


def test_filters_move_on_while_the_input_is_limited():
    """The filter of the dynamic surface is no estimate: saturation must not stop it."""
    limits = {"saturation": (-0.5, 0.5), "anti_windup": "hold"}
    system = dynamic_surface(implementation=certrack.Implementation(period=1e-3, **limits))
    run = certrack.simulate(system, duration=0.3)
    assert np.abs(run.u[run.t > 1e-3]).min() == 0.5  # limited throughout
    assert np.ptp(run.z[0]) > 0.1


# Disturbances and distributions.


@register_disturbance
class Bursts(DisturbanceFamily):
    kind = "bursts"

    def numbers(self, population):
        return {
            "centre": certrack.Distribution("uniform", (0, 10)),
            "speed": certrack.Distribution("uniform", (1, 20)),
        }

    def pattern(self, number):
        return f"exp(-(t - {number('centre')})**2)*sin({number('speed')}*t)"


def test_a_registered_disturbance_runs_in_ensembles_and_files():
    population = certrack.Population(disturbance="bursts")
    system = certrack.load("example1").replace(population=population).with_settings(duration=2)
    assert certrack.loads(certrack.to_text(system)) == system
    found = [certrack.ensemble(system, 4, method=method) for method in ("lockstep", "alone")]
    np.testing.assert_allclose(*(each.per_member()[0] for each in found), rtol=1e-3, atol=1e-5)
    assert found[0].limit is None  # its bound is not proven
    again = certrack.simulate(found[0].member(2)).metrics.tail_error
    assert found[0].run(2).metrics.tail_error == pytest.approx(again, rel=1e-9)


def test_a_disturbance_beyond_one_is_refused():
    @register_disturbance
    class Large(Bursts):
        kind = "large"

        def pattern(self, number):
            return "1.01*sin(t)"

    system = certrack.load("example1").replace(population=certrack.Population(disturbance="large"))
    with pytest.raises(InputError, match=r"disturbance.large: must stay within \[-1, 1\]"):
        certrack.ensemble(system, 4)


@pytest.mark.parametrize(
    "frozen",
    [
        scipy.stats.norm(2.0, 0.1),
        scipy.stats.beta(2, 3, loc=1.5, scale=1),
        scipy.stats.lognorm(0.1, scale=2),
        scipy.stats.poisson(3, loc=1),
        scipy.stats.uniform(1.5, 1),
    ],
)
def test_any_frozen_distribution_gives_its_quantiles_and_survives_a_file(frozen):
    drawn = certrack.Distribution.of(frozen)
    p = np.linspace(0.001, 0.999, 99)
    np.testing.assert_allclose(drawn.quantile(p), frozen.ppf(p), rtol=1e-12)
    ends = drawn.quantile(np.array([0.0, 1.0]))
    assert ends.tolist() == [drawn.low, drawn.high]
    population = certrack.Population(theta=[frozen])
    system = certrack.load("example1").replace(population=population)
    assert certrack.loads(certrack.to_text(system)) == system


def test_empirical_samples_are_drawn_equally_often():
    drawn = certrack.Distribution.empirical([3.0, 1.0, 2.0])
    values, counts = np.unique(drawn.quantile((np.arange(300) + 0.5) / 300), return_counts=True)
    assert (values.tolist(), counts.tolist()) == ([1.0, 2.0, 3.0], [100, 100, 100])


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ({"nrm": {"loc": 1}}, "is no distribution of scipy.stats; got nrm"),
        ({"norm": {"lok": 1}}, "unexpected keyword argument 'lok'"),
        ({"norm": {"scale": -1}}, "has no such distribution"),
        ({"empirical": []}, "must be 1 to 1000000 samples"),
        (scipy.stats.rv_histogram(np.histogram([1.0, 2, 3]))(), "must be a frozen distribution"),
    ],
)
def test_what_is_no_distribution_is_refused(value, message):
    with pytest.raises(InputError, match=message):
        certrack.Population(theta=[value])


# Comparisons, tables, replays.


def two_laws():
    system = certrack.load("example1")
    return {
        "c = (1, 0.5)": system,
        "c = (2, 1)": system.replace(law=dataclasses.replace(system.law, c=(2, 1))),
    }


def test_paired_comparison_uses_the_same_members():
    found = certrack.paired(two_laws(), 40, seed=3)
    frame = found.frame()
    assert list(frame.columns[:2]) == ["member", "law"]
    assert frame.groupby("law", sort=False).size().tolist() == [40, 40]
    draws = [each.frame(draws=True).iloc[:, 9:] for _, each in found.ensembles]
    assert draws[0].equals(draws[1])
    pairs = found.pairs("tail_error")
    difference = pairs["c = (2, 1)"] - pairs["c = (1, 0.5)"]
    assert difference.equals(pairs["c = (2, 1) - c = (1, 0.5)"])
    row = found.summary().loc[("tail_error", "c = (2, 1)")]
    assert row["difference"] == pytest.approx(np.median(difference))
    assert row["low"] <= row["difference"] <= row["high"] < 0
    assert row["smaller"] == 1.0
    assert row["smaller_low"] == pytest.approx(0.025 ** (1 / 40))  # Clopper and Pearson


def test_the_interval_of_the_median_holds_it_as_often_as_it_says():
    from certrack.studies.ensembles.comparison import _median_interval

    random = np.random.default_rng(0)
    hits = [
        low <= 0 <= high
        for low, high in map(_median_interval, np.sort(random.standard_cauchy((2000, 40)), axis=1))
    ]
    assert 0.945 <= np.mean(hits) <= 0.99


def test_different_members_are_not_compared():
    a, b = two_laws().values()
    few = certrack.ensemble(a, 8, method="lockstep", limit=1.0)
    with pytest.raises(InputError, match="a and b have different seeds or numbers of members"):
        certrack.paired({"a": few, "b": certrack.ensemble(b, 9, method="lockstep", limit=1.0)})
    late = b.with_settings(tail=12.0)
    with pytest.raises(InputError, match="different durations, tails or bands"):
        certrack.paired({"a": few, "b": certrack.ensemble(late, 8, method="lockstep", limit=1.0)})
    dropped = certrack.ensemble(b, 8, method="lockstep", limit=1.0, per_member=False)
    with pytest.raises(InputError, match="the metrics of single members were not kept"):
        certrack.paired({"a": few, "b": dropped})


def test_a_thousand_pairs_take_two_seconds():
    with within(2):
        assert len(certrack.paired(two_laws(), 1000).frame()) == 2000


def test_members_of_chunks_on_disk_are_in_the_table(tmp_path):
    system = certrack.load("example1").with_settings(duration=1)
    options = {"method": "lockstep", "limit": 1.0, "out": tmp_path, "chunk": 16}
    certrack.ensemble(system, 16, **options)
    resumed = certrack.ensemble(system, 40, **options)
    assert resumed.computed == 24
    fresh = certrack.ensemble(system, 40, method="lockstep", limit=1.0)
    assert resumed.frame().equals(fresh.frame())
    chunk = next(tmp_path.glob("chunk-0000000016*"))
    arrays = dict(np.load(chunk))
    np.savez(chunk, **{k: v for k, v in arrays.items() if not k.startswith("table")})
    again = certrack.ensemble(system, 40, **options)  # as an older version had written it
    assert again.computed == 16
    assert again.frame().equals(fresh.frame())


def test_replays_share_one_compiled_simulator():
    system = certrack.load("dual-motor-drive").with_settings(duration=0.05, tail=None)
    found = certrack.ensemble(system, 3, method="lockstep", limit=1.0)
    for index in range(3):
        alone = certrack.simulate(found.member(index))
        replayed = found.run(index)
        assert replayed.system == alone.system
        expected = alone.metrics.tail_error
        assert replayed.metrics.tail_error == pytest.approx(expected, rel=1e-7)
    assert found._members._simulator is found._members._simulator


def test_a_stated_tail_keeps_its_share():
    system = certrack.load("example1").with_settings(tail=15.0)
    assert system.with_settings(duration=5).settings.tail == pytest.approx(3.75)
    assert certrack.simulate(system, duration=5).metrics.tail_start == pytest.approx(3.75)
    assert system.with_settings(duration=5, tail=None).settings.tail is None


def latex_problems(text):
    """Why LaTeX would stop at a table, as far as rules of syntax say."""
    problems, open_, columns = [], [], None
    assert re.sub(r"\\.", "", text).count("{") == re.sub(r"\\.", "", text).count("}")
    for line in text.splitlines():
        if begin := re.match(r"\\begin\{(\w+)\}(?:\{([lr]+)\})?", line):
            open_.append(begin[1])
            columns = len(begin[2]) if begin[2] else columns
        elif end := re.match(r"\\end\{(\w+)\}", line):
            problems += [] if open_ and open_.pop() == end[1] else [line]
        elif line.endswith(r"\\"):
            cells = re.sub(r"\\[&\\]", "", line).count("&") + 1
            problems += [] if cells == columns else [f"{cells} cells: {line}"]
            text_only = re.sub(r"\$[^$]*\$", "", re.sub(r"\\[A-Za-z]+(\{\})?|\\.", "", line))
            problems += [line] if re.search(r"[_^#%$~<>|\"]", text_only) else []
    return problems + open_


def test_tables_are_latex(tmp_path):
    import pandas

    frame = pandas.DataFrame(
        {"a_b & 100 %": [1.5, np.nan], "text": ["x^2 \\ {y} ~ #1 <z>", "$"], "n": [3, 400]},
        index=["c = (1, 0.5)", "50 %_"],
    )
    text = latex_table(frame, caption="All of #1 & 2", label="tab:a b")
    assert latex_problems(text) == []
    assert r"\label{tab:a-b}" in text
    assert latex_problems(text.replace(" & text", "")) != []
    assert latex_problems(text.replace(r"\_", "_")) != []
    assert latex_problems(certrack.paired(two_laws(), 16).latex("Two laws", "tab:two")) == []
    if compiler := shutil.which("pdflatex"):
        page = rf"\documentclass{{article}}\begin{{document}}{text}\end{{document}}"
        (tmp_path / "page.tex").write_text(page)
        command = [compiler, "-halt-on-error", "-interaction=batchmode", "page.tex"]
        subprocess.run(command, cwd=tmp_path, capture_output=True, check=True)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "$0.00$"),
        (0.012345, "$0.0123$"),
        (-1.5e-7, r"$-1.50\cdot 10^{-7}$"),
        (123456.0, r"$1.23\cdot 10^{5}$"),
        (12345.0, "$12345$"),
        (np.nan, "--"),
        (np.inf, r"$\infty$"),
        (7, "7"),
    ],
)
def test_numbers_in_tables(value, text):
    assert latex_number(value) == text


def test_text_in_tables_is_harmless():
    assert latex_text("\\input{a}\n") == r"\textbackslash{}input\{a\}"
