"""The command line as a user meets it."""

import json
import re
import subprocess
import sys
from pathlib import Path

import click
import pytest
from conftest import SHIPPED
from rich.console import Console

import certrack
from certrack.cli import cli, console, main
from certrack.cli.console import print_table, print_wide_table
from certrack.reports.runs import metrics_table, moves_table
from certrack.reports.tables import table
from certrack.simulation.metrics import METRIC_LABELS
from certrack.simulation.moves import MOVE_LABELS


def invoke(capfd, *arguments):
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    streams = capfd.readouterr()
    return caught.value.code, streams.out, streams.err


def result(capfd, *arguments):
    code, out, err = invoke(capfd, *arguments, "--json")
    assert code == 0, err
    return json.loads(out)


def test_ensemble(capfd, tmp_path):
    """Results, replay of a member, and a second call that computes nothing."""
    out = tmp_path / "members"
    found = result(
        capfd, "ensemble", "example1", "-n", "64", "--seed", "2", "--out", str(out), "--keep", "3"
    )
    assert found["members"] == found["computed"] == 64
    assert found["violations"]["count"] == 0
    assert found["microseconds_per_member"] > 0
    worst = found["tail_error"]["worst_member"]
    replayed = result(capfd, "simulate", "example1", "--member", str(worst), "--seed", "2")
    assert replayed["tail_error"] == pytest.approx(found["tail_error"]["max"], rel=1e-3)
    for name in ("bands.nc", "summary.json", "fan.png", "fan.svg", "metrics.png", "member-3.nc"):
        assert (out / name).stat().st_size > 0
    again = result(capfd, "ensemble", "example1", "-n", "64", "--seed", "2", "--out", str(out))
    assert again["computed"] == 0
    assert again["metrics"] == found["metrics"]
    code, text, _ = invoke(capfd, "ensemble", "example1", "-n", "64", "--seed", "2", "--limit", "1")
    assert code == 0
    assert "0 of 64 members" in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("ensemble", "example1", "--keep", "3"), "--keep needs --out"),
        (("ensemble", "example1", "-n", "8", "--keep", "8", "--out", "x"), "below --members"),
        (("ensemble", "example1", "--cluster", "nowhere"), "cannot reach the scheduler"),
        (("ensemble", "example1", "--tolerance", "1"), "tolerance: must be at most"),
        (("simulate", "example1", "--seed", "1"), "--seed needs --member or --corner"),
    ],
)
def test_bad_ensembles(capfd, arguments, message):
    code, out, err = invoke(capfd, *arguments)
    assert (code, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1


def test_list(capfd):
    assert tuple(result(capfd, "list")) == SHIPPED
    code, out, _ = invoke(capfd, "list")
    assert code == 0
    assert "dual-motor-lean" in out


def test_new_file_simulates_and_is_not_overwritten(capfd, tmp_path):
    path = tmp_path / "drive.toml"
    assert result(capfd, "new", str(path)) == {"file": str(path)}
    assert result(capfd, "simulate", str(path))["outcome"] == "finished"
    before = path.read_text()
    code, _, err = invoke(capfd, "new", str(path))
    assert code == 2
    assert "exists already" in err
    assert path.read_text() == before
    code, _, err = invoke(capfd, "new", str(tmp_path / "no" / "drive.toml"))
    assert code == 2
    assert "cannot be written" in err


def test_a_new_file_may_be_a_shipped_system_with_its_comments(capfd, tmp_path):
    path = tmp_path / "mine.toml"
    assert result(capfd, "new", str(path), "--from", "dual-motor-drive") == {"file": str(path)}
    assert "# 16-bit encoders" in path.read_text()
    assert certrack.load(path) == certrack.load("dual-motor-drive")
    code, _, err = invoke(capfd, "new", str(tmp_path / "no.toml"), "--from", "mine.toml")
    assert code == 2
    assert "--from: must be one of axis, axis-load, dual-motor" in err
    assert not (tmp_path / "no.toml").exists()


def test_rows_of_the_table_of_certificates_do_not_repeat_a_reason(capfd):
    _, out, _ = invoke(capfd, "certify", "dual-motor-lean", "--effort", "fast")
    assert out.count("k[1][2]") == 1
    assert out.count("as above") == 2


@pytest.mark.slow
def test_falsify_says_which_loop_a_number_is_of(capfd):
    _, out, _ = invoke(capfd, "falsify", "dual-motor-drive", "--budget", "100")
    assert "continuous law, worst |e_1| found in" in out
    assert "as implemented, certified limsup |e_1|: 0.0016" in out
    assert "published" not in out


def test_design(capfd):
    found = result(capfd, "design", "dual-motor")
    assert found["B"] == pytest.approx([1, 3.5, 2.40451389, 53.18253642])
    assert found["kappa"][3] == pytest.approx(267.04359722)
    assert found["eta"][0] == [-3.5]
    assert found["d"][0] == 3.5
    assert len(found["A"]) == 4
    code, out, _ = invoke(capfd, "design", "example1")
    assert code == 0
    assert "lambda_1 = -1.75*x1 + 3.25*y_d" in out
    code, out, _ = invoke(capfd, "design", "example1", "--latex")
    assert out.startswith("\\begin{align*}")
    assert "\\dot{\\hat\\delta}" in out


def test_every_shipped_design_can_be_printed(capfd):
    for name in SHIPPED:
        for option in ((), ("--latex",), ("--json",)):
            assert invoke(capfd, "design", name, *option)[0] == 0


def test_simulate(capfd, tmp_path):
    out, plots = tmp_path / "run.nc", tmp_path / "plots"
    found = result(capfd, "simulate", "example1", "--out", str(out), "--plot", str(plots))
    assert found["settling_time"] == pytest.approx(2.15, abs=0.005)
    assert found["tail_error"] == pytest.approx(0.0336, abs=5e-5)
    assert found["peak_input"] == pytest.approx(12.90, abs=5e-3)
    assert found["input_energy"] == pytest.approx(33.1, abs=0.05)
    assert found["outcome"] == "finished"
    assert set(found["final_state"]) == {"x1", "x2", "delta_hat", "theta_hat_1"}
    assert found["rms_error"] > 0
    assert out.stat().st_size > 10_000
    names = {path.name for path in plots.iterdir()}
    panels = ("output", "error", "states", "estimates", "input", "overview")
    assert names == {f"{panel}.{kind}" for panel in panels for kind in ("png", "svg", "pdf")}
    assert all(path.stat().st_size < 300_000 for path in plots.glob("*.png"))


def test_compare(capfd):
    found = result(capfd, "compare", "example1", "example1-classic")
    better, worse = found["example1"], found["example1-classic"]
    assert better["settling_time"] < worse["settling_time"]
    code, out, _ = invoke(capfd, "compare", "example1", "example1-classic")
    assert code == 0
    assert "settling time" in out


@pytest.mark.slow
def test_reproduce(capfd, tmp_path):
    found = result(capfd, "reproduce", "--out", str(tmp_path))
    verdicts = [claim["verdict"] for claim in found["claims"]]
    assert set(verdicts) == {"holds", "differs", "ambiguous", "not testable"}
    assert all(claim["measure"] and claim["measured"] for claim in found["claims"])
    assert any("more accurate" in note["text"] for note in found["observations"])
    figures = {path.name for path in tmp_path.iterdir()}
    expected = {
        f"figure-{name}{detail}.{k}"
        for name in "2a 2b 2c 2d 3a 3b 3c 4a 4b 4c".split()
        for detail in ("", "-detail")
        for k in ("pdf", "png", "svg")
    }
    others = {
        f"{name}.{k}"
        for name in ("figure-1", "certificates", "counterexample")
        for k in ("pdf", "png", "svg")
    }
    assert figures == expected | others
    assert all(path.stat().st_size < 300_000 for path in tmp_path.glob("*.png"))


def test_certify_and_verify(capfd, tmp_path):
    path = tmp_path / "cert.json"
    found = result(
        capfd, "certify", "dual-motor-lean", "--out", str(path), "--plot", str(tmp_path / "p")
    )
    assert found["verified"] is True
    assert found["semidefinite"]["bound"] == pytest.approx(0.00154, rel=0.01)
    assert found["published"]["bound"] is None
    assert "finite k" in found["published"]["reason"]
    assert found["critical_strength"]["semidefinite"] > 50
    assert (tmp_path / "p" / "tube.png").exists()
    checked = result(capfd, "verify", str(path))
    assert checked["verified"] is True
    path.write_text(path.read_text().replace('"points"', '"point"'))
    code, _, err = invoke(capfd, "verify", str(path))
    assert code == 2
    assert "proof: a cell must have" in err
    code, _, err = invoke(capfd, "certify", "example1-classic", "--require")
    assert code == 1
    assert "without leakage" in err
    code, _, err = invoke(capfd, "certify", "example1-classic")
    assert code == 0, "nothing was asked for"
    assert "without leakage" in err
    code, _, err = invoke(
        capfd, "certify", "example1-classic", "--out", str(tmp_path / "none.json")
    )
    assert code == 1 and not (tmp_path / "none.json").exists()
    assert "is not written" in err


def test_tampered_certificate_is_exit_1(capfd, tmp_path):
    path = tmp_path / "cert.json"
    result(capfd, "certify", "example1", "--out", str(path))
    path.write_text(path.read_text().replace("0.6", "0.7"))
    code, _, err = invoke(capfd, "verify", str(path))
    assert code == 1
    assert "not verified" in err


def test_falsify(capfd, tmp_path):
    path = tmp_path / "worst.toml"
    found = result(capfd, "falsify", "dual-motor", "--budget", "400", "--out", str(path))
    assert 1 <= found["ratio"] < 1.2
    replayed = result(capfd, "simulate", str(path))
    assert replayed["tail_error"] == pytest.approx(found["worst_error"], rel=1e-12)
    kinds = ["published", "corrected", "rate", "semidefinite", "cascade", "bootstrap", "peak"]
    assert list(found["certificates"]) == kinds
    assert not any(entry["exceeded"] for entry in found["certificates"].values())
    assert found["against"]["method"] == "peak"
    assert found["certificates"]["peak"]["ratio"] == found["ratio"]
    assert found["certificates"]["cascade"]["bound"] is None


def test_falsify_passes_the_published_bound_where_theorem_1_is_false(capfd):
    case = ("falsify", "theorem1-counterexample", "--budget", "200")
    found = result(capfd, *case)
    entries = found["certificates"]
    assert {kind for kind, entry in entries.items() if entry["exceeded"]} == {"published"}
    assert entries["published"]["ratio"] < 0.6
    code, out, _ = invoke(capfd, *case)
    assert code == 0
    assert "EXCEEDED" in out
    assert "No alarm" in out


def test_a_run_that_does_not_finish_is_exit_1_with_the_remedy(capfd, tmp_path):
    path = tmp_path / "wild.toml"
    certrack.save(certrack.load("example1-classic").with_settings(max_state=2.4), path)
    code, out, err = invoke(capfd, "simulate", str(path), "--json")
    assert code == 1
    assert json.loads(out)["outcome"] == "escaped"
    assert "Raise c" in err


@pytest.mark.slow
def test_what_was_written_is_said_but_not_to_programs(capfd, tmp_path):
    run, pictures, members = tmp_path / "run.nc", tmp_path / "pictures", tmp_path / "members"
    simulate = ("simulate", "example1", "--out", str(run), "--plot", str(pictures))
    _, out, err = invoke(capfd, *simulate)
    count = len(list(pictures.iterdir()))
    assert out.endswith(f"{run} written\n{count} files written in {pictures}\n") and err == ""
    assert "outcome" in result(capfd, *simulate)
    _, out, _ = invoke(capfd, "compare", "example1", "--plot", str(pictures))
    assert out.endswith(f"{count} files written in {pictures}\n")
    _, out, _ = invoke(
        capfd, "ensemble", "example1", "-n", "16", "--keep", "3", "--out", str(members)
    )
    kinds = (".nc", ".json", ".png", ".svg", ".pdf")
    listed = [path for path in members.iterdir() if path.suffix in kinds]
    assert (members / "member-3.nc") in listed
    assert out.endswith(f"{len(listed)} files written in {members}\n")


BAD = {
    "no file": (["simulate", "nowhere"], "neither a file nor a shipped system"),
    "missing file": (["simulate", "nowhere.toml"], "cannot be read"),
    "no argument": (["simulate"], "Missing argument"),
    "unknown verb": (["frobnicate"], "No such command"),
    "unknown option": (["simulate", "example1", "--frob"], "No such option"),
    "bad integrator": (["simulate", "example1", "--integrator", "euler"], "is not one of"),
    "bad tolerance": (["simulate", "example1", "--tolerance", "-1"], "simulation.tolerance"),
    "unwritable plot": (["simulate", "example1", "--plot", "/proc/nowhere"], "cannot be written"),
    "unwritable out": (["simulate", "example1", "--out", "/nowhere/run.nc"], "cannot be written"),
    "out is a folder": (["simulate", "example1", "--out", "/"], "is a directory"),
    "no certificate": (["verify", "nowhere.json"], "cannot be read"),
    "samples without out": (["simulate", "example1", "--samples", "9"], "--samples needs --out"),
    "period missing for C": (
        ["export", "c", "dual-motor", "--out", "/nowhere/firmware"],
        "dual-motor.toml: implementation: is missing",
    ),
    "period missing for ST": (
        ["export", "st", "dual-motor", "--out", "/nowhere/drive.st"],
        "dual-motor.toml: implementation: is missing",
    ),
    "period missing for an FMU": (
        ["export", "fmu", "dual-motor", "--out", "/nowhere/drive.fmu"],
        "dual-motor.toml: implementation: is missing",
    ),
    "sampled by C": (
        ["simulate", "dual-motor", "--with-c"],
        "dual-motor.toml: implementation: is missing",
    ),
    "budget": (["falsify", "example1", "--budget", "1"], "is not in the range"),
    "unwritable reproduction": (["reproduce", "--out", "/proc/nowhere"], "cannot be written"),
}


@pytest.mark.parametrize(("arguments", "message"), BAD.values(), ids=BAD.keys())
def test_bad_calls_are_exit_2_and_one_line(capfd, arguments, message):
    code, out, err = invoke(capfd, *arguments)
    assert code == 2
    assert out == ""
    assert message in err
    assert len(err.strip().splitlines()) == 1, err


@pytest.mark.parametrize(
    "verb",
    [
        *("list", "new", "design", "simulate", "compare", "ensemble", "margin", "certify"),
        *("check", "verify", "falsify", "reproduce", "export c", "export st", "export fmu"),
        "cache",
    ],
)
def test_help_has_an_example_that_is_right(capfd, verb):
    code, out, _ = invoke(capfd, *verb.split(), "--help")
    assert code == 0
    assert f"Example: certrack {verb}" in out
    assert "--json" in out


def commands(group, *path):
    for name, command in group.commands.items():
        if isinstance(command, click.Group):
            yield from commands(command, *path, name)
        else:
            yield (*path, name), command


def test_every_option_says_what_it_is(capfd):
    """And the example of every verb has arguments that the verb takes."""
    for path, command in commands(cli):
        for option in command.params:
            assert isinstance(option, click.Argument) or option.help, (path, option.name)
        (example,) = re.findall(r"Example: certrack (.*)", command.help)
        words = example.split()
        assert tuple(words[: len(path)]) == path
        command.make_context(path[-1], words[len(path) :])


@pytest.mark.parametrize("path", [(), ("export",)])
def test_the_lists_of_verbs_fit_a_terminal(monkeypatch, capfd, path):
    monkeypatch.setenv("COLUMNS", "80")
    code, out, _ = invoke(capfd, *path, "--help")
    assert code == 0
    assert "..." not in out.partition("Commands:")[2]
    assert max(map(len, out.splitlines())) <= 80


@pytest.mark.parametrize("terminal", [False, True])
def test_notes_break_between_words_on_a_terminal_only(monkeypatch, capfd, terminal):
    monkeypatch.setattr(console, "console", lambda: Console(width=30, force_terminal=terminal))
    lines = ["resting on:", "  " + "a-word " * 20 + "end", "", "x" * 40]
    console.print_lines(lines)
    out, _ = capfd.readouterr()
    if terminal:
        assert max(map(len, out.splitlines()[:-1])) <= 30
        assert out.split() == " ".join(lines).split()
        assert all(line.startswith("  ") for line in out.splitlines()[1:-2])
    else:
        assert out.splitlines() == lines


def test_module_runs_as_an_installed_command(tmp_path):
    command = Path(sys.executable).with_name("certrack")
    done = subprocess.run([command, "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("certrack, version ")


@pytest.mark.parametrize("width", ["80", "120"])
def test_tables_break_neither_numbers_nor_words(monkeypatch, capfd, width):
    def printed(content, way=print_table):
        way(content)
        return capfd.readouterr().out

    monkeypatch.setenv("COLUMNS", width)
    numbers = [8.0494e5, 1.2344e-4, 0.012344, 0.0012344, -7.6543e-12]
    heads = ["5%", "median", "95%", "99%", "largest", "none"]
    rows = [[label, *numbers, 1000] for label in METRIC_LABELS.values()]
    text = printed(table("", ["metric", *heads], rows, digits=4))
    for word in ["8.049e5", "1.234e-4", "0.01234", "0.001234", "-7.654e-12", *heads, "variation"]:
        assert word in text, word
    names = [f"dual-motor-{name}" for name in ("lean", "drive", "strong", "physical", "other")]
    summary = dict.fromkeys(METRIC_LABELS, 8.0494e5)
    summary |= {"outcome": "finished", "integrator": "implicit"}
    text = printed(metrics_table(dict.fromkeys(names, summary)), print_wide_table)
    assert text.count("8.0494e5") == len(METRIC_LABELS) * len(names)
    assert text.count("finished") == text.count("implicit") == len(names)
    for word in ("lean", "drive", "strong", "physical", "other"):
        assert word in text, word
    assert max(map(len, text.splitlines())) <= int(width)
    move = dict.fromkeys(MOVE_LABELS, 8.0883e-4) | {"begin": 0.801, "arrival": 1.402}
    text = printed(moves_table([move | {"origin": 1.571, "target": 3.142}]))
    for word in ("begins", "arrives", "following", "overshoot", "settled", "8.088e-4"):
        assert word in text, word
    assert max(map(len, text.splitlines())) <= int(width)
