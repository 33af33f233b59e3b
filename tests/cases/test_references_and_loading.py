"""References that jump or need no bound, files of samples, systems that were refused or hung."""

import pickle
import time
from pathlib import Path

import numpy as np
import pytest
from pace import within

import certrack
from certrack.core.errors import InputError
from certrack.core.powers import ConstantPower

CASES = Path(__file__).parent.parent / "data" / "cases"


def load(name):
    return certrack.load(CASES / f"{name}.toml")


def test_a_division_that_jumps_is_refused():
    with pytest.raises(InputError, match=r"may jump.* a denominator may be zero near t = 3\.01819"):
        load("jump")


def test_a_ramp_needs_no_bound_that_no_proof_uses():
    found = certrack.certify(load("ramp"))
    assert found.best.verified
    assert 0.01 <= found.best.bound <= 0.0101
    assert "|y_d^(1)| <= 0.5 (proven)" in " ".join(found.semidefinite.assumptions)
    assert "|y_d^(0)|" not in " ".join(found.semidefinite.assumptions)


def test_a_reference_may_overflow_beyond_the_run():
    """exp(t/10) of a 3 s run is e^0.3 at most; at 7111 s it is beyond floats."""
    run = certrack.simulate(load("ref_beyond_duration"))
    assert run.outcome.name == "finished"
    assert run.y_d[-1] == pytest.approx(np.exp(0.3))
    longer = load("ref_beyond_duration").with_settings
    with pytest.raises(InputError, match="not finite in floating point at t = "):
        longer(duration=8000.0)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("bom_csv", [0, 0.1, 0.3]),
        ("semicolon_csv", [0, 0.1, 0.3]),
        ("semi", [0, 0.1, 0.1]),
    ],
)
def test_samples_as_spreadsheets_write_them(name, values):
    reference = load(name).reference
    assert reference.knots == (0, 1, 2)
    assert reference.values(np.arange(3.0), 0)[0] == pytest.approx(values)


def test_times_in_milliseconds_are_not_read_as_seconds():
    with pytest.raises(InputError, match=r'row 3, cell 1 of ms\.csv: .*time_unit = "ms"'):
        load("ms")
    text = (CASES / "ms.toml").read_text()
    for unit, last in (("ms", 0.2), ("s", 200.0)):
        stated = text.replace('file = "ms.csv"', f'file = "ms.csv"\ntime_unit = "{unit}"')
        system = certrack.loads(stated, folder=CASES)
        assert system.reference.knots[-1] == pytest.approx(last)
        assert certrack.loads(certrack.to_text(system)) == system


def test_limited_steps_are_simulated_and_certify_says_what_is_missing():
    system = load("rfj")
    assert system.reference.order == 1
    assert "too strong for this design" in certrack.certify(system).semidefinite.reason


def test_an_s_curve_of_min_and_max_has_the_order_it_was_made_for():
    """35 s^4 - 84 s^5 + 70 s^6 - 20 s^7: three derivatives vanish at both ends."""
    system = load("rfj3b")
    assert system.reference.order == 4
    computed = certrack.references.SymbolicReference(system.reference.signal).bounds(4).values
    assert computed == pytest.approx((0.7854, 2.14757813, 9.2200909, 80.5341797, 1610.68359))
    assert np.all(np.array(computed) <= system.reference.declared)
    assert certrack.certify(system).best.verified


def test_a_smooth_pulse_is_bounded_with_all_its_derivatives():
    reference = load("flexible-joint-drive").reference
    t = np.linspace(0, 6, 60_001)
    largest = np.abs(reference.values(t, 4)).max(axis=1)
    found = certrack.references.SymbolicReference(reference.signal).bounds(4).values
    assert np.all(found >= largest)
    assert np.all(found <= 1.01 * largest)


def test_dollars_in_a_title_are_dollars(tmp_path):
    system = load("title_mathtext")
    run = certrack.simulate(system)
    drawing = certrack.plotting.overview({"a$_1_2$": run, "b": run}, system.title)
    paths = certrack.plotting.save_figure(drawing, tmp_path, "run")
    assert "bench $x_1_2$" in paths[1].read_text()


def test_a_title_like_a_placeholder_is_kept():
    system = load("title-at0at")
    assert len(system.reference.knots) == 300
    assert certrack.loads(certrack.to_text(system)) == system


def test_atan2_of_two_zeros_is_zero_in_comparisons():
    drift = load("nan-comparison").plant.drift.expr
    assert float(drift.subs({"x1": 0}).subs(dict.fromkeys(drift.free_symbols, 0))) > 3.6  # sinh 2


@pytest.mark.parametrize(
    ("name", "constant", "value"),
    [
        ("hang-power", "K_L", 4.076**0.0000001),
        ("refused-power", "K_L", 3 * 16.925**0.02114 / 1.0615),
        ("refused-constant", "q", 1.000001**50),
    ],
)
def test_powers_of_constants_load_at_once(name, constant, value):
    with within(2):
        system = load(name)
    assert float(system.plant.constant_values[constant]) == pytest.approx(value, rel=1e-15)
    assert certrack.loads(certrack.to_text(system)) == system


def test_a_constant_power_is_a_number_like_pi():
    power = load("hang-power").plant.constant_values["K_L"]
    assert isinstance(power, ConstantPower)
    assert pickle.loads(pickle.dumps(power)) == power
    assert str(power.evalf(30)) == "1.00000014051162140780478862109"
    assert power.is_positive


def test_a_state_may_have_the_name_of_a_function_of_numpy():
    system = load("state-named-arctan").with_settings(duration=1.0, tail=None)
    renamed = (CASES / "state-named-arctan.toml").read_text().replace("arctan", "x1")
    other = certrack.loads(renamed).with_settings(duration=1.0, tail=None)
    for integrator in ("taylor", "scipy"):
        runs = [
            certrack.simulate(entry.with_settings(integrator=integrator))
            for entry in (system, other)
        ]
        found, expected = (list(run.final_state.values()) for run in runs)
        assert found == pytest.approx(expected, abs=1e-9)


def test_thousands_of_constants_load_in_linear_time():
    text = (CASES / "many-constants.toml").read_text()

    def seconds(count):
        """The least of a few loads of the file with so many of its constants."""
        lines = text.splitlines(keepends=True)
        first = lines.index("q0 = 1\n")
        shorter = "".join(lines[: first + count] + lines[first + 3000 :])
        spent = []
        for _ in range(3):
            begin = time.process_time()
            system = certrack.loads(shorter)
            spent.append(time.process_time() - begin)
        assert count <= len(system.plant.constants) < count + 10
        return min(spent)

    assert seconds(3000) < 8 * seconds(750)  # 4 times as many


def test_a_state_like_a_macro_is_exported(tmp_path):
    certrack.export_c(load("state_M_L"), tmp_path, "servo", period=0.01)
    assert "M_L_" in (tmp_path / "servo.c").read_text()
