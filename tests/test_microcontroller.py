"""The exported C on a microcontroller: a Cortex-M4F, emulated instruction by instruction."""

import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from test_export_c import fully_implemented

import certrack
from certrack.export.c.export import c_files
from certrack.export.c.source import c_code
from certrack.export.program import sampled_system
from certrack.laws.observer import Observer

FIRMWARE = Path(__file__).parent / "firmware"
PAGE = Path(__file__).parents[1] / "docs" / "deployment.md"
MISSING = [tool for tool in ("arm-none-eabi-gcc", "qemu-system-arm") if shutil.which(tool) is None]

pytestmark = pytest.mark.skipif(
    bool(MISSING),
    reason=f"NOT TESTED on the microcontroller: no {', '.join(MISSING)} (see .ci/run)",
)

COMPILER = (
    "arm-none-eabi-gcc -mcpu=cortex-m4 -mthumb -mfloat-abi=hard -mfpu=fpv4-sp-d16 -std=c99 -O2 "
    "-Wall -Wextra -Wdouble-promotion -Werror"
).split()
LINKED = ["--specs=rdimon.specs", "-nostartfiles", "-T", str(FIRMWARE / "mps2.ld")]
EMULATOR = (
    "qemu-system-arm -M mps2-an386 -nographic -monitor none -serial none "
    "-semihosting-config enable=on,target=native -icount shift=0 -kernel"
).split()

VARIANTS = [
    pytest.param((name, real), id=f"{name}-{real}", marks=pytest.mark.slow if slow else ())
    for name, slow in {
        "example1": False,
        "example1 (limits, filter)": False,
        "example1 (limits, filter, monitor)": True,
        "dual-motor-lean": False,
        "dual-motor-lean (monitor)": False,
        "dual-motor-lean (monitor, limiter, parameters)": True,
        "dual-motor-observer": False,
        "dual-motor-observer (kalman)": True,
        "dual-motor-observer (dob, filter)": True,
        "dual-motor-observer (integral, filter)": True,
    }.items()
    for real in ("float", "double")
]


def run(*command, cwd):
    done = subprocess.run(
        command, cwd=cwd, capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr  # semihosting writes to either


def emulate(folder, *sources):
    start = FIRMWARE / "startup.c"
    run(*COMPILER, *LINKED, "-I.", *sources, str(start), "-lm", "-o", "firmware.elf", cwd=folder)
    return run(*EMULATOR, "firmware.elf", cwd=folder)


def monitor_of(name, system):
    """The monitor that a row of the table speaks of, if it does."""
    if "monitor" not in name:
        return None
    more = {"limit_reference": True, "parameters": True} if "parameters" in name else {}
    return certrack.Monitor(box=dict.fromkeys(system.plant.states, (-1, 1)), **more)


def with_other_estimates(system, name):
    """The system with the observer, or the integral action, that a row of the table speaks of."""
    law, drive = system.law, system.implementation
    if "filter" in name and "limits" not in name:
        drive = replace(drive, velocity_filter=0.002)
    if "kalman" in name:
        law = replace(law, observer=Observer(kind="kalman", bandwidth=200.0))
    elif "dob" in name:
        law = replace(law, observer=Observer(kind="dob", bandwidth=40.0))
    elif "integral" in name:
        law = replace(law, observer=None, integral=6.0)
    return system.replace(law=law, implementation=drive)


@pytest.fixture(params=VARIANTS)
def firmware(request, tmp_path):
    name, real = request.param
    plain = certrack.load(name.split()[0])
    system = fully_implemented(plain) if "limits" in name else sampled_system(plain, 0.001)
    system = with_other_estimates(system, name)
    code = c_code(system, "controller", real=real, monitor=monitor_of(name, plain))
    for file, text in c_files(code).items():
        (tmp_path / file).write_text(text)
    return name, code, tmp_path


def documented():
    """Rows of the page's table, by controller and numbers."""
    rows = re.findall(r"^\| (\S.*?) \| (float|double) \| (.*) \|$", PAGE.read_text(), re.M)
    return {(name, real): [int(v) for v in rest.split(" | ")] for name, real, rest in rows}


def test_answers_are_right_and_costs_are_as_documented(firmware, record_property):
    name, code, folder = firmware
    said = emulate(folder, "controller.c", "controller_test.c")
    assert "passed" in said
    defined, sources = ["-DCONTROLLER=controller", "-I."], ["controller.c"]
    if code.monitor:
        defined, sources = [*defined, "-DMONITORED"], [*sources, str(FIRMWARE / "monitored.c")]
    measured = emulate(folder, *defined, *sources, str(FIRMWARE / "measure.c"))
    instructions, state, stack = map(int, measured.split())
    run(*COMPILER, *defined, "-c", "-fstack-usage", *sources, cwd=folder)
    objects = [Path(source).with_suffix(".o").name for source in sources]
    sizes = run("arm-none-eabi-size", *objects, cwd=folder).splitlines()[1:]
    size = sum(int(line.split()[0]) for line in sizes)
    usage = [(folder / o).with_suffix(".su").read_text().splitlines() for o in objects]
    frames = [int(line.split()[-2]) for lines in usage for line in lines]
    stack = max(stack, *frames)  # the last words of a frame may be reserved and never written
    row = [instructions, size, state, stack]
    worst = re.search(r"worst deviation (\S+)", said)[1]
    record_property("microcontroller", f"| {name} | {code.real} | {' | '.join(map(str, row))} |")
    record_property("microcontroller_worst", f"{name}, {code.real}: worst deviation {worst}")
    wanted = documented()[name, code.real]
    assert row == [pytest.approx(value, rel=0.2, abs=16) for value in wanted]


def test_float_code_calls_no_double_arithmetic(firmware):
    _, code, folder = firmware
    run(*COMPILER, "-c", "controller.c", cwd=folder)
    called = run("arm-none-eabi-nm", "-u", "controller.o", cwd=folder).split()[1::2]
    assert any(name.startswith("__aeabi_d") for name in called) == (code.real == "double")
