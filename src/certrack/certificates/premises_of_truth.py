"""The premises of a certificate, held against the truth of the same file."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from fractions import Fraction

import numpy as np
import sympy

from certrack.certificates.assumption_1 import UncertainTerm, uncertain_terms
from certrack.certificates.assumptions import irrational_numbers
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.cover import Cover, smallest_cover
from certrack.certificates.domain import NONNEGATIVE, NONZERO, Condition, conditions, undefined_at
from certrack.certificates.premise import ASSUMED, CHECKED, CONTRADICTED, PROVEN, Premise
from certrack.certificates.reference_premise import reference_premise
from certrack.certificates.sampling import RANDOM_POINTS, Points, random_points
from certrack.certificates.stated import stated_error_system
from certrack.core.expressions import TIME, Expression, parse
from certrack.core.powers import put_in
from certrack.core.rounding import rounded_range
from certrack.laws.error_system import KnownParameters
from certrack.model.plant import Plant
from certrack.systems.system import System

#: Seed of the samples: the same file has the same premises everywhere.
SEED = 0

#: Names that are not of a state, in the order of the list.
PLANT, GAIN, THETA, DOMAIN, IRRATIONAL, CONTINUOUS_LAW = (
    "plant",
    "input gain",
    "theta",
    "domain",
    "irrational numbers",
    "continuous law, exact states",
)

#: Random states at which two formulas are compared, digits of the comparison, and what they may
#: differ by: they differ in a constant, or not at all.
COMPARED_POINTS, FORMULA_DIGITS, SAME = 60, 40, 1e-30


def premises(system: System) -> tuple[Premise, ...]:
    """What a certificate of `system` rests on, and whether the file's own truth keeps it.

    Parameters
    ----------
    system : System

    Returns
    -------
    tuple of Premise
        In a fixed order. The same system has the same premises everywhere: samples have a seed.

    Examples
    --------
    >>> import certrack
    >>> {p.status for p in premises(certrack.load("example1"))}
    {'proven'}
    """
    return tuple(_premises(system))


def _premises(system: System) -> Iterator[Premise]:
    points = random_points(system.plant.n, system.settings.duration, SEED)
    yield _plant(system)
    if not system.truth.states:
        yield _input_gain(system)
        if system.plant.r:
            yield _theta(system)
        yield from (_term(term, points) for term in uncertain_terms(system))
    yield _domain(system, points)
    yield reference_premise(system)
    rounded = irrational_numbers(system)
    if rounded:
        yield Premise(IRRATIONAL, ASSUMED, f"rounded to 17 digits: {', '.join(rounded)}")
    if system.implementation is not None:
        yield Premise(
            CONTINUOUS_LAW,
            ASSUMED,
            "the law runs in continuous time on exact states; sampling, delay, limits and sensors "
            "of [implementation] are left out",
            remedy="certrack margin tells how far the sampled loop may go",
        )


def _plant(system: System) -> Premise:
    plant, truth = system.plant, system.truth
    if truth.states:
        return Premise(
            PLANT,
            ASSUMED,
            "the simulated plant, which has states of its own, differs from the design's by no "
            "more than w, that is within gamma and beta",
            remedy="certrack ensemble --limit with the bound may refute it",
        )
    design, built = _as_built(system), plant.with_constants(**dict(truth.constants))
    ranged, unsure = plant.constant_boxes, False
    stated = {
        name: value
        for name, value in truth.constants
        if value.expr != plant.constant_values[name] or name in ranged
    }
    for key, ours, theirs in _pairs(design, built):
        a, b = _numeric(ours.expr, design), _numeric(theirs.expr, built)
        same = _same(a, b, plant.symbols)
        if same is False:
            names = ", ".join(f"{name} = {value}" for name, value in stated.items())
            return Premise(
                PLANT,
                CONTRADICTED,
                f"plant.{key} is another with truth.constants ({names})",
                {name: float(value.expr) for name, value in stated.items()},
                f"remove truth.constants, or set plant.constants to {names}; a difference may "
                "also be written into truth.omega and covered by gamma and beta",
            )
        unsure |= same is None
    if unsure:
        detail = f"the same formulas with truth.constants at {COMPARED_POINTS} random states"
        return Premise(PLANT, CHECKED, detail)
    detail = "chain, linear, drift and regressor exactly as in the file"
    if ranged:
        varying = "varying in time" if plant.uncertainty.constants_vary else "standing still"
        named_ranges = ", ".join(f"{k} in {rounded_range(*ends)}" for k, ends in ranged.items())
        detail += f", with {named_ranges}, {varying}; the true values among them"
    return Premise(PLANT, PROVEN, detail)


def _pairs(design: Plant, built: Plant) -> Iterator[tuple[str, Expression, Expression]]:
    """Key and formula of everything in chain, linear, drift and regressor of two plants."""
    for name in ("chain", "regressor"):
        for ours, theirs in zip(getattr(design, name), getattr(built, name), strict=True):
            yield name, ours, theirs
    for ours_row, theirs_row in zip(design.linear or (), built.linear or (), strict=True):
        yield from (("linear", *pair) for pair in zip(ours_row, theirs_row, strict=True))
    yield "drift", design.drift, built.drift


def _as_built(system: System) -> Plant:
    """The design's plant with the true values of the constants that have a range."""
    plant = system.plant
    true = {name: v for name, v in system.truth.constants if name in plant.constant_boxes}
    return plant.with_constants(**true)


def _numeric(formula: sympy.Expr, plant: Plant) -> sympy.Expr:
    """The formula with the values of the plant's constants."""
    constants = plant.constant_values
    return put_in(
        formula, {s: constants[s.name] for s in formula.free_symbols if s.name in constants}
    )


def _same(a: sympy.Expr, b: sympy.Expr, states: Sequence[sympy.Symbol]) -> bool | None:
    """Whether two formulas are the same; None if they are at random states, which is no proof."""
    if a == b or sympy.expand(a - b) == 0:
        return True
    random = np.random.default_rng(SEED)
    for _ in range(COMPARED_POINTS):
        size = sympy.Rational(10) ** int(random.integers(-2, 4))
        x = [size * sympy.Rational(int(v), 1000) for v in random.integers(-1000, 1001, len(states))]
        place = dict(zip(states, x, strict=True))
        gap = sympy.N((a - b).xreplace(place), FORMULA_DIGITS)
        if gap is sympy.nan:  # neither has a value there
            continue
        if not gap.is_number or abs(gap) > SAME * (1 + abs(sympy.N(a.xreplace(place), 20))):
            return False
    return None


def _equal(a: sympy.Expr, b: sympy.Expr) -> bool:
    """Whether two numbers are the same, to 40 digits."""
    return _same(a, b, ()) is not False


def _knows_parameters(system: System) -> bool:
    """Whether the law uses the plant's g_n and theta themselves, by the error system it states."""
    try:
        return isinstance(stated_error_system(system, integral=True, moving=True), KnownParameters)
    except NoCertificate:
        return False


def _follows_ranges(system: System, value: Expression | None) -> bool:
    """Whether a number of the plant is a formula of constants that have a range."""
    if value is None:
        return False
    return bool(parse("", value, system.plant.open_values).expr.free_symbols)


def _input_gain(system: System) -> Premise:
    plant, truth = system.plant, system.truth
    assert truth.input_gain is not None
    true = truth.input_gain
    if plant.input_gain_range is not None:  # the loader refuses a truth outside
        stated = rounded_range(*plant.input_gain_range)
        return Premise(GAIN, PROVEN, f"every g_n in {stated}, the true one among them")
    built = _as_built(system).input_gain
    if not _knows_parameters(system) and not _follows_ranges(system, plant.input_gain):
        return Premise(GAIN, PROVEN, f"the true g_n = {true} (the file gives no range)")
    assert plant.input_gain is not None and built is not None
    if _equal(true.expr, built.expr):
        known = f"g_n = {plant.input_gain}"
        how = "of the constants in their ranges" if plant.constant_ranges else "as the law uses it"
        return Premise(GAIN, PROVEN, f"{known} exactly {how}")
    if _follows_ranges(system, plant.input_gain):
        return Premise(
            GAIN,
            CONTRADICTED,
            f"with the true constants g_n = {plant.input_gain} is {float(built.expr):.6g}, the "
            f"true one is {float(true.expr):.6g}",
            {"true": float(true.expr), "assumed": float(built.expr)},
            f'write truth.input_gain = "{plant.input_gain}", and the true value of its constants '
            "in truth.constants; or state plant.ranges.input_gain in the place of their ranges",
        )
    values = {"true": float(true.expr), "assumed": float(plant.input_gain.expr)}
    return Premise(
        GAIN,
        CONTRADICTED,
        f"the law divides by g_n = {values['assumed']:.6g}, the true one is {values['true']:.6g}",
        values,
        f"set plant.input_gain to {values['true']:.6g}; or state plant.ranges.input_gain and use "
        'law.kind = "adaptive"',
    )


def _theta(system: System) -> Premise:
    plant, truth = system.plant, system.truth
    if plant.theta_range is not None:
        return Premise(THETA, PROVEN, "every theta in its range, the true one among them")
    true = [value.expr for value in truth.theta]
    open_theta = any(_follows_ranges(system, value) for value in plant.theta or ())
    if not _knows_parameters(system) and not open_theta:
        return Premise(THETA, PROVEN, "the true theta of the file (it gives no range)")
    known = [value.expr for value in _as_built(system).theta or ()]
    if all(_equal(a, b) for a, b in zip(true, known, strict=True)):
        how = "of the constants in their ranges" if plant.constant_ranges else "as the law uses it"
        return Premise(THETA, PROVEN, f"theta exactly {how}")
    if open_theta:
        listed = ", ".join(f'"{value}"' for value in plant.theta or ())
        return Premise(
            THETA,
            CONTRADICTED,
            f"with the true constants theta is {_listed([float(v) for v in known])}, the true one "
            f"is {_listed([float(v) for v in true])}",
            {"true": [float(v) for v in true], "assumed": [float(v) for v in known]},
            f"write truth.theta = [{listed}], and the true value of its constants in "
            "truth.constants; or state plant.ranges.theta in the place of their ranges",
        )
    values = {"true": [float(v) for v in true], "assumed": [float(v) for v in known]}
    return Premise(
        THETA,
        CONTRADICTED,
        f"the law uses theta = {_listed(values['assumed'])}, the true one is "
        f"{_listed(values['true'])}",
        values,
        f"set plant.theta to {_listed(values['true'])}; or state plant.ranges.theta and use "
        'law.kind = "adaptive"',
    )


def _listed(values: Sequence[float]) -> str:
    return f"[{', '.join(f'{v:.6g}' for v in values)}]"


def _term(term: UncertainTerm, points: Points) -> Premise:
    name, tau = term.name, f"tau |{term.name}|"
    if term.zero:
        return Premise(name, PROVEN, f"{tau} = 0")
    bound = f"{tau} <= {term.allowance}"
    if term.proven:
        return Premise(name, PROVEN, f"{bound} for all t and x (Assumption 1)")
    violation = term.violation(points)
    if violation is None:
        how = f"no point beyond it among {RANDOM_POINTS} random ones, the worst polished"
        return Premise(name, CHECKED, f"{bound} (Assumption 1): {how}")
    place = {"t": violation.t, "x": list(violation.x)}
    value = None if math.isnan(violation.value) else violation.value
    point = f"t = {violation.t:.4g}, x = {_listed(violation.x)}"
    if value is None:
        detail, remedy = f"{name} has no value at {point}", violation.remedy
    else:
        detail = f"{tau} = {value:.6g} > {violation.limit:.6g} at {point} (Assumption 1)"
        remedy = widening(term, smallest_cover(term, points))
    return Premise(
        name, CONTRADICTED, detail, {**place, "value": value, "limit": violation.limit}, remedy
    )


def widening(term: UncertainTerm, cover: Cover) -> str:
    """What makes Assumption 1 hold for a term that breaks it, in words."""
    k = term.k
    if term.growing is not None:
        return f"raise plant.uncertainty.bound[{k}], or bound truth.omega[{k}] (tanh, min, max)"
    if not term.tau:
        return f"set plant.uncertainty.tau[{k}] to {_number(term.strength)}, with gamma and beta"
    options = [] if cover.gamma is None else [f"widen gamma[{k}] to {cover.gamma:g}"]
    options += [] if cover.beta is None else [f"widen beta[{k}] to {cover.beta:g}"]
    if cover.both is not None:
        options = [f"widen gamma[{k}] to {cover.both[0]:g} and beta[{k}] to {cover.both[1]:g}"]
    if options:
        return " or ".join(options)
    return (
        f"no gamma and beta were found to cover it: {term.name} grows faster than ||x||. Bound "
        f"truth.omega[{k}] (tanh, min, max), or move its known part into plant.drift"
    )


def _number(value: Fraction) -> str:
    return f"{float(value):.6g}"


def formulas_of_states(system: System) -> tuple[dict[str, sympy.Expr], str]:
    """What must have a value wherever the states are, by its key, and all of it in words."""
    plant, online = system.plant, system.law.online
    formulas, named = {"plant.drift": plant.drift.expr}, "drift and regressor"
    formulas |= {f"plant.regressor[{i}]": v.expr for i, v in enumerate(plant.regressor)}
    if online is not None and online.schedule is not None:
        formulas["law.online.schedule"] = online.formula(plant)
        named = "drift, regressor and schedule"
    return {key: _numeric(formula, plant) for key, formula in formulas.items()}, named


def _domain(system: System, points: Points) -> Premise:
    plant, unproven = system.plant, False
    formulas, named = formulas_of_states(system)
    for key, exact in formulas.items():
        undefined = undefined_at(exact, plant.symbols, points)
        if undefined is not None:
            condition, where = undefined
            x, t = where.x[:, 0].tolist(), float(where.t[0])
            at = f"t = {t:.4g}, x = {_listed(x)}" if exact.has(TIME) else f"x = {_listed(x)}"
            return Premise(
                DOMAIN,
                CONTRADICTED,
                f"{key} has no value at {at}: {condition}",
                {"t": t, "x": x},
                f"the claim is of all states: {_rewriting(condition)}",
            )
        unproven |= not all(c.proven(plant.symbols) for c in conditions(exact))
    if unproven:
        detail = f"{named} are defined at {RANDOM_POINTS} random states"
        return Premise(DOMAIN, CHECKED, detail)
    return Premise(DOMAIN, PROVEN, f"{named} are defined for every state")


def _rewriting(condition: Condition) -> str:
    """A formula that is defined everywhere in the place of one that is not."""
    g = condition.inside
    if condition.must_be == NONNEGATIVE:
        return f"write max({g}, 0) there if the plant keeps away from negative ones"
    if condition.must_be == NONZERO:
        return f"write sqrt(({g})**2 + 0.001**2) there, or move the singular part into the input"
    return f"write max({g}, 0.001) there if the plant keeps above it"
