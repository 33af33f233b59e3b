"""FMUs: valid, reproducible, and in closed loop equal to our own run, with two importers."""

import ctypes
import ctypes.util
import io
import re
import shutil
import subprocess
import sys
import zipfile

import fmpy
import numpy as np
import pytest
from exported import EVERYTHING, PythonController, along_a_run, sampled
from fmpy.fmi2 import FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu
from test_cli import invoke, result

import certrack
from certrack.core.compilers import c_compilers
from certrack.export.c.source import c_code
from certrack.export.fmu.archive import fmu
from certrack.export.fmu.description import variables

VERSIONS = ("2", "3")

pytestmark = pytest.mark.skipif(not c_compilers(), reason="FMUs need a C compiler")

HAS_ECOS = sys.platform == "linux" and ctypes.util.find_library("tbb") is not None
NO_ECOS = "ecospy, the second importer, needs the system's libtbb (apt install libtbb12)"


@pytest.fixture(params=VERSIONS)
def version(request):
    return request.param


def written(system, version, folder, name="example1"):
    path = folder / f"{name}.fmu"
    path.write_bytes(fmu(system, name, version=version))
    return str(path)


class Imported:
    """An FMU in FMPy, ready to step."""

    def __init__(self, path, version, folder):
        self.description = fmpy.read_model_description(path)
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}
        self.messages, self.version = [], version
        made = {"2": FMU2Slave, "3": FMU3Slave}[version]
        self.fmu = made(
            unzipDirectory=fmpy.extract(path, str(folder / f"unzipped-{version}")),
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName="controller",
            guid=self.description.guid or self.description.instantiationToken,
        )
        if version == "2":
            callbacks = fmi2CallbackFunctions(logger=fmi2CallbackLoggerTYPE(self.log))
            self.fmu.instantiate(callbacks=callbacks)
            self.fmu.setupExperiment(startTime=0.0)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.instantiate(logMessage=self.log)
            self.fmu.enterInitializationMode(startTime=0.0)
        self.fmu.exitInitializationMode()

    def log(self, *arguments):
        self.messages.append(arguments[-1].decode())

    def get(self, *names):
        get = self.fmu.getReal if self.version == "2" else self.fmu.getFloat64
        return list(get([self.references[name] for name in names]))

    def set(self, values):
        put = self.fmu.setReal if self.version == "2" else self.fmu.setFloat64
        put([self.references[name] for name in values], list(values.values()))

    def step(self, t, h):
        self.fmu.doStep(currentCommunicationPoint=t, communicationStepSize=h)
        return self.get("u")[0]

    def close(self):
        self.fmu.terminate()
        self.fmu.freeInstance()


def inputs(system, x, Y):
    names = [*system.plant.states, "y_d", *(f"y_d_{i}" for i in range(1, len(Y)))]
    return dict(zip(names, map(float, (*x, *Y)), strict=True))


@pytest.mark.parametrize(
    ("name", "implementation"),
    [
        ("example1", {}),
        ("example1", EVERYTHING),
        ("dual-motor-lean", {}),
        ("dual-motor-lean", {"delay": 0.5, "saturation": (-10, 10)}),
    ],
)
def test_closed_loop_reproduces_the_run(name, implementation, version, tmp_path):
    """The plant of the python-control bridge and the FMU, step by step."""
    system = sampled(name, **implementation).with_settings(tolerance=1e-12)
    blocks, T = certrack.to_control(system), system.implementation.period
    controller = Imported(written(system, version, tmp_path, name), version, tmp_path)
    run = certrack.simulate(system)
    n = system.plant.n
    state, times = blocks.X0[: blocks.plant.nstates], T * np.arange(900)
    expected = run.trajectory.interpolate(times)[:n].T
    acting = run.input_of(times + (system.implementation.delay + 0.25) * T, None)
    for t, x, u_run in zip(times, expected, acting, strict=True):
        measured = blocks.plant.output(t, state, [0])
        assert state[:n] == pytest.approx(x, rel=1e-12, abs=1e-12)
        controller.set(inputs(system, measured, blocks.reference.output(t, [], [])))
        u = controller.step(t, T)
        assert u == pytest.approx(u_run, rel=1e-11, abs=1e-11)
        state = blocks.plant.dynamics(t, state, [u])
    controller.close()


def test_jacobi_master_is_a_delay_of_one_period(version, tmp_path):
    """Plant and controller side by side: the plant gets the command of the step before."""
    system = sampled("example1").with_settings(tolerance=1e-12)
    late = sampled("example1", delay=1.0).with_settings(tolerance=1e-12)
    blocks, run, T = certrack.to_control(system), certrack.simulate(late), 0.001
    controller = Imported(written(system, version, tmp_path), version, tmp_path)
    state, times = blocks.X0[:2], T * np.arange(500)
    for t, x in zip(times, run.trajectory.interpolate(times)[:2].T, strict=True):
        assert state == pytest.approx(x, rel=1e-12, abs=1e-12)
        controller.set(inputs(system, state, blocks.reference.output(t, [], [])))
        state = blocks.plant.dynamics(t, state, controller.get("u"))
        controller.step(t, T)
    controller.close()


def test_valid(version, tmp_path):
    for name in ("example1", "dual-motor-lean"):
        path = written(sampled(name), version, tmp_path, name)
        assert validate_fmu(path) == []
        description = fmpy.read_model_description(path, validate=True)
        assert description.fmiVersion == f"{version}.0"
        outputs = [v.name for v in description.modelVariables if v.causality == "output"]
        assert outputs == ["u"]
        assert ("time" in {v.name for v in description.modelVariables}) == (version == "3")


def test_simulates_in_one_call(version, tmp_path):
    """An importer's own driver, with constant inputs."""
    system = sampled("example1")
    path = written(system, version, tmp_path)
    start = {"x1": 1.0, "x2": 2.0, "y_d": 0.2}
    found = fmpy.simulate_fmu(path, stop_time=0.02, start_values=start, output=["u"])
    ours = PythonController(system)
    expected = [0.0, *(ours.step([1.0, 2.0], [0.2, 0.0]) for _ in range(20))]
    assert found["u"] == pytest.approx(expected, rel=1e-13)


def test_reproducible(version):
    system = sampled("example1")
    data = fmu(system, "example1", version=version)
    assert data == fmu(system, "example1", version=version)
    other = fmu(system, "example1", version=version, period=0.002)
    tokens = [token_of(archive) for archive in (data, other)]
    assert tokens[0] != tokens[1]


def test_what_is_not_read_is_not_called_measured():
    found = {
        v.name: v.description for v in variables(c_code(sampled("example1", velocity=("x2",))))
    }
    assert found["x1"] == "measured state"
    assert found["x2"] == "not read; computed from x1"


def token_of(archive):
    with zipfile.ZipFile(io.BytesIO(archive)) as opened:
        return opened.read("sources/model.h").decode().split('MODEL_TOKEN "')[1].split('"')[0]


def test_steps_that_do_not_fit_are_refused(version, tmp_path):
    controller = Imported(written(sampled("example1"), version, tmp_path), version, tmp_path)
    for h in (0.0005, 0.0, 0.0015):
        with pytest.raises(fmpy.fmi1.FMICallException):
            controller.step(0.0, h)
    assert controller.messages[0].endswith("multiple of the controller's period, 0.001 s")
    controller.close()


def test_longer_steps_hold_the_inputs(version, tmp_path):
    system = sampled("example1")
    controller = Imported(written(system, version, tmp_path), version, tmp_path)
    ours = PythonController(system)
    controller.set(inputs(system, [1.0, 2.0], [0.2, 0.0]))
    assert controller.get("u") == [0.0]
    found = controller.step(0.0, 0.003)
    expected = [ours.step([1.0, 2.0], [0.2, 0.0]) for _ in range(3)]
    assert found == pytest.approx(expected[-1], rel=1e-14)
    assert controller.get("kept.delta_hat", "kept.theta_hat_1") == pytest.approx(ours.state)
    controller.close()


def test_reset_and_state(version, tmp_path):
    """A master may go back; reset starts again."""
    system = sampled("example1", **EVERYTHING)
    controller = Imported(written(system, version, tmp_path), version, tmp_path)
    controller.set(inputs(system, [1.0, 2.0], [0.2, 0.0]))
    assert controller.get("u") == [0.3]
    first = [controller.step(k * 0.001, 0.001) for k in range(4)]
    get = controller.fmu.getFMUState if version == "3" else controller.fmu.getFMUstate
    put = controller.fmu.setFMUState if version == "3" else controller.fmu.setFMUstate
    saved = get()
    after = [controller.step(k * 0.001, 0.001) for k in range(4, 8)]
    put(saved)
    assert [controller.step(k * 0.001, 0.001) for k in range(4, 8)] == after
    controller.fmu.reset()
    controller.set(inputs(system, [1.0, 2.0], [0.2, 0.0]))
    assert [controller.step(k * 0.001, 0.001) for k in range(4)] == first
    controller.close()


@pytest.mark.skipif(not HAS_ECOS, reason=NO_ECOS)
@pytest.mark.parametrize("name", ["example1", "dual-motor-lean"])
def test_second_importer(name, version, tmp_path):
    """In a process of its own: its library stays loaded."""
    import json

    system = sampled(name, duration=0.2)
    path = written(system, version, tmp_path, name)
    ours, rows, expected = PythonController(system), [], []
    for x, Y in zip(*along_a_run(system), strict=True):
        rows.append(inputs(system, x, Y))
        expected.append(ours.step(x, Y))
    (tmp_path / "inputs.json").write_text(json.dumps(rows))
    command = [sys.executable, "-c", ECOS, path, str(tmp_path / "inputs.json")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found == pytest.approx(expected, rel=1e-12, abs=1e-12)


ECOS = """
import json, sys
from ecospy.EcosSimulation import EcosSimulation
from ecospy.EcosSimulationStructure import EcosSimulationStructure

with EcosSimulationStructure() as structure:
    structure.add_model("c", sys.argv[1])
    with EcosSimulation(structure=structure, step_size=0.001) as simulation:
        simulation.init()
        found = []
        for row in json.load(open(sys.argv[2])):
            for name, value in row.items():
                simulation.set_real(f"c::{name}", value)
            simulation.step()
            found.append(simulation.get_real("c::u"))
        simulation.terminate()
print(json.dumps(found))
"""


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.skipif(not shutil.which(name), reason=f"no {name}"))
        for name in ("gcc", "clang")
    ],
)
def test_wrappers_compile_without_a_warning(name, version, tmp_path):
    with zipfile.ZipFile(written(sampled("example1"), version, tmp_path)) as archive:
        archive.extractall(tmp_path)
    strict = "-std=c99 -Wall -Wextra -Wpedantic -Wshadow -Werror -Wno-unused-parameter".split()
    command = [name, *strict, "-c", f"fmi{version}.c", "-o", "wrapper.o"]
    done = subprocess.run(
        command, cwd=tmp_path / "sources", capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_all_functions_are_there(version, tmp_path):
    """Every function that the standard's headers declare is in the binary."""
    path = written(sampled("dual-motor-lean"), version, tmp_path, "lean")
    library = ctypes.CDLL(extracted_binary(path, tmp_path))
    with zipfile.ZipFile(path) as archive:
        header = archive.read(f"sources/fmi{version}Functions.h").decode()
    declared = re.findall(r"Export \w+TYPE +(\w+);", header)
    assert len(declared) > 40
    assert all(hasattr(library, name) for name in declared)


def extracted_binary(path, folder):
    with zipfile.ZipFile(path) as archive:
        (name,) = (name for name in archive.namelist() if name.startswith("binaries/"))
        return archive.extract(name, folder)


def test_names_of_the_wrapper_are_not_taken(version, tmp_path):
    for name in ("fmi2", "fmi3", "model", "instance"):
        path = written(sampled("example1"), version, tmp_path, name)
        assert validate_fmu(path) == []


def test_what_is_needed(monkeypatch):
    with pytest.raises(certrack.InputError, match="implementation: is missing"):
        fmu(certrack.load("example1"), "example1")
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(
        certrack.CertrackError, match="no C compiler was found: install gcc or clang"
    ):
        fmu(sampled("example1"), "example1")


def test_command_line(capfd, tmp_path, version, monkeypatch):
    out = tmp_path / "drive.fmu"
    ask = ("export", "fmu", "dual-motor-lean", "--fmi", version, "--period", "0.01", "--out")
    assert result(capfd, *ask, str(out)) == {"file": str(out)}
    description = fmpy.read_model_description(str(out))
    assert description.coSimulation.modelIdentifier == "drive"
    assert description.fmiVersion == f"{version}.0"
    monkeypatch.setattr(shutil, "which", lambda name: None)
    code, _, err = invoke(capfd, *ask, str(tmp_path / "other.fmu"))
    assert (code, err.count("\n")) == (2, 1)
    assert "no C compiler was found: install gcc or clang" in err
    assert list(tmp_path.iterdir()) == [out]
