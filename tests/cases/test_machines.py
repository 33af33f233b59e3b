"""Implementations that cannot work: said at load, before a run and before an export."""

import json
from pathlib import Path

import numpy as np
import pytest

import certrack
from certrack import Implementation, InputError
from certrack.cli import main
from certrack.integrators.base import Outcome
from certrack.laws.leakage import leak_matrix, longest_euler_period
from certrack.simulation.implementation_notes import (
    implementation_notes,
    longest_speed_period,
    quantum_error,
)
from certrack.studies.ensembles.all_lost import PROBED_MEMBERS, AllMembersLost

CASES = Path(__file__).parents[1] / "data" / "cases"


def go(capsys, *arguments):
    with pytest.raises(SystemExit) as end:
        main([str(a) for a in arguments])
    return end.value.code, *capsys.readouterr()


def case(name, old="", new=""):
    text = (CASES / f"{name}.toml").read_text()
    assert old in text
    return text.replace(old, new)


class TestLeak:
    """Gamma leak T = 10: a step of Euler overshoots the prior by nine times the distance."""

    @pytest.mark.parametrize(
        "command",
        [("simulate",), ("export", "c", "--out", "x"), ("export", "st", "--out", "x.st")],
    )
    def test_said_at_load_and_before_export(self, capsys, tmp_path, monkeypatch, command):
        monkeypatch.chdir(tmp_path)
        verb, more = command[:2] if command[0] == "export" else command[:1], command[2:]
        code, out, errors = go(capsys, *verb, CASES / f"{'leak'}.toml", *more)
        assert (code, out) == (2, "")
        assert errors.count("\n") == 1
        for part in ("leak.toml:67", "implementation.period", "0.002 s", "exact_leak"):
            assert part in errors
        assert not list(tmp_path.iterdir())

    def test_a_period_of_the_command_is_checked_too(self):
        system = certrack.loads(case("leak", "period = 0.01", "period = 0.001"))
        with pytest.raises(InputError, match=r"implementation\.period: must be below 0\.002 s"):
            certrack.export_st(system, "never.st", period=0.01)

    @pytest.mark.parametrize(
        "change",
        ["period = 0.0019", 'period = 0.01\nupdate = "exact_leak"'],
        ids=["short", "exact"],
    )
    def test_both_remedies_work(self, change):
        run = certrack.simulate(certrack.loads(case("leak", "period = 0.01", change)))
        assert run.outcome is Outcome.finished and run.metrics.tail_error < 0.1

    def test_the_limit_is_where_the_step_ceases_to_decay(self):
        system = certrack.loads(case("leak", "period = 0.01", "period = 0.001"))
        longest = longest_euler_period(system.controller)
        step = np.eye(2) + longest * leak_matrix(system.controller)
        assert np.abs(np.linalg.eigvals(step)).max() == pytest.approx(1, abs=1e-12)
        with pytest.raises(InputError):
            system.replace(implementation=Implementation(period=longest))
        system.replace(implementation=Implementation(period=0.999 * longest))

    def test_a_law_without_leakage_has_no_limit(self):
        assert longest_euler_period(certrack.load("example1-classic").controller) == np.inf
        assert longest_euler_period(certrack.load("dual-motor").controller) == np.inf

    @pytest.mark.slow
    def test_margins_begin_where_the_leak_decays(self):
        system = certrack.loads(case("leak", "[implementation]\nperiod = 0.01"))
        assert certrack.margins(system, members=8).period.within < 0.002


class TestSpeed:
    @pytest.mark.parametrize(("period", "said"), [(0.007, False), (0.0071, True)])
    def test_a_linear_loop_is_judged_exactly(self, period, said):
        system = certrack.load("dual-motor").replace(implementation=Implementation(period=period))
        notes = implementation_notes(system)
        assert bool(notes) is said
        assert all("certrack margin" in note for note in notes)

    @pytest.mark.parametrize("delay", [0, 1, 2, 5])
    def test_the_edge_of_one_pole(self, delay):
        gain = 3.0 * longest_speed_period(3.0, delay)
        for factor, stable in ((0.999, True), (1.001, False)):
            polynomial = np.zeros(delay + 2)  # z^(d+1) - z^d + gain
            polynomial[:2] = 1, -1
            polynomial[-1] += factor * gain
            assert (np.abs(np.roots(polynomial)).max() < 1) == stable

    def test_the_fastest_pole_of_an_adaptive_law(self, tmp_path, capsys):
        system = certrack.load("example1").replace(implementation=Implementation(period=0.5))
        (note,) = certrack.simulate(system, duration=1).notes
        assert "too long for the fastest error pole" in note
        code, _, errors = go(
            capsys, "export", "st", "example1", "--period", 0.5, "--out", tmp_path / "a.st"
        )
        assert code == 0 and note in errors
        code, out, _ = go(
            capsys, "export", "c", "example1", "--period", 0.5, "--out", tmp_path / "c", "--json"
        )
        assert json.loads(out)["notes"] == [note]
        assert note in (tmp_path / "c" / "README.md").read_text()


class TestQuantum:
    def test_a_constant_error_of_all_sensors_is_the_estimate(self):
        """Sensors that are off by half a quantum, all to the loop's disadvantage."""
        system = certrack.load("dual-motor-lean")
        quanta = np.array([1e-3, 2e-3, 1e-3, 3e-3])
        sampled = system.replace(
            implementation=Implementation(period=1e-3, measurement_quantum=tuple(quanta))
        )
        coordinates = system.controller.coordinates
        offset = np.sign(coordinates.nu_x) * quanta / 2
        e = np.linalg.solve(coordinates.error_matrix, -np.eye(4)[3] * (coordinates.nu_x @ offset))
        assert quantum_error(sampled) == pytest.approx(abs(e[0]), rel=1e-9)

    def test_said_where_it_passes_the_band(self):
        system = certrack.load("example1")
        rough = Implementation(period=0.001, measurement_quantum=(0.1, 0.1), input_quantum=1)
        (note,) = implementation_notes(system.replace(implementation=rough))
        assert "beyond the settling band of 0.05" in note
        assert not implementation_notes(certrack.load("dual-motor-drive"))


class TestMessages:
    def test_an_overflow_of_the_controller_is_no_domain(self):
        system = certrack.load("example1").with_settings(estimates=(1e60, 1e90), duration=2)
        for implementation in (None, Implementation(period=0.01)):
            run = certrack.simulate(system.replace(implementation=implementation))
            assert run.outcome is Outcome.controller_diverged
            assert "domain" not in run.message and "controller" in run.message

    def test_a_domain_is_still_called_one(self):
        system = certrack.load("example1")
        truth = certrack.Truth(
            input_gain=2, theta=(1,), omega=(0, "sqrt(1 - t)"), tau=system.truth.tau
        )
        for implementation in (None, Implementation(period=0.01)):
            run = certrack.simulate(system.replace(truth=truth, implementation=implementation))
            assert run.outcome is Outcome.undefined
            assert "domain" in run.message

    def test_raising_c_is_no_remedy_for_sampling(self):
        system = certrack.load("dual-motor-lean")
        run = certrack.simulate(system.replace(implementation=Implementation(period=0.2)))
        assert run.outcome is Outcome.escaped
        assert "implementation.period" in run.message
        assert run.summary()["message"] == run.message
        assert run.message.index("implementation.period") < run.message.index("raise c")


class TestAllLost:
    def wild(self):
        return certrack.System(
            plant=certrack.Plant(states=["x"], drift="x**3", gain_sign=1, input_gain=1),
            law=certrack.Robust(c=(1,)),
            reference=certrack.SymbolicReference("0.1*sin(t)"),
            truth=certrack.Truth(input_gain=0.3),
            settings=certrack.Settings(x0=(1.9,), duration=10),
            population=certrack.Population(x0=(certrack.Distribution("uniform", (1.8, 2)),)),
        )

    @pytest.mark.parametrize("method", ["native", "lockstep"])
    def test_it_stops_early_and_says_why(self, method):
        with pytest.raises(AllMembersLost, match=r"none of the first 256 members .*256 escaped"):
            certrack.ensemble(self.wild(), 10**7, method=method, limit=1.0)

    def test_what_was_asked_for_is_given(self):
        found = certrack.ensemble(self.wild(), PROBED_MEMBERS, limit=1.0)
        assert found.statistics.outcomes == {"escaped": PROBED_MEMBERS}

    def test_the_command(self, tmp_path, capsys):
        file = tmp_path / "wild.toml"
        certrack.save(self.wild(), file)
        code, out, errors = go(capsys, "ensemble", file, "-n", 1000, "--limit", 1)
        assert (code, out) == (1, "")
        *notes, error = errors.splitlines()
        assert all(note.startswith("certrack: note: ") for note in notes)
        assert error.startswith("ensemble: stopped") or "stopped" in error
        assert "--member 0" in error


class TestMargins:
    def test_nothing_holds_beyond_the_exact_edge(self):
        """A run of 20 s ends before a slow growth shows: 1 % beyond the edge it is still small."""
        found = certrack.margins(certrack.load("dual-motor-lean"), members=8)
        for one in (found.period, found.delay):
            assert one.within <= one.bounded <= one.exact
            beyond = [e for v, e in zip(one.values, one.errors, strict=True) if v >= one.exact]
            assert beyond and not np.isfinite(beyond).any()

    def test_bounded_is_better_than_an_output_at_rest(self):
        found = certrack.margins(certrack.load("example1"), members=8)
        assert found.bounded_error == pytest.approx(0.2)  # y_d = 0.2 cos t
        assert found.summary()["bounded_error"] == found.bounded_error
        coarse = certrack.margins(certrack.load("example1"), members=8, error=1.0)
        assert coarse.bounded_error == 10.0

    def test_no_line_contradicts_another(self, capsys, monkeypatch):
        """A saturation without an edge is not told beside a saturation with one."""
        monkeypatch.setenv("COLUMNS", "120")
        code, out, _ = go(capsys, "margin", "example1", "-n", 8, "--error", 0.3)
        assert code == 0
        rows = {line.split("│")[1].strip(): line for line in out.splitlines() if "│ l" in line}
        saturation = rows["lowest saturation (+-)"].split("│")[2:4]
        assert all(cell.strip()[0] in "<123456789" for cell in saturation)
        assert ("> and <" in out) == any(sign in line for line in rows.values() for sign in "<>")
        assert "nothing failed within the range" not in out
