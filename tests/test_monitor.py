"""The monitor of exported controllers: every flag goes up and comes alone, in C, FMUs and ST."""

import ctypes
import io
import math
import re
import shutil
import subprocess
import zipfile
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from exported import PythonController, along_a_run, sampled
from extensions import dynamic_surface, prescribed_performance
from fmpy.validation import validate_fmu
from test_cli import invoke
from test_export_c import CLANG, CPPCHECK, STRICT, mutants
from test_export_fmu import VERSIONS, Imported
from test_export_st import FunctionBlock

import certrack
from certrack import Monitor
from certrack.core.compilers import c_compilers, load_library
from certrack.export.c.export import c_files, controller_files
from certrack.export.c.source import c_code
from certrack.export.fmu.archive import fmu
from certrack.export.golden_vectors import GOLDEN_TOLERANCE, golden_vectors
from certrack.export.monitor import default_parameters, rounded_to_type
from certrack.export.program import controller_program
from certrack.export.st.function_block import structured_text

needs_compiler = pytest.mark.skipif(not c_compilers(), reason="needs a C compiler")

#: All that a controller may have.
LIMITED = {
    "initial_input": 0.05,
    "saturation": (-5, 5),
    "rate_limit": 200.0,
    "velocity": ("x2",),
    "velocity_filter": 0.002,
    "update": "exact_leak",
    "projection": ((0.1, 2), (-5, 5)),
}
BOX = {"x1": (-0.02, 0.03), "x2": (-0.1, "1/5")}
FULL = LIMITED, Monitor(box=BOX, parameters=True)
FREE = {"velocity": ("x2",), "velocity_filter": 0.002}, Monitor(limit_reference=True)


class InC:
    """The exported C with its monitor, compiled."""

    real = "double"

    def __init__(self, system, monitor, folder=None, header=lambda text: text):
        self.code = code = c_code(system, "drive", real=self.real, monitor=monitor)
        files = controller_files(code)
        files["drive_monitor.h"] = header(files["drive_monitor.h"])
        self.flags = re.findall(r"bool (\w+);", files["drive_monitor.h"])
        listed = "".join(f"    l[{i}] = f->{name};\n" for i, name in enumerate(self.flags))
        files["bridge.c"] = (
            '#include "drive_monitor.h"\n'
            "static drive_monitor m;\n"
            "void *state(void) { return &m.state; }\n"
            "void start(void) { drive_monitor_init(&m); }\n"
            "void clear(void) { drive_clear_flags(&m); }\n"
            "void again(void) { drive_reset_estimates(&m); }\n"
            "int hold(void) { return drive_premises_hold(&m); }\n"
            "void flags(int latched, int *l)\n"
            f"{{\n    drive_flags *f = latched ? &m.latched : &m.now;\n{listed}}}\n"
            "double step(int on, const drive_real *x, const drive_real *y)\n"
            "{ return (double)drive_monitored_step(&m, on != 0, x, y); }\n"
        )
        if code.program.parameters:
            files["bridge.c"] += "void *parameters(void) { return &m.parameters; }\n"
        self.library = load_library(files, ["-std=c99", "-O2", "-shared", "-fPIC"])
        self.library.step.restype = ctypes.c_double
        self.number = {"double": ctypes.c_double, "float": ctypes.c_float}[self.real]
        self.library.start()

    def restart(self):
        self.library.start()

    def members(self, function):
        function.restype = ctypes.POINTER(self.number)
        return function()

    def step(self, x, y, enable=True):
        given = ((self.number * len(part))(*part) for part in (x, y))
        return self.library.step(int(enable), *given)

    def up(self, latched=False):
        listed = (ctypes.c_int * len(self.flags))()
        self.library.flags(int(latched), listed)
        return {name for name, value in zip(self.flags, listed, strict=True) if value}

    def hold(self):
        return bool(self.library.hold())

    def clear(self):
        self.library.clear()

    def reset_estimates(self):
        self.library.again()

    def place(self, state):
        return self.code.members.index(state)

    def get(self, state):
        return self.members(self.library.state)[self.place(state)]

    def set(self, state, value):
        self.members(self.library.state)[self.place(state)] = value

    def tune(self, parameter, factor):
        names = [self.code.names[c] for c in self.code.program.parameters]
        self.members(self.library.parameters)[names.index(parameter)] *= factor


class InFloat(InC):
    """The same with float."""

    real = "float"


class InFmu:
    """The controller as an FMU, imported by FMPy."""

    version = "2"

    def __init__(self, system, monitor, folder):
        self.names = system.plant.states
        path = folder / f"drive{self.version}.fmu"
        path.write_bytes(fmu(system, "drive", version=self.version, monitor=monitor))
        assert validate_fmu(str(path)) == []
        self.fmu, self.t, self.T = (
            Imported(str(path), self.version, folder),
            0.0,
            system.implementation.period,
        )
        self.flags = [n.removeprefix("now.") for n in self.fmu.references if n.startswith("now.")]

    def restart(self):
        self.fmu.fmu.reset()

    def step(self, x, y, enable=True):
        names = [*self.names, *("y_d" if not i else f"y_d_{i}" for i in range(len(y)))]
        values = dict(zip(names, map(float, (*x, *y)), strict=True))
        self.fmu.set(values | {"monitor.enable": float(enable)})
        u = self.fmu.step(self.t, self.T)
        self.t += self.T
        self.fmu.set({"monitor.clear_flags": 0.0, "monitor.reset_estimates": 0.0})
        return u

    def up(self, latched=False):
        group = "latched" if latched else "now"
        found = self.fmu.get(*(f"{group}.{name}" for name in self.flags))
        assert set(found) <= {0.0, 1.0}
        return {name for name, value in zip(self.flags, found, strict=True) if value}

    def hold(self):
        return self.fmu.get("monitor.premises_hold") == [1.0]

    def clear(self):
        self.fmu.set({"monitor.clear_flags": 1.0})

    def reset_estimates(self):
        self.fmu.set({"monitor.reset_estimates": 1.0})

    def get(self, state):
        return self.fmu.get(f"kept.{state}")[0]

    def set(self, state, value):
        self.fmu.set({f"kept.{state}": value})

    def tune(self, parameter, factor):
        name = f"parameters.{parameter}"
        self.fmu.set({name: self.fmu.get(name)[0] * factor})


class InFmu3(InFmu):
    """The same with FMI 3."""

    version = "3"


class InSt:
    """The function block, executed statement by statement."""

    def __init__(self, system, monitor, folder=None, text=lambda text: text):
        self.text = text(structured_text(system, "drive", monitor=monitor))
        self.restart()

    def restart(self):
        self.block = FunctionBlock(self.text)
        assert not self.block.tree.root_node.has_error
        self.pulses = {"RESET": False, "RESET_ESTIMATES": False, "CLEAR_FLAGS": False}
        self.parameters = [
            self.block.values[name]
            for name in self.block.sections["VAR_INPUT"]
            if self.block.types[name] == "LREAL" and self.block.values[name] is not None
        ]
        outputs = self.block.sections["VAR_OUTPUT"][2:]
        self.flags = outputs[::2]
        assert outputs[1::2] == [f"{name}_LATCHED" for name in self.flags]
        assert self.hold()  # before the first call

    def step(self, x, y, enable=True):
        block = self.block
        for name in block.sections["VAR_TEMP"]:
            block.values[name] = None
        given = [*map(float, (*x, *y)), *self.parameters, enable, *self.pulses.values()]
        block.values |= dict(zip(block.sections["VAR_INPUT"], given, strict=True))
        block.run(block.block.children)
        self.pulses = dict.fromkeys(self.pulses, False)
        return block.values["U"]

    def up(self, latched=False):
        end = "_LATCHED" * latched
        return {name.lower() for name in self.flags if self.block.values[name + end]}

    def hold(self):
        return self.block.values["PREMISES_HOLD"]

    def clear(self):
        self.pulses["CLEAR_FLAGS"] = True

    def reset_estimates(self):
        self.pulses["RESET_ESTIMATES"] = True

    def get(self, state):
        return self.block.values[state.upper()]

    def set(self, state, value):
        self.block.values[state.upper()] = value

    def tune(self, parameter, factor):
        names = [
            name for name in self.block.sections["VAR_INPUT"] if self.block.types[name] == "LREAL"
        ][-len(self.parameters) :]
        self.parameters[names.index(parameter.upper())] *= factor


DRIVES = [
    pytest.param(InC, marks=needs_compiler),
    pytest.param(InFloat, marks=needs_compiler),
    pytest.param(InFmu, marks=needs_compiler),
    pytest.param(InFmu3, marks=needs_compiler),
    InSt,
]
REST = [0.0, 0.0], [0.0, 0.0]


# What trips each flag of example1 with all limits, and no other one: a sample after rest.


def beyond(drive, limit):
    """The next number of the type away from zero."""
    real = getattr(drive, "real", "double")
    kind = {"double": np.float64, "float": np.float32}[real]
    near = kind(rounded_to_type(abs(limit), real, up=True))
    return math.copysign(float(np.nextafter(near, kind(np.inf))), limit)


def reference(drive, sign, order):
    y = [0.0, 0.0]
    y[order] = sign * 0.2
    drive.step([0.0, 99.0], [y[0] * 0.999, y[1] * 0.999])
    assert drive.up() == set()
    y[order] = beyond(drive, y[order])
    drive.step([0.0, 99.0], y)


def position(drive, sign):
    """From the first sample on: there is no difference to be taken yet."""
    limit = {1: 0.03, -1: -0.02}[sign]
    drive.step([limit * 0.9999, 0.0], REST[1])
    assert drive.up() == set()
    for _ in range(3):
        drive.step([beyond(drive, limit), 0.0], REST[1])


def speed(drive, sign):
    """x2 = (x1' + 3 x1)/2 is not measured; what the sensor says of it is not read."""
    for k in range(12):
        drive.step([sign * 0.0005 * k, 0.0], REST[1])


def saturation(drive, sign):
    """u = delta_hat ubar with ubar = -theta_hat at rest: slowly, below the limit of the rate."""
    for k in range(1, 60):
        drive.set("delta_hat", 2.0)
        drive.set("theta_hat_1", -sign * 0.0437 * k)
        u = drive.step(*REST)
        if abs(u) == 5:
            break
        assert drive.up() == set()
    assert u == sign * 5


def rate(drive, sign):
    drive.set("delta_hat", 2.0)
    drive.set("theta_hat_1", -sign * 0.5)
    assert drive.step(*REST) == pytest.approx(0.05 + sign * 0.2)


def bad_input(drive, sign):
    drive.step([sign * math.inf, 0.0], REST[1])


def bad_number(drive, sign):
    drive.step(REST[0], [0.0, math.nan])


def parameter(drive, sign):
    drive.tune("leak_gain", 1 + sign * 1e-6)
    drive.step(*REST)


def coefficient(drive, sign):
    drive.tune("nu_x_2", 1 + sign * 1e-6)
    drive.step(*REST)


TRIPS = {
    "y_d_exceeded": [lambda drive, sign: reference(drive, sign, 0)],
    "y_d_1_exceeded": [lambda drive, sign: reference(drive, sign, 1)],
    "x1_outside": [position],
    "x2_outside": [speed],
    "saturated": [saturation],
    "rate_limited": [rate],
    "held": [bad_input, bad_number],
    "parameters_changed": [parameter, coefficient],
}


def check_flag(drive, flag):
    """The flag goes up and comes alone, on both sides; it is latched until it is cleared."""
    for trip in TRIPS[flag]:
        for sign in (1, -1):
            drive.restart()
            assert (drive.up(), drive.up(latched=True), drive.hold()) == (set(), set(), True)
            trip(drive, sign)
            assert (drive.up(), drive.up(latched=True)) == ({flag}, {flag})
            assert not drive.hold()
            if flag in ("parameters_changed", "saturated", "rate_limited"):
                continue  # still so at the next sample
            for _ in range(40):  # until the differences are gone
                drive.step(*REST)
            assert drive.up() == set()
            assert flag in drive.up(latched=True)
            drive.clear()
            drive.step(*REST)
            assert (drive.up(latched=True), drive.hold()) == (set(), True)


@pytest.fixture(params=DRIVES, scope="module")
def drives(request, tmp_path_factory):
    """A drive with all limits and one without any; built once."""
    made = [
        request.param(sampled("example1", **options), monitor, tmp_path_factory.mktemp("drive"))
        for options, monitor in (FULL, FREE)
    ]
    return dict(zip(("full", "free"), made, strict=True))


@pytest.fixture
def full(drives):
    drives["full"].restart()
    return drives["full"]


@pytest.fixture
def free(drives):
    drives["free"].restart()
    return drives["free"]


def test_every_flag_goes_up_alone(full):
    assert {name.lower() for name in full.flags} == set(TRIPS)
    for flag in TRIPS:
        check_flag(full, flag)


# Enable, disable, reset.


def moving(k):
    """A sample of an axis that turns on its own at x2 = 0.1: x1' = 2 x2 - 3 x1."""
    x1 = 0.2 / 3 * (1 - math.exp(-0.003 * k))
    return [x1, 0.1], [x1, 2 * 0.1 - 3 * x1]


def test_disabled_means_no_command_and_no_learning(full):
    full.set("delta_hat", 0.7)
    full.set("theta_hat_1", 1.5)
    y = [0.3, 0.0]
    for k in range(30):
        x, _ = moving(k)
        assert full.step(x, y, enable=False) == pytest.approx(0.05, rel=1e-7)
        wanted = {"delta_hat": 0.7, "theta_hat_1": 1.5, "u_last": 0.05, "before_x2": x[0]}
        for state, value in wanted.items():
            assert full.get(state) == pytest.approx(value, rel=1e-6)
    assert "y_d_exceeded" in full.up()
    assert (full.up(latched=True), full.hold()) == (set(), True)
    u = full.step(moving(30)[0], y)
    assert 0 < abs(u - 0.05) <= 0.2 * (1 + 1e-6)  # on from there, within the limit of the rate
    assert full.get("delta_hat") != pytest.approx(0.7, rel=1e-6)
    assert "y_d_exceeded" in full.up(latched=True)
    full.reset_estimates()
    before = full.get("speed_x2")
    full.step(moving(31)[0], y)
    assert full.get("delta_hat") == pytest.approx(0.1, rel=1e-6)  # from 0, into its projection
    assert abs(full.get("theta_hat_1")) < 0.01
    assert full.get("speed_x2") == pytest.approx(before, rel=0.01)  # differences go on


def test_the_speed_is_there_when_the_axis_is_enabled(free):
    """Enabled in motion, the first command is that of a drive with a sensor of the speed."""
    free.set("delta_hat", 1.0)
    for k in range(40):
        free.step(*moving(k), enable=False)
    measured = PythonController(sampled("example1"))
    measured.state = np.array([1.0, 0.0])
    u, first = measured.step(*moving(40)), free.step(*moving(40))
    assert first == pytest.approx(u, abs=0.005)
    free.restart()
    free.set("delta_hat", 1.0)
    assert abs(free.step(*moving(40)) - u) > 0.1  # else it has a difference of 0 to begin with


def test_held_while_disabled(full):
    full.step(*REST, enable=False)
    kept = [full.get(state) for state in ("delta_hat", "before_x2", "speed_x2")]
    assert full.step([math.nan, 0.0], REST[1], enable=False) == pytest.approx(0.05)
    assert (full.up(), full.hold()) == ({"held"}, True)
    assert [full.get(state) for state in ("delta_hat", "before_x2", "speed_x2")] == kept


@pytest.mark.parametrize("drive", [pytest.param(InC, marks=needs_compiler), InSt])
def test_filters_go_on_and_time_begins_anew(drive):
    """A law's own filter follows while it is disabled; a funnel opens when it is enabled."""
    surface = dynamic_surface(implementation=certrack.Implementation(period=1e-3))
    own = drive(surface, Monitor())
    start = own.get("alpha_filter")
    for _ in range(20):
        own.step([1.0, 0.0], REST[1], enable=False)
    assert own.get("alpha_filter") != start
    kept = own.get("alpha_filter")
    own.reset_estimates()
    own.step([1.0, 0.0], REST[1])
    assert own.get("alpha_filter") == pytest.approx(kept, rel=0.1)  # it is no estimate
    funnel = prescribed_performance(implementation=certrack.Implementation(period=1e-3))
    own = drive(funnel, Monitor())
    for _ in range(20):
        own.step([0.1, 0.0], REST[1], enable=False)
        assert own.get("sample") == 0
    own.step([0.1, 0.0], REST[1])
    own.step([0.1, 0.0], REST[1])
    assert own.get("sample") == 2


# The limiter, the parameters, the golden vectors.


def test_the_limiter_lets_nothing_beyond_the_bounds_through(free):
    ours = PythonController(sampled("example1", **FREE[0]))
    for y, followed in (
        ([0.1, -0.15], [0.1, -0.15]),
        ([0.3, 0.1], [0.2, 0.1]),
        ([-7.0, 1e9], [-0.2, 0.2]),
        ([-0.2, -0.2000001], [-0.2, -0.2]),
    ):
        free.restart()
        free.set("delta_hat", 1.0)
        ours.state = np.array([1.0, *ours.start[1:]])
        u = free.step([0.1, 0.2], y)
        assert u == pytest.approx(ours.step([0.1, 0.2], followed), rel=2e-6)
        names = ["y_d_exceeded", "y_d_1_exceeded"]
        beyond = {name for name, a, b in zip(names, y, followed, strict=True) if a != b}
        assert free.up() == beyond
    assert free.step([0.1, 0.2], [math.inf, 0.0]) == u  # not finite: held, not limited
    assert free.up() == {"held"}


def test_golden_vectors_with_the_monitor(full):
    system = sampled("example1", **LIMITED)
    real, program = getattr(full, "real", "double"), controller_program(system)
    vectors = golden_vectors(system, program, real)
    names = [program.labels[state] for state in program.states]
    for k in range(vectors.x.shape[1]):
        for name, value in zip(names, vectors.states[:, k], strict=True):
            full.set(name, float(value))
        u = full.step(vectors.x[:, k], vectors.Y[:, k])
        got = np.array([u, *map(full.get, names)])
        deviation = np.abs(got - vectors.answers[:, k]) / vectors.scales[:, k]
        assert deviation.max() <= GOLDEN_TOLERANCE[real]


@pytest.mark.parametrize("options", [{}, LIMITED], ids=["plain", "limited"])
@pytest.mark.parametrize("drive", [pytest.param(InC, marks=needs_compiler), InSt])
def test_the_parameters_of_another_design_make_its_controller(drive, options):
    system = sampled("example1", **options)
    other = system.replace(law=replace(system.law, c=(2.5, 1.5), leak_gain=0.9))
    running = drive(system, Monitor(parameters=True))
    ours, theirs = default_parameters(system), default_parameters(other)
    assert ours.keys() == theirs.keys() and ours != theirs
    for name, value in theirs.items():
        running.tune(name, value / ours[name])
    wanted = PythonController(other)
    xs, ys = along_a_run(system)
    for x, y in zip(xs[:200], ys[:200], strict=True):
        assert running.step(x, y) == pytest.approx(wanted.step(x, y), rel=1e-9, abs=1e-9)
        assert "parameters_changed" in running.up(latched=True)


@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("name", ["example1", "dual-motor", "dual-motor-lean", "axis"])
def test_the_reference_of_the_file_trips_nothing(name, real):
    """Its values in the numbers of the type, at the samples of a long run."""
    system = sampled(name, duration=20.0)
    code = c_code(system, real=real, monitor=Monitor())
    t = np.arange(0, 20.0, 0.001)
    values = system.reference.values(t, len(code.program.Y) - 1)
    bounds = np.array(code.monitor.reference_bounds)
    kind = np.float32 if real == "float" else np.float64
    assert (np.abs(values.astype(kind)).max(axis=1) <= bounds).all()
    exact = np.array(system.reference.bounds(len(bounds) - 1).values)
    assert (bounds >= exact).all() and (bounds <= exact * (1 + 3e-7)).all()


# Mutants: what is wrong with a monitor must be seen by its acceptance test, and by ours.

#: Wrong monitors in C: (what stands there, what stands there instead).
WRONG = {
    "no abs": ("within(y_d[0], -0.2,", "within(y_d[0], -1e30,"),
    "no upper bound": ("within(y_d[1], -0.2, 0.2)", "within(y_d[1], -0.2, 1e30)"),
    "wrong sign": ("!drive_within(y_d[0]", "drive_within(y_d[0]"),
    "wrong sign of a bound": ("within(y_d[0], -0.2,", "within(y_d[0], 0.2,"),
    "another derivative": ("within(y_d[1],", "within(y_d[0],"),
    "bound excluded": ("return (value >= low) &&", "return (value > low) &&"),
    "limit of u included": (
        "return (value > low) && (value < high)",
        "return (value >= low) && (value <= high)",
    ),
    "one side of u": ("inside(u, -5.0,", "inside(u, -5e30,"),
    "one side of the rate": ("m->u - 0.2,", "m->u - 1e30,"),
    "box upside down": ("!drive_within(x[0]", "drive_within(x[0]"),
    "the sensor that is not read": ("within((1.5 * x[0]) + (0.5 * next.speed_x2)", "within(x[1]"),
    "the difference before": ("0.5 * next.speed_x2", "0.5 * m->state.speed_x2"),
    "u judged while disabled": ("rate_limited = enable && !", "rate_limited = !"),
    "latched while disabled": ("    if (enable) {", "    if (true) {"),
    "not latched": (
        "m->latched.x1_outside = m->latched.x1_outside || m",
        "m->latched.x1_outside = m->latched.x1_outside && m",
    ),
    "one flag less": ("|| m->latched.saturated", "|| false"),
    "flags not cleared": ("drive_lower_flags(&m->latched);\n}\n\n/* Whether", "}\n\n/* Whether"),
    "learning while disabled": ("next.theta_hat_1 = m->state.theta_hat_1;", ""),
    "command while disabled": ("        u = off;\n", ""),
    "the last command forgotten": ("    m->u = u;\n", ""),
    "the next state forgotten": ("    m->state = next;\n", ""),
    "reset of one estimate": ("    m->state.theta_hat_1 = 0.0;\n", ""),
    "a parameter not looked at": ("drive_within(m->parameters.theta0, 2.1, 2.1)", "true"),
    "a bad input limited": ("if (drive_valid(x, y_d)) {", "if (true) {"),
    "limited on one side": ("(value < -bound) ? -bound : value", "value"),
}


class Acceptance:
    """The acceptance test of a monitored controller, for one header or another."""

    def __init__(self, folder, system, monitor):
        self.folder, self.files = folder, c_files(c_code(system, "drive", monitor=monitor))
        for name, text in self.files.items():
            (folder / name).write_text(text)
        self.run("gcc", "-c", "drive.c", "-o", "drive.o")

    def run(self, *command):
        return subprocess.run(command, cwd=self.folder, capture_output=True, text=True, check=False)

    def passes(self, header):
        (self.folder / "drive_monitor.h").write_text(header)
        built = self.run("gcc", "drive_test.c", "drive.o", "-lm", "-o", "accept")
        assert built.returncode == 0, built.stderr
        return self.run("./accept").returncode == 0


@needs_compiler
@pytest.mark.parametrize(
    "some",
    [
        pytest.param(["no abs", "wrong sign", "command while disabled"], id="some"),
        pytest.param(list(WRONG), id="all", marks=pytest.mark.slow),
    ],
)
def test_the_acceptance_test_sees_what_is_wrong(tmp_path, some):
    system = sampled("example1", **LIMITED)
    monitor = Monitor(box=BOX, parameters=True, limit_reference=True)
    acceptance = Acceptance(tmp_path, system, monitor)
    header = acceptance.files["drive_monitor.h"]
    assert acceptance.passes(header)
    for what in some:
        old, new = WRONG[what]
        assert header.count(old) >= 1, what
        assert not acceptance.passes(header.replace(old, new)), what


@needs_compiler
@pytest.mark.slow
def test_the_acceptance_test_sees_every_wrong_number(tmp_path):
    system = sampled("example1", **LIMITED)
    monitor = Monitor(box=BOX, parameters=True, limit_reference=True)
    acceptance = Acceptance(tmp_path, system, monitor)
    header, found = re.sub(r"/\*.*?\*/", "", acceptance.files["drive_monitor.h"], flags=re.S), 0
    for number, wrong in mutants(header, header.index("void drive_clear_flags")):
        assert not acceptance.passes(wrong), number
        found += 1
    assert found > 40


#: Wrong monitors in Structured Text, and the flags whose tests must see them.
WRONG_ST = {
    "no abs": ("(y_d >= -0.2)", "(y_d >= -1.0E30)", "y_d_exceeded"),
    "wrong sign": ("(y_d_1 <= 0.2)", "(y_d_1 >= 0.2)", "y_d_1_exceeded"),
    "one side of u": ("(u > -5.0)", "(u > -5.0E30)", "saturated"),
    "one side of the rate": ("(u < saved_u + 0.2)", "(u < saved_u + 2.0E30)", "rate_limited"),
    "the sensor that is not read": ("0.5 * speed_x2 + 1.5 * x1", "x2", "x2_outside"),
    "a parameter not looked at": (
        "(nu_x_2 >= -5.265625)",
        "(nu_x_2 >= -9.0)",
        "parameters_changed",
    ),
    "not latched": ("(ENABLE AND x1_outside) OR", "(ENABLE AND x1_outside) AND", "x1_outside"),
    "for ever": ("AND NOT CLEAR_FLAGS", "AND TRUE", "x1_outside"),
    "not held": ("held := TRUE", "held := FALSE", "held"),
}


@pytest.mark.parametrize("what", WRONG_ST)
def test_our_tests_see_what_is_wrong_in_structured_text(what):
    old, new, flag = WRONG_ST[what]
    options, monitor = FULL

    def mutated(text):
        assert old in text
        return text.replace(old, new)

    drive = InSt(sampled("example1", **options), monitor, text=mutated)
    with pytest.raises(AssertionError):
        check_flag(drive, flag)


# Clean, and the same bytes as ever without a monitor.

VARIANTS = [
    pytest.param(
        "example1", LIMITED, Monitor(box=BOX, parameters=True), id="full", marks=pytest.mark.slow
    ),
    pytest.param("dual-motor-lean", {}, Monitor(limit_reference=True), id="lean"),
    pytest.param("example1", {}, Monitor(), id="plain", marks=pytest.mark.slow),
    pytest.param("dual-motor", {}, Monitor(parameters=True), id="dual", marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("name", "options", "monitor"), VARIANTS)
@pytest.mark.parametrize("real", [pytest.param("double", marks=pytest.mark.slow), "float"])
def test_strict_compilers_and_misra(tmp_path, name, options, monitor, real):
    code = c_code(sampled(name, **options), "drive", real=real, monitor=monitor)
    for file, text in c_files(code).items():
        (tmp_path / file).write_text(text)
    (tmp_path / "use.c").write_text('#include "drive_monitor.h"\n')
    sources = ["drive.c", "drive_test.c"]
    checks = [
        ["gcc", *STRICT, *sources, "-lm"],
        ["./a.out"],
        ["clang", *CLANG, *sources, "-lm"],
        ["./a.out"],
        ["cppcheck", *CPPCHECK, "drive.c", "use.c"],
    ]
    for command in checks:
        if command[0] != "./a.out" and shutil.which(command[0]) is None:
            pytest.skip(f"NOT TESTED: {command[0]} is not installed (see .ci/run)")
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
    if real == "float":
        header = code.header[code.header.index("*/") :]
        assert "double" not in header + code.source + c_files(code)["drive_monitor.h"]


@needs_compiler
@pytest.mark.parametrize("version", VERSIONS)
def test_the_wrapper_of_a_monitor_compiles_without_a_warning(version, tmp_path):
    options, monitor = FULL
    data = fmu(sampled("example1", **options), "drive", version=version, monitor=monitor)
    assert data == fmu(sampled("example1", **options), "drive", version=version, monitor=monitor)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        archive.extractall(tmp_path)
    strict = "-std=c99 -Wall -Wextra -Wpedantic -Wshadow -Werror -Wno-unused-parameter".split()
    command = ["gcc", *strict, "-c", f"fmi{version}.c", "-o", "wrapper.o"]
    done = subprocess.run(
        command, cwd=tmp_path / "sources", capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_without_a_monitor_nothing_of_it():
    code = c_code(sampled("example1"), "drive")
    files = c_files(code)
    assert "drive_monitor.h" not in files
    assert not any("monitor" in text or "parameters" in text for text in files.values())


@needs_compiler
def test_names_that_are_taken(tmp_path):
    """A state may be called like a flag, an input or a local variable."""
    system = sampled("example1", duration=0.1)
    plant = replace(
        system.plant,
        states=("saturated", "held"),
        drift="saturated*held",
        regressor=["1 + saturated"],
    )
    strange = system.replace(plant=plant, truth=certrack.Truth(2.0, [2.0]))
    monitor = Monitor(box={"held": (-1, 1), "saturated": (-1, 1)}, parameters=True)
    assert Acceptance(tmp_path, strange, monitor).passes(
        c_files(c_code(strange, "drive", monitor=monitor))["drive_monitor.h"]
    )
    path = tmp_path / "drive.fmu"
    path.write_bytes(fmu(strange, "drive", monitor=monitor))
    assert validate_fmu(str(path)) == []
    block = FunctionBlock(structured_text(strange, "drive", monitor=monitor))
    assert not block.tree.root_node.has_error


# What does not fit is refused.


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--box", "x1", "-1", "1"], "--box: goes with --monitor. Add --monitor"),
        (["--parameters"], "--parameters: goes with --monitor"),
        (["--limit-reference"], "--limit-reference: goes with --monitor"),
        (
            ["--monitor", "--box", "x_1", "-1", "1"],
            "--box x_1: is no state of the plant. Did you mean x1?",
        ),
        (["--monitor", "--box", "x1", "1", "-1"], "--box x1: low must be less than high"),
        (["--monitor", "--box", "x1", "1/3", "1/3"], "--box x1: low must be less than high"),
        (["--monitor", "--box", "x1", "low", "1"], "--box x1[0]: unknown name 'low'"),
        (["--monitor", "--box", "x1", "0", "nan"], "--box x1[1]: "),
        (
            ["--monitor", "--box", "x1", "0", "1", "--box", "x1", "0", "2"],
            "--box x1: names must be different",
        ),
        (["--monitor", "--box", "x1", "1"], "requires 3 arguments"),
    ],
)
@pytest.mark.parametrize("verb", ["c", "st", "fmu"])
def test_wrong_options_are_one_line(capfd, tmp_path, verb, arguments, message):
    out = tmp_path / {"c": "folder", "st": "a.st", "fmu": "a.fmu"}[verb]
    ask = ("export", verb, "example1", "--period", "0.001", "--out", str(out))
    code, _, err = invoke(capfd, *ask, *arguments)
    assert (code, err.count("\n")) == (2, 1)
    assert message in err
    assert list(tmp_path.iterdir()) == []


def test_wrong_monitors_in_python():
    for wrong, message in (
        ({"box": {"x1": 3}}, r"monitor.box.x1: must be a list of 2"),
        ({"box": "x1"}, r"monitor.box: must be a"),
        ({"limit_reference": 1}, r"monitor.limit_reference: must be True or False"),
        ({"parameters": None}, r"monitor.parameters: must be True or False"),
    ):
        with pytest.raises(certrack.InputError, match=message):
            Monitor(**wrong)
    for wrong in (True, {"x1": (-1, 1)}):
        for export in (c_code, structured_text, fmu):
            with pytest.raises(certrack.InputError, match=r"monitor: must be a Monitor; got .*"):
                export(sampled("example1"), monitor=wrong)
    with pytest.raises(certrack.InputError, match="float cannot hold the number 1e"):
        c_code(sampled("example1"), real="float", monitor=Monitor(box={"x1": (0, 1e200)}))


def test_bounds_are_rounded_to_the_safe_side():
    third = Monitor(box={"x1": ("-1/3", "1/3")})
    for real in ("double", "float"):
        code = c_code(sampled("example1"), real=real, monitor=third)
        (flag,) = (flag for flag in code.monitor.flags if flag.name == "x1_outside")
        low, high = flag.premises[0].low, flag.premises[0].high
        assert float(low) == -float(high)
        assert 3 * exactly(high) <= 1 < 3 * exactly(high) * (1 + 2**-22)


def exactly(number):
    """What a number of a formula is, exactly."""
    return Fraction(float(number))
