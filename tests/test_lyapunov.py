"""The paper's Lyapunov steps, as identities: what an inequality leaves is a sum of squares.

Shown for general gains and couplings, n = 2, 3, 4. The coefficients eta_mj, d_m are symbols here:
no step uses more of them than that they are constants, and tests/test_backstepping.py shows that
the recursion's numbers are the derivatives of lambda_m. The uncertain terms are split,
w_j = a_j + b_j with |a_j| <= gamma_j ||x|| and |b_j| <= beta_j.
"""

from dataclasses import dataclass, field

import numpy as np
import pytest
import sympy as sp

import certrack
from certrack.core.expressions import symbol
from certrack.laws.backstepping import carry_out

ORDERS = [2, 3, 4]


def indexed(name, *ranges):
    """A dictionary of symbols name_i or name_i_j."""
    if len(ranges) == 1:
        return {i: sp.Symbol(f"{name}_{i}") for i in ranges[0]}
    return {(i, j): sp.Symbol(f"{name}_{i}_{j}") for i in ranges[0] for j in ranges[1]}


@dataclass
class Steps:
    """Symbols of the recursion for a plant of order n, numbered from 1 as in the paper."""

    n: int
    y: tuple = field(default_factory=lambda: sp.symbols("y y1"))

    def __post_init__(self):
        n = self.n
        every = range(1, n + 1)
        self.x, self.e = indexed("x", range(1, n + 2)), indexed("e", range(n + 2))
        self.a, self.b_part = indexed("a", every), indexed("b", every)
        self.g, self.b = indexed("g", range(n + 1)), indexed("b", every, every)
        self.c, self.p, self.tau = indexed("c", every), indexed("p", every), indexed("tau", every)
        self.k = indexed("k", every, range(1, 2 * n + 1))
        self.eta, self.d = indexed("eta", range(n), every), indexed("d", range(n))
        self.d[0] = sp.Integer(1)  # lambda_0 = y_d
        self.g[0] = sp.Integer(0)

    def w(self, j):
        return self.a[j] + self.b_part[j]

    def F(self, i):
        """Row i of the nominal chain."""
        return self.g[i] * self.x[i + 1] + sum(self.b[i, j] * self.x[j] for j in range(1, i + 1))

    def weight(self, m, j):
        """Coefficient of tau_j w_j in e_m', which is A_mj."""
        return 1 if j == m else -self.eta[m - 1, j]

    def kappa(self, m):
        """The damping of [9], [13], [18], and of [25] for m = n."""
        k, eta = self.k, self.eta
        young = 1 / (4 * k[m, 2 * m - 1]) + 1 / (4 * k[m, 2 * m])
        young += sum(
            (1 / (4 * k[m, 2 * i - 1]) + 1 / (4 * k[m, 2 * i])) * eta[m - 1, i] ** 2
            for i in range(1, m)
        )
        return young + (self.d[m - 1] ** 2 / (4 * self.p[m]) if m < self.n else 0)

    def virtual(self, m):
        """lambda_m, from [9], [13], [18]."""
        known = sum(self.eta[m - 1, i] * self.F(i) for i in range(1, m))
        linear = sum(self.b[m, i] * self.x[i] for i in range(1, m + 1))
        damped = -(self.c[m] + self.kappa(m)) * self.e[m] - self.g[m - 1] * self.e[m - 1]
        return (damped + known - linear) / self.g[m]

    def open_loop_rate(self, m):
        """e_m' before x_{m+1} is replaced: [7] for m = 1, [11] for m = 2, [16] for m < n."""
        rate = self.F(m) + self.tau[m] * self.w(m) - self.d[m - 1] * self.y[1]
        return rate - sum(
            self.eta[m - 1, i] * (self.F(i) + self.tau[i] * self.w(i)) for i in range(1, m)
        )

    def rate(self, m):
        """e_m' with x_{m+1} = e_{m+1} + lambda_m [6]."""
        return self.open_loop_rate(m).subs(self.x[m + 1], self.e[m + 1] + self.virtual(m))

    def dissipation(self, m):
        """Right-hand side of [10], [14], [15], [19], with a_j, b_j, y_d' in place of bounds."""
        total = -sum(self.c[i] * self.e[i] ** 2 for i in range(1, m + 1))
        total += self.g[m] * self.e[m] * self.e[m + 1] if m < self.n else 0
        return total + sum(self.paid(i) for i in range(1, m + 1))

    def paid(self, m):
        """What step m adds: k (tau a)^2 + k (tau b)^2 of every term, p y_d'^2."""
        terms = sum(
            self.k[m, 2 * j - 1] * (self.tau[j] * self.a[j]) ** 2
            + self.k[m, 2 * j] * (self.tau[j] * self.b_part[j]) ** 2
            for j in range(1, m + 1)
        )
        return terms + (self.p[m] * self.y[1] ** 2 if m < self.n else 0)

    def squares(self, m):
        """What Young's inequality gives away at step m: a sum of squares."""
        e, k, tau = self.e[m], self.k, self.tau
        total = 0
        for j in range(1, m + 1):
            half = self.weight(m, j) * e / 2
            first, second = k[m, 2 * j - 1], k[m, 2 * j]
            total += first * (half / first - tau[j] * self.a[j]) ** 2
            total += second * (half / second - tau[j] * self.b_part[j]) ** 2
        if m < self.n:
            total += self.p[m] * (self.d[m - 1] * e / (2 * self.p[m]) + self.y[1]) ** 2
        return total


def is_zero(expression):
    return sp.simplify(sp.expand(expression)) == 0


@pytest.mark.parametrize("n", ORDERS)
def test_step_m_is_dissipation_less_squares(n):
    """[8], [10] for m = 1; [12], [14] for m = 2; [15], [17], [19] for every m < n."""
    s = Steps(n)
    rate = 0  # of L_m = (e_1^2 + ... + e_m^2)/2
    for m in range(1, n):
        known = sum(s.eta[m - 1, i] * s.F(i) for i in range(1, m))
        bracket = s.g[m - 1] * s.e[m - 1] + s.F(m) - known + s.kappa(m) * s.e[m]
        before = (s.dissipation(m - 1) if m > 1 else 0) + s.paid(m)
        before += s.e[m] * bracket - (s.g[m - 1] * s.e[m - 1] * s.e[m] if m > 1 else 0)
        given_away = sum(s.squares(i) for i in range(1, m + 1))
        assert is_zero(before - rate - s.e[m] * s.open_loop_rate(m) - given_away)  # [8], [12], [17]
        rate += s.e[m] * s.rate(m)
        given_away = sum(s.squares(i) for i in range(1, m + 1))
        assert is_zero(s.dissipation(m) - rate - given_away)


@pytest.mark.parametrize("n", ORDERS)
def test_a_step_with_less_damping_is_no_identity(n):
    s = Steps(n)
    whole = s.kappa
    s.kappa = lambda m: whole(m) - 1 / (4 * s.k[m, 1])
    m = n - 1
    rate = sum(s.e[i] * s.rate(i) for i in range(1, m + 1))
    given_away = sum(s.squares(i) for i in range(1, m + 1))
    assert not is_zero(s.dissipation(m) - rate - given_away)


@dataclass
class Estimation:
    """Symbols of step n: estimates, their errors [22], and the update laws [26]; r = 2."""

    sign: int

    def __post_init__(self):
        self.size, self.gbar = sp.symbols("size gbar", positive=True)
        self.g_n = self.sign * self.size
        self.gbar1, self.gbar2 = sp.symbols("gbar1 gbar2", positive=True)
        self.delta_hat, self.delta0, self.h = sp.symbols("delta_hat delta0 h")
        self.phi, self.theta, self.theta_hat, self.theta0 = (
            sp.Matrix(sp.symbols(f"{name}_1 {name}_2"))
            for name in ("phi", "theta", "theta_hat", "theta0")
        )
        first, off, last = sp.symbols("G11 G12 G22")
        self.Gamma = sp.Matrix([[first, off], [off, last]])
        self.delta_tilde = 1 / self.g_n - self.delta_hat  # [22]
        self.theta_tilde = self.theta - self.theta_hat  # [22]

    def update(self, ubar, e_n):
        """delta_hat' and theta_hat' of [26]."""
        gap, gaps = self.delta_hat - self.delta0, self.theta_hat - self.theta0
        delta_rate = -self.gbar * self.sign * ubar * e_n - self.gbar * self.gbar1 * gap
        return delta_rate, self.Gamma * (self.phi * e_n - self.gbar2 * gaps)

    def leak(self):
        """The right-hand sides of [27]: what decays, and what the prior guesses cost."""
        decay = self.size * self.gbar1 * self.delta_tilde**2 / 2
        decay += self.gbar2 * self.theta_tilde.dot(self.theta_tilde) / 2
        off, offs = 1 / self.g_n - self.delta0, self.theta - self.theta0
        cost = self.size * self.gbar1 * off**2 / 2 + self.gbar2 * offs.dot(offs) / 2
        return decay, cost

    def leak_squares(self):
        """What [27] gives away."""
        apart = self.delta_hat - self.delta0
        aparts = self.theta_hat - self.theta0
        return self.size * self.gbar1 * apart**2 / 2 + self.gbar2 * aparts.dot(aparts) / 2


def estimates_rate(a, delta_rate, *theta_rate):
    """The estimates' part of V_n, differentiated [23]."""
    weighted = (a.theta_tilde.T * a.Gamma.inv() * sp.Matrix(theta_rate))[0]
    return -weighted - a.size / a.gbar * a.delta_tilde * delta_rate


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("n", ORDERS)
def test_step_n_is_dissipation_less_squares(n, sign):
    """[21], [23], [24] with the law [25], [26] and [27] in them give [28] with Delta of [29]."""
    s, a = Steps(n), Estimation(sign)
    known = sum(s.eta[n - 1, i] * s.F(i) for i in range(1, n)) + s.d[n - 1] * s.y[1]
    nu = -(s.c[n] + s.kappa(n)) * s.e[n] - s.g[n - 1] * s.e[n - 1] - a.h + known
    ubar = nu - a.phi.dot(a.theta_hat)  # [25]
    u = a.delta_hat * ubar
    rate_n = a.h + a.phi.dot(a.theta) + a.g_n * u + s.tau[n] * s.w(n)  # [21]
    rate_n -= known + sum(s.eta[n - 1, i] * s.tau[i] * s.w(i) for i in range(1, n))
    free, free_rates = sp.Symbol("u"), sp.symbols("r1 r2 r3")  # any input, any update laws
    any_rate = rate_n - a.g_n * u + a.g_n * free
    bracket = s.g[n - 1] * s.e[n - 1] + a.h + a.phi.dot(a.theta) + a.g_n * free - known
    before = s.dissipation(n - 1) - s.g[n - 1] * s.e[n - 1] * s.e[n] + s.paid(n)
    before += s.e[n] * (bracket + s.kappa(n) * s.e[n]) + estimates_rate(a, *free_rates)
    rate = sum(s.e[m] * s.rate(m) for m in range(1, n))
    total = rate + s.e[n] * any_rate + estimates_rate(a, *free_rates)
    assert is_zero(before - total - sum(s.squares(m) for m in range(1, n + 1)))  # [24]
    delta_rate, theta_rate = a.update(ubar, s.e[n])
    rate += s.e[n] * rate_n + estimates_rate(a, delta_rate, *theta_rate)
    decay, cost = a.leak()
    bound = s.dissipation(n) - decay + cost
    given_away = sum(s.squares(m) for m in range(1, n + 1)) + a.leak_squares()
    assert is_zero(bound - rate - given_away)


@pytest.mark.parametrize("sign", [1, -1])
def test_leakage_inequalities_are_squares(sign):
    """[27]: gbar1 |g| d (delta_hat - delta_0) and its theta counterpart."""
    a = Estimation(sign)
    left = a.gbar1 * a.size * a.delta_tilde * (a.delta_hat - a.delta0)
    left += a.gbar2 * a.theta_tilde.dot(a.theta_hat - a.theta0)
    decay, cost = a.leak()
    assert is_zero(cost - decay - left - a.leak_squares())


@pytest.mark.parametrize("n", ORDERS)
def test_state_norm_is_bounded_by_the_errors(n):
    """[32]: what the two inequalities give away are squares, too (Young, Lagrange)."""
    inverse = sp.Matrix(n, n, lambda i, j: sp.Symbol(f"m_{i}_{j}") if j <= i else 0)
    e = sp.Matrix(sp.symbols(f"e1:{n + 1}"))
    v = sp.Matrix(sp.symbols(f"v1:{n + 1}"))  # A^{-1} B y_d
    eps = sp.Symbol("eps", positive=True)
    through = inverse * e
    apart = sp.sqrt(eps) * through - v / sp.sqrt(eps)
    young = (1 + eps) * through.dot(through) + (1 + 1 / eps) * v.dot(v)
    assert is_zero(young - (through + v).dot(through + v) - apart.dot(apart))
    lagrange = sum(
        (inverse[r, i] * e[j] - inverse[r, j] * e[i]) ** 2
        for r in range(n)
        for i in range(n)
        for j in range(i)
    )
    frobenius = sum(entry**2 for entry in inverse)
    assert is_zero(frobenius * e.dot(e) - through.dot(through) - lagrange)


def test_decay_of_the_energy_and_the_comparison_principle():
    """[33] to [39]: rho_1 is the least rate; [37], [40]: L' = -(rho_1/rho_2) L + Dbar solved."""
    mu1, half_gbar2, leak, e2, theta2, delta2 = sp.symbols("mu1 r2 r3 e2 th2 d2", nonnegative=True)
    for rho1 in (mu1, half_gbar2, leak):  # [38]
        rest = {mu1: mu1, half_gbar2: half_gbar2, leak: leak}
        above = sp.symbols("s1 s2 s3", nonnegative=True)  # the rates exceed the least by these
        rates = {
            rate: rho1 + s if rate != rho1 else rho1 for rate, s in zip(rest, above, strict=True)
        }
        left = sum(rates[r] * v for r, v in zip(rest, (e2, theta2, delta2), strict=True))
        slack = sp.expand(left - rho1 * (e2 + theta2 + delta2))
        assert all(term.is_nonnegative for term in sp.Add.make_args(slack))
    t, rho1, rho2, dbar, start = sp.symbols("t rho1 rho2 Dbar L0", positive=True)
    L = sp.Function("L")
    equation = sp.Eq(L(t).diff(t), -rho1 / rho2 * L(t) + dbar)
    solution = sp.dsolve(equation, L(t), ics={L(0): start}).rhs
    decay = sp.exp(-rho1 / rho2 * t)
    assert is_zero(solution - (start * decay + rho2 / rho1 * dbar * (1 - decay)))  # [40]
    assert sp.limit(solution, t, sp.oo) == rho2 * dbar / rho1


def test_the_recursion_has_the_constants_of_remark_3():
    """eta_11 and d_1, written out, and lambda_m as a linear form [20], n = 3, all symbols."""
    n = 3
    g = np.array(sp.symbols("g1:3"), dtype=object)
    b = np.array([[sp.Symbol("b11"), 0, 0], [*sp.symbols("b21 b22"), 0]], dtype=object)
    c = np.array(sp.symbols("c1:4"), dtype=object)
    weights = [np.array(sp.symbols(f"w{m}_1:{m + 1}"), dtype=object) for m in (1, 2, 3)]
    q = np.array(sp.symbols("q1:3"), dtype=object)
    found = carry_out(g, b, c, weights, q, 0)
    assert is_zero(found.eta[0][0] - (-c[0] - weights[0][0] - q[0] - b[0, 0]) / g[0])
    assert is_zero(found.d[0, 0] - (c[0] + weights[0][0] + q[0]) / g[0])
    x, y = sp.symbols("x1:4"), sp.Symbol("y")
    virtual = [y]
    for m in range(n - 1):  # [6], [9], [13] by differentiation
        e = [x[i] - virtual[i] for i in range(m + 1)]
        slopes = [virtual[m].diff(x[i]) for i in range(m)]
        chain = [g[i] * x[i + 1] + sum(b[i, j] * x[j] for j in range(i + 1)) for i in range(m)]
        kappa = weights[m][m] + virtual[m].diff(y) ** 2 * q[m]
        kappa += sum(weights[m][i] * slopes[i] ** 2 for i in range(m))
        wanted = -(c[m] + kappa) * e[m] - (g[m - 1] * e[m - 1] if m else 0)
        wanted += sum(slope * row for slope, row in zip(slopes, chain, strict=True))
        wanted -= sum(b[m, j] * x[j] for j in range(m + 1))
        virtual.append(sp.expand(wanted / g[m]))
        form = sum(found.eta[m][j] * x[j] for j in range(m + 1)) + found.d[m, 0] * y  # [20]
        assert is_zero(virtual[-1] - form)


def rational_design(name):
    """Recursion of a shipped system, in exact rationals as SymPy has them."""
    from certrack.certificates.arithmetic import rational
    from certrack.certificates.formulation import error_coordinates

    exact = error_coordinates(certrack.load(name), rational)

    def of(array):
        return sp.Matrix(np.atleast_2d(array)).applyfunc(lambda v: sp.Rational(int(v.p), int(v.q)))

    return of(exact.A), of(exact.B), [sp.Rational(str(v)) for v in certrack.load(name).law.c]


def test_example_1_step_by_step():
    """[43] to [47]: the inequalities of Example 1, with the recursion's own numbers."""
    A, B, c = rational_design("example1")
    x1, x2, y, y1, w1, a2, b2 = sp.symbols("x1 x2 y y1 w1 a2 b2")
    k11, k21, k23, k24, p1 = sp.Rational(1, 2), 1, 1, 1, sp.Rational(1, 20)
    tau1, tau2 = sp.Rational(1, 10), sp.Rational(1, 5)
    e1 = x1 - y
    eta, d1 = -A[1, 0], B[1, 0]
    assert (eta, d1) == (sp.Rational(-7, 4), sp.Rational(13, 4))
    x1_rate = 2 * x2 - 3 * x1 + tau1 * w1  # [43]
    rate1 = e1 * (x1_rate - y1)
    damped = e1 * (2 * x2 - 3 * x1 + e1 / (4 * k11) + e1 / (4 * p1))
    paid1 = k11 * (tau1 * w1) ** 2 + p1 * y1**2
    squares1 = k11 * (e1 / (2 * k11) - tau1 * w1) ** 2 + p1 * (e1 / (2 * p1) + y1) ** 2
    assert is_zero(damped + paid1 - rate1 - squares1)  # [44]
    lam1 = (-c[0] * e1 + 3 * x1 - e1 / (4 * k11) - e1 / (4 * p1)) / 2
    assert is_zero(lam1 - (eta * x1 + d1 * y))
    e2 = x2 - lam1
    assert is_zero(-c[0] * e1**2 + 2 * e1 * e2 + paid1 - rate1 - squares1)  # [45]
    g2, u, theta, theta_hat, delta_hat = sp.symbols("g2 u theta theta_hat delta_hat")
    phi = 1 + x1 * sp.sin(x2)
    x2_rate = g2 * u + x1**2 * x2 + phi * theta + tau2 * (a2 + b2)  # [43]
    rate2 = rate1 + e2 * (x2_rate - d1 * y1 - eta * x1_rate)
    bracket = g2 * u + 2 * e1 + x1**2 * x2 + phi * theta - d1 * y1 - eta * (2 * x2 - 3 * x1)
    bracket += e2 / (4 * k21) * eta**2 + e2 / (4 * k23) + e2 / (4 * k24)
    paid2 = k21 * (tau1 * w1) ** 2 + k23 * (tau2 * a2) ** 2 + k24 * (tau2 * b2) ** 2
    squares2 = k21 * (eta * e2 / (2 * k21) + tau1 * w1) ** 2
    squares2 += k23 * (e2 / (2 * k23) - tau2 * a2) ** 2 + k24 * (e2 / (2 * k24) - tau2 * b2) ** 2
    bound = -c[0] * e1**2 + paid1 + paid2 + e2 * bracket  # [46], the estimates apart
    assert is_zero(bound - rate2 - squares1 - squares2)
    ubar = -c[1] * e2 - 2 * e1 - x1**2 * x2 - phi * theta_hat + d1 * y1  # [47]
    ubar += eta * (2 * x2 - 3 * x1) - e2 * (eta**2 / 4 + sp.Rational(1, 2))
    same_as_shipped("example1", delta_hat * ubar, {"theta_hat": "theta_hat_1"})
    matched = bracket.subs({g2 * u: ubar, theta: theta_hat})
    assert is_zero(e2 * matched + c[1] * e2**2)


def same_as_shipped(name, u, renamed):
    """The input written out by hand is the one that the shipped system's controller has."""
    system = certrack.load(name)
    controller = system.controller
    values = dict(zip(controller.symbols, controller.values, strict=True))
    values |= {symbol(v): number for v, number in system.plant.constant_values.items()}
    ours = controller.equations.u.subs(values)
    renamed = {"y": "y_d_0", "y1": "y_d_1"} | renamed
    symbols = {v: symbol(renamed.get(v.name, v.name)) for v in u.free_symbols}
    gap = sp.lambdify(sorted(ours.free_symbols, key=str), ours - u.xreplace(symbols))
    rng = np.random.default_rng(0)
    for _ in range(20):
        assert abs(gap(*rng.normal(size=len(ours.free_symbols)))) < 1e-9


def test_example_2_step_by_step():
    """[49] to [54]: the inequalities and the law of Example 2."""
    A, B, c = rational_design("dual-motor")
    x1, x2, x3, x4 = x = sp.symbols("x1:5")
    y, y1, w2, a4, b4, u = sp.symbols("y y1 w2 a4 b4 u")
    k, p = sp.Rational(3, 10), [sp.Rational(1, 10), sp.Rational(1, 2), sp.Rational(1, 2)]
    g, ratio, l2, l11 = (1, 12, 1), 6, 30, 20
    rates = [x2, 2 * ratio * (x3 - x1) + w2, x4, l2 * (x1 - x3) + l11 * u + a4 + b4]  # [4]
    e = list(A * sp.Matrix(x) - B[:, 0] * y)
    rate, paid, squares, decay = 0, 0, 0, 0
    for m in range(4):  # [49], [50], [52], and [53] for m = 3
        e_rate = sum(A[m, j] * rates[j] for j in range(m + 1)) - B[m, 0] * y1
        rate += e[m] * e_rate
        through = A[m, 1]
        if through:
            paid += k * w2**2
            squares += k * (through * e[m] / (2 * k) - w2) ** 2
        decay += c[m] * e[m] ** 2
        if m == 3:
            break
        paid += p[m] * y1**2
        squares += p[m] * (B[m, 0] * e[m] / (2 * p[m]) + y1) ** 2
        assert is_zero(-decay + g[m] * e[m] * e[m + 1] + paid - rate - squares), m + 1
        if m == 2:
            eta, d2, e_3 = [-A[2, j] for j in range(2)], B[2, 0], e[2]
            bracket = 2 * ratio * e[1] + x4 + eta[1] ** 2 * e_3 / (4 * k)
            bracket += d2**2 * e_3 / (4 * p[2]) - eta[0] * x2 - 2 * ratio * eta[1] * (x3 - x1)
            bound = -(decay - c[2] * e_3**2) + paid + e_3 * bracket  # [51]
            assert is_zero(bound - rate - squares)
    paid += k * a4**2 + k * b4**2
    squares += k * (e[3] / (2 * k) - a4) ** 2 + k * (e[3] / (2 * k) - b4) ** 2
    e_before, e_4 = e[2], e[3]
    eta, d3 = [-A[3, j] for j in range(3)], B[3, 0]
    bracket = e_before + l11 * u + e_4 * (eta[1] ** 2 + 2) / (4 * k) - eta[0] * x2
    bracket += (l2 + 2 * ratio * eta[1]) * (x1 - x3) - eta[2] * x4 - d3 * y1
    bound = -(decay - c[3] * e_4**2) + paid + e_4 * bracket  # [53]
    assert is_zero(bound - rate - squares)
    law = -c[3] * e_4 - e_before - e_4 * (eta[1] ** 2 + 2) / (4 * k) + eta[0] * x2
    law += -(l2 + 2 * ratio * eta[1]) * (x1 - x3) + eta[2] * x4 + d3 * y1  # [54]
    same_as_shipped("dual-motor", law / l11, {})
    assert is_zero(e_4 * bracket.subs(u, law / l11) + c[3] * e_4**2)


def test_the_servo_of_the_means_is_the_physical_one():
    """[1] with the means of [3] and the ratios of [2] is [4]."""
    KL, JL, Ki, Ji, u1, u2, wL, w1, w2 = sp.symbols("K_L J_L K_i J_i u1 u2 wL w1 w2")
    th_L, th_1, th_2 = sp.symbols("th_L th_1 th_2")
    load = KL / JL * ((th_1 - th_L) + (th_2 - th_L)) + wL  # [1]
    motors = [
        Ki / Ji * u - KL / Ji * (th - th_L) + w for u, th, w in ((u1, th_1, w1), (u2, th_2, w2))
    ]
    ratio, l_i1, l_2 = KL / JL, Ki / (2 * Ji), KL / Ji  # [2]
    x1, x3 = th_L, (th_1 + th_2) / 2  # [3]
    assert is_zero(load - (2 * ratio * x3 - 2 * ratio * x1 + wL))  # [4]
    mean = sum(motors) / 2
    assert is_zero(mean - (l_2 * (x1 - x3) + l_i1 * (u1 + u2) + (w1 + w2) / 2))  # [4]
