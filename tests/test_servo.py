"""What a servo engineer reads on the way from a blank file to a tuned design of two masses."""

import importlib
import math
import re
from dataclasses import replace

import pytest
from click.testing import CliRunner

import certrack
from certrack.certificates.certificate import Certificate
from certrack.cli import cli, console
from certrack.core.rounding import rounded_range
from certrack.reports.certificates import certificates_notes
from certrack.reports.tables import short_number
from certrack.tuning import measure as measure_room
from certrack.tuning import tune as tune_room
from certrack.tuning.candidate import Candidate
from certrack.tuning.fallback import MOST_CHECKS, best_certified
from certrack.tuning.front import FRONT_POINTS
from certrack.tuning.measure import MEASURING_STEPS, STEP_NAMES, UNMEASURED
from certrack.tuning.search import GainSearch
from certrack.tuning.tune import FINISHING_STEPS

certify_room = importlib.import_module("certrack.certificates.certify")


def run(*arguments):
    return CliRunner().invoke(cli, list(arguments))


def test_tolerance_and_drive_of_the_starter_file_need_their_marks_off_only():
    text = certrack.starter()
    text = re.sub(r"^input_gain = \[.*\n", "", text, flags=re.M).replace("# J = [", "J = [")
    before, mark, drive = text.partition("# [implementation]")
    system = certrack.loads(before + re.sub(r"^# ", "", mark + drive, flags=re.M))
    assert system.plant.constant_boxes == {"J": (0.4, 0.6)}
    assert system.implementation.period == 0.00025 and system.implementation.delay == 0.5
    assert certrack.simulate(system.with_settings(duration=0.2)).outcome.name == "finished"


def test_bounds_by_a_constant_with_a_range_are_refused():
    text = certrack.starter("motor-shaft-load").replace('"D/(0.85*0.0012)"', '"D/JL"')
    with pytest.raises(certrack.InputError, match="must not depend on a constant with a range"):
        certrack.loads(text)


def test_a_tube_that_begins_within_its_bound_says_so():
    result = certrack.certify(certrack.load("motor-shaft-load"), "fast")
    assert result.implemented.verified and result.implemented.cells == 1
    (line,) = (line for line in certificates_notes(result) if line.startswith("tube"))
    assert "after 0 s" not in line and "at all times" in line
    level = float(re.search(r"\|e_1\| <= ([\d.]+) at all times", line)[1])
    assert result.tube.settling_time(level) == 0 and level >= 1.1 * result.vertices.bound


def test_tune_reports_its_proofs_and_their_effort(monkeypatch):
    seen, efforts = [], []
    certify = tune_room.figures_of

    def noted(system, box, seed, effort, progress):
        efforts.append(effort)
        return certify(system, box, seed, "fast", progress)

    monkeypatch.setattr(tune_room, "figures_of", noted)
    system = certrack.load("axis")
    certrack.tune(system, starts=1, effort="high", proving=lambda *news: seen.append(news))
    assert efforts == ["high", "high"]
    done = [news[0] for news in seen]
    assert done == sorted(done) and {news[1] for news in seen} == {FINISHING_STEPS}
    names = list(dict.fromkeys(map(tune_room.finishing_step, done)))
    assert names[0] == "tuned design: closed forms"
    assert names[-1] == "design before: simulation"
    assert len(names) == len(set(done)) == 2 * MEASURING_STEPS
    with pytest.raises(certrack.InputError, match="effort"):
        certrack.tune(system, effort="best")


def test_steps_have_the_names_of_what_is_at_work(monkeypatch):
    """Each is named for what is called while it is reported."""
    at, calls = [], {}

    def called(name, original):
        def noted(*args, **kwargs):
            calls.setdefault(name, STEP_NAMES[int(at[-1])])
            return original(*args, **kwargs)

        return noted

    for room, name in (
        (certify_room, "certify_implemented"),
        (measure_room, "falsify"),
        (measure_room, "simulate"),
    ):
        monkeypatch.setattr(room, name, called(name, getattr(room, name)))
    system = certrack.load("motor-shaft-load").with_settings(duration=0.1)
    measure_room.figures_of(system, None, 0, "fast", lambda done, *_: at.append(done))
    assert calls == {
        "certify_implemented": "loop as the drive runs it",
        "falsify": "falsifier",
        "simulate": "simulation",
    }


def test_a_front_reports_its_points(monkeypatch):
    """Not as starts of the search."""
    starts, points = [], []
    monkeypatch.setattr(tune_room, "figures_of", lambda *_, **__: UNMEASURED)
    certrack.tune(
        certrack.load("dual-motor-lean"),
        peak_input=39.1,
        starts=1,
        front="peak-input",
        progress=lambda *news: starts.append(news),
        sweeping=lambda *news: points.append(news),
    )
    assert {news[1] for news in starts} == {1}
    assert [news[:2] for news in points] == [(k, FRONT_POINTS) for k in range(FRONT_POINTS)]
    assert points[0][2] is None and points[1][2] > points[2][2] > 0


def test_phases_follow_each_other(monkeypatch):
    opened = []

    class Bar:
        def __init__(self, what):
            self.what = what

        def __enter__(self):
            opened.append(f"+{self.what}")
            return lambda *news: opened.append(news)

        def __exit__(self, *_):
            opened.append(f"-{self.what}")

    monkeypatch.setattr(console, "progress", lambda what, *_: Bar(what))
    with console.phases() as bars:
        first, second = bars.phase("one"), bars.phase("two")
        first(0, 2, None)
        first(1, 2, None)
        second(0, 1, None)
    assert opened == ["+one", (0, 2, None), (1, 2, None), "-one", "+two", (0, 1, None), "-two"]


def test_what_is_not_tuned_is_said():
    """Where constants have ranges the observer stays as in the file."""
    text = certrack.starter("motor-shaft-load").replace(
        "\n[simulation]", '\n[law.observer]\nkind = "eso"\nbandwidth = 2000\n\n[simulation]'
    )
    stages = tune_room.searches_of(
        certrack.loads(text), tune_room.Requirements(), "error", None, None
    )
    (note,) = stages[-1].left_alone()
    assert "law.observer.bandwidth" in note and "ranges" in note
    free = re.sub(r"\[plant.ranges\][^\[]*\[[^\[]*\[[^\[]*\[", "[", text)
    assert not certrack.loads(free).plant.constant_boxes
    stages = tune_room.searches_of(
        certrack.loads(free), tune_room.Requirements(), "error", None, None
    )
    assert stages[-1].left_alone() == []


def test_notes_of_a_comparison_say_whose_they_are(tmp_path):
    for name in ("one", "two"):
        text = certrack.starter("stiction").replace("duration = 20", "duration = 3")
        (tmp_path / f"{name}.toml").write_text(text.replace("tail = 10", "tail = 2"))
    one, two = (str(tmp_path / f"{name}.toml") for name in ("one", "two"))
    done = run("compare", one, two)
    assert f"note: {one}: Stuck at v = 0" in done.output
    assert f"note: {two}: Stuck at v = 0" in done.output
    assert "docs/observers.md" in done.output and "settled within [m]" in done.output
    assert "note: Stuck at v = 0" in run("simulate", one).output


def test_members_that_run_alone_are_counted_one_by_one():
    text = certrack.starter("stiction").replace("sign(v)", "sign(v + 0.2*q)")
    system = certrack.loads(text.replace("tail = 10", "tail = 2"))
    seen = []
    certrack.ensemble(
        system.with_settings(duration=3.0),
        members=5,
        limit=float("inf"),
        progress=lambda done, total, _: seen.append((done, total)),
    )
    assert {(k, 5) for k in range(6)} <= set(seen)


def test_the_search_of_a_worst_case_certifies_first_and_says_so():
    steps, runs = [], []
    certrack.falsify(
        certrack.load("axis"),
        budget=60,
        progress=lambda *news: runs.append(news),
        certifying=lambda *news: steps.append((len(runs), *news)),
    )
    assert steps and all(count == 0 for count, *_ in steps) and runs


def test_no_zero_is_negative():
    assert rounded_range(-0.0, 1.0) == "[0, 1]"
    assert short_number(-0.0) == "0" and short_number(1e-311) == "0"


@pytest.mark.parametrize("count", [0, 1, 2, 7, 40])
@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_the_best_certified_design_on_the_way(count, share):
    """Halving finds the last that is certified, where those before it are."""
    certified_ones = round(share * count)
    found, asked = best_certified(list(range(count)), lambda k: k < certified_ones)
    assert found == (certified_ones - 1 if certified_ones else None)
    assert asked <= MOST_CHECKS


def test_a_best_design_without_a_certificate_is_not_the_result(monkeypatch):
    """Gains that are too sharp for a proof: the best of the others is returned, with a note."""
    system, asked, sharpest = certrack.load("dual-motor-lean"), [], math.inf

    def rates(of):
        return sum(map(math.log, of.law.c))

    def figures(of, box, seed, effort, progress):
        progress(MEASURING_STEPS, MEASURING_STEPS, None)
        return replace(UNMEASURED, certified=math.inf if rates(of) > sharpest else rates(of))

    def proof(of, **_):
        asked.append(rates(of))
        return Certificate("cells", 1.0, verified=rates(of) <= sharpest)

    def searched(stage, *_):
        search, family, base = GainSearch(system, None), stage.family, stage.problem.base
        search.state.improvements = [
            Candidate(family, base, family.start + k / 100) for k in range(7)
        ]
        search.state.best = search.state.improvements[-1]
        return search

    monkeypatch.setattr(tune_room, "_searched", searched)
    monkeypatch.setattr(tune_room, "figures_of", figures)
    monkeypatch.setattr(tune_room, "certified", proof)
    best, first = rates(certrack.tune(system, starts=1).system), rates(system)
    assert best > first and not asked
    sharpest = first + 0.5 * (best - first)
    news = []
    found = certrack.tune(system, starts=1, proving=lambda *args: news.append(args[0]))
    assert first <= rates(found.system) <= sharpest
    assert rates(found.system) == max(each for each in asked if each <= sharpest)
    assert found.after.certified == rates(found.system) and news == sorted(news)
    (note,) = (note for note in found.notes if "on the way" in note)
    assert f"of {len(asked)} asked" in note
    sharpest = -math.inf
    found = certrack.tune(system, starts=1)
    assert rates(found.system) == best and math.isinf(found.after.certified)
    assert any("nothing is certified of the best design" in note for note in found.notes)
