"""Broken surroundings: one line, no half file; and machines without heyoka or a compiler."""

import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from pace import too_long

import certrack
from certrack.core.expressions import symbol
from certrack.core.lowering import numpy_callable
from certrack.core.scalar import NotOrdinary, ScalarFunction
from certrack.integrators.many.numpy_batch import NumpyBatch
from certrack.integrators.sampled.maps import NumpyMaps
from certrack.integrators.sampled.scalar_maps import ScalarMaps
from certrack.simulation.sampled import SampledSimulator
from certrack.studies.falsifier.loop import HUNT_TOLERANCE, AdversarialLoop

linux = pytest.mark.skipif(sys.platform != "linux", reason="needs /dev/full and signals")
SOURCE = str(Path(certrack.__file__).parents[1])
COMMAND = [sys.executable, "-m", "certrack"]


def environment(**more):
    return os.environ | {"PYTHONPATH": SOURCE, "OMP_NUM_THREADS": "1"} | more


def said(arguments, **options):
    """Exit code and standard error of a command."""
    done = subprocess.run(
        [*COMMAND, *map(str, arguments)],
        stderr=subprocess.PIPE,
        text=True,
        check=False,
        timeout=300,
        **({"env": environment()} | options),
    )
    return done.returncode, done.stderr


@linux
class TestOutput:
    @pytest.mark.parametrize("command", [("list",), ("simulate", "dual-motor-lean")])
    def test_full(self, command):
        with Path("/dev/full").open("w") as full:
            code, errors = said(command, stdout=full)
        reason = "standard output cannot be written (No space left on device)"
        assert (code, errors) == (2, f"certrack: {reason}\n")

    @pytest.mark.parametrize("numbers", [">&-", ">&- 2>&-"])
    def test_closed(self, tmp_path, numbers):
        """A file that is written does not get the number, and with it the text, of the output."""
        out = tmp_path / "drive.st"
        command = f'"$@" {numbers}'
        arguments = ["export", "st", "dual-motor-lean", "--period", "0.01", "--out", str(out)]
        done = subprocess.run(
            ["/bin/sh", "-c", command, "sh", *COMMAND, *arguments], env=environment(), check=False
        )
        assert done.returncode == 0
        assert out.read_text().startswith("(*") and out.read_text().endswith("END_FUNCTION_BLOCK\n")

    def test_a_reader_that_goes_away(self):
        done = subprocess.run(
            ["/bin/sh", "-c", '"$@" | true', "sh", *COMMAND, "list"],
            env=environment(),
            stderr=subprocess.PIPE,
            check=False,
        )
        assert done.stderr == b""

    def test_no_errors_can_be_told(self):
        with Path("/dev/full").open("w") as full:
            done = subprocess.run(
                [*COMMAND, "simulate", "nothing"], env=environment(), stderr=full, check=False
            )
        assert done.returncode == 2


@linux
def test_sigterm_ends_the_compiler_and_leaves_no_folder(tmp_path):
    slow, temporary = tmp_path / "cc", tmp_path / "tmp"
    slow.write_text(f"#!/bin/sh\necho $$ > {tmp_path}/pid\nexec sleep 60\n")
    slow.chmod(0o755)
    temporary.mkdir()
    process = subprocess.Popen(
        [*COMMAND, "simulate", "dual-motor-drive", "--with-c"],
        env=environment(CC=str(slow), TMPDIR=str(temporary)),
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    )
    deadline = time.monotonic() + 60
    while not (tmp_path / "pid").exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    time.sleep(0.2)
    assert list(temporary.iterdir())
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=60)
    assert (process.returncode, errors) == (143, "certrack: terminated\n")
    assert not list(temporary.iterdir())
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "pid").read_text()), 0)


@linux
@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "limit"),
    [(resource.RLIMIT_AS, 450_000_000), (resource.RLIMIT_NOFILE, 6)],
    ids=["memory", "handles"],
)
def test_one_line_where_memory_or_handles_are_short(kind, limit):
    def restrict():
        resource.setrlimit(kind, (limit, limit))

    code, errors = said(["simulate", "example1"], preexec_fn=restrict, stdout=subprocess.DEVNULL)
    assert code == 2 and errors.count("\n") == 1 and errors.startswith("certrack: ")


@linux
def test_a_full_disk_leaves_no_export(tmp_path):
    def restrict():
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))

    code, errors = said(
        ["export", "c", "dual-motor-lean", "--period", "0.01", "--out", tmp_path / "out"],
        preexec_fn=restrict,
        stdout=subprocess.DEVNULL,
    )
    assert code == 2 and errors.count("\n") == 1 and "cannot be written" in errors
    assert not list(tmp_path.iterdir())


# ---- without heyoka and a compiler ---------------------------------------------------------------


class TestPlainNumbers:
    def test_they_are_those_of_numpy(self):
        x, y = symbol("x"), symbol("y")
        import sympy

        formulas = [sympy.sin(x) * y**3, sympy.sqrt(x), x ** sympy.Rational(1, 3), 1 / y]
        one, many = ScalarFunction([x, [y]], formulas), numpy_callable([x, [y]], formulas)
        assert one(0.7, [2.0]) == pytest.approx(many(0.7, [2.0]), rel=1e-15)

    @pytest.mark.parametrize(("x", "y"), [(-0.5, 1.0), (0.5, 0.0), (1e200, 1e200)])
    def test_what_is_not_ordinary_is_left_to_numpy(self, x, y):
        """A root of a negative number, a division by zero, an overflow: nothing complex."""
        a, b = symbol("x"), symbol("y")
        import sympy

        with pytest.raises(NotOrdinary):
            ScalarFunction([a, b], [a ** sympy.Rational(1, 3) + 1 / b + a * b * b])(x, y)

    @pytest.mark.parametrize("name", ["dual-motor-drive", "example1"])
    def test_a_run_is_that_of_numpy(self, name):
        system = certrack.load(name)
        if system.implementation is None:
            implementation = certrack.Implementation(period=0.01, saturation=(-20, 20))
            system = system.replace(implementation=implementation)
        system = system.with_settings(duration=0.5, integrator="scipy")
        ours = SampledSimulator(system)
        assert isinstance(ours.maps, ScalarMaps)
        numpy = SampledSimulator(system, around=lambda _, loop: NumpyMaps(loop)).run(system)
        run = ours.run(system)
        assert len(run.t) == len(numpy.t)
        assert np.abs(run.x - numpy.x).max() < 1e-12 and np.abs(run.u - numpy.u).max() < 1e-10

    def test_a_run_that_escapes_ends_as_with_numpy(self):
        system = certrack.load("dual-motor-lean").with_settings(integrator="scipy", duration=6)
        system = system.replace(implementation=certrack.Implementation(period=0.3))
        numpy = SampledSimulator(system, around=lambda _, loop: NumpyMaps(loop)).run(system)
        run = SampledSimulator(system).run(system)
        assert run.outcome is numpy.outcome
        # the loop grows by what rounding left, too
        assert run.trajectory.end == pytest.approx(numpy.trajectory.end, rel=1e-6)


@pytest.mark.parametrize("name", ["dual-motor-lean", "example1"])
def test_adversaries_score_the_same_in_numpy(name):
    loop = AdversarialLoop(certrack.load(name))
    low, high = np.array([(v.low, v.high) for v in loop.adversary.variables]).T
    points = np.random.default_rng(0).uniform(low, high, (5, len(low))).T
    wanted = loop.errors(points)
    loop._integrator = NumpyBatch(loop._loop, HUNT_TOLERANCE)
    assert loop.errors(points) == pytest.approx(wanted, rel=5e-3)
    assert loop.errors(points[:, :1]) == pytest.approx(wanted[:1], rel=5e-3)


@pytest.fixture(scope="module")
def bare(tmp_path_factory):
    """An environment in which heyoka cannot be imported and no program is found."""
    folder = tmp_path_factory.mktemp("bare")
    (folder / "sitecustomize.py").write_text("import sys\nsys.modules['heyoka'] = None\n")
    paths = os.pathsep.join([str(folder), SOURCE])
    made = environment(PYTHONPATH=paths, PATH="")
    made.pop("CC", None)
    return made


#: Main commands, what they say of their engine, and the seconds of processor time that they may
#: take: 3 times what they took.
WITHOUT = {
    "simulate": (("simulate", "example1", "--json"), "using SciPy", 30),
    "sampled": (("simulate", "dual-motor-drive", "--json"), "", 60),
    "compare": (("compare", "example1", "dual-motor-lean", "--json"), "using SciPy", 30),
    "ensemble": (("ensemble", "example1", "-n", "4", "--json"), "computed by SciPy", 60),
    "margin": (("margin", "example1", "-n", "1", "--json"), "computed by NumPy", 120),
    "falsify": (
        ("falsify", "dual-motor-lean", "--budget", "200", "--json"),
        "heyoka is not installed: computed by NumPy",
        120,
    ),
    "certify": (("certify", "dual-motor-lean", "--json"), "", 30),
    "design": (("design", "example1", "--json"), "", 30),
    "export st": (
        ("export", "st", "example1", "--period", "0.01", "--out", "a.st", "--json"),
        "",
        30,
    ),
    "export c": (("export", "c", "example1", "--period", "0.01", "--out", "c", "--json"), "", 30),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", WITHOUT)
def test_every_command_works_without_heyoka_and_compiler(name, bare, tmp_path):
    arguments, note, seconds = WITHOUT[name]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [*COMMAND, *arguments],
        env=bare,
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        timeout=20 * seconds,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert done.returncode == 0, done.stderr
    assert note in done.stderr
    assert json.loads(done.stdout)
    assert not too_long(after.ru_utime - before.ru_utime, seconds)


@pytest.mark.slow
def test_what_needs_a_compiler_says_so(bare, tmp_path):
    for arguments in (
        ("export", "fmu", "example1", "--period", "0.01", "--out", "a.fmu"),
        ("simulate", "dual-motor-drive", "--with-c"),
    ):
        code, errors = said(arguments, env=bare, cwd=tmp_path, stdout=subprocess.DEVNULL)
        assert (code, errors) == (2, "certrack: no C compiler was found: install gcc or clang\n")
    assert not list(tmp_path.iterdir())


# ---- the newest Python ---------------------------------------------------------------------------

#: The core of the fast suite: no compiled extension but NumPy's and SciPy's is needed.
CORE = ["test_backstepping.py", "test_laws.py", "test_references.py", "test_systemfile.py"]


def newest_python():
    """The newest Python of this machine above the running one that has what the core needs."""
    home = Path.home() / ".pyenv" / "versions"
    found = [shutil.which(f"python3.{minor}") for minor in range(30, sys.version_info.minor, -1)]
    found.insert(0, os.environ.get("NEWEST_PYTHON"))  # of an environment made for it
    found += sorted((str(path) for path in home.glob("3.*/bin/python3")), reverse=True)
    modules = "sys, numpy, scipy, sympy, click, pytest, hypothesis, xarray, flint, heyoka"
    needed = f"import {modules}; print(*sys.version_info[:2])"
    best = None
    for path in filter(None, found):
        done = subprocess.run([path, "-c", needed], capture_output=True, text=True, check=False)
        version = tuple(map(int, done.stdout.split())) if done.returncode == 0 else (0, 0)
        if version > sys.version_info[:2] and (best is None or version > best[0]):
            best = version, path
    return best


@pytest.mark.slow
def test_the_newest_python_passes_the_core(tmp_path):
    best = newest_python()
    if best is None:
        pytest.skip(
            "NOT TESTED: no Python newer than "
            f"{sys.version_info.major}.{sys.version_info.minor} with the dependencies is here"
        )
    tests = Path(__file__).parent
    command = [
        best[1],
        "-m",
        "pytest",
        "-q",
        "--no-cov",
        "-m",
        "not slow",
        "-p",
        "no:cacheprovider",
    ]
    done = subprocess.run(
        [*command, *(str(tests / name) for name in CORE)],
        cwd=tests.parent,
        env=environment(),
        capture_output=True,
        text=True,
        check=False,
        timeout=1800,
    )
    assert done.returncode == 0, done.stdout[-3000:]
