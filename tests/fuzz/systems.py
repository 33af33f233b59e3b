"""System files: shipped ones with keys and values changed, and their bytes.

What loads must survive being written and read again, and now and then it is designed, certified
and simulated, none of which may end otherwise than by a result or one line.
"""

import copy
import random
import tomllib
from contextlib import suppress
from importlib.resources import files
from pathlib import Path
from typing import Any

import tomlkit

import certrack
from certrack.core.errors import CertrackError
from certrack.systems.reader import loads
from certrack.systems.writer import to_text
from fuzz.mutation import entry, mutated_bytes, paths, shuffled_list
from fuzz.runner import SEARCHED, UNTIMED, Finding, TooLong

CASES = Path(__file__).parents[1] / "data" / "cases"

#: Larger files take the time of many small ones and show nothing more.
LARGE = 10_000

REFERENCES = (
    {"kind": "triangle", "amplitude": 1, "period": 4},
    {"kind": "trapezoid", "amplitude": 1, "period": 4, "rise": 1},
    {"kind": "steps", "times": [1, 2], "levels": [0, 1, 0.5], "slope": 1},
    {"kind": "samples", "times": [0, 1, 2, 3], "values": [0, 1, 0, 1]},
    {
        "kind": "samples",
        "times": [0, 1, 2, 3],
        "values": [0, 1, 0, 1],
        "interpolation": "cubic",
    },
    *(
        {"signal": signal}
        for signal in (
            "abs(sin(t))",
            "max(sin(t),0.5)",
            "t",
            "exp(t)",
            "1/(t-1)",
            "sqrt(t)",
            "log(1+t)",
            "tan(t)",
            "sin(t**2)",
            "sign(sin(t))",
            "t**3*exp(-t)",
            "tanh(20*(t-1))",
            "atan(1/(t-1))",
            "exp(-((t-1)/0.02)**2)",
        )
    ),
)
ENSEMBLE = {
    "disturbance": "multisine",
    "sines": 3,
    "frequencies": [0.1, 10],
    "sampling": "latin",
    "points": 50,
    "limit": 1.0,
    "reference": {"amplitude": {"uniform": [0.5, 1]}, "frequency": {"loguniform": [0.5, 1]}},
}
IMPLEMENTATION = {
    "period": 0.001,
    "offset": 0.0,
    "delay": 1,
    "saturation": [-100, 100],
    "rate_limit": 1000,
    "input_quantum": 0.01,
    "seed": 1,
    "update": "euler",
    "anti_windup": "hold",
}
NUMBERS = (
    *(0, 1, -1, 2, 0.5, 1e-300, 1e300, 1.7e308, 5e-324, -0.0, 2**63, 2**64, 10**400, 1e-9),
    *(1e9, 1e6, 3, 7, 50, 51, -(2**70), 0.1, 1e-12, 1e12, 100000, 1e160, 1e-160, 4.076),
    *(float("inf"), float("-inf"), float("nan")),
)
TEXTS = (
    *("", "0", "1/0", "nan", "inf", "pi", "t", "x1", "x1**2", "x1*x2", "abs(x1)", "1e999"),
    *("exp(exp(exp(9)))", "9**9**9", "sin(x1)", "x1**0.5", "sqrt(x1)", "log(x1)", "1/x1"),
    *("max(x1,x2,1)", "sign(x1)", "x1**64", "((((1))))", "(lambda:1)()", "x1.__class__"),
    *('__import__("os").system("true")', "a b", "\u0661", "1_000", "0x10", "1j", "True"),
    *("None", "[1]", "x1 if x1 else 2", 'f"{1}"', "*", "é", "\uff581", "x1;x2", "x1\n+1", "\x00"),
    *("x1-x1", "0*x1", "x1/x1", "tan(x1)", "atan2(x1,0)", "atan2(0,0)", "acos(2)", "asin(x1)"),
    *("cosh(x1)", "min(x1)", "x" * 11000, "(" * 101 + ")" * 101, "-" * 150 + "1", "uniform"),
    *("latin", "sobol", "adaptive", "robust", "classic", "samples", "cubic", "taylor", "scipy"),
    *("implicit", "auto", "multisine", "file", "@0@", "0.1+0.2", "x1**-64", "(x1+1)**-2"),
    *("abs(abs(x1)-1)", "sin(1e300*x1)", "u", "e_1", "theta_hat_1", "y_d", "*/", "]]>", "$(*"),
    *("E", "I", "S", "N", "beta", "gamma", "lambda", "oo", "zoo", "4.076**0.0000001", "arctan"),
    *("M_L", "int", "double", "$\\frac{1}{2}$", "1e-7**1e-7", "(1/3)**(1/7)", "x1 < nan"),
)
KEYS = (
    "title plant truth reference law simulation ensemble implementation states units chain linear "
    "drift regressor gain_sign input_gain theta constants ranges uncertainty tau gamma beta omega "
    "rates outputs signal kind amplitude period offset start rise times levels slope values file "
    "interpolation bound bounds c k p feedforward Gamma gain_rate leak_gain leak_theta delta0 "
    "theta0 x0 duration estimates band tail tolerance integrator max_state delay saturation "
    "rate_limit input_quantum measurement_quantum noise noise_bound seed stream velocity "
    "velocity_filter update anti_windup projection initial_input disturbance sines frequencies "
    "sampling points limit frequency __class__ __init__ self"
).split()
SUFFIXES = (
    *("+1", "*2", "**2", "/3", "+abs(x1)", "*sin(x1)", " + t", "*0", "/0", "(", ")", "^2"),
    *("+x9", "*1e300", "**99", "**0.0000001"),
)
PIECES = [
    *(b"[", b"[[", b'"""', b"'''", b"\x00", b"\xff", b"=", b".", b"#", b"{", b"1e9999"),
    *(b"9" * 5000, b"[a.b.c]\n", b"\\u0000", b"\r", b"[" * 2000, b"a." * 5000, b"{a=" * 500),
    *(b"0x" + b"f" * 9000, b"x" * 30000, b'"' + b"x" * 30000 + b'"', b"[a]\n" * 50),
]


class Systems:
    """Whole system files."""

    name, suffix = "systems", ".toml"

    def __init__(self) -> None:
        self.texts = [
            path.read_bytes()
            for path in sorted(files("certrack.systems").joinpath("catalog").iterdir())
        ]
        self.texts.append(certrack.starter().encode())
        cases = [path.read_bytes() for path in sorted(CASES.glob("*.toml"))]
        self.texts += [text for text in cases if len(text) < LARGE]
        self.tables = [tomllib.loads(text.decode()) for text in self.texts]
        for table in list(self.tables):
            extended = copy.deepcopy(table)
            extended.setdefault("ensemble", copy.deepcopy(ENSEMBLE))
            extended.setdefault("implementation", copy.deepcopy(IMPLEMENTATION))
            self.tables.append(extended)

    def make(self, rng: random.Random) -> bytes:
        while True:
            if rng.random() < 0.2:
                text = rng.choice(self.texts)
                start = rng.randrange(len(text))
                return mutated_bytes(rng, text, [*PIECES, text[start : start + 60]])
            try:
                return tomlkit.dumps(self._mutated(rng)).encode()
            except Exception:  # tomlkit writes no None, no empty key
                continue

    def _mutated(self, rng: random.Random) -> dict[str, Any]:
        tables = copy.deepcopy(rng.choice(self.tables))
        if rng.random() < 0.25:
            tables["reference"] = copy.deepcopy(rng.choice(REFERENCES))
        if rng.random() < 0.1:
            other = rng.choice(self.tables)
            name = rng.choice(list(other))
            tables[name] = copy.deepcopy(other[name])
        for _ in range(rng.choice([0, 1, 1, 1, 1, 2, 2, 3, 5])):
            found = paths(tables)
            if not found:
                break
            *place, key = rng.choice(found)
            around, kind = entry(tables, tuple(place)), rng.random()
            if kind < 0.6:
                around[key] = tweaked(rng, around[key])
            elif kind < 0.75:
                around[key] = value(rng)
            elif kind < 0.85:
                del around[key]
            elif isinstance(around, dict):
                around[rng.choice([*KEYS, ""])] = value(rng)
            else:
                around.append(value(rng))
        return tables

    def examine(self, data: bytes) -> str:
        try:
            system = loads(data)
        except CertrackError as refusal:
            one_line(refusal)
            return "refused"
        text = to_text(system)
        try:
            again = loads(text)
        except CertrackError as refusal:
            raise Finding(f"what was written is refused: {refusal.args[:1]}") from None
        if again != system:
            raise Finding("what was written is another system")
        if to_text(again) != text:
            raise Finding("what was written twice differs")
        return self._used(system, random.Random(data))

    def _used(self, system: certrack.System, rng: random.Random) -> str:
        """Use a few of the systems; a word for what was done."""
        kind = rng.random()
        if kind > 0.25:
            return "loaded"
        try:
            if kind > 0.1:
                str(system.design())
                return "loaded, designed"
            if kind > 0.07:
                certrack.certify(system)
                return SEARCHED
            duration = min(system.settings.duration, 0.02)
            integrator = "auto" if system.implementation else rng.choice(["scipy", "implicit"])
            settings = {"duration": duration, "tail": None, "integrator": integrator}
            with suppress(TooLong):  # any number of steps may be needed
                certrack.simulate(system.with_settings(**settings)).summary()
            return UNTIMED
        except CertrackError as refusal:
            one_line(refusal)
            return "loaded, then refused"


def one_line(refusal: CertrackError) -> None:
    text = str(refusal)
    if "\n" in text or len(text) > 3000 or not text.strip():
        raise Finding("a message that is not one line") from None


def value(rng: random.Random, depth: int = 0) -> Any:
    """Any value."""
    kind = rng.random()
    if kind < 0.35:
        return rng.choice(NUMBERS)
    if kind < 0.7:
        return rng.choice(TEXTS)
    if kind < 0.75:
        return rng.random() < 0.5
    if kind < 0.9 and depth < 3:
        count = rng.choice([0, 1, 2, 3, 4, 5, 51]) if depth == 0 else rng.randrange(4)
        return [value(rng, depth + 1) for _ in range(count)]
    if depth < 3:
        return {
            rng.choice([*KEYS, *TEXTS[:8]]): value(rng, depth + 1) for _ in range(rng.randrange(3))
        }
    return rng.uniform(-10, 10)


def tweaked(rng: random.Random, old: Any) -> Any:
    """A value near the old one, of its type or nearly."""
    kind = rng.random()
    if isinstance(old, bool):
        return not old
    if isinstance(old, (int, float)):
        try:
            if kind < 0.3:
                return old * rng.choice([-1, 2, 0.5, 10, 0.1, 1e3, 1e-3, 1e6])
            if kind < 0.5:
                return old + rng.choice([-1, 1, 1e-9])
        except OverflowError:
            return 0
        return str(old) if kind < 0.6 else rng.choice(NUMBERS)
    if isinstance(old, str):
        if kind < 0.4:
            return old + rng.choice(SUFFIXES)
        if kind < 0.6:
            function = rng.choice(["-", "sin", "cos", "abs", "exp", "log", "sqrt", "max", "tanh"])
            return f"{function}({old})"
        if kind < 0.7 and old:
            i = rng.randrange(len(old))
            return old[:i] + rng.choice("()*/+-x1. e\\\"'_é\x00") + old[i + 1 :]
        return rng.choice(TEXTS)
    if isinstance(old, list):
        return shuffled_list(rng, old, lambda: value(rng, 1))
    return value(rng)
