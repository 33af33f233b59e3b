"""Files made to fill the memory or to take for ever are refused at once, in one line."""

import sys
import time
import tomllib

import pytest
from pace import within

import certrack
from certrack.core.budget import resident_megabytes
from certrack.core.errors import InputError
from certrack.systems import toml

PARTS = 20_000

#: Texts, each of which took seconds or hundreds of MB, and what is said of them.
HOSTILE = {
    "a key of 20,000 dotted parts": ("a" + ".a" * PARTS + " = 1\n", "a key has more than 16"),
    "a table of as many": ("[a" + ".a" * PARTS + "]\n", "a key has more than 16 dotted parts"),
    "quoted parts": ("'a'" + ' . "a=#"' * PARTS + " = 1\n", "a key has more than 16"),
    "within an inline table": ("a = {b" + ".b" * PARTS + " = 1}\n", "a key has more than 16"),
    "lists in lists": ("a = " + "[" * PARTS + "]" * PARTS, "brackets are nested deeper than 16"),
    "tables in tables": ("a = " + "{a = " * 500 + "1" + "}" * 500, "brackets are nested deeper"),
    "many tables": ("".join(f"[t{i}]\n" for i in range(200_000)), "more than 100000 keys"),
    "many lists": ("a = [" + "[]," * 200_000 + "]", "more than 100000 keys, tables and lists"),
    "many keys": ("".join(f"k{i} = 1\n" for i in range(200_000)), "more than 100000 keys"),
    "a huge integer": ("a = 0x" + "f" * 2_000_000, "a number or name is longer than 5000"),
    "a huge decimal": ("a = 0." + "1" * 2_000_000, "a number or name is longer than 5000"),
    "a huge name": ("a" * 2_000_000 + " = 1", "a number or name is longer than 5000 characters"),
    "a long text": ('title = "' + "a" * 2_000_000 + '"', "a text is longer than 1000000"),
    "a long text in lines": ("a = '''" + "'a\n" * 1_000_000 + "'''", "a text is longer than"),
    "a long text with escapes": ('a = """' + "\\n" * 1_000_000 + '"""', "a text is longer than"),
}


@pytest.mark.parametrize(("text", "expected"), HOSTILE.values(), ids=HOSTILE)
def test_what_would_fill_the_memory_is_refused_in_one_line(text, expected):
    before = resident_megabytes()
    with within(2), pytest.raises(InputError) as refused:
        certrack.loads(text, "drive.toml")
    assert resident_megabytes() - before < 200
    message = str(refused.value)
    assert message.startswith("drive.toml")
    assert f"is not TOML of a system: {expected}" in message
    assert "\n" not in message
    assert len(message) < 200


def test_the_line_is_named():
    text = certrack.starter() + "\n\n[plant.constants.a" + ".a" * 100 + "]\n"
    line = text.splitlines().index("[plant.constants.a" + ".a" * 100 + "]") + 1
    with pytest.raises(InputError, match=f"^drive.toml:{line}: is not TOML of a system: a key"):
        certrack.loads(text, "drive.toml")


def test_texts_may_hold_what_keys_may_not():
    """Dots, brackets and equal signs of texts and comments are not counted."""
    dots = "..." * 100 + "[{=" * 100
    text = (
        f'a = "{dots}\\""  # {dots}\nb = \'{dots}"\'\nc = """{dots}"" \\" {dots}"""""\n'
        f"d = '''{dots}'' {dots}'''''\n# {dots}\n\"{dots}\" = [1.5, 2.5, 1e-3]\n"
        "e = [" + "1.5," * 1000 + "]\n"
    )
    assert toml.parse_toml(text) == tomllib.loads(text)


@pytest.mark.parametrize("name", certrack.catalog())
def test_shipped_files_are_far_within_the_limits(name, monkeypatch):
    monkeypatch.setattr(toml, "MAX_ENTRIES", 200)
    monkeypatch.setattr(toml, "MAX_BRACKETS", 4)
    certrack.load(name)


def test_many_samples_load_in_linear_time_and_memory():
    """A million samples, the largest file that makes sense, are then within the budget."""
    from certrack.systems.reader import LOAD_MEGABYTES

    def load(count):
        samples = f"""
[reference]
kind = "samples"
times = [{", ".join(str(i / 1000) for i in range(count))}]
values = [{", ".join(f"{i % 7 / 10}" for i in range(count))}]
"""
        head, _, tail = certrack.starter().partition("[reference]")
        text = head + samples + "[law]" + tail.partition("[law]")[2]
        clock = time.thread_time()
        certrack.loads(text)
        return time.thread_time() - clock

    before, count = resident_megabytes(), 20_000
    few = load(count // 4)
    assert load(count) < 10 * few  # 4 times as many samples
    assert resident_megabytes() - before < 100 + count / 1_000_000 * LOAD_MEGABYTES / 3


@pytest.mark.parametrize("size", [10, 10_000])
def test_a_long_name_is_shortened(size):
    with pytest.raises(InputError) as refused:
        certrack.loads(certrack.starter() + "\n[simulation.x]\n" + "y" * (size // 3) + " = 1\n")
    assert len(str(refused.value)) < 600


def test_python_does_not_limit_what_is_checked():
    """An integer beyond Python's own limit of digits is one line too."""
    digits = sys.get_int_max_str_digits()
    with pytest.raises(InputError, match="is not TOML") as refused:
        certrack.loads("a = " + "9" * (digits + 100))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "drift",
    [
        "abs(exp(acos(x2/9)))",
        "tan(x1 + 1 + pi/2)",
        "abs(exp(asin(x1/9))*x2)",
        "1/tan(pi/2 - x1/9 - 1)",
    ],
)
def test_what_sympy_rewrites_in_functions_of_its_own_is_not_refused(drift):
    """Found by the fuzzer of system files: valid formulas had no compiled form."""
    system = certrack.loads(certrack.starter().replace('drift = "-d/J*x2"', f'drift = "{drift}"'))
    short = system.with_settings(duration=0.01, tail=None)
    ends = [
        certrack.simulate(short.with_settings(integrator=name)).metrics.tail_error
        for name in ("scipy", "implicit")
    ]
    assert ends[0] == pytest.approx(ends[1], rel=1e-5)
