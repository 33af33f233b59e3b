"""Laws side by side: one search, one set of limits, figures that another computation confirms."""

import json
import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import certrack
from certrack.cli import cli, main
from certrack.cli.console import to_json
from certrack.laws.baselines.pid import Pid
from certrack.model.implementation import Implementation
from certrack.plotting.law_comparison import law_comparison_figure
from certrack.reports.law_comparison import law_notes, law_table
from certrack.tuning.comparison import compare_laws as comparison_module
from certrack.tuning.comparison import known_gains
from certrack.tuning.comparison.compare_laws import (
    AS_STATED,
    NOTHING_FOUND,
    LawFigures,
    compare_laws,
)
from certrack.tuning.comparison.entrants import ENTRANTS, entrant_of, informed, most_feedforward
from certrack.tuning.comparison.gain_search import search_gains
from certrack.tuning.comparison.known_gains import read_gains
from certrack.tuning.comparison.trials import (
    ASTRAY_SCORE,
    LOST_SCORE,
    PENALTY,
    SharedLimits,
    Trials,
    resting_error,
    sampled,
    score,
)

NO_LIMITS = SharedLimits(1e6, 1e6, 0.006)


@pytest.fixture(scope="module")
def short():
    """Example 1, sampled, for a short time."""
    system = certrack.load("example1").with_settings(duration=6, tail=3)
    return sampled(system, 0.002)


@pytest.fixture(scope="module")
def compared(short):
    return compare_laws(short, ["lqr", "pid"], budget=10, members=8)


@pytest.mark.slow
def test_every_law_can_enter(short):
    for name in ENTRANTS:
        for system in (short, sampled(certrack.load("dual-motor-lean"), 0.001)):
            entrant, family = entrant_of(system, name)
            assert entrant.law == family.law(family.start)
            assert entrant.settings.estimates is None
            assert entrant.reference == system.reference and entrant.truth == system.truth
            for v in (family.start - 0.3, family.start + 0.3):
                entrant.replace(law=family.written(v))


def untouched(*_):
    raise AssertionError("searched before it was known whether the laws can be compared")


@pytest.fixture
def motor():
    """A system without limits of the input, for a short time."""
    system = certrack.load("dual-motor-lean").with_settings(duration=1.5, tail=1.0)
    return system.replace(implementation=Implementation(period=0.002))


def test_without_osqp_a_comparison_with_mpc_says_so_at_once(motor, monkeypatch):
    """Not that no gains were found: nothing was solved."""
    monkeypatch.setitem(sys.modules, "osqp", None)
    monkeypatch.setattr(comparison_module, "search_gains", untouched)
    with pytest.raises(certrack.MissingExtra, match=r"certrack\[mpc\]"):
        compare_laws(motor, ["lqr", "mpc"], budget=10, members=2)
    entrant, _ = entrant_of(motor, "mpc")
    limited = replace(entrant, law=replace(entrant.law, input_limit=0.1))
    with pytest.raises(certrack.MissingExtra):
        Trials(limited, None).metrics(limited.law)


@pytest.mark.parametrize("saturation", [None, (-50, 50)])
def test_what_plans_do_not_know_is_refused_before_any_search(
    motor, monkeypatch, tmp_path, capsys, saturation
):
    monkeypatch.setattr(comparison_module, "search_gains", untouched)
    drive = replace(motor.implementation, rate_limit=1e4, saturation=saturation)
    file = tmp_path / "limited.toml"
    file.write_text(certrack.to_text(motor.replace(implementation=drive)))
    with pytest.raises(SystemExit) as stop:
        main(["compare", str(file), "--laws", "lqr,mpc", "--evaluations", "10", "-n", "2"])
    said = capsys.readouterr().err.strip().splitlines()
    assert stop.value.code == 2
    assert "--laws" in said[-1] and "mpc does not fit" in said[-1] and "rate_limit" in said[-1]


def test_what_nobody_knows_is_guessed_as_the_file_guesses(short):
    plant = informed(short).plant
    assert float(plant.input_gain.expr) == 1 / 0.4 and [float(v.expr) for v in plant.theta] == [2.1]
    assert informed(short).truth.input_gain.text == short.truth.input_gain.text
    lean = certrack.load("dual-motor-lean")
    assert informed(lean) is lean
    with pytest.raises(certrack.InputError, match="delta0"):
        informed(short.replace(law=replace(short.law, delta0=0.0)))


def test_feedforward_is_what_plant_and_reference_allow():
    lean = certrack.load("dual-motor-lean")
    assert most_feedforward(lean.reference, 4) == 3
    steps = certrack.references.steps((1.0,), (0.0, 1.0), slope=2.0)
    assert most_feedforward(steps, 4) == max(0, min(3, steps.order - 1))


def test_the_score_is_the_tail_error_and_what_limits_add(short):
    trials, law = Trials(short, None), short.law
    tail = certrack.simulate(short).metrics.tail_error
    free = score(trials, law, NO_LIMITS, 1.0)
    assert free.works and not free.exceeded and free.value == pytest.approx(math.log(tail))
    peak = certrack.simulate(short).metrics.peak_input
    tight = score(trials, law, replace(NO_LIMITS, peak_input=peak / 2), 1.0)
    assert tight.exceeded == ("peak input",)
    assert tight.value == pytest.approx(free.value + PENALTY * math.log(2))
    assert score(trials, law, NO_LIMITS, tail / 2).value > ASTRAY_SCORE - 20
    assert not score(trials, law, NO_LIMITS, tail / 2).works


def test_a_law_that_escapes_is_lost():
    lean = sampled(certrack.load("dual-motor-lean"), 0.001).replace(law=Pid(feedforward=3))
    trials = Trials(lean, None)
    assert score(trials, lean.law, NO_LIMITS, 1.0).value == LOST_SCORE


@pytest.mark.slow
def test_a_search_is_never_worse_than_its_start_and_repeats(short):
    entrant, family = entrant_of(short, "lqr")
    limits, resting = SharedLimits(16.0, 300.0, 0.006), resting_error(short)
    assert resting == pytest.approx(0.2, rel=1e-3)
    first = score(Trials(entrant, None), family.written(family.start), limits, resting)
    runs = [search_gains(Trials(entrant, None), family, limits, resting, 12, 3) for _ in range(2)]
    assert runs[0].score.value <= first.value and runs[0] == runs[1]


@pytest.mark.slow
def test_figures_are_those_of_the_runs(compared, short):
    stated, lqr, _ = compared.laws
    assert stated.metrics == certrack.simulate(short).metrics
    fresh = certrack.simulate(lqr.system)
    assert lqr.metrics == fresh.metrics
    truth = replace(short.truth, input_gain=short.truth.input_gain.text + "*1.3")
    tail = certrack.simulate(lqr.system.replace(truth=truth)).metrics.tail_error
    assert lqr.at_gains[1] == pytest.approx(tail, rel=1e-6)
    longest = lqr.system.replace(implementation=certrack.Implementation(lqr.longest_period))
    assert certrack.simulate(longest).metrics.tail_error <= 2 * fresh.metrics.tail_error
    longer = lqr.system.replace(implementation=certrack.Implementation(1.1 * lqr.longest_period))
    assert not certrack.simulate(longer).metrics.tail_error <= 2 * fresh.metrics.tail_error
    assert lqr.worst_member >= lqr.members.statistics.metrics["tail_error"].quantile(0.5)
    assert math.isinf(lqr.bound) and "guesses" in lqr.bound_note  # g_n is not known
    assert stated.bound > stated.metrics.tail_error


@pytest.mark.slow
def test_known_gains_give_the_same_figures_without_a_search(compared, short, tmp_path, monkeypatch):
    monkeypatch.setattr(comparison_module, "search_gains", untouched)
    file = tmp_path / "gains.json"
    file.write_text(to_json(compared.summary()))
    known = read_gains(file, AS_STATED)
    again = compare_laws(short, list(known.laws), members=known.member_count, known=known)
    assert to_json(again.summary()) == file.read_text()
    with pytest.raises(certrack.InputError, match="smc"):
        compare_laws(short, ["smc"], members=2, known=known)


def gains_text(**changes):
    body = {
        "limits": {"peak_input": 1.0, "input_variation": 2.0, "period": 0.003},
        "laws": {"pid": {"gains": {"k_p": 1.0}, "evaluations": 3}},
        "evaluations": 10,
        "seed": 0,
        "members": 4,
    }
    return json.dumps(body | changes)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("no JSON", "not JSON"),
        ("[]", "no file of gains"),
        (gains_text(laws={}), "laws"),
        (gains_text(laws={"pid": {}}), "laws.pid.gains"),
        (gains_text(limits={"period": 1}), "limits.peak_input"),
        (gains_text(laws={"pid": {"gains": {"k_q": 1.0}}}), "k_q"),
        (gains_text(laws={"pid": {"gains": {"k_p": -1.0}}}), "k_p"),
        (gains_text(laws={"nothing": {"gains": {}}}), "nothing"),
    ],
)
def test_a_bad_file_of_gains_is_one_line(text, message, tmp_path, capsys):
    file = tmp_path / "gains.json"
    file.write_text(text)
    with pytest.raises(SystemExit) as end:
        main(["compare", "example1", "--gains", str(file)])
    error = capsys.readouterr().err.strip().splitlines()
    assert end.value.code == 2 and message in error[-1]


def test_of_a_file_of_gains_that_is_too_large_that_is_said(tmp_path, monkeypatch):
    file = tmp_path / "gains.json"
    file.write_text(gains_text())
    read_gains(file, AS_STATED)
    monkeypatch.setattr(known_gains, "LARGEST_GAINS_FILE", 10)
    with pytest.raises(certrack.InputError, match="is too large for a file of gains$"):
        read_gains(file, AS_STATED)


def test_a_search_and_known_gains_exclude_each_other(tmp_path):
    file = tmp_path / "gains.json"
    file.write_text(gains_text())
    result = CliRunner().invoke(cli, ["compare", "example1", "--gains", str(file), "--seed", "3"])
    assert result.exit_code == 2 and "--seed cannot be given with --gains" in result.output


def test_a_pid_begins_with_the_poles_of_the_files_law():
    """k_p, k_i and k_d of a double integrator with a triple pole."""
    axis = certrack.load(Path(__file__).parent / "data" / "friction-axis.toml")
    law, _ = entrant_of(axis, "pid")
    gains = law.law.gains_at(law.plant, 30.0)
    b_0 = 1 / 2.706
    poles = np.roots([1, b_0 * gains["k_d"], b_0 * gains["k_p"], b_0 * gains["k_i"]])
    assert np.allclose(poles, -30, rtol=1e-3)


@pytest.mark.parametrize("name", ["l1", "lqr", "mpc", "mrac"])
def test_weights_begin_at_the_speed_that_is_asked_for(name):
    entrant, family = entrant_of(sampled(certrack.load("dual-motor-lean"), 0.001), name)
    for factor in (0.5, 1.0, 4.0):
        poles = entrant.replace(
            law=family.law(family.at_speed(factor))
        ).controller.coordinates.poles
        typical = np.exp(np.log(np.abs(poles)).mean())
        assert 0.5 < typical / (6.0 * factor) < 2


@pytest.mark.slow
def test_limits_are_those_of_the_files_law(compared):
    stated, limits = compared.laws[0], compared.limits
    assert limits.input_variation == pytest.approx(10 * stated.metrics.input_variation)
    assert limits.peak_input >= stated.metrics.peak_input and limits.period == 0.006


@pytest.mark.slow
def test_table_and_picture_have_every_law(compared):
    table = law_table(compared, None)
    assert table.columns == ("", "as stated", "lqr", "pid")
    assert all(len(row) == 4 for row in table.rows)
    notes = "\n".join(law_notes(compared))
    assert "k_p" in notes and "lqr = [" in notes
    drawing = law_comparison_figure(compared, "")
    titles = [ax.get_title() for ax in drawing.axes if ax.get_visible()]
    assert titles == [figures.name for figures in compared.laws if figures.members is not None]
    json.dumps(compared.summary(), default=float)


@pytest.mark.slow
def test_no_gains_are_found_where_none_stabilise():
    """A PID on the load of the dual motor, whose integral would need more phase than it has."""
    lean = certrack.load("dual-motor-lean").with_settings(duration=8, tail=4)
    result = compare_laws(lean, ["pid"], budget=12, members=4)
    assert not result.laws[1].works and law_table(result, None).rows[-1][2] == NOTHING_FOUND
    assert result.laws[0].works and np.isfinite(result.laws[0].bound)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--laws", "nothing"], "--laws"),
        (["--laws", "lqr,lqr"], "twice"),
        (["--laws", "lqr", "--peak-input", "-1"], "--peak-input"),
        (["--laws", "lqr", "example1-classic"], "one FILE"),
    ],
)
def test_bad_input_is_one_line(arguments, message, capsys):
    with pytest.raises(SystemExit) as end:
        main(["compare", "example1", *arguments])
    assert end.value.code == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1


def test_options_of_the_laws_need_them():
    result = CliRunner().invoke(cli, ["compare", "example1", "--peak-input", "3"])
    assert result.exit_code == 2 and "--peak-input needs --laws" in result.output


def test_a_regulator_is_held_against_an_output_that_stays_where_it_begins():
    """With y_d = 0 the largest reference says nothing."""
    system = certrack.load("dual-motor-lean")
    still = system.replace(reference=certrack.SymbolicReference("0*t"))
    assert resting_error(still) == pytest.approx(1.0)
    assert resting_error(system) == pytest.approx(0.1, rel=1e-6)
    at_zero = still.with_settings(x0=(0.0, 0.0, 0.0, 0.0))
    assert resting_error(at_zero) == math.inf


def test_bounds_of_the_continuous_loop_are_marked():
    figures = LawFigures("paper", certrack.load("example1"), None, works=True, bound=0.0618)
    assert replace(figures, bound_note="bootstrap").bound_is_continuous
    assert not replace(figures, bound_note="implemented").bound_is_continuous
    assert not replace(figures, bound=math.inf, bound_note="none").bound_is_continuous
    assert figures.why_not != NOTHING_FOUND
