"""Parts that are built in Python: what does not fit is refused at once, in one line."""

from dataclasses import replace

import numpy as np
import pytest

import certrack
from certrack.core.errors import InputError
from certrack.model.distribution import Distribution
from certrack.model.plant import Plant
from certrack.model.population import Population
from certrack.model.truth import Truth
from certrack.references import SymbolicReference
from certrack.studies.falsifier.falsify import falsify

EXAMPLE = certrack.load("example1")
TWICE = (("A", 1), ("A", 2))
REFUSED = {
    "constant named t": (lambda: SymbolicReference("t", constants={"t": 1}), "constants.t"),
    "constant named pi": (lambda: SymbolicReference("pi", constants={"pi": 1}), "constants.pi"),
    "constant named sin": (lambda: SymbolicReference("1", constants={"sin": 1}), "constants.sin"),
    "constant twice": (lambda: SymbolicReference("A", constants=TWICE), "constants.A"),
    "constant without value": (lambda: SymbolicReference("A", constants=("A",)), "constants"),
    "constant of no name": (lambda: SymbolicReference("1", constants={3: 1}), "constants"),
    "constants no table": (lambda: SymbolicReference("1", constants=3), "constants"),
    "constant no number": (lambda: SymbolicReference("A", constants={"A": "x"}), "constants.A"),
    "no reference": (lambda: EXAMPLE.replace(reference=None), "reference"),
    "number as reference": (lambda: EXAMPLE.replace(reference=3), "reference"),
    "text as reference": (lambda: EXAMPLE.replace(reference="x"), "reference"),
    "class as reference": (lambda: EXAMPLE.replace(reference=SymbolicReference), "reference"),
    "gain 0": (lambda: Truth(0), "truth.input_gain"),
    "gain nan": (lambda: Truth("nan"), "truth.input_gain"),
    "gain inf": (lambda: Truth("inf"), "truth.input_gain"),
    "gain of t": (lambda: Truth("1 + t"), "truth.input_gain"),
    "truth's constant twice": (lambda: Truth(1, constants=TWICE), "truth.constants.A"),
    "truth's constant of no name": (lambda: Truth(1, constants={2: 1}), "truth.constants"),
    "varied twice": (lambda: Population(constants=TWICE), "ensemble.constants.A"),
    "varied without name": (lambda: Population(constants={None: 1}), "ensemble.constants"),
    "set for a list": (lambda: Truth(1, theta={1, 2}), "truth.theta"),
    "states in a set": (lambda: Plant({"x", "y"}, [1]), "plant.states"),
    "array without dimensions": (lambda: Truth(1, theta=np.array(3.0)), "truth.theta"),
    "array as bounds": (lambda: Plant(["x"], uncertainty=np.ones(3)), "plant.uncertainty"),
    "array as number": (lambda: replace(EXAMPLE.law, k=[np.ones(2)] * 2), "law.k"),
    "unknown setting": (lambda: EXAMPLE.with_settings(foo=1), "settings.foo"),
    "unknown setting of a run": (lambda: certrack.simulate(EXAMPLE, foo=1), "settings.foo"),
    "name for a system": (lambda: certrack.simulate("example1"), "system"),
    "number for a file": (lambda: certrack.load(3), "source"),
    "negative seed": (lambda: falsify(EXAMPLE, seed=-1), "seed"),
    "no budget": (lambda: falsify(EXAMPLE, budget=0), "budget"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_it_is_refused_in_one_line(what):
    make, key = REFUSED[what]
    with pytest.raises(InputError) as caught:
        make()
    message = str(caught.value)
    assert key in message.partition(": ")[0]
    assert "\n" not in message


def test_quantiles_of_a_wide_loguniform():
    wide = Distribution("loguniform", (1e-300, 1e300))
    found = wide.quantile(np.array([0.0, 0.25, 0.5, 1.0]))
    assert found == pytest.approx([1e-300, 1e-150, 1.0, 1e300], rel=1e-12)
