"""What a user of the package meets: types, reprs, notebooks, pickles, threads, progress."""

import dataclasses
import html.parser
import importlib
import inspect
import itertools
import multiprocessing
import pickle
import pkgutil
import re
import subprocess
import sys
import threading
import zipfile
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

import joblib
import numpy as np
import pytest
from conftest import SHIPPED

import certrack
from certrack.core.errors import CertrackError, InputError
from certrack.core.rounding import rounded_up
from certrack.systems.system import Settings

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "certrack"
PROGRAM = Path(__file__).parent / "data" / "typed_program.py"


# types


def found_by_mypy(program, tmp_path):
    """Line and message of everything that mypy says of a program that uses the package."""
    command = [sys.executable, "-m", "mypy", "--config-file", "", "--strict"]
    command += ["--cache-dir", str(tmp_path), "--allow-untyped-calls", str(program)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    pattern = rf"^.*{re.escape(program.name)}:(\d+): (.*)$"
    return re.findall(pattern, done.stdout, re.M), done.stdout


@pytest.mark.slow
def test_mypy_knows_the_types_of_a_users_program(tmp_path):
    entries, output = found_by_mypy(PROGRAM, tmp_path)
    lines = PROGRAM.read_text().splitlines()
    revealed = {lines[int(number) - 1]: text for number, text in entries if "Revealed type" in text}
    wanted = {
        "system": "certrack.systems.system.System",
        "certrack.simulate(system)": "certrack.simulation.run.Run",
        "certrack.simulate(system).metrics.settling_time": "float",
        "certrack.certify(system).best.bound": "float",
        "certrack.ensemble(system, 10).members": "int",
        "certrack.margins(system)": "certrack.studies.margins.Margins",
        "certrack.falsify(system).worst_error": "float",
        "system.design()": "certrack.systems.design.Design",
        'certrack.export_st(system, "drive.st")': "pathlib.Path",
        "certrack.plot(system)": "matplotlib.figure.Figure",
        "certrack.reproduce().claims": "certrack.papers.liu2025.claim.Claim, ...]",
        'certrack.certificates.verify("cert.json")': "certrack.certificates.verification.Verdict",
        "certrack.references.steps((1.0,), (0.0, 1.0), 0.5)": "PiecewiseReference",
        "certrack.__version__": "str",
    }
    assert revealed.keys() == {f"reveal_type({text})" for text in wanted}, output
    for text, kind in wanted.items():
        assert kind in revealed[f"reveal_type({text})"]
    errors = {lines[int(number) - 1] for number, text in entries if text.startswith("error")}
    assert errors == {line for line in lines if "# error" in line}, output
    assert 'has no attribute "no_such_name"' in output


def test_stub_and_marker_are_in_the_wheel(tmp_path):
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation"]
    done = subprocess.run(
        [*command, "--wheel-dir", str(tmp_path), str(ROOT)], capture_output=True, check=False
    )
    if done.returncode:
        pytest.skip("hatchling is not installed here")
    (wheel,) = tmp_path.glob("*.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {"certrack/__init__.pyi", "certrack/py.typed", "certrack/__main__.py"} <= names


def test_every_name_of_the_stub_loads():
    text = (SOURCE / "__init__.pyi").read_text()
    for name in re.findall(r"import (\w+) as \1$", text, re.M):
        assert getattr(certrack, name) is not None
        assert name in certrack.__all__
    with pytest.raises(AttributeError):
        _ = certrack.no_such_name


def test_python_m_certrack():
    done = subprocess.run(
        [sys.executable, "-m", "certrack", "--version"], capture_output=True, text=True, check=True
    )
    assert certrack.__version__ in done.stdout


# what is shown


@pytest.fixture(scope="module")
def results():
    """One of each main object."""
    system = certrack.load("example1")
    tried = certrack.Margin(0.01, 0.02, None, False, (0.01, 0.02), (1e-3, 1e-2))
    return {
        "system": system,
        "long": system.replace(title="word " * 200),
        "sampled": certrack.load("dual-motor-drive"),
        "run": certrack.simulate(system),
        "escaped": certrack.simulate(system, max_state=2.5),
        "certificates": certrack.certify(system),
        "none": certrack.certify(certrack.load("example1-classic")),
        "ensemble": certrack.ensemble(system, 64, method="lockstep"),
        "margins": certrack.Margins(2e-3, "given", 8, 0.01, None, tried, tried, tried),
        "design": system.design(),
        "simulator": certrack.Simulator(system),
    }


def test_reprs_are_a_line_or_two(results):
    for name, value in results.items():
        text = repr(value)
        assert len(text) <= 400 and text.count("\n") <= 1, name
        assert text.startswith(type(value).__name__)
    assert "0.033585" in repr(results["run"])
    assert "cascade 0.07864 (verified)" in repr(results["certificates"])
    assert "no bound" in repr(results["none"])


class Tags(html.parser.HTMLParser):
    """Counts tags and refuses one that is not closed."""

    def __init__(self):
        super().__init__()
        self.open, self.count = [], {}

    def handle_starttag(self, tag, attrs):
        self.count[tag] = self.count.get(tag, 0) + 1
        if tag not in ("img", "br"):
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.count[tag] = self.count.get(tag, 0) + 1

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_html_has_table_formulas_and_picture(results):
    for name, value in results.items():
        if name == "simulator":
            continue
        text = value._repr_html_()
        tags = Tags()
        tags.feed(text)
        assert not tags.open, name
        assert len(text) < 400_000, name
        if name != "design":
            assert tags.count["table"] == 1 and tags.count["img"] == 1, name
            assert "data:image/png;base64,iVBOR" in text
    for name in ("system", "design"):
        text = results[name]._repr_html_()
        assert r"$$" in text and r"\begin{aligned}" in text and r"\hat\theta_{1}" in text


def test_html_does_not_trust_the_file():
    system = certrack.load("example1").replace(title="<script>alert(1)</script>")
    assert "<script" not in system._repr_html_()


@pytest.mark.parametrize("bound", [0.136101, 0.1, 123456.0, 3.00001e-5, 1e-300, 7e250, 99995.0])
def test_a_bound_is_never_shown_too_small(bound):
    for digits in (1, 4, 8):
        shown = float(rounded_up(bound, digits))
        assert bound <= shown <= bound * (1 + 1.0001 * 10 ** (1 - digits))


def test_plot_draws_every_result_and_refuses_what_it_cannot(results):
    for name in ("system", "run", "escaped", "certificates", "none", "ensemble", "margins"):
        assert certrack.plot(results[name]).axes, name
    several = certrack.plot({"a": results["run"], "b": results["run"]})
    assert len(several.axes) == 10  # five panels, the transient of each apart
    for value in (3, {}, {"a": 3}):
        with pytest.raises(InputError, match="plot"):
            certrack.plot(value)


# pickles


def all_errors(root=CertrackError):
    yield root
    for kind in root.__subclasses__():
        yield from all_errors(kind)


def test_errors_are_one_tree():
    for module in pkgutil.walk_packages([str(SOURCE)], "certrack."):
        if module.name != "certrack.__main__":
            for value in vars(importlib.import_module(module.name)).values():
                if inspect.isclass(value) and issubclass(value, BaseException):
                    # what is private to a module, as the signal of a spent budget, stays in it
                    ours = value.__module__.startswith("certrack") and value.__name__[0] != "_"
                    assert not ours or issubclass(value, CertrackError), value
    assert issubclass(InputError, ValueError)


@pytest.mark.parametrize("kind", sorted(set(all_errors()), key=lambda kind: kind.__name__))
def test_errors_keep_every_field_in_a_pickle(kind):
    if issubclass(kind, InputError):
        error = kind("plant.chain", "must be 2 numbers", {"a": [1, 2]}, "Add one")
        error.within("drive.toml", 7)
    elif kind is certrack.MissingExtra:
        error = kind("control", "control", "to_control")
    else:
        error = kind("what went wrong")
    error.add_note("while trying")
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is kind
    assert str(again) == str(error) and again.args == error.args
    assert again.__dict__ == error.__dict__


def test_an_error_about_something_that_cannot_be_pickled_can_be():
    error = InputError("plant", "must be a Plant", lambda: None)
    again = pickle.loads(pickle.dumps(error))
    assert str(again) == str(error)


def test_a_worker_hands_back_the_error_with_key_and_line():
    text = certrack.to_text(certrack.load("example1")).replace("duration = 20.0", "duration = -1")
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        error = pool.submit(certrack.loads, text, "drive.toml").exception()
    assert isinstance(error, InputError)
    assert (error.file, error.key) == ("drive.toml", "simulation.duration")
    assert error.line == 1 + text.splitlines().index("duration = -1")


@pytest.mark.parametrize("name", SHIPPED)
def test_systems_runs_and_simulators_survive_a_pickle(name):
    system = certrack.load(name).with_settings(duration=2.0, tail=None)
    assert pickle.loads(pickle.dumps(system)) == system
    simulator = certrack.Simulator(system)
    run = simulator.run()
    assert same(pickle.loads(pickle.dumps(simulator)).run(), run)
    again = pickle.loads(pickle.dumps(run))
    assert same(again, run)
    assert again.dataset().identical(run.dataset())
    assert again.dataset(50).identical(run.dataset(50))


def same(a, b):
    """Whether two runs are equal to the last bit."""
    pairs = ((a.t, b.t), (a.x, b.x), (a.u, b.u), (a.e, b.e))
    return a.metrics.as_dict() == b.metrics.as_dict() and all(
        np.array_equal(p, q) for p, q in pairs
    )


@pytest.mark.parametrize("integrator", ["scipy", "implicit"])
def test_runs_of_other_methods_survive_a_pickle(integrator):
    run = certrack.simulate(certrack.load("example1"), duration=1, tail=None, integrator=integrator)
    assert same(pickle.loads(pickle.dumps(run)), run)


def test_results_of_studies_survive_a_pickle(results):
    for name in ("certificates", "margins", "design"):
        again = pickle.loads(pickle.dumps(results[name]))
        assert repr(again) == repr(results[name])
    ensemble = results["ensemble"]
    data = pickle.dumps(ensemble)
    again = pickle.loads(data)
    assert len(data) < 1_000_000
    assert again.summary() == ensemble.summary()
    assert np.array_equal(again.bands, ensemble.bands, equal_nan=True)
    again.statistics.merge(ensemble.statistics)  # an ensemble that is still good for more
    assert again.members == 2 * ensemble.members


def starts(system, count):
    """The same loop from several starts."""
    return [system.with_settings(x0=(0.01 * i, 0.2)) for i in range(count)]


def tail_error(system):
    return certrack.simulate(system).metrics.tail_error


@pytest.mark.slow
def test_spawned_processes_take_systems_simulators_and_runs():
    system = certrack.load("example1").with_settings(duration=2.0, tail=None)
    simulator, systems = certrack.Simulator(system), starts(system, 4)
    expected = [simulator.run(each) for each in systems]
    context = multiprocessing.get_context("spawn")
    with context.Pool(2) as pool:
        for run, wanted in zip(pool.map(simulator.run, systems), expected, strict=True):
            assert same(run, wanted)
    with ProcessPoolExecutor(2, mp_context=context) as pool:
        errors = list(pool.map(tail_error, systems))
    assert errors == [run.metrics.tail_error for run in expected]
    by_joblib = joblib.Parallel(n_jobs=2)(joblib.delayed(simulator.run)(each) for each in systems)
    for run, wanted in zip(by_joblib, expected, strict=True):
        assert same(run, wanted)


def test_a_simulator_that_is_sent_twice_is_compiled_once():
    data = pickle.dumps(certrack.Simulator(certrack.load("example1")))
    assert pickle.loads(data) is pickle.loads(data)


# threads


@pytest.fixture
def eager_switches():
    """Threads take turns a thousand times as often."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(5e-6)
    yield
    sys.setswitchinterval(before)


@pytest.mark.parametrize(
    ("name", "changes", "count"),
    [
        ("example1", {"duration": 1.0}, 100),
        pytest.param("example1", {"duration": 1.0}, 1000, marks=pytest.mark.slow),
        ("example1", {"duration": 0.5, "integrator": "scipy"}, 20),
        ("dual-motor-drive", {"duration": 0.05}, 60),
    ],
)
def test_threads_that_share_a_simulator_get_what_one_gets(name, changes, count, eager_switches):
    base = certrack.load(name).with_settings(tail=None, **changes)
    n = base.plant.n
    systems = [
        base.with_settings(x0=(1e-3 * i,) + (0.0,) * (n - 1), duration=base.settings.duration)
        for i in range(count)
    ]
    simulator = certrack.Simulator(base)
    serial = [simulator.run(each) for each in systems]
    with ThreadPoolExecutor(2) as pool:
        parallel = list(pool.map(simulator.run, systems))
    assert all(same(a, b) for a, b in itertools.zip_longest(serial, parallel))


# progress


CALLS = {
    "simulate": lambda progress, _: certrack.simulate(certrack.load("example1"), progress=progress),
    "scipy": lambda progress, _: certrack.simulate(
        certrack.load("example1"), duration=1, tail=None, integrator="scipy", progress=progress
    ),
    "sampled": lambda progress, _: certrack.simulate(
        certrack.load("dual-motor-drive"), duration=2, tail=None, progress=progress
    ),
    "ensemble": lambda progress, out: certrack.ensemble(
        certrack.load("example1"), 48, chunk=16, method="lockstep", out=out, progress=progress
    ),
    "certify": lambda progress, _: certrack.certify(
        certrack.load("dual-motor-lean"), progress=progress
    ),
    "falsify": lambda progress, _: certrack.falsify(
        certrack.load("dual-motor-lean"), budget=150, progress=progress
    ),
}


@pytest.mark.parametrize("name", CALLS)
def test_long_calls_report_in_one_way(name, tmp_path):
    reports = []
    CALLS[name](lambda *report: reports.append(report), tmp_path / "out")
    done = [report[0] for report in reports]
    assert len(reports) >= 2 and done[0] == 0 and done == sorted(done)
    assert len({report[1] for report in reports}) == 1, "the total stays"
    assert done[-1] >= reports[-1][1] * 0.99
    best = [report[2] for report in reports if report[2] is not None]
    assert best == sorted(best)
    assert bool(best) == (name in ("ensemble", "falsify"))


#: These do not know beforehand how much they will do.
OPEN_ENDED = {
    "margins": lambda progress, _: certrack.margins(
        certrack.load("dual-motor-lean"), members=1, progress=progress
    ),
    "reproduce": lambda progress, _: certrack.reproduce(progress, budget=100),
}


@pytest.mark.parametrize("name", CALLS | OPEN_ENDED)
def test_another_thread_stops_a_call(name, tmp_path):
    waiting, go_on, caught = threading.Event(), threading.Event(), []

    def report(*_):
        waiting.set()
        go_on.wait(60)

    stop = certrack.Cancellable(report)

    def work():
        try:
            (CALLS | OPEN_ENDED)[name](stop, tmp_path / "out")
        except certrack.Cancelled as problem:
            caught.append(problem)

    worker = threading.Thread(target=work)
    worker.start()
    assert waiting.wait(60)
    assert not stop.cancelled
    stop.cancel()
    go_on.set()
    worker.join(120)
    assert len(caught) == 1 and stop.cancelled
    assert not list(tmp_path.rglob("*.part"))


def test_a_cancelled_ensemble_goes_on_where_it_stopped(tmp_path):
    stop = certrack.Cancellable(lambda done, *_: stop.cancel() if done else None)
    with pytest.raises(certrack.Cancelled):
        CALLS["ensemble"](stop, tmp_path)
    assert len(list(tmp_path.glob("chunk-*.npz"))) == 2
    again = CALLS["ensemble"](lambda *_: None, tmp_path)
    assert again.computed == 16
    whole = certrack.ensemble(certrack.load("example1"), 48, method="lockstep")
    assert again.summary()["tail_error"] == whole.summary()["tail_error"]


def test_a_simulator_serves_after_a_cancelled_run():
    simulator = certrack.Simulator(certrack.load("example1"))
    stop = certrack.Cancellable()
    stop.cancel()
    before = simulator.run()
    with pytest.raises(certrack.Cancelled):
        simulator.run(progress=stop)
    assert same(simulator.run(), before)


# what Python can


def test_python_can_what_the_command_line_can():
    """Every verb has its function among the public names."""
    from certrack.cli import cli

    functions = {
        "list": "catalog",
        "new": "starter",
        "compare": "plot",
        "margin": "margins",
        "report": "dossier",
        "verify": "certificates",
        "export": "export_c",
    }
    # `cache` is about this machine and `app` is a page: neither computes something of a system
    for verb in set(cli.commands) - {"cache", "app"}:
        assert functions.get(verb, verb) in certrack.__all__, verb
    for verb in cli.commands["export"].commands:
        assert f"export_{verb}" in certrack.__all__
    assert {"samples", "steps", "recursion", "tube", "verify"}.isdisjoint(certrack.__all__)


def test_design_says_what_the_command_prints(capsys):
    from certrack.cli import main

    with pytest.raises(SystemExit):
        main(["design", "example1"])
    assert str(certrack.load("example1").design()) in capsys.readouterr().out


def test_types_of_results_are_public():
    for value in (certrack.Falsification, certrack.Reproduction, certrack.Margin, Settings):
        assert dataclasses.is_dataclass(value)
        assert getattr(certrack, value.__name__) is value
