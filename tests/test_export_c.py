"""The exported C computes what the simulation computes, cleanly, and its own test would tell."""

import ctypes
import json
import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from conftest import numbers, systems
from hypothesis import given, settings
from hypothesis import strategies as st

import certrack
from certrack import Implementation, InputError
from certrack.cli import main
from certrack.export import c as export_c
from certrack.export import with_c
from certrack.export.c_printer import comment, literal, wrapped
from certrack.export.c_source import c_code, sampled_system
from certrack.export.golden import TOLERANCE, golden
from certrack.export.names import RESERVED, free_name, stem

STRICT = (
    "-std=c99 -Wall -Wextra -Wpedantic -Wconversion -Wdouble-promotion -Wshadow -Werror -O2"
).split()
CLANG = "-std=c99 -Weverything -Wno-declaration-after-statement -Wno-padded -Werror -O1".split()
CPPCHECK = (
    "--std=c99 --enable=all --inconclusive --addon=misra --error-exitcode=1 -q "
    "--suppress=missingIncludeSystem --suppress=unusedFunction --suppress=unmatchedSuppression "
    "--suppress=misra-c2012-2.5:*.h"  # the period is for the caller to read
).split()


def needs(tool):
    return pytest.mark.skipif(
        shutil.which(tool) is None, reason=f"NOT TESTED: {tool} is not installed (see .ci/run)"
    )


pytestmark = needs("gcc")

NUMBER = re.compile(r"(?<![\w.])(\d+\.\d+(?:e[-+]?\d+)?|\d+e[-+]?\d+)(F?)\b")

FULL = Implementation(
    period=0.001,
    saturation=(-20, 20),
    rate_limit=1e4,
    velocity=("x2",),
    velocity_filter=0.01,
    update="exact_leak",
)


def fully_implemented(system):
    """With everything that an implementation can have."""
    if not system.controller.states:
        return system.replace(implementation=replace(FULL, update="euler"))
    boxes = ((-3, 3),) * len(system.controller.states)
    return system.replace(implementation=replace(FULL, projection=boxes))


def run(*command, cwd, code=0):
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout


def write(folder, code):
    for name, text in export_c.files(code).items():
        (folder / name).write_text(text)
    return code.name


VARIANTS = [
    (name, full, real)
    for name in ("example1", "example1-classic", "dual-motor", "dual-motor-lean")
    for full in (False, True)
    for real in ("double", "float")
]


@pytest.fixture(params=VARIANTS, ids=lambda v: f"{v[0]}-{'full' if v[1] else 'plain'}-{v[2]}")
def exported(request, tmp_path):
    name, full, real = request.param
    system = certrack.load(name)
    system = fully_implemented(system) if full else sampled_system(system, 0.001)
    code = c_code(system, name, real=real)
    write(tmp_path, code)
    return code, tmp_path


class TestCode:
    def test_compiles_strictly_and_passes_its_own_test(self, exported):
        code, folder = exported
        run("gcc", *STRICT, f"{code.name}.c", f"{code.name}_test.c", "-lm", cwd=folder)
        said = run("./a.out", cwd=folder)
        assert "passed" in said and code.name in said

    def test_no_double_in_float_code(self, exported):
        code, _ = exported
        if code.real == "float":
            body = code.source + code.header[code.header.index("*/") :]
            assert "double" not in body
            assert all(match[2] == "F" for match in NUMBER.finditer(body))

    @needs("clang")
    def test_clang_with_every_warning(self, exported):
        code, folder = exported
        run("clang", *CLANG, f"{code.name}.c", f"{code.name}_test.c", "-lm", cwd=folder)
        run("./a.out", cwd=folder)

    @needs("cppcheck")
    def test_cppcheck_with_misra(self, exported):
        code, folder = exported
        run("cppcheck", *CPPCHECK, f"{code.name}.c", cwd=folder)

    def test_sanitizers(self, exported):
        code, folder = exported
        sanitize = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g"]
        run("gcc", *sanitize, f"{code.name}.c", f"{code.name}_test.c", "-lm", cwd=folder)
        run("./a.out", cwd=folder)


def mutants(text, start=0):
    """The text with one number 0.3 % off, for every number but zero."""
    for match in NUMBER.finditer(text, start):
        if float(match[1]):
            wrong = f"{float(match[1]) * 1.003!r}{match[2]}"
            yield match[0], text[: match.start()] + wrong + text[match.end() :]


def test_every_wrong_number_is_caught(exported):
    code, folder = exported
    name = code.name
    run("gcc", "-c", f"{name}_test.c", "-o", "test.o", cwd=folder)
    found = []
    for number, wrong in mutants(code.source):
        (folder / f"{name}.c").write_text(wrong)
        run("gcc", f"{name}.c", "test.o", "-lm", "-o", "mutant", cwd=folder)
        assert run("./mutant", cwd=folder, code=1), number
        found.append(number)
    assert len(found) >= 9
    (folder / f"{name}.c").write_text(code.source)
    (wrong_period,) = mutants(code.header, code.header.index("*/"))
    (folder / f"{name}.h").write_text(wrong_period[1])
    run("gcc", f"{name}.c", f"{name}_test.c", "-lm", "-o", "mutant", cwd=folder)
    assert run("./mutant", cwd=folder, code=1)


FORMULAS = (
    "0 x1*{z} sin({z})-0.5*x1**3 tanh({z}/0.1) atan2({z},1+x1**2) exp(-x1**2)*{z} log(1+{z}**2) "
    "sqrt(1+x1**2) abs({z}) sign({z}) min(x1,{z},0.5) max(-1,{z}) {z}*abs({z}) asin(0.3*sin(x1)) "
    "acos(0.5*cos({z})) sinh(x1)/cosh(x1) atan({z})**2 tan(0.5*sin(x1)) (1+{z}**2)**0.3 "
    "1/(2+cos({z}))**3 pi*x1 x1**9/(1+x1**8) (x1+{z})**2/3 (1+abs(x1))**1.5"
).split()


@st.composite
def implementations(draw, system):
    r = len(system.controller.states)
    velocity = tuple(name for name in system.plant.states[1:] if draw(st.integers(0, 3)) == 0)
    return Implementation(
        period=draw(st.sampled_from([1e-3, 1e-2, 2.5e-4])),
        saturation=draw(st.sampled_from([None, (-5, 5), (-100, 30)])),
        rate_limit=draw(st.sampled_from([None, 100.0])),
        velocity=velocity,
        velocity_filter=draw(st.sampled_from([0.0, 0.02])) if velocity else 0.0,
        update=draw(st.sampled_from(["euler", "exact_leak"])),
        anti_windup=draw(st.sampled_from(["hold", "none"])),
        projection=draw(st.sampled_from([None, ((-2, 3),) * r])) if r else None,
    )


@st.composite
def controllers(draw):
    system = draw(systems(orders=st.integers(1, 6)))
    last = system.plant.states[-1]
    formulas = st.sampled_from([text.format(z=last) for text in FORMULAS])
    plant = replace(
        system.plant,
        drift=f"{draw(formulas)} + {draw(numbers(0.1, 3))}*({draw(formulas)})",
        regressor=[draw(formulas) for _ in range(system.plant.r)],
    )
    system = system.replace(plant=plant)
    return system.replace(implementation=draw(implementations(system)))


def worst(library, code):
    """Largest deviation of compiled code over its scale, at thousands of points."""
    kind = np.dtype("float32" if code.real == "float" else "float64")
    vectors = golden(code.system, code.program, code.real, thin=False)
    step = getattr(library, f"{code.name}_step")
    step.argtypes = [ctypes.c_void_p] * 3
    step.restype = ctypes.c_float if code.real == "float" else ctypes.c_double
    found = np.empty_like(vectors.answers)
    for k in range(found.shape[1]):
        s, x, y = (
            np.ascontiguousarray(part[:, k], dtype=kind)
            for part in (vectors.states, vectors.x, vectors.Y)
        )
        s = np.append(s, kind.type(0))
        found[0, k] = step(s.ctypes.data, x.ctypes.data, y.ctypes.data)
        found[1:, k] = s[:-1]
    deviations = np.abs(found - vectors.answers) / vectors.scales
    assert np.isfinite(deviations).all()
    return deviations.max()


def agree(folder, drawn):
    codes = [
        c_code(system, f"c{i}_{real}", real=real)
        for i, system in enumerate(drawn)
        for real in ("double", "float")
    ]
    for code in codes:
        (folder / f"{code.name}.h").write_text(code.header)
        (folder / f"{code.name}.c").write_text(code.source)
    sources = [f"{code.name}.c" for code in codes]
    flags = [*STRICT, "-ffp-contract=off", "-shared", "-fPIC"]
    run("gcc", *flags, *sources, "-o", "all.so", "-lm", cwd=folder)
    library = ctypes.CDLL(str(folder / "all.so"))
    for code in codes:
        assert worst(library, code) <= TOLERANCE[code.real], code.source


def batches(examples):
    def decorate(test):
        several = st.lists(controllers(), min_size=4, max_size=4)
        return settings(max_examples=examples)(given(drawn=several)(test))

    return decorate


@batches(2)
def test_random_controllers_agree(tmp_path_factory, drawn):
    agree(tmp_path_factory.mktemp("c"), drawn)


@pytest.mark.slow
@batches(40)
def test_many_random_controllers_agree(tmp_path_factory, drawn):
    agree(tmp_path_factory.mktemp("c"), drawn)
