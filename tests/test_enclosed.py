"""Floats with what they may be off by hold the exact numbers, also where every rounding falls."""

import importlib
import math
import pkgutil
import re
from dataclasses import replace
from fractions import Fraction
from itertools import product
from types import SimpleNamespace

import flint
import numpy as np
import pytest
from scipy.integrate import simpson
from scipy.linalg import expm
from test_implemented_parts import CALM
from test_slow import axis

import certrack
from certrack.certificates import implemented
from certrack.certificates.arithmetic import rational
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented import premises as implemented_premises
from certrack.certificates.implemented.certify import certify_implemented, limits_met
from certrack.certificates.implemented.drive import DRIVE_BITS, drive_of, linear_drift
from certrack.certificates.implemented.enclosed import Enclosed, widened
from certrack.certificates.implemented.gains import (
    KernelColumns,
    gains_table,
    largest_of_each,
    mean_magnitude,
    product_error,
    sums_over_time,
    tail_gains,
)
from certrack.certificates.implemented.levels import _sized
from certrack.certificates.implemented.outputs import ERROR_DEGREE, STATE_DEGREE, output_rows
from certrack.certificates.implemented.period import one_period
from certrack.certificates.implemented.premises import _covered, lipschitz_status
from certrack.certificates.implemented.proof import (
    ImplementedProof,
    prove_implemented,
    start_prover,
)
from certrack.certificates.implemented.start import Later, _product_with, is_above, up
from certrack.certificates.implemented.start_proof import MOST_DOUBLINGS, StartProof, StartProver
from certrack.certificates.implemented.start_set import (
    ANY_PHASE,
    FILE_PHASE,
    POLYTOPE,
    X0,
    start_set_of,
)
from certrack.certificates.premise import ASSUMED, CHECKED, PROVEN
from certrack.references import SoftStart

ROUNDOFF = np.finfo(float).eps / 2  # not what the module takes it for
LOST = ROUNDOFF * (1 - 2.0**-20)  # added to 1 it is lost


@pytest.mark.parametrize("roundings", range(0, 60, 7))
def test_what_roundings_lose_is_made_good(roundings):
    found = Fraction(float(widened(np.array(1.0), roundings)))
    assert found >= (1 + Fraction(ROUNDOFF)) ** (roundings + 1)
    assert found <= 1 + 4 * (roundings + 8) * Fraction(ROUNDOFF)
    assert widened(np.array(0.0)) > 0
    total = 1.0
    for _ in range(roundings):
        total += LOST
    assert Fraction(float(widened(np.array(total), roundings))) >= 1 + roundings * Fraction(LOST)


@pytest.mark.parametrize("value", ["1/3", "-1/3", "1e-320", "-7e18", "0"])
def test_the_middle_and_the_radius_of_a_ball_are_enclosed(value):
    with flint.ctx.workprec(200):
        exact = Fraction(value)
        ball = flint.arb(flint.fmpq(exact.numerator, exact.denominator), "1e-20")
        found = Enclosed.of(flint.arb_mat([[ball]]))
        largest = abs(exact) + Fraction(1, 10**20)
        low = Fraction(float(found.value[0, 0])) - Fraction(float(found.error[0, 0]))
        high = Fraction(float(found.value[0, 0])) + Fraction(float(found.error[0, 0]))
        assert low <= exact - Fraction(1, 10**20) and exact + Fraction(1, 10**20) <= high
        assert high - low <= Fraction(3, 10**20) + abs(exact) * Fraction(2) ** -48
        assert largest <= Fraction(float(found.upper[0, 0])) <= largest * 2 + Fraction(1, 10**100)
        assert up(ball) == found.upper[0, 0]
        assert found.error[0, 0] > float(ball.rad())


@pytest.fixture
def counted(monkeypatch):
    """How many roundings each sum was widened for, in all modules of the implemented loop."""
    counts = []

    def counting(values, roundings=8):
        counts.append(roundings)
        return widened(values, roundings)

    for entry in pkgutil.iter_modules(implemented.__path__, implemented.__name__ + "."):
        module = importlib.import_module(entry.name)
        if hasattr(module, "widened"):
            monkeypatch.setattr(module, "widened", counting)
    return counts


@pytest.mark.parametrize("kind", ["starts", "jitter", "rates"])
def test_no_sum_counts_fewer_roundings_than_its_last_steps(counted, kind):
    """Of one entry each: the products and sums by which it enters what is widened."""
    if kind == "rates":
        certify_implemented(axis(rate=[0, 0.5]))
    else:
        system = certrack.loads(CALM)
        jitter = 0.1 if kind == "jitter" else 0.0
        drive = replace(system.implementation, delay=0.5, jitter=jitter)
        certify_implemented(system.replace(implementation=drive), from_start=kind == "starts")
    assert len(counted) > 10 and min(counted) >= 3


def test_sums_count_a_rounding_for_each_of_their_terms(counted):
    size, ends, periods, bends = 12, 40, 30, 50
    columns = KernelColumns(
        np.zeros(ends - 1),
        flint.arb_mat(size, 2 * ends),
        flint.arb_mat(size, 3),
        flint.arb_mat(size, bends),
        np.zeros(bends),
        np.zeros((size, 1)),
    )
    width = 2 * ends + 3 + bends + size
    sums_over_time(columns, np.zeros((2, periods, width)), np.zeros((2, width)))
    assert counted.pop() >= ends + periods
    for few in (1, 20):  # bends, or entries of chi, that are many beside the others
        table = replace(columns, bends=flint.arb_mat(size, few), bend_weights=np.zeros(few))
        gains_table(table, 1, np.zeros((2, 2 + 3 + few + size)))
        assert counted.pop() >= size + few
    for size, block, blocks in ((30, 1, 1), (2, 40, 1), (2, 1, 50)):
        heads = Enclosed(*np.ones((2, blocks * 2, size)))
        table = Enclosed(*np.ones((2, size, block * 3)))
        product_error(heads, table, 2, block)
        assert counted.pop() >= blocks + block + 2 * size
    tail_gains(np.ones((1, 40)), np.ones((40, 2)), 0.001 * np.ones((40, 40)))
    assert len(counted) == 4 and counted[0] >= 40 and counted[-1] >= 40
    for cells, q in ((60, 0), (3, 20), (1, 1)):
        Y = [float(k + 2) for k in range(q + 2)]
        period = SimpleNamespace(drive=SimpleNamespace(q=q, Y=list(map(rational, Y))))
        bends = cells * max(q - 1, 0)
        columns = SimpleNamespace(bend_weights=np.ones(bends))
        found = _sized(period, [None], columns, cells, np.ones((1, 1 + cells * (q + 1) + bends)))
        assert counted.pop() >= cells + q + 1
        assert found == pytest.approx((1 + bends) * Y[-1] + cells * sum(Y[:-1]))


def exact_product(p, q):
    return [
        [sum(Fraction(float(u)) * Fraction(float(v)) for u, v in zip(row, column, strict=True))]
        for row in p
        for column in q.T
    ]


@pytest.mark.parametrize("size", range(1, 7))
@pytest.mark.parametrize("part", ["value", "left error", "right error"])
def test_products_of_enclosed_matrices_hold_all_products(size, part):
    """Of 1 and what is lost beside it: a product of the values, or of a value and an error."""
    ones, none = np.ones((1, size)), np.zeros((1, size))
    column = np.full((size, 1), LOST)
    column[0] = 1
    a, b = {
        "value": ((ones, none), (column, 0 * column)),
        "left error": ((none, ones), (column, 0 * column)),
        "right error": ((ones, none), (0 * column, column)),
    }[part]
    found = _product_with(Enclosed(*a), Enclosed(*b))
    exact = exact_product(ones, column)[0][0]
    high = Fraction(float(found.value[0, 0])) + Fraction(float(found.error[0, 0]))
    assert high >= exact
    assert high <= exact * (1 + 8 * (size + 10) * Fraction(ROUNDOFF))


def test_a_later_bound_is_strictly_above_its_image():
    image = np.array([9.0, 1.0, 2.0, 3.0, 9.0])
    assert is_above(Later((1.1, 2.1), 3.1), image)
    for states, size in (((1.0, 2.1), 3.1), ((1.1, 2.0), 3.1), ((1.1, 2.1), 3.0)):
        assert not is_above(Later(states, size), image)


def test_a_proof_of_starts_has_the_shape_of_its_system():
    prover = SimpleNamespace(drive=SimpleNamespace(n=2, sized=2))
    region = (("-1", "1"), ("0", "0"))

    def holds(**changes):
        fields = {"of": X0, "phase": FILE_PHASE, "region": (), "doublings": 5, "middle": 31}
        fields |= {"states": ("1",) * 2, "input": "1", "peaks": ("1",) * 5}
        return StartProver._is_well_formed(prover, StartProof(**fields | changes))

    right = [
        {},
        {"phase": ANY_PHASE},
        {"of": POLYTOPE, "region": region},
        {"middle": 0},
        {"doublings": 1, "middle": 1},
        {"doublings": MOST_DOUBLINGS},
    ]
    wrong = [
        {"of": "x1"},
        {"phase": "none"},
        {"region": region},
        {"of": POLYTOPE},
        {"of": POLYTOPE, "region": region[:1]},
        {"of": POLYTOPE, "region": (("-1", "1"), ("0", "-1"))},
        {"doublings": 0, "middle": 0},
        {"doublings": MOST_DOUBLINGS + 1},
        {"middle": 32},
        {"middle": -1},
        {"states": ("1",)},
        {"states": ("1",) * 3},
        {"peaks": ("1",) * 4},
        {"peaks": ("1",) * 6},
    ]
    assert all(holds(**changes) for changes in right)
    assert not any(holds(**changes) for changes in wrong)


#: A drive whose reference at t = 0 is not zero, with sensors that err.
DRIVE = """
[plant]
states = ["x1", "x2"]
chain = [1]
input_gain = 1
gain_sign = 1
[plant.uncertainty]
tau = [0, 1]
gamma = [0, 0]
beta = [0, 0.1]
[truth]
input_gain = 1
omega = [0, "0.1*sin(t)"]
[reference]
signal = "0.1*cos(t)"
[law]
kind = "robust"
c = [2, 2]
feedforward = 1
[simulation]
x0 = [0.01, 0]
duration = 5
[implementation]
period = 0.01
measurement_quantum = [0.001, 0.002]
"""


def test_a_start_with_any_reference_covers_every_reference():
    """Within their bounds: what the starts add is at least what they add with each of them."""
    system = certrack.loads(DRIVE)
    with flint.ctx.workprec(DRIVE_BITS):
        prover = start_prover(system, rational(0), (1, 1))
        frame = prover.frame(9)
        starts = start_set_of(system, prover.drive, ANY_PHASE, ())
        every = frame.transient(starts)
        assert starts.Y is None
        for signs in product((-1, 1), repeat=2):
            bounds = [flint.arb(v) * s for v, s in zip(prover.drive.Y, signs, strict=False)]
            one = frame.transient(replace(starts, Y=tuple(bounds)))
            assert (every.size >= one.size).all()
            assert (every.later >= one.later).all()
            assert (every.free >= one.free).all()
        noisy = replace(starts, half=tuple(flint.arb("0.001") for _ in starts.half))
        more = frame.transient(noisy)
        assert (more.size > every.size).all() and (more.later >= every.later).all()


def test_what_is_there_at_the_start():
    """x(0) or the middle of a region and its half widths, Y(0), and the first input's own part."""
    base = certrack.loads(DRIVE)
    system = base.replace(implementation=replace(base.implementation, initial_input=0.5))
    with flint.ctx.workprec(DRIVE_BITS):
        drive = replace(drive_of(system), offset=rational(0.125))
        found = start_set_of(system, drive, FILE_PHASE, ())
        assert [float(v) for v in (*found.center, *found.half)] == [0.01, 0, 0, 0]
        assert [float(v.mid()) for v in found.Y] == pytest.approx([0.1, 0])  # of 0.1 cos t
        assert float(found.initial) == 0.5 - 0.125 and found.jump is None
        box = (("-1", "3"), ("0.5", "0.75"))
        every = start_set_of(system, drive, ANY_PHASE, box)
        assert [float(v) for v in every.center] == [1, 0.625] and every.Y is None
        assert [float(v) for v in every.half] == [2, 0.125]
        with pytest.raises(NoCertificate, match="jitter"):
            start_set_of(system, replace(drive, jitter=rational(0.1)), FILE_PHASE, ())
        late = system.replace(implementation=replace(system.implementation, offset=0.0025))
        with pytest.raises(NoCertificate, match="first sample"):
            start_set_of(late, drive, FILE_PHASE, ())


def test_the_premise_names_what_an_observer_estimates():
    """Disturbances alone, whose states are measured; or all states, too."""
    dob, eso = axis(), certrack.load("dual-motor-observer")
    said = _covered(dob, dob.implementation).split("; ")
    assert "what acts on x2 by the observer, which is part of the loop" in said
    (said,) = (part for part in _covered(eso, eso.implementation).split("; ") if "observer" in part)
    assert said.startswith(", ".join(eso.plant.states) + ", what acts on ")


def test_the_premise_names_what_the_drive_has():
    quantised = DRIVE.replace("[implementation]", "[implementation]\ninput_quantum = 0.25")
    sensors = "sensors within 0.0005001 for x1, 0.001001 for x2"  # rounded up
    exact = re.sub("measurement_quantum.*", "", DRIVE)
    for text, expected in (
        (DRIVE, [sensors]),
        (quantised, [sensors, "the input in steps of 0.25"]),
        (exact, ["exact sensors"]),
    ):
        system = certrack.loads(text)
        every, *others = _covered(system, system.implementation).split("; ")
        assert every.startswith("sampled every 0.01 s, its input acts 0 periods later")
        assert others == expected


def test_the_premise_names_a_reference_that_is_fed_forward_for_samples():
    system = certrack.loads(DRIVE)
    fed = system.replace(law=replace(system.law, sampled_feedforward=True))
    said = "the reference fed forward as the sampled loop needs it"
    assert _covered(fed, fed.implementation).split("; ")[-1] == said
    assert said not in _covered(system, system.implementation)


@pytest.mark.parametrize(
    ("signal", "declared", "proven", "status"),
    [
        ("sin(t)", None, None, PROVEN),
        ("sin(t)", (1, 1), None, PROVEN),  # nothing is stated of the slope of y_d'
        ("sin(t)", (1, 1, 1), 1.0, PROVEN),
        ("sin(t)", (1, 1, 2), 1.0, PROVEN),
        ("sin(t)", (1, 1, 1), 1.5, CHECKED),
        ("sin(t)", (1, 1, 1), None, CHECKED),
        ("abs(t - 1)*exp(-t)", (1, 2, 3), None, ASSUMED),
    ],
)
def test_what_is_known_of_the_slope_of_the_last_derivative(
    monkeypatch, signal, declared, proven, status
):
    asked = []

    def bound(reference, order):
        asked.append((reference.declared, order))
        return proven

    monkeypatch.setattr(implemented_premises, "lipschitz_bound", bound)
    reference = certrack.SymbolicReference(signal, declared=declared)
    assert lipschitz_status(reference, 1) == status
    assert lipschitz_status(SoftStart(reference, 0.5), 1) == status
    assert set(asked) <= {(None, 1)} and bool(asked) == (len(declared or ()) > 2)


def test_nothing_is_known_of_a_foreign_reference():
    Foreign = type("Foreign", (), {"__module__": "somewhere"})
    assert lipschitz_status(Foreign(), 1) == ASSUMED


@pytest.mark.parametrize("delay", ["0", "1/3"])
def test_what_acts_within_a_cell_is_at_least_its_integral(delay):
    """|c e^{As} W| over a cell, and the remainders of Taylor's polynomials of y_d, x and u."""
    text = DRIVE.replace("gain_sign", 'drift = "-300*x1 - 40*x2"\ngain_sign')
    delay = Fraction(delay)
    text = text.replace("[implementation]", f'[implementation]\ndelay = "{delay}"')
    system = certrack.loads(text)
    with flint.ctx.workprec(DRIVE_BITS):
        drive = drive_of(system, flint.fmpq(delay.numerator, delay.denominator))
        period = one_period(drive, (1, 2))
        rows = [row for row in output_rows(period) if row.output <= drive.n]
        A, b, W = (Enclosed.of(m).value for m in (drive.A, drive.b, drive.W))
        lengths = [float(cell.length) for cell in period.cells]
        found = [(row.output, lengths[row.phase], row.in_cell, float(row.share)) for row in rows]
        assert {length for _, length, *_ in found} == set(lengths)
        q, fractions = drive.q, np.linspace(0, 1, 21)
        motion = {h: np.array([expm(A * h * f) for f in fractions]) for h in set(lengths)}
        for output, h, cell, share in found:
            if share:
                continue  # the same of all points of a cell
            degree = max(ERROR_DEGREE, q) if output == 0 else STATE_DEGREE
            c = np.eye(drive.n)[max(output - 1, 0)]
            E = motion[h]
            integrals = simpson(np.abs(c @ E @ W), h * fractions, axis=0)
            bounds = np.array([float(v.mid()) for v in cell.w])
            assert (bounds >= integrals * (1 - 1e-6)).all()
            assert (bounds <= integrals * 1.5 + h**3).all()
            exact = h ** (q + 1) / math.factorial(q + 1) if output == 0 else 0
            assert float(cell.r.mid()) == pytest.approx(exact, rel=1e-12)
            step = h ** (degree + 1) / math.factorial(degree + 1)
            powers = np.linalg.matrix_power(A, degree)
            of_x = np.abs(c @ powers @ A @ E).max(axis=0)
            of_u = np.abs(c @ powers @ E @ b).max()
            assert (np.array([float(v.mid()) for v in cell.x]) >= of_x * step * (1 - 1e-12)).all()
            assert of_u * step * (1 - 1e-12) <= float(cell.u.mid()) <= of_u * step * 2 + h**9


def test_the_mean_magnitude_of_a_line_is_exact():
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(2, 50))
    a[:3], b[1:4] = 0, 0
    s = (np.arange(20_000) + 0.5) / 20_000
    sampled_means = np.abs(a + (b - a) * s[:, None]).mean(axis=0)
    assert mean_magnitude(a, b) == pytest.approx(sampled_means, abs=1e-8)
    assert mean_magnitude(-a, -b) == pytest.approx(sampled_means, abs=1e-8)


def test_columns_of_gains_add_what_bends_between_the_nodes():
    rng = np.random.default_rng(2)
    size, width, cells, n, bends = 4, 3, 2, 2, 5
    columns = SimpleNamespace(
        nodes=SimpleNamespace(nrows=lambda: size, ncols=lambda: width * (cells + 1)),
        lengths=np.ones(cells),
        curvature=rng.uniform(size=(size, width - 1)),
        bend_weights=rng.uniform(size=bends),
    )
    sums = rng.uniform(size=(6, width + n + 2 + bends + size))
    lines, samples, bent, of_row = np.split(sums, np.cumsum([width, n + 2, bends]), axis=1)
    expected = np.hstack(
        [
            lines[:, :-1] + of_row @ columns.curvature,
            lines[:, -1:] + bent @ columns.bend_weights[:, None],
            samples,
            np.zeros((6, 1)),
        ]
    )
    found = gains_table(columns, n, sums)
    assert (found >= expected).all()
    assert found == pytest.approx(expected, rel=1e-13)


def test_largest_samples_are_summed_over_so_many_periods():
    samples = np.array([[1.0, 5, 2, 4, 3], [7, 1, 1, 1, 9]])
    assert largest_of_each(samples, 2).tolist() == [5 + 4 + 3, 7 + 1 + 9]
    assert largest_of_each(samples, 1).tolist() == [15, 19]
    assert largest_of_each(samples, 9).tolist() == [5, 9]


def test_the_parts_of_a_bound_add_up_to_it():
    proof, parts = prove_implemented(certrack.loads(DRIVE), rational(0))
    assert all(part >= -1e-12 for part in parts.values())
    assert sum(parts.values()) == pytest.approx(float(proof.bound), rel=1e-4)


def test_known_regressors_are_part_of_alinear_drift():
    """x1 times 2 and -3 times 5 as regressors, or written into the drift; the constant cancels."""
    written = DRIVE.replace(
        "gain_sign", 'drift = "K*x2 + 2*x1 - 15"\nconstants = {K = 4}\ngain_sign', 1
    )
    known = written.replace("K*x2 + 2*x1 - 15", "K*x2")
    known = known.replace("gain_sign", 'regressor = ["x1", -3]\ntheta = [2, 5]\ngain_sign', 1)
    known = known.replace("[truth]", "[truth]\ntheta = [2, 5]")
    found = [linear_drift(certrack.loads(text)) for text in (written, known)]
    assert found[0] == found[1] == ([2, 4], -15)
    for wrong in ("x1*x2", "sin(x1)", "abs(x1)"):
        with pytest.raises(NoCertificate, match="only loops that are linear"):
            linear_drift(certrack.loads(written.replace("K*x2 + 2*x1 - 15", wrong)))


@pytest.mark.parametrize(
    ("limits", "met"),
    [
        ((-13, 7), False),
        ((-12.999, 7), True),
        ((-13, 6.999), True),
        ((-14, 8), False),
        ((-7, 13), True),
    ],
)
def test_limits_are_not_met_by_a_certified_input_about_its_offset(limits, met):
    """The law's constant is -3 here, and |u + 3| <= 10; the step is at most 0.5 in 0.01 s."""
    text = DRIVE.replace("gain_sign", 'drift = "3"\ngain_sign', 1)
    text = text.replace("[implementation]", f"[implementation]\nsaturation = {list(limits)}", 1)
    proofs = [
        ImplementedProof("0", (1, 1), 9, ("1", "1"), size, step, "1")
        for size, step in (("10", "0.1"), ("2", "0.5"))
    ]
    assert bool(limits_met(certrack.loads(text), proofs)) == met
    if not met:
        for rate, refused in ((50, False), (49.99, True)):
            limited = text.replace("[implementation]", f"[implementation]\nrate_limit = {rate}", 1)
            assert ("rate limit" in limits_met(certrack.loads(limited), proofs)) == refused
