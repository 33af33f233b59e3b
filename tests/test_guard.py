"""One bad sample does not poison an exported controller: C, FMU and Structured Text hold it off."""

import ctypes
import math
import shutil
import subprocess

import numpy as np
import pytest
from exported import EVERYTHING, sampled
from test_export_c import CPPCHECK
from test_export_fmu import VERSIONS, Imported, inputs, written
from test_export_st import FunctionBlock

from certrack.core.compilers import c_compilers, load_library
from certrack.export.c.export import c_files
from certrack.export.c.guard import guard_header
from certrack.export.c.source import c_code
from certrack.export.st.function_block import structured_text

BAD = (math.nan, math.inf, -math.inf)
needs_compiler = pytest.mark.skipif(not c_compilers(), reason="needs a C compiler")


def good_samples(system, count=6):
    """Plausible inputs; the controller's answers to them differ."""
    random = np.random.default_rng(0)
    n, m = system.plant.n, len(system.controller.signals.Y)
    return random.normal(0, 0.3, (count, n)), random.normal(0, 0.1, (count, m))


class InC:
    """The exported C with its guard, compiled."""

    def __init__(self, system, real="double"):
        self.code = code = c_code(system, "drive", real=real)
        files = {name: text for name, text in c_files(code).items() if name.startswith("drive")}
        del files["drive_test.c"]
        kind = "drive_real"
        files["bridge.c"] = (
            '#include "drive_guard.h"\n'
            f"int valid(const {kind} *x, const {kind} *y) {{ return drive_valid(x, y); }}\n"
            f"void start(drive_state *s) {{ drive_init(s); }}\n"
            f"{kind} guarded(drive_state *s, const {kind} *x, const {kind} *y, {kind} u)\n"
            "{ return drive_guarded_step(s, x, y, u); }\n"
        )
        self.library = load_library(files, ["-std=c99", "-O2", "-shared", "-fPIC"])
        self.real = {"double": ctypes.c_double, "float": ctypes.c_float}[real]
        self.library.guarded.restype = self.real
        self.state = (self.real * max(1, len(code.members)))()
        self.library.start(self.state)

    def array(self, values):
        return (self.real * len(values))(*values)

    def step(self, x, y, last):
        return self.library.guarded(self.state, self.array(x), self.array(y), self.real(last))


@needs_compiler
@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("options", [{}, EVERYTHING], ids=["plain", "everything"])
def test_c_holds_the_command_and_the_state(real, options):
    system = sampled("example1", **options)
    guarded, (xs, ys) = InC(system, real), good_samples(system)
    u = guarded.step(xs[0], ys[0], 0.0)
    unread = {1} if "velocity" in options else set()
    for x, y in zip(xs[1:], ys[1:], strict=True):
        kept = list(guarded.state)
        for i in range(len(x) + len(y)):
            for value in (
                *BAD,
                1e38,
            ):  # the last is finite: the answer overflows, in float at least
                both = np.concatenate([x, y])
                both[i] = value
                bad = both[: len(x)], both[len(x) :]
                if i in unread:
                    assert guarded.library.valid(*map(guarded.array, bad))
                    continue
                assert bool(guarded.library.valid(*map(guarded.array, bad))) == (value == 1e38)
                if value != 1e38:
                    assert guarded.step(*bad, u) == u
                    assert list(guarded.state) == kept
        after = guarded.step(x, y, u)
        assert after != u and math.isfinite(after)
        u = after


@needs_compiler
def test_c_lets_no_answer_through_that_overflows():
    """Finite inputs whose product is not: the state would be lost for good."""
    guarded = InC(sampled("example1"))
    (x, *_), (y, *_) = good_samples(sampled("example1"))
    u = guarded.step(x, y, 0.0)
    kept = list(guarded.state)
    assert guarded.library.valid(guarded.array([1e300, 1e300]), guarded.array(y))
    assert guarded.step([1e300, 1e300], y, u) == u
    assert list(guarded.state) == kept


@needs_compiler
def test_the_acceptance_test_notices_a_guard_that_lets_everything_pass(tmp_path):
    files = c_files(c_code(sampled("example1"), "drive"))
    hole = {
        "drive_valid": ("if (drive_valid(x, y_d)) {", "if (largest > 0.0) {"),
        "results": ("((u >= -largest) && (u <= largest))", "true"),
    }
    for changes, passes in (
        (("drive_valid",), True),
        (("drive_valid", "results"), False),
        ((), True),
    ):
        text = files["drive_guard.h"]
        for change in changes:
            old, new = hole[change]
            assert old in text
            text = text.replace(old, new)
        if len(changes) == 2:  # no look at the next state either
            begin = text.index("if (true")
            text = text[:begin] + "if (true) {" + text[text.index("{", begin) + 1 :]
        for name, body in (files | {"drive_guard.h": text}).items():
            (tmp_path / name).write_text(body)
        command = [c_compilers()[0], "drive.c", "drive_test.c", "-lm", "-o", "accept"]
        subprocess.run(command, cwd=tmp_path, check=True)
        done = subprocess.run([tmp_path / "accept"], capture_output=True, check=False)
        assert (done.returncode == 0) == passes, (changes, done.stdout)


@pytest.mark.skipif(shutil.which("cppcheck") is None, reason="NOT TESTED: cppcheck is missing")
@pytest.mark.parametrize("real", ["double", "float"])
def test_the_guard_is_misra_clean(tmp_path, real):
    for name, text in c_files(
        c_code(sampled("example1", **EVERYTHING), "drive", real=real)
    ).items():
        (tmp_path / name).write_text(text)
    (tmp_path / "use.c").write_text('#include "drive_guard.h"\n')
    done = subprocess.run(
        ["cppcheck", *CPPCHECK, "use.c"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


@needs_compiler
@pytest.mark.parametrize("version", VERSIONS)
def test_an_fmu_holds_and_warns(version, tmp_path):
    system = sampled("example1", **EVERYTHING)
    (xs, ys), T = good_samples(system), system.implementation.period
    path = written(system, version, tmp_path)
    fmu = Imported(path, version, tmp_path)
    names = [v.name for v in fmu.description.modelVariables if v.name.startswith("kept.")]
    fmu.set(inputs(system, xs[0], ys[0]))
    u = fmu.step(0.0, T)
    kept = fmu.get(*names)
    for value in BAD:
        fmu.set(inputs(system, [value, 0.0], ys[0]))
        assert fmu.step(T, T) == u
        assert fmu.get(*names) == kept
    assert len(fmu.messages) == len(BAD)
    assert all("not finite" in message for message in fmu.messages)
    fmu.set(inputs(system, xs[1], ys[1]))
    assert fmu.step(2 * T, T) != u
    assert len(fmu.messages) == len(BAD)


@needs_compiler
@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("h", [math.inf, -math.inf, math.nan, 1e9, 1e300, 0.0, -0.001])
def test_an_fmu_refuses_an_infinite_or_absurd_step(version, tmp_path, h):
    system = sampled("dual-motor-lean")
    fmu = Imported(written(system, version, tmp_path), version, tmp_path)
    with pytest.raises(Exception, match=r"[Ss]tatus.*3|failed"):
        fmu.step(0.0, h)
    assert "multiple of the controller's period" in fmu.messages[-1]


@pytest.mark.parametrize("options", [{}, EVERYTHING], ids=["plain", "everything"])
def test_structured_text_holds(options):
    system = sampled("example1", **options)
    text = structured_text(system, "drive")
    block, (xs, ys) = FunctionBlock(text), good_samples(system)
    plain = FunctionBlock(text)
    for x, y in zip(xs, ys, strict=True):
        u = block.call(*x, *y, guard=True)
        assert u == plain.call(*x, *y)
        kept = {name: block.values[name] for name in block.sections["VAR"]}
        for value in (*BAD, 1.5e308):
            assert block.call(value, x[1], *y, guard=True) == u
            assert block.call(*x, value, y[1], guard=True) == u
            assert {name: block.values[name] for name in kept} == kept
    assert not math.isfinite(plain.call(math.nan, *xs[0][1:], *ys[0])) or options
    assert math.isnan(plain.values["DELTA_HAT"]) or options  # without the guard: for good


def test_only_arguments_that_no_condition_reads_are_called_unused():
    """Which compilers would warn of otherwise."""
    header = guard_header(c_code(sampled("example1", **EVERYTHING), "drive"))
    assert "(void)" not in header
    for argument in ("x[0]", "y_d[0]"):
        assert f"(({argument} >= -largest) && ({argument} <= largest))" in header
