"""What varies between members: distributions, sampling, and members alone and together."""

import numpy as np
import pytest
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st

import certrack
from certrack.certificates.assumption_1 import check_assumption_1
from certrack.core.errors import InputError
from certrack.core.expressions import TIME
from certrack.core.lowering import numpy_callable
from certrack.loops.continuous import close_loop, parameter_values
from certrack.model.distribution import Distribution
from certrack.model.population import Population
from certrack.model.sampling import MEMBERS_PER_DRAW, SAMPLINGS, probabilities
from certrack.studies.ensembles.members import Members


def uniform(low, high):
    return Distribution("uniform", (low, high))


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        (uniform(-1, 3), scipy.stats.uniform(-1, 4)),
        (Distribution("loguniform", (0.1, 50)), scipy.stats.loguniform(0.1, 50)),
        (
            Distribution("truncnorm", (1.0, 0.5, 0.2, 3.0)),
            scipy.stats.truncnorm(-1.6, 4.0, loc=1.0, scale=0.5),
        ),
    ],
)
def test_distributions_are_scipys(ours, theirs):
    p = np.linspace(0, 1, 1001)
    np.testing.assert_allclose(ours.quantile(p), theirs.ppf(p), rtol=1e-12, atol=1e-12)
    assert ours.quantile(p).min() >= ours.low
    assert ours.quantile(p).max() <= ours.high


@pytest.mark.parametrize("sampling", SAMPLINGS)
@given(begin=st.integers(0, 5000), count=st.integers(1, 3000), seed=st.integers(0, 5))
def test_members_depend_on_seed_and_index_alone(sampling, begin, count, seed):
    whole = probabilities(sampling, seed, 0, begin + count, 3)
    np.testing.assert_array_equal(
        probabilities(sampling, seed, begin, begin + count, 3), whole[:, begin:]
    )
    assert whole.min() >= 0
    assert whole.max() < 1


def test_latin_groups_and_sobol_fill_every_stratum():
    for sampling in ("latin", "sobol"):
        table = probabilities(sampling, 7, 0, 2 * MEMBERS_PER_DRAW, 4)
        for group in (table[:, :MEMBERS_PER_DRAW], table[:, MEMBERS_PER_DRAW:]):
            strata = np.sort((group * MEMBERS_PER_DRAW).astype(int), axis=1)
            np.testing.assert_array_equal(strata, np.tile(np.arange(MEMBERS_PER_DRAW), (4, 1)))


VARIED = {
    "example1": {
        "x0": [{"uniform": [-1, 1]}, 2],
        "estimates": [{"uniform": [0, 1]}, {"truncnorm": [2, 0.1, 1, 3]}],
        "input_gain": {"loguniform": [1, 4]},
        "theta": [{"uniform": [1, 3]}],
        "tau": [{"uniform": [0, 0.1]}, 0.2],
        "amplitude": {"uniform": [0.5, 1]},
        "frequency": {"uniform": [0.5, 2]},
        "disturbance": "multisine",
    },
    "dual-motor": {
        "constants": {"K_L": {"uniform": [2, 4]}, "J_M": {"uniform": [0.08, 0.12]}},
        "disturbance": "multisine",
        "sines": 2,
    },
    "dual-motor-lean": {
        "x0": [{"uniform": [-1, 1]}] * 4,
        "constants": {"K_M": {"uniform": [3, 5]}},
    },
}


@pytest.mark.parametrize("name", VARIED)
@pytest.mark.parametrize("sampling", SAMPLINGS)
def test_members_alone_and_together_are_the_same(name, sampling):
    """The rates of every member, from the table and from a system of its own."""
    system = certrack.load(name)
    agree(system.replace(population=Population(**VARIED[name], sampling=sampling)))


@pytest.mark.parametrize("name", ["dual-motor-lean", "dual-motor-physical"])
def test_derived_constants_follow_those_that_vary(name):
    """Also in the drift, in the true input gain, and where another true value is stated."""
    text = certrack.to_text(certrack.load(name).replace(population=None))
    text = text.replace("J_M = 0.1\n", 'J_M = 0.1\nk = "K_L/J_M"\ng = "K_M/(2*J_M)"\nk2 = "2*k"\n')
    text = text.replace("K_L/J_M*(x1", "k2/2*(x1").replace("K_L/J_M*(max", "k2/2*(max")
    text = text.replace('input_gain = "K_M/(2*J_M)"', 'input_gain = "g"')
    text = text.replace("[truth.constants]\n", "[truth.constants]\nJ_M = 0.11\n")
    varied = {"K_L": {"uniform": [2, 4]}, "K_M": {"uniform": [3, 5]}}
    system = certrack.loads(text).replace(population=Population(constants=varied))
    assert "k2" in system.plant.drift.text and system.truth.constants
    agree(system)


def agree(system):
    members, count = Members(system, 3), 5
    starts, table = members.table(10, 10 + count)
    loop, base = members.loop, members.base
    rates = numpy_callable([TIME, loop.states, loop.parameters], [*loop.rates, loop.u, loop.e_1])
    rng = np.random.default_rng(0)
    for i in range(count):
        values = base.copy()
        for symbol, column in table.items():
            values[loop.parameters.index(symbol)] = column[i]
        alone = members.member(10 + i)
        own = close_loop(alone)
        other = numpy_callable([TIME, own.states, own.parameters], [*own.rates, own.u, own.e_1])
        np.testing.assert_array_equal(starts[:, i], alone.start)
        for _ in range(4):
            t, x = rng.uniform(0, 10), rng.normal(size=len(loop.states))
            np.testing.assert_allclose(
                rates(t, x, values), other(t, x, parameter_values(own, alone)), rtol=1e-11
            )


def test_random_disturbances_are_admissible(shipped):
    population = Population(disturbance="multisine")
    if shipped.truth.states:  # there is no omega to put them in
        with pytest.raises(InputError, match="ensemble.disturbance: must be file"):
            shipped.replace(population=population)
        return
    members = Members(shipped.replace(population=population), 0)
    for index in (0, 1, 999):
        assert not check_assumption_1(members.member(index))


def test_a_member_can_be_saved_and_loaded(tmp_path):
    system = certrack.load("example1").replace(population=Population(**VARIED["example1"]))
    member = Members(system, 1).member(4)
    certrack.save(member, tmp_path / "member.toml")
    again = certrack.load(tmp_path / "member.toml")
    assert again.truth == member.truth
    one, other = certrack.simulate(again).metrics, certrack.simulate(member).metrics
    assert one.rms_error == pytest.approx(other.rms_error, rel=1e-9)
    assert one.peak_input == pytest.approx(other.peak_input, rel=1e-6)
    assert certrack.loads(certrack.to_text(system)) == system


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x0 = [1]", "ensemble.x0: must be a list of 2: one per state"),
        ("x0 = [{uniform = [1, 0]}, 0]", "ensemble.x0[0].uniform: low must not exceed high"),
        ("x0 = [{uniform = [1]}, 0]", "ensemble.x0[0].uniform: must be a list of 2: low, high"),
        ("x0 = [{gauss = [0, 1]}, 0]", "ensemble.x0[0]: must be one of uniform, loguniform, trunc"),
        ("theta = [{loguniform = [0, 1]}]", "ensemble.theta[0].loguniform: low must be positive"),
        ("theta = [{truncnorm = [0, 0, 0, 1]}]", "the deviation must be positive"),
        ("input_gain = {uniform = [-1, 1]}", "ensemble.input_gain: must have the sign"),
        ("tau = [{uniform = [-1, 1]}, 0]", "ensemble.tau[0]: must be zero or positive"),
        ("constants = {K = 1}", "ensemble.constants.K: is not a constant of the plant"),
        ("reference = {phase = 1}", "ensemble.reference.phase: unknown key"),
        ("reference = {frequency = 0}", "ensemble.reference.frequency: must be positive"),
        ("sampling = 'halton'", "ensemble.sampling: must be one of plain, latin, sobol"),
        ("sines = 0", "ensemble.sines: must be a whole number from 1 to 50"),
        ("frequencies = [0, 1]", "ensemble.frequencies: must be positive"),
        ("limit = 0", "ensemble.limit: must be positive"),
        ("member = 3", "ensemble.member: unknown key"),
    ],
)
def test_bad_input_is_refused(text, message):
    file = certrack.to_text(certrack.load("example1").replace(population=None))
    with pytest.raises(InputError, match="ensemble") as caught:
        certrack.loads(f"{file}\n[ensemble]\n{text}\n")
    assert message in str(caught.value)


def test_members_that_do_not_exist_are_refused():
    members = Members(certrack.load("example1"), 0)
    for index in (-1, 2**31):
        with pytest.raises(InputError, match="index: must be a whole number from 0 to"):
            members.member(index)


def test_a_piecewise_reference_has_no_amplitude_to_vary():
    system = certrack.load("example1").replace(
        reference=certrack.triangle(0.1, 4.0), population=Population(amplitude=0.5)
    )
    with pytest.raises(InputError, match="needs a reference given by a formula"):
        Members(system, 0)
