"""Ensembles against single runs and brute force; the same numbers however they are computed."""

import errno
import json
import math
import os
import platform
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from clusters import local_cluster
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import certrack
from certrack.core import compilers
from certrack.core.errors import InputError
from certrack.integrators.base import Outcome
from certrack.integrators.many import native
from certrack.integrators.many.native import vector_compiler
from certrack.model.distribution import Distribution
from certrack.model.implementation import Implementation
from certrack.model.population import Population
from certrack.studies.ensembles import workers
from certrack.studies.ensembles.engine import OUTCOME_CODES, Engine
from certrack.studies.ensembles.members import Members
from certrack.studies.ensembles.methods.choice import create_method
from certrack.studies.ensembles.plan import METRICS, make_plan
from certrack.studies.ensembles.problem import EnsembleProblem
from certrack.studies.ensembles.statistics import (
    BAND_BINS,
    BAND_BITS,
    BINS_PER_SIDE,
    FINEST_OCTAVE,
    LEVELS,
    METRIC_BITS,
    Bands,
    Tally,
    binomial_interval,
)
from certrack.studies.ensembles.workers import chunk_members

METHODS = ["lockstep"] + ["native", "implicit"] * (vector_compiler() is not None)


def uniform(low, high):
    return Distribution("uniform", (low, high))


def example1(**population):
    start = (uniform(-1, 1), uniform(-2, 2))
    return certrack.load("example1").replace(
        population=Population(x0=start, input_gain=uniform(1.5, 2.5), **population)
    )


def variants():
    """Systems that show every kind of formula, reference and variation."""
    base = example1(disturbance="multisine")
    kinked = replace(base.plant, drift="abs(x1)*x2 + max(x1, 0.1*x2)")
    lean = certrack.load("dual-motor-lean")
    return {
        "file": example1(),
        "multisine": base,
        "sobol": example1(sampling="sobol", amplitude=uniform(0.5, 1), frequency=uniform(0.5, 2)),
        "triangle": base.replace(reference=certrack.triangle(0.2, 5.0)),
        "steps": base.replace(
            reference=certrack.references.steps([1.0, 7.0], [0.0, 0.1, -0.1], 0.5)
        ),
        "kinks": base.replace(plant=kinked),
        "four states": lean.replace(
            population=Population(constants={"K_L": uniform(2, 4)}, disturbance="multisine")
        ),
    }


VARIANTS = variants()


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", VARIANTS)
def test_metrics_are_those_of_single_runs(name, method):
    """Final states to 1e-6, metrics to what their way of computing allows."""
    system = VARIANTS[name]
    engine = Engine(make_plan(system, 5, 1e-7, None, method))
    bands = Bands(engine.plan.centre, engine.plan.scale)
    found, outcomes = engine.metrics_and_outcomes(3, 9, bands)
    assert set(outcomes) == {OUTCOME_CODES[Outcome.finished]}
    close = {
        "settling_time": {"atol": 5e-3},
        "tail_error": {"rtol": 1e-3},
        "integral_abs_error": {"rtol": 2e-3},
        "peak_input": {"rtol": 5e-3},
        "input_variation": {"rtol": 5e-3},
    }
    checked = [0, 3, 5]  # of six, which are more than a register
    for k in checked:
        run = Members(system, 5).member(3 + k)
        metrics = certrack.simulate(run, tolerance=1e-9).metrics
        for name_, value in zip(METRICS, found[:, k], strict=True):
            expected = getattr(metrics, name_)
            limits = {"rtol": 1e-4, "atol": 1e-9} | close.get(name_, {})
            np.testing.assert_allclose(value, expected, err_msg=name_, **limits)
    if method != "lockstep":
        x = engine.method.final_states(3, 9, bands)[:, checked]
        alone = [
            certrack.simulate(Members(system, 5).member(3 + k), tolerance=1e-11).x[:, -1]
            for k in checked
        ]
        np.testing.assert_allclose(x, np.transpose(alone), atol=1e-7 * (1 + np.abs(x).max()))


@pytest.mark.skipif(vector_compiler() is None, reason="needs a C compiler")
@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8])
def test_errors_stay_below_the_tolerance(tolerance):
    """The error estimate of the method may be relaxed: it exceeds the error by far."""
    system = example1()
    engine = Engine(make_plan(system, 0, tolerance, None, "native"))
    bands = engine.plan.empty().bands
    members = Members(system, 0)
    exact = [certrack.simulate(members.member(i), tolerance=1e-12).x[:, -1] for i in range(16)]
    assert np.abs(engine.method.final_states(0, 16, bands) - np.transpose(exact)).max() < tolerance


def problems():
    """A continuous and a sampled loop, with jumps of the reference and of the noise."""
    continuous = VARIANTS["triangle"].with_settings(duration=6, tail=3)
    implementation = Implementation(0.01, delay=0.5, noise=(1e-3, 1e-3))
    return {"continuous": continuous, "sampled": continuous.replace(implementation=implementation)}


@pytest.mark.parametrize("method", [*METHODS, "alone"])
@pytest.mark.parametrize("loop", problems())
def test_every_method_does_its_duties(loop, method):
    """Exactly the range is computed and counted, and no neighbour or thread matters."""
    if (loop, method) == ("sampled", "implicit"):
        pytest.skip("a sampled loop has none")
    problem = EnsembleProblem(problems()[loop], 4, 1e-6)
    signals, times = problem.system.plant.n + 2, len(problem.times)

    def compute(begin, end, threads):
        bands = Bands(np.zeros((signals, times)), np.ones(signals))
        return create_method(method, problem, threads).compute(begin, end, bands), bands

    results, bands = compute(0, 300, 1)
    part, counted = compute(13, 270, 2)
    assert results.metrics.shape == (len(METRICS), 300)
    for name in ("metrics", "ends", "run_alone"):
        np.testing.assert_array_equal(getattr(part, name), getattr(results, name)[..., 13:270])
    assert results.run_alone.all() if method == "alone" else not results.run_alone.any()
    np.testing.assert_array_equal(results.ends == problem.end, ~results.run_alone)
    for range_bands, members in ((bands, 300), (counted, 270 - 13)):
        expected = 0 if method == "alone" else members
        assert np.unique(range_bands.counts.sum(axis=2)).tolist() == [expected]
    for begin, end in ((0, 13), (270, 300)):
        counted.merge(compute(begin, end, 1)[1])
    np.testing.assert_array_equal(counted.counts, bands.counts)


def identical(first, second):
    a, b = first.statistics.packed(), second.statistics.packed()
    assert set(a) == set(b)
    for name in a:
        if not name.startswith("outcome"):  # in the order of their first member
            np.testing.assert_array_equal(a[name], b[name], err_msg=name)
    assert first.statistics.outcomes == second.statistics.outcomes


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ["multisine", "triangle"])
def test_threads_and_chunks_do_not_matter(name, method):
    """Bit for bit."""
    system = VARIANTS[name]
    whole = certrack.ensemble(system, 2500, method=method, threads=1)
    for threads, chunk in ((2, 777), (3, 100_000), (1, 1025)):
        parts = certrack.ensemble(system, 2500, method=method, threads=threads, chunk=chunk)
        identical(whole, parts)
        assert {**whole.summary(), "microseconds_per_member": 0} == {
            **parts.summary(),
            "microseconds_per_member": 0,
        }


@pytest.mark.slow
@pytest.mark.skipif(vector_compiler() is None, reason="needs a C compiler")
@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="flags of x86-64")
@pytest.mark.parametrize("name", ["multisine", "triangle"])
def test_older_processors_agree_within_the_tolerance(name, monkeypatch):
    """Not bit for bit: without AVX-512 reciprocals are exact, without FMA products are rounded.

    On the way the error may be twice the tolerance (:data:`native.ESTIMATE_EXCESS`), of both.
    """
    system, tolerance = VARIANTS[name], 1e-6
    settings = {"method": "native", "tolerance": tolerance, "threads": 1, "limit": np.inf}
    expected, given = certrack.ensemble(system, 256, **settings).per_member(), native.VECTOR_FLAGS
    for processor in ("x86-64-v3", "x86-64-v2"):
        flags = [f"-march={processor}" if flag == "-march=native" else flag for flag in given]
        monkeypatch.setattr(native, "VECTOR_FLAGS", flags)
        metrics, outcomes = certrack.ensemble(system, 256, **settings).per_member()
        np.testing.assert_array_equal(outcomes, expected[1])
        scale = 1 + np.nanmax(np.abs(expected[0]), axis=1)[:, None]
        np.testing.assert_allclose(metrics / scale, expected[0] / scale, atol=4 * tolerance, rtol=0)


@pytest.mark.parametrize("method", METHODS)
def test_quantiles_and_violations_are_those_of_brute_force(method):
    """Against single runs of every member, within half a bin."""
    system, count = example1(disturbance="multisine"), 40
    limit = 0.034
    found = certrack.ensemble(system, count, limit=limit, method=method, tolerance=1e-9)
    runs = [found.run(i) for i in range(count)]
    t, n = found.t, system.plant.n
    signals = np.empty((count, n + 2, len(t)))
    for i, run in enumerate(runs):
        states = run.trajectory.interpolate(t)
        signals[i, 0] = states[0] - system.reference.values(t, 0)[0]
        signals[i, 1:-1], signals[i, -1] = states[:n], run.input_of(t, states)
    exact = np.quantile(signals, LEVELS, axis=0, method="inverted_cdf")
    bands = found.statistics.bands
    away = np.abs(exact - bands.centre)
    half = (away + bands.scale[:, None] * 2.0**-FINEST_OCTAVE) / 2 ** (BAND_BITS + 1)
    assert np.all(np.abs(found.bands - exact) <= 1.01 * half + 2e-6)
    tails = np.array([run.metrics.tail_error for run in runs])
    for level in LEVELS:
        tally = found.statistics.metrics["tail_error"]
        value = np.quantile(tails, level, method="inverted_cdf")
        assert tally.quantile(level) == pytest.approx(value, rel=2.0**-METRIC_BITS)
    violations = found.violations()
    assert violations["count"] == (tails > limit).sum()
    assert 0 < violations["count"] < count
    assert found.summary()["worst"][0]["member"] == tails.argmax()


def test_clopper_pearson():
    """Its ends are where the tails of the binomial distribution hold 2.5 %."""
    from scipy.stats import binom

    low, high = binomial_interval(7, 100)
    assert binom.sf(6, 100, low) == pytest.approx(0.025)
    assert binom.cdf(7, 100, high) == pytest.approx(0.025)
    assert binomial_interval(0, 50)[0] == 0
    assert example_with_sobol().violations()["interval"] is None


def example_with_sobol():
    return certrack.ensemble(example1(sampling="sobol"), 8, limit=1.0)


finite = st.floats(-1e12, 1e12)


@given(values=arrays(float, st.integers(1, 60), elements=finite), cut=st.integers(0, 60))
def test_counts_merge_exactly_and_stay_within_their_bins(values, cut):
    def bands(part):
        made = Bands(np.zeros((1, 1)), np.ones(1))
        made.observe(0, 0, part)
        return made

    whole, parts = bands(values), bands(values[:cut])
    parts.merge(bands(values[cut:]))
    np.testing.assert_array_equal(whole.counts, parts.counts)
    inside = np.clip(values, -1000, 1000)
    median = np.quantile(inside, 0.5, method="inverted_cdf")
    found = np.clip(whole.quantiles((0.5,))[0, 0, 0], -1000, 1000)
    assert abs(found - median) <= (abs(median) + 2.0**-FINEST_OCTAVE) / 2 ** (BAND_BITS + 1) * 1.001
    first, second = Tally(), Tally()
    first.observe(np.abs(values))
    second.observe(np.abs(values[:cut]))
    rest = Tally()
    rest.observe(np.abs(values[cut:]))
    second.merge(rest)
    assert first.summary() == second.summary()


@given(
    values=arrays(np.float32, st.integers(1, 60), elements=st.floats(-(2.0**40), 2.0**40, width=32))
)
def test_bins_are_octaves_cut_evenly(values):
    """By logarithms instead of bits: bin k of y = 1 + |v|/unit, mirrored where v is negative."""
    bands = Bands(np.zeros((1, 1)), np.array([4.0]))
    bands.observe(0, 0, values)
    y = np.float32(1) + np.abs(values) / np.float32(bands.unit[0])
    mantissa, exponent = np.frexp(y)  # y = mantissa 2^exponent, 1/2 <= mantissa < 1
    part = np.floor((2 * mantissa - 1) * 2**BAND_BITS).astype(int)
    k = np.minimum((exponent - 1) * 2**BAND_BITS + part, BINS_PER_SIDE - 1)
    expected = BINS_PER_SIDE + np.where(np.signbit(values), -k - 1, k)
    np.testing.assert_array_equal(bands.counts[0, 0], np.bincount(expected, minlength=BAND_BINS))


def test_missing_and_infinite_values_have_bins_of_their_own():
    bands = Bands(np.zeros((1, 1)), np.ones(1))
    bands.observe(0, 0, np.array([np.nan, np.nan, np.inf, -np.inf, -np.inf, -np.inf]))
    filled = {int(i): int(bands.counts[0, 0, i]) for i in np.flatnonzero(bands.counts[0, 0])}
    assert filled == {0: 3, 2 * BINS_PER_SIDE - 1: 1, BAND_BINS - 1: 2}


@given(value=st.floats(1e-300, 1e300))
def test_bins_of_metrics_have_a_fixed_relative_width(value):
    tally = Tally()
    tally.observe(np.array([value, value * (1 + 2.0 ** -(METRIC_BITS - 1))]))
    assert len(tally.keys) == 2  # more than a bin apart
    tally.least, tally.most = 0.0, np.inf
    assert tally.values[0] == pytest.approx(value, rel=2.0 ** -(METRIC_BITS + 1))


@pytest.mark.parametrize("method", METHODS)
def test_members_that_escape(method):
    """Less input gain than designed for: large starts escape; single runs say the same."""
    wild = certrack.System(
        plant=certrack.Plant(states=["x"], drift="x**3", gain_sign=1, input_gain=1),
        law=certrack.Robust(c=(1,)),
        reference=certrack.SymbolicReference("0.1*sin(t)"),
        truth=certrack.Truth(input_gain=0.3),
        settings=certrack.Settings(x0=(0,), duration=10),
        population=Population(x0=(uniform(-2, 2),), input_gain=uniform(0.2, 1)),
    )
    found = certrack.ensemble(wild, 48, method=method, limit=10.0)
    alone = [found.run(i).outcome.name for i in range(48)]
    assert found.statistics.outcomes == Counter(alone)
    escaped = found.statistics.outcomes["escaped"]
    assert 0 < escaped < 48
    assert found.violations()["count"] >= escaped
    assert found.summary()["tail_error"]["missing"] == escaped


def test_no_certificate_is_claimed_for_a_population_it_does_not_cover():
    assert certrack.ensemble(example1(), 8).limit is None  # the gain varies without a range
    lean = certrack.load("dual-motor-lean")
    assert certrack.ensemble(lean, 8).limit == pytest.approx(0.0012874, rel=1e-4)
    stronger = lean.replace(population=Population(tau=(0, 2, 0, 1)))
    assert "tau exceeds" in certrack.ensemble(stronger, 8).limit_origin
    moving = lean.replace(population=Population(constants={"K_L": uniform(2, 4)}))
    assert "not the designer's" in certrack.ensemble(moving, 8).limit_origin


def test_fixed_values_other_than_certified_are_not_covered():
    motor = certrack.load("dual-motor")
    for other in ({"constants": {"J_L": 5.0}}, {"input_gain": 0.5}):
        assert certrack.ensemble(motor.replace(population=Population(**other)), 8).limit is None
    same = Population(constants={"J_L": 0.5}, input_gain=20)
    assert certrack.ensemble(motor.replace(population=same), 8).limit_origin == "certificate"
    theta = certrack.load("example1").replace(population=Population(theta=(50.0,)))
    assert certrack.ensemble(theta, 8).limit is None


@pytest.mark.parametrize("method", METHODS)
def test_names_of_the_user_do_not_collide(method):
    """A constant called amplitude beside a varied amplitude; states with names used inside."""
    system = certrack.loads(RENAMED.format(x1="settling_band", x2="u_end"))
    found = certrack.ensemble(system, 8, method=method)
    tails = [found.run(i).metrics.tail_error for i in range(8)]
    assert found.summary()["tail_error"]["max"] == pytest.approx(max(tails), rel=2e-3)
    for name in ("kept_u_end", "mode_sign_0"):
        with pytest.raises(InputError, match="reserved"):
            certrack.loads(RENAMED.format(x1=name, x2="x2"))


RENAMED = """
[plant]
states = ["{x1}", "{x2}"]
chain = [2]
drift = "amplitude*{x1}"
gain_sign = 1
input_gain = 1
[plant.constants]
amplitude = 2
[truth]
input_gain = 1
[reference]
signal = "0.1*sin(t)"
[law]
kind = "robust"
c = [1, 1]
[simulation]
x0 = [1, 0]
duration = 10
[ensemble.reference]
amplitude = {{uniform = [0.1, 1]}}
[ensemble.constants]
amplitude = {{uniform = [1, 3]}}
"""


@pytest.mark.parametrize("method", [*METHODS, "alone"])
def test_bands_show_the_input_after_a_jump_and_members_far_from_the_nominal_run(method):
    """A triangle's corners are times of the grid; the nominal run rests, the members do not."""
    system = VARIANTS["triangle"].with_settings(x0=(0, 0), duration=10, tail=5)
    found = certrack.ensemble(system, 8, method=method)
    corner = int(np.searchsorted(found.t, 2.5))
    exact = []
    for i in range(8):
        run = found.run(i)
        after = np.array([2.5 + 1e-9])
        exact.append(run.input_of(after, run.trajectory.interpolate(after))[0])
    low, high = found.bands[0, -1, corner], found.bands[-1, -1, corner]
    assert low == pytest.approx(min(exact), abs=0.03)
    assert high == pytest.approx(max(exact), abs=0.03)
    still = certrack.load("dual-motor")
    still = still.replace(
        reference=certrack.SymbolicReference("1e-5*sin(t)"),
        truth=replace(still.truth, omega=(0, 0, 0, 0)),
    ).with_settings(x0=(0, 0, 0, 0))
    wide = certrack.ensemble(still, 16, method=method)
    starts = [wide.member(i).settings.x0[0] for i in range(16)]
    assert wide.bands[-1, 1, 0] == pytest.approx(max(starts), rel=0.02)
    assert wide.bands[0, 1, 0] == pytest.approx(min(starts), rel=0.02)


RUN = """
import sys, certrack
certrack.ensemble(certrack.load(sys.argv[1]), 6000, seed=1, chunk=500, threads=1, out=sys.argv[2])
"""


def test_a_killed_run_goes_on(tmp_path):
    """kill -9 in mid-run, then the same call: the result of an undisturbed run."""
    system = certrack.load("dual-motor-lean")
    folder = tmp_path / "killed"
    run = subprocess.Popen([sys.executable, "-c", RUN, "dual-motor-lean", str(folder)])
    while len(list(folder.glob("chunk-*.npz"))) < 3:
        assert run.poll() is None
        time.sleep(0.01)
    os.kill(run.pid, signal.SIGKILL)
    assert run.wait() == -signal.SIGKILL
    done = len(list(folder.glob("chunk-*.npz")))
    assert 3 <= done < 12
    torn = folder / "chunk-0000005500-0000006000.npz"
    torn.write_bytes((folder / "chunk-0000000000-0000000500.npz").read_bytes()[:-10])
    again = certrack.ensemble(system, 6000, seed=1, chunk=700, out=folder)
    assert 0 < again.computed <= 6000 - 500 * done + 500
    whole = certrack.ensemble(system, 6000, seed=1)
    identical(whole, again)
    loaded = certrack.ensemble(system, 6000, seed=1, out=folder)
    assert loaded.computed == 0
    identical(whole, loaded)
    more = certrack.ensemble(system, 6500, seed=1, out=folder)
    assert more.computed == 500
    with pytest.raises(InputError, match="holds another ensemble"):
        certrack.ensemble(system, 6000, seed=2, out=folder)


def test_many_chunks_are_gathered(tmp_path):
    system = certrack.load("dual-motor-lean")
    found = certrack.ensemble(system, 800, chunk=20, out=tmp_path)
    assert len(list(tmp_path.glob("chunk-*.npz"))) < 40
    again = certrack.ensemble(system, 800, out=tmp_path)
    assert again.computed == 0
    identical(found, again)


def test_a_full_disk(tmp_path, monkeypatch):
    """A clear error; earlier chunks are intact and the same call goes on."""
    system, replace_ = certrack.load("dual-motor-lean"), os.replace

    def full(temporary, path):
        if "0000000600" in path.name:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return replace_(temporary, path)

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(InputError, match="No space left on device.*written before are intact"):
        certrack.ensemble(system, 800, chunk=200, out=tmp_path)
    monkeypatch.undo()
    assert not list(tmp_path.glob("*.part"))
    again = certrack.ensemble(system, 800, chunk=200, out=tmp_path)
    assert again.computed == 400
    identical(again, certrack.ensemble(system, 800))


def test_an_unwritable_folder(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        certrack.ensemble(certrack.load("example1"), 8, out=tmp_path / "file" / "below")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"members": 0}, "members: must be a whole number"),
        ({"seed": -1}, "seed: must be a whole number"),
        ({"tolerance": 1.0}, "tolerance: must be at most"),
        ({"method": "magic"}, "method: must be one of"),
        ({"threads": 0}, "threads: must be a whole number"),
        ({"limit": -1}, "limit: must be positive"),
    ],
)
def test_bad_arguments(arguments, message):
    with pytest.raises(InputError) as caught:
        certrack.ensemble(certrack.load("example1"), **arguments)
    assert message in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["dual-motor", "dual-motor-lean", "dual-motor-strong", "example1"])
def test_certificates_hold_for_every_admissible_member(name):
    """A real test of soundness: no violation in 10^5 members."""
    found = certrack.ensemble(certrack.load(name), 100_000)
    assert found.limit_origin == "certificate"
    assert found.violations()["count"] == 0
    assert found.statistics.outcomes == {"finished": 100_000}


def test_a_cluster_with_work_enough_gets_larger_chunks():
    def client(count):
        return SimpleNamespace(scheduler_info=lambda: {"workers": dict.fromkeys(range(count))})

    plan = make_plan(certrack.load("example1"), 0, 1e-6, math.inf, "native")
    slow = replace(plan, method="alone")
    assert chunk_members(plan, 10**7, None) == chunk_members(slow, 10**7, client(4)) == 16_384
    assert chunk_members(plan, 10**7, client(4)) == 65_536
    assert chunk_members(plan, 10**6, client(4)) == 49_152
    assert chunk_members(plan, 10**5, client(4)) == chunk_members(plan, 1, client(0)) == 16_384
    for members in (10**5, 10**6, 10**7):
        chunks = members / chunk_members(plan, members, client(4))
        assert chunks >= 16 or chunk_members(plan, members, client(4)) == 16_384


@pytest.mark.slow
def test_a_cluster_gives_the_same_even_if_a_worker_dies():
    """A local Dask cluster; one worker is killed in mid-run."""
    from distributed import Client

    system = certrack.load("dual-motor")
    with local_cluster(2) as cluster, Client(cluster) as client:
        pids = list(client.run(os.getpid).values())
        killed = []

        def progress(done, total, worst):
            if done and not killed:
                killed.append(pids[0])
                os.kill(pids[0], signal.SIGKILL)

        found = certrack.ensemble(system, 12_000, chunk=1000, client=client, progress=progress)
    assert killed
    identical(found, certrack.ensemble(system, 12_000))


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("openssl") is None, reason="nothing makes keys")
def test_a_cluster_over_tls(tmp_path):
    """Keys of Dask's configuration serve the address of `--cluster`; without them it is refused."""
    import dask
    from distributed import Security

    key, certificate = tmp_path / "key.pem", tmp_path / "cert.pem"
    request = "openssl req -x509 -newkey rsa:2048 -nodes -days 1 -subj /CN=localhost -keyout"
    command = [*request.split(), key, "-out", certificate]
    subprocess.run(command, check=True, capture_output=True)
    tls = "distributed.comm.tls"
    keys = {f"{tls}.ca-file": str(certificate), "distributed.comm.require-encryption": True}
    for role in ("scheduler", "worker", "client"):
        keys |= {f"{tls}.{role}.cert": str(certificate), f"{tls}.{role}.key": str(key)}
    system = certrack.load("example1")
    with (
        dask.config.set(keys),
        local_cluster(1, protocol="tls", security=Security()) as cluster,
    ):
        address = cluster.scheduler_address
        assert address.startswith("tls://")
        with workers.connect(address) as client:
            found = certrack.ensemble(system, 512, limit=np.inf, chunk=64, client=client)
        with (
            dask.config.set(dict.fromkeys(keys)),
            pytest.raises(InputError, match="--cluster: cannot reach the scheduler .*TLS"),
            workers.connect(address),
        ):
            pass
    identical(found, certrack.ensemble(system, 512, limit=np.inf))


def test_summary_is_json():
    found = certrack.ensemble(certrack.load("example1-classic"), 16)
    summary = json.loads(json.dumps(found.summary()))
    assert summary["members"] == 16
    assert summary["violations"] is None
    assert found.dataset()["quantiles"].shape == (len(LEVELS), 4, 201)


#: Members whose steps vanish before the end: x' = x^3 escapes in finite time, and a square root
#: whose argument becomes negative. In a process of its own: a node of the memories that rounding
#: leaves where it is once made the compiled integrator go on for ever.
VANISHING = """
import certrack
from certrack.model.distribution import Distribution
from certrack.model.population import Population

def uniform(low, high):
    return Distribution("uniform", (low, high))

system = certrack.System(
    plant=certrack.Plant(states=["x"], drift="x**3", gain_sign=1, input_gain=1),
    law=certrack.Robust(c=(1,)),
    reference=certrack.SymbolicReference("0.1*sin(t)"),
    truth=certrack.Truth(input_gain=0.3, omega={omega}, tau=(1,)),
    settings=certrack.Settings(x0=(0,), duration=10),
    population=Population(x0=(uniform(-2, 2),), input_gain=uniform(0.2, 1)),
)
print(certrack.ensemble(system, {members}, seed=3, method="native").statistics.outcomes)
"""


@pytest.mark.skipif(vector_compiler() is None, reason="no C compiler")
@pytest.mark.parametrize(
    ("omega", "members", "outcome"),
    [("None", 100, "escaped"), ('("sqrt(3.2 - t + 0.05*x)",)', 8, "undefined")],
)
def test_members_whose_steps_vanish_end(omega, members, outcome):
    program = VANISHING.format(omega=omega, members=members)
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    assert outcome in done.stdout


@pytest.mark.slow
@pytest.mark.skipif(not (shutil.which("gcc") and shutil.which("clang")), reason="one compiler")
def test_members_are_the_same_by_every_compiler(monkeypatch, tmp_path):
    monkeypatch.setenv("CERTRACK_CACHE", str(tmp_path))
    found = []
    for compiler in ("gcc", "clang"):
        monkeypatch.setenv("CC", compiler)
        monkeypatch.setattr(compilers, "_LOADED", {})
        assert vector_compiler() == shutil.which(compiler)
        engine = Engine(make_plan(VARIANTS["four states"], 5, 1e-7, None, "native"))
        bands = Bands(engine.plan.centre, engine.plan.scale)
        found.append(engine.metrics_and_outcomes(3, 9, bands)[0])
    assert found[0].tobytes() != found[1].tobytes()  # they round differently: there are two
    np.testing.assert_allclose(*found, rtol=1e-6)


def test_a_chunk_by_itself_does_not_depend_on_the_one_before_it():
    """Its table of counts is that of an earlier chunk, made empty again."""
    engine = Engine(make_plan(VARIANTS["four states"], 5, 1e-6, None, "alone"))
    first, second = engine.packed(0, 4), engine.packed(4, 10)
    assert first["totals"][0] == 4 and second["totals"][0] == 6
    for (begin, end), stated in (((0, 4), first), ((4, 10), second), ((4, 10), second)):
        fresh = engine.compute(begin, end).packed()
        again = engine.packed(begin, end)
        for found in (stated, again):
            assert fresh.keys() == found.keys()
            assert all(np.array_equal(fresh[name], found[name]) for name in fresh)
