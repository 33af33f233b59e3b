"""Ranges of constants: hulls, kernels, proofs, and searches that try to beat them."""

import itertools
import math
import re
from dataclasses import replace
from fractions import Fraction

import flint
import numpy as np
import pytest
import sympy
from depth import depth
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import quad_vec
from scipy.linalg import expm

import certrack
from certrack.certificates.arithmetic import rational
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import float_up, from_text
from certrack.certificates.ranges.attainable import worst_reference
from certrack.certificates.ranges.cells import halved
from certrack.certificates.ranges.certify import certify_ranges
from certrack.certificates.ranges.kernels import peak_gains
from certrack.certificates.ranges.loop import error_form, ranged_loop
from certrack.certificates.ranges.proofs import RangeProver, cells_fill, check_cells, numbers, texts
from certrack.certificates.ranges.rational import MAX_HULL_POINTS, RationalVector
from certrack.certificates.ranges.search import bound_ranges
from certrack.certificates.ranges.tube import range_tube
from certrack.certificates.ranges.vertices import ProblemMaker, VertexProgram, prove_vertices
from certrack.certificates.semidefinite import best_solution
from certrack.core.errors import InputError
from certrack.core.expressions import symbol

CASES = "tests/data/cases"
Q = flint.fmpq


def case(name, **changes):
    """A case's system, with every range that its file offers where `all_ranges`."""
    from pathlib import Path

    text = (Path(__file__).parent / "data" / "cases" / f"{name}.toml").read_text()
    if changes.get("all_ranges"):
        text = re.sub(r"^# (Ia|Jeq)", r"\1", text, flags=re.M)
    return certrack.loads(text)


def seven_constants():
    """The flexible joint with seven constants within 0.2 %."""
    nominal = {
        "Ia": "2.773278e-3",
        "da": "6.5407e-4",
        "c0": "0.9898",
        "Jeq": "0.00208",
        "Rm": "2.6",
        "kt": "0.00767",
        "Kg": "70",
    }
    joint = case("ranges-joint")
    ranges = {name: [f"0.998*{v}", f"1.002*{v}"] for name, v in nominal.items()}
    return joint.replace(plant=replace(joint.plant, constant_ranges=ranges))


def exact(matrix):
    return np.vectorize(rational, otypes=[object])(np.asarray(matrix, dtype=float))


# hulls


def test_the_trap_whose_corners_lie():
    """d m/(m^2 + J): 0.8 at the corners, 1.0 inside."""
    d, m, J = map(symbol, "dmJ")
    box = [(Q(1), Q(2)), (Q(1, 2), Q(3)), (Q(1), Q(2))]
    vector = RationalVector.of([d * m / (m**2 + J)], [d, m, J])
    corners = [vector.at(point)[0] for point in itertools.product(*box)]
    assert float(max(corners)) == pytest.approx(0.8)
    assert vector.ends(box)[1][0] >= 1
    cells = [tuple(box)]
    for _ in range(9):
        cells = [part for cell in cells for part in halved(cell, [1, 1, 1])]
    assert 1 <= float(max(vector.ends(cell)[1][0] for cell in cells)) < 1.02


def test_p_and_its_inverse_lie_in_a_triangle():
    m = symbol("m")
    points = RationalVector.of([m, 1 / m], [m]).points([(Q(1, 2), Q(2))])
    assert [tuple(map(float, p)) for p in points] == [(0.5, 2), (0.8, 0.8), (2, 0.5)]


FUNCTIONS = [
    "a", "1/a", "a*b", "a/b", "a + 1/a", "a**2", "b/a**2", "a*b/(a + b)", "1/(a + b)", "a**3 - b",
    "a/(1 + a*b)", "3/7",
]  # fmt: skip


@given(
    texts_=st.lists(st.sampled_from(FUNCTIONS), min_size=1, max_size=4),
    ends=st.lists(st.integers(1, 40), min_size=4, max_size=4, unique=True),
)
@settings(max_examples=60, deadline=None)
def test_hulls_contain_what_they_stand_for(texts_, ends):
    """Dense samples are convex combinations of the points, by linear programming."""
    from scipy.optimize import linprog

    a, b = map(symbol, "ab")
    entries = [sympy.sympify(text, locals={"a": a, "b": b}) for text in texts_]
    low, high = sorted(ends[:2]), sorted(ends[2:])
    box = [(Q(low[0], 10), Q(low[1], 10)), (Q(high[0], 10), Q(high[1], 10))]
    vector = RationalVector.of(entries, [a, b])
    points = np.array([p.astype(float) for p in vector.points(box)])
    f = sympy.lambdify([a, b], entries)
    for u, v in itertools.product(np.linspace(0, 1, 4), repeat=2):
        value = f(
            *(float(lo) + w * float(hi - lo) for w, (lo, hi) in zip((u, v), box, strict=True))
        )
        size = np.abs(points).max(axis=0) + 1e-9
        found = linprog(
            np.zeros(len(points)),
            A_eq=np.vstack([(points / size).T, np.ones(len(points))]),
            b_eq=np.append(np.array(value, dtype=float) / size, 1.0),
            method="highs",
        )
        assert found.status == 0, (value, points)


def test_a_denominator_that_may_vanish_is_refused():
    m = symbol("m")
    with pytest.raises(NoCertificate, match="may vanish"):
        RationalVector.of([1 / (m - 2)], [m]).points([(Q(1), Q(3))])


@given(st.integers(0, 10**6))
@settings(max_examples=40, deadline=None)
def test_covers_are_recognised(seed):
    rng = np.random.default_rng(seed)
    box = ((Q(0), Q(1)), (Q(1), Q(3)))
    cells = [box]
    for _ in range(int(rng.integers(0, 9))):
        i = int(rng.integers(len(cells)))
        cells[i : i + 1] = halved(cells[i], [1, 1])
    assert cells_fill(cells, box)
    missing = cells[:-1] if len(cells) > 1 else []
    assert not cells_fill(missing, box)
    (a, b), other = cells[0]
    shrunk = [((a, b - (b - a) / 1000), other), *cells[1:]]
    assert not cells_fill(shrunk, box)


# kernels


@pytest.mark.slow
@given(st.integers(0, 10**6))
@settings(max_examples=20, deadline=None)
def test_peak_gains_are_above_and_near_the_integrals(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 5))
    M = np.round(rng.normal(size=(n, n)) * 10.0 ** rng.uniform(-1, 1), 3)
    M -= np.round(np.linalg.eigvals(M).real.max() + 10.0 ** rng.uniform(-1, 1), 3) * np.eye(n)
    values = np.linalg.eigvals(M)
    assume(values.real.max() < -0.05 and np.abs(values).max() < 100)
    C, B = np.round(rng.normal(size=(2, n)), 2), np.round(rng.normal(size=(n, 2)), 2)
    bound = peak_gains(exact(M), exact(C), exact(B))
    slow, fast = -values.real.max(), np.abs(values).max()
    edges = np.concatenate([[0], np.geomspace(1e-3 / fast, 40 / slow, 400)])
    total = np.zeros((2, 2))
    for a, b in itertools.pairwise(edges):
        total += quad_vec(lambda t: np.abs(C @ expm(M * t) @ B), a, b, epsrel=1e-7, limit=30)[0]
    assert (bound >= total * (1 - 1e-6)).all()
    assert (bound <= total * 1.01 + 1e-9).all()


def test_an_unstable_matrix_has_no_peak_gain():
    for M in ([[0.0]], [[1e-9]], [[0.0, 1.0], [-1.0, 0.0]], [[-1.0, 0.0], [0.0, 1e-12]]):
        one = np.eye(len(M))
        with pytest.raises(NoCertificate):
            peak_gains(exact(M), exact(one), exact(one))


# the loop as a function of its constants


@pytest.mark.parametrize("name", ["ranges-axis", "ranges-dual-motor", "ranges-joint"])
def test_the_nominal_loop_is_the_design(name):
    loop = ranged_loop(case(name))
    form = error_form(loop, loop.entries.at(loop.nominal))
    assert (loop.coordinates.error_matrix == form.M).all()
    assert (form.W[:, :-1] == 0).all() and (form.W[:, -1] == -loop.coordinates.R).all()
    assert not form.offset.any()


def random_system(rng, states=4, constants=3):
    """A chain of 2 to `states` states with 1 to `constants` constants in any rational form."""
    n = int(rng.integers(2, states + 1))
    names = ["a", "b", "d", "h"][: int(rng.integers(1, constants + 1))]
    forms = ["a", "1/a", "1"]
    forms += ["a*b", "a/b", "b"] if len(names) > 1 else []
    forms += ["d/b"] if len(names) > 2 else []
    forms += ["h/(a + h)", "d*h"] if len(names) > 3 else []

    def pick():
        return f"{rng.integers(1, 20) / 10}*{rng.choice(forms)}"

    states = [f"x{i + 1}" for i in range(n)]
    c = (rng.integers(20, 60, n) / 10).tolist()
    drift = " + ".join(f"({pick()})*{x}*{rng.integers(-20, 20) / 10}" for x in states)
    if rng.random() < 0.4:
        drift += f" + ({pick()})*tanh({states[-1]})"
    constants = {name: float(rng.integers(5, 30) / 10) for name in names}
    ranges = {}
    for name in names:
        low, high = rng.integers(2, 16, 2) / 100
        ranges[name] = [f"{constants[name]}*{1 - low:.2f}", f"{constants[name]}*{1 + high:.2f}"]
    q = int(rng.integers(0, n))
    plant = certrack.Plant(
        states=states,
        chain=[pick() for _ in range(n - 1)],
        linear=[
            [f"({pick()})*{rng.integers(-10, 10) / 10}" for _ in range(i + 1)] for i in range(n - 1)
        ],
        drift=drift,
        gain_sign=1,
        input_gain=pick(),
        constants=constants,
        constant_ranges=ranges,
        uncertainty={"tau": [1] * n, "gamma": [0] * n, "beta": [0] * (n - 1) + [0.1]},
    )
    return certrack.System(
        plant=plant,
        law=certrack.Robust(c=c, feedforward=q),
        reference=certrack.SymbolicReference("0.3*sin(0.7*t)"),
        truth=certrack.Truth(input_gain=plant.input_gain, omega=["0"] * (n - 1) + ["0.1*sin(2*t)"]),
        settings=certrack.Settings(x0=[0] * n, duration=30, tail=15),
    )


@pytest.mark.parametrize("seed", range(6))
def test_the_derived_loop_is_the_simulated_plant(seed):
    """e at the end of a run of a member, from (M, W) and from the plant's own equations."""
    rng = np.random.default_rng([seed, 1])
    system = random_system(rng)
    loop = ranged_loop(system)
    if loop.brackets:  # a nonlinear loop
        pytest.skip("not linear")
    point = [low + (high - low) * Q(int(rng.integers(0, 101)), 100) for low, high in loop.box]
    form = error_form(loop, loop.entries.at(point))
    n, q = loop.n, loop.coordinates.q
    values = {str(s): float(v) for s, v in zip(loop.symbols, point, strict=True)}
    member = system.replace(truth=replace(system.truth, constants=values)).with_settings(
        duration=5, tail=1, tolerance=1e-12
    )
    run = certrack.simulate(member)
    x = np.array(list(run.final_state.values())[:n])
    Y = system.reference.values(np.array([0.0, 5.0]), q + 1)
    A, B = loop.coordinates.A.astype(float), loop.coordinates.B.astype(float)
    from scipy.integrate import solve_ivp

    M, W = form.M.astype(float), form.W.astype(float)

    def rate(t, e):
        y = system.reference.values(np.array([t]), q + 1)[:, 0]
        return M @ e + W @ y + A[:, -1] * 0.1 * math.sin(2 * t) + form.offset.astype(float)

    e0 = -B @ Y[: q + 1, 0]
    found = solve_ivp(rate, (0, 5), e0, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    expected = A @ x - B @ Y[: q + 1, 1]
    assert np.abs(found - expected).max() <= 1e-9 * (1 + np.abs(expected).max())


# proofs and searches


GOALS = {  # varying, fixed
    "ranges-axis": (0.00062, 0.00055),
    "ranges-dual-motor": (0.0103, 0.0034),
    "ranges-joint": (0.0335, 0.0263),
}


@pytest.mark.parametrize("name", GOALS)
def test_bounds_of_the_examples(name):
    system = case(name)
    prover = RangeProver(system)
    bounds = bound_ranges(prover, cells=True)
    varying, fixed = GOALS[name]
    assert float(bounds.vertices.bound) <= varying and prover.check(bounds.vertices) == ""
    cover = bounds.cells
    bound = max((proof.bound for proof in cover), key=float)
    assert float(bound) <= fixed and check_cells(system, cover, bound) == ""
    best = 0.0
    for corner in itertools.product(*prover.box):
        best = max(best, attained(prover.loop, corner))
    assert 0.94 <= best / float(bound) <= 1


def attained(loop, point):
    form = error_form(loop, loop.entries.at(point))
    u, A = loop.system.plant.uncertainty, loop.coordinates.A.astype(float)
    inputs = [A[:, k] * u.tau[k] * u.beta[k] for k in range(loop.n) if u.tau[k] * u.beta[k]]
    Y = loop.system.reference.bounds(loop.coordinates.q + 1).values
    found = worst_reference(
        form.M.astype(float),
        form.W.astype(float),
        np.array(inputs).reshape(-1, loop.n).T,
        form.offset.astype(float),
        Y,
    )
    return 0.0 if found is None else found.error


@pytest.mark.slow
def test_bounds_of_the_joint_with_three_ranges():
    system = case("ranges-joint", all_ranges=True)
    bounds = bound_ranges(RangeProver(system), cells=True)
    assert float(bounds.vertices.bound) <= 0.0541
    bound = max((proof.bound for proof in bounds.cells), key=float)
    assert float(bound) <= 0.0405
    assert check_cells(system, bounds.cells, bound) == ""


@pytest.mark.search
@pytest.mark.parametrize(
    "seed", [*range(3), *(pytest.param(s, marks=pytest.mark.slow) for s in range(3, depth(20, 60)))]
)
def test_no_member_corner_or_reference_exceeds_a_bound(seed):
    rng = np.random.default_rng([seed, 2])
    no_bound_is_exceeded(random_system(rng), rng)


@pytest.mark.slow
@given(st.integers(0, 10**6))
@settings(max_examples=30, deadline=None)
def test_no_bound_is_exceeded_with_up_to_five_states_and_four_constants(seed):
    rng = np.random.default_rng([seed, 3])
    no_bound_is_exceeded(random_system(rng, states=5, constants=4), rng)


def no_bound_is_exceeded(system, rng):
    """Neither by references and members at corners and inside, nor by runs from their starts."""
    try:
        prover = RangeProver(system)
    except NoCertificate:
        return
    loop = prover.loop
    proofs = [p for p in (prover.vertices(prover.box), prover.peak(prover.box)) if p]
    halves = [prover.peak(part) for part in halved(prover.box, [1] * len(prover.box))]
    if all(halves):
        proofs.append(max(halves, key=lambda proof: float(proof.bound)))
    if not proofs:
        return
    least = min(float(proof.bound) for proof in proofs)
    points = list(itertools.product(*prover.box))
    points += [
        tuple(low + (high - low) * Q(int(rng.integers(0, 101)), 100) for low, high in prover.box)
        for _ in range(3)
    ]
    if not loop.brackets:
        assert max(attained(loop, point) for point in points) <= least
    for point in points[:4] + points[-1:]:
        values = {str(s): float(v) for s, v in zip(loop.symbols, point, strict=True)}
        member = system.replace(truth=replace(system.truth, constants=values))
        run = certrack.simulate(member)
        assert run.metrics.tail_error <= least
        if proofs[0].points:
            assert (np.abs(run.e[0]) <= range_tube(system, proofs[0])(run.t)).all()


def test_a_mutated_proof_is_refused():
    system = case("ranges-dual-motor")
    prover = RangeProver(system)
    proof = prover.vertices(prover.box)
    assert prover.check(proof) == ""
    first, *rest = proof.points
    P = [list(row) for row in first.P]
    P[0][0] = str(float(P[0][0]) * 0.9)
    lower = f"{float(proof.bound) * (1 - 1e-6):.15g}"
    mutants = [
        replace(proof, bound=lower),
        replace(proof, bound=lower, points=tuple(replace(p, bound=lower) for p in proof.points)),
        replace(proof, points=(replace(first, P=tuple(map(tuple, P))), *rest)),
        replace(proof, points=tuple(replace(p, P=tuple(map(tuple, P))) for p in proof.points)),
        replace(proof, points=tuple(rest)),
        replace(proof, points=(replace(first, nu=("0",) * len(first.nu)), *rest)),
        replace(proof, points=(*rest, first)[::-1]),
        replace(proof, cell=((proof.cell[0][0], "7/10"), proof.cell[1])),
        replace(proof, points=()),
    ]
    assert all(prover.check(mutant) for mutant in mutants)
    cell = halved(prover.box, [1, 1])[0]
    whole = prover.peak(halved(cell, [1, 1])[0])
    assert prover.check(whole) == ""
    assert prover.check(replace(whole, bound=f"{float(whole.bound) * (1 - 1e-5):.12g}"))
    assert prover.check(replace(whole, cell=texts(cell)))


def test_many_functions_have_one_multiplier_each():
    """Where the hull has too many points: the inequality at the centre, weaker but proven."""
    prover = RangeProver(case("ranges-joint"))
    problem = ProblemMaker(prover.loop).at_centre(prover.coefficients, prover.box, None)
    proofs = prove_vertices([problem], best_solution(VertexProgram([problem.in_floats()])))
    assert float(prover.vertices(prover.box).bound) < float(proofs[0].bound) < 0.0338


@pytest.mark.slow
def test_seven_constants_are_proven_at_the_centre():
    """Their hull has more points than a proof may have; the one stage is checked at the centre."""
    system = seven_constants()
    prover = RangeProver(system)
    assert prover.loop.entries.count > MAX_HULL_POINTS
    with pytest.raises(NoCertificate, match="more than 256"):
        prover.loop.entries.points(prover.box)
    proof = prover.vertices(prover.box)
    assert len(proof.points) == 1 and prover.check(proof) == ""
    nominal = certrack.certify(system.replace(plant=replace(system.plant, constant_ranges={})))
    assert float(proof.bound) > nominal.semidefinite.bound
    problem = ProblemMaker(prover.loop).at_centre(prover.coefficients, prover.box, None)
    (stage,) = proof.points
    assert len(stage.lam) == problem.counts[0] == len(prover.coefficients.functions)
    assert check_cells(system, (proof,), proof.bound) == ""
    every = certify_ranges(system, effort="fast")
    assert every.vertices.bound == float_up(from_text(proof.bound)) > every.attainable
    lower = f"{float(proof.bound) * (1 - 1e-6):.15g}"
    wider = tuple((str(low * Q(99, 100)), str(high)) for low, high in prover.box)
    mutants = [
        replace(proof, bound=lower, points=(replace(stage, bound=lower),)),
        replace(proof, points=(replace(stage, lam=("0", *stage.lam[1:])),)),
        replace(proof, points=(stage, stage)),
        replace(proof, cell=wider),
    ]
    assert all(prover.check(mutant) for mutant in mutants)


def test_numbers_and_texts_of_cells_are_inverse():
    cell = ((Q(7, 20), Q(13, 20)), (Q(-1, 3), Q(2)))
    assert numbers(texts(cell)) == cell
    assert rational(Fraction("7/20")) == from_text("7") / from_text("20")


# what a file may say


JOINT = case("ranges-joint")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"c0": [1, 2]}, "plant.ranges.c0: must contain the constant's own value 0.9898"),
        ({"c0": [1, 0.5]}, "low must be less than high"),
        ({"c0": [0.9898, 0.9898]}, "low must be less than high"),
        ({"c1": [1, 2]}, "plant.ranges.c1: unknown key"),
        ({"c0": [1]}, r"plant.ranges.c0: must be a list of 2"),
        ({"eta": [0.5, 0.7], "kv": [0.1, 0.2]}, "is a formula of eta, which has a range too"),
        ({"c0": ["exp(-1)", 2]}, "the ends must be decimals or fractions"),
    ],
)
def test_wrong_ranges_are_refused_in_one_line(change, message):
    with pytest.raises(InputError, match=message) as problem:
        replace(JOINT.plant, constant_ranges=change)
    assert "\n" not in str(problem.value)


def test_a_true_constant_outside_its_range_is_refused():
    with pytest.raises(InputError, match=r"truth.constants.c0: must lie in plant.ranges.c0"):
        JOINT.replace(truth=replace(JOINT.truth, constants={"c0": 2}))
    with pytest.raises(InputError, match=r"ensemble.constants.c0: must lie in plant.ranges.c0"):
        JOINT.replace(
            population=certrack.Population(
                constants={"c0": certrack.Distribution("uniform", (0.5, 1))}
            )
        )


def test_a_strength_that_follows_a_ranged_constant_is_refused():
    bounds = {"tau": [0, "1/c0", 0, 1], "gamma": [0] * 4, "beta": [0, 1, 0, 1]}
    with pytest.raises(InputError, match=r"uncertainty.tau.*must not depend on a constant with a"):
        replace(JOINT.plant, uncertainty=bounds)


def test_a_range_inside_a_nonlinear_function_has_no_certificate():
    plant = replace(JOINT.plant, drift="sin(c0*phi)")
    with pytest.raises(NoCertificate, match="c0 has a range and stands inside a nonlinear"):
        ranged_loop(JOINT.replace(plant=plant))
    plant = replace(JOINT.plant, drift="c0*phi**3")
    with pytest.raises(NoCertificate, match=r"phi\*\*3 is unbounded"):
        ranged_loop(JOINT.replace(plant=plant))


def test_ranges_move_what_is_a_formula_of_them():
    """A range of eta reaches kv and Beff."""
    plant = replace(JOINT.plant, constant_ranges={"eta": ["0.9*0.621", "1.1*0.621"]})
    loop = ranged_loop(JOINT.replace(plant=plant))
    assert [str(s) for s in loop.symbols] == ["eta"]
    last = loop.matrix[3, 0]
    assert last.free_symbols and last.is_polynomial(loop.symbols[0])


def test_members_have_their_constants_in_the_ranges():
    found = certrack.ensemble(JOINT, 64, method="lockstep", limit=math.inf).frame(draws=True)
    drawn = found["constants.c0"]
    assert drawn.min() >= 0.8 * 0.9898 and drawn.max() <= 1.2 * 0.9898 and drawn.nunique() == 64


# units


def test_balanced_poles():
    for n, c, rho in ((2, 1.5, 0.5), (4, 25.0, 1.0), (5, 3.0, 0.1)):
        plant = certrack.Plant(
            states=[f"x{i}" for i in range(n)],
            chain=[10.0**i for i in range(1, n)],
            gain_sign=1,
            input_gain=3,
        )
        found = certrack.Robust(c=[c] * n, coupling=rho).coordinates(plant).poles
        k = np.arange(1, n + 1)
        expected = -c + 2j * rho * c * np.cos(k * np.pi / (n + 1))
        order = lambda z: z[np.argsort(z.imag)]  # noqa: E731
        assert np.abs(order(found) - order(expected)).max() < 1e-9 * c


def test_coupling_needs_a_lean_design():
    with pytest.raises(InputError, match=r"law.coupling: needs k and p to be inf"):
        certrack.Robust(c=[1, 1], k=[[1, 1], [1, 1, 1, 1]], coupling=0.5)


UNITS = [(1, 1, 1, 1), (1, 1, 0.1, 0.1), (1, 5, 20, 0.3), (1, 1, 35.7, 35.7)]


@pytest.mark.parametrize("coupling", [None, 0.5])
def test_bounds_do_not_depend_on_the_units_of_the_states(coupling):
    """x -> D x, y the same; the balanced law is the same too, the paper's is kept by its gains."""
    bounds = []
    for scale in UNITS if coupling else UNITS[:1]:
        law = replace(JOINT.law, coupling=coupling)
        system = in_units(JOINT, scale).replace(law=law)
        prover = RangeProver(system)
        bounds.append(
            [float(prover.vertices(prover.box).bound), float(prover.peak(prover.box).bound)]
        )
    assert np.ptp(bounds, axis=0) == pytest.approx(0, abs=1e-6 * np.max(bounds))


def in_units(system, scale):
    """The same plant with its states in other units: x_i -> d_i x_i."""
    plant = system.plant
    d = [Fraction(str(v)) for v in scale]
    chain = [f"({g.text})*({d[i]})/({d[i + 1]})" for i, g in enumerate(plant.chain)]
    linear = [
        [f"({b.text})*({d[i]})/({d[j]})" for j, b in enumerate(row)]
        for i, row in enumerate(plant.linear)
    ]
    drift = str(plant.drift.expr)
    for name, value in zip(plant.states, d, strict=True):
        drift = re.sub(rf"\b{name}\b", f"({name}/({value}))", drift)
    u = plant.uncertainty
    return system.replace(
        plant=replace(
            plant,
            chain=chain,
            linear=linear,
            drift=f"({drift})*{d[-1]}",
            input_gain=f"({plant.input_gain.text})*{d[-1]}",
            uncertainty={
                "tau": [f"{t}*{v}" for t, v in zip(u.tau, d, strict=True)],
                "gamma": u.gamma,
                "beta": u.beta,
            },
        ),
        truth=replace(system.truth, input_gain=f"({plant.input_gain.text})*{d[-1]}", tau=None),
    )
