"""The runs that the claims are judged by."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

from certrack.certificates import Certificates, certify
from certrack.papers.liu2025.measures import Response, response
from certrack.references import Reference, SymbolicReference, triangle
from certrack.simulation.run import Run
from certrack.simulation.simulator import Simulator, simulate
from certrack.systems.reader import load
from certrack.systems.system import System

#: A start of Example 1 and the sign of its y_d.
Variant = tuple[tuple[int, int], int]

#: The signs that the shipped files have.
AS_SHIPPED: Variant = ((1, 2), 1)

#: Starts of Example 2: the paper gives x1(0) apart from x2(0) = x3(0), so one of both is negative;
#: the first would be written otherwise.
MOTOR_STARTS = ((1, 1, 1, 0), (-1, 1, 1, 0), (1, -1, -1, 0))

#: The systems whose bounds are compared with what happens.
CERTIFIED = ("example1", "dual-motor", "dual-motor-strong", "dual-motor-lean")

COUNTEREXAMPLE = "theorem1-counterexample"


@dataclass(frozen=True)
class PaperRuns:
    """Runs and certificates of the paper's systems.

    Attributes
    ----------
    example1 : dict
        Runs of the improved and the classic law by the signs of x(0) and y_d.
    weak, strong : Run
        Example 2 with tau = 1 and 5.
    starts : dict
        Example 2, tau = 1, by x(0).
    lean : Run
        Example 2 without damping terms, our design.
    triangle : Run
        Example 1 with a triangle as reference, improved law.
    counterexample, confirmation : Run
        The system that exceeds (42), by the Taylor method and by SciPy.
    certificates : dict
        By the name of the shipped system.
    """

    example1: dict[Variant, tuple[Run, Run]]
    weak: Run
    strong: Run
    starts: dict[tuple[int, ...], Run]
    lean: Run
    triangle: Run
    counterexample: Run
    confirmation: Run
    certificates: dict[str, Certificates]

    @cached_property
    def laws(self) -> tuple[Response, Response]:
        """Example 1 as shipped: improved and classic law."""
        improved, classic = self.example1[AS_SHIPPED]
        return response(improved), response(classic)

    @cached_property
    def motors(self) -> tuple[Response, Response]:
        """Example 2: tau = 1 and 5."""
        return response(self.weak), response(self.strong)


def paper_runs(begin: Callable[[str], None] = lambda _: None) -> PaperRuns:
    """Run and certify everything; `begin` gets a text that says what is being done."""
    begin("Example 1, every sign of x(0) and y_d")
    variants = dict(example1_variants())
    begin("Example 2")
    motor = Simulator(load("dual-motor"))
    refuting = load(COUNTEREXAMPLE)
    begin("A system that exceeds the bound (42)")
    runs = simulate(refuting), simulate(refuting, integrator="scipy")
    certificates = {}
    for name in (*CERTIFIED, COUNTEREXAMPLE):
        begin(f"Certifying {name}")
        certificates[name] = certify(load(name))
    return PaperRuns(
        example1=variants,
        weak=motor.run(),
        strong=motor.run(load("dual-motor-strong")),
        starts={x0: motor.run(motor.system.with_settings(x0=x0)) for x0 in MOTOR_STARTS},
        lean=simulate(load("dual-motor-lean")),
        triangle=simulate(replace(load("example1"), reference=triangle_reference())),
        counterexample=runs[0],
        confirmation=runs[1],
        certificates=certificates,
    )


def triangle_reference() -> Reference:
    """As high and as long as Example 1's cosine; its second derivative is unbounded."""
    return triangle(amplitude=0.2, period=2 * math.pi)


def example1_variants() -> Iterator[tuple[Variant, tuple[Run, Run]]]:
    """Example 1 with every sign of x(0) and y_d: improved and classic law."""
    improved, classic = load("example1"), load("example1-classic")
    for sign in (1, -1):
        pair = [Simulator(_variant(law, (1, 2), sign)) for law in (improved, classic)]
        for x0 in product((1, -1), (2, -2)):
            runs = [s.run(_variant(s.system, x0, sign)) for s in pair]
            yield (x0, sign), (runs[0], runs[1])


def _variant(system: System, x0: tuple[int, int], sign: int) -> System:
    """Example 1 from the start `x0`, with the sign of y_d = +-0.2 cos t.

    y_d -> -y_d is a shift by pi in cos, so the compiled loop would differ; each sign has its own.
    """
    reference = SymbolicReference("0.2*cos(t)" if sign > 0 else "-0.2*cos(t)", bound=0.4)  # type: ignore[arg-type]
    return replace(system, reference=reference).with_settings(x0=x0)


def scaled_damping(system: System, factor: float) -> System:
    """The system with every k and p of its law multiplied by `factor`."""
    gains = system.law.gains()
    assert gains.k is not None and gains.p is not None
    k = tuple(tuple(factor * value for value in row) for row in gains.k)
    p = tuple(factor * value for value in gains.p)
    return replace(system, law=replace(system.law, k=k, p=p))  # type: ignore[call-arg]
