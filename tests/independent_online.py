"""The independent checker's part for gains that move, from the page of the file alone."""

import tomllib
from fractions import Fraction as Q

from independent_checker import (
    Problem,
    Refused,
    System,
    check_premises,
    check_stage,
    decimal,
    demand,
    negative_form,
    number,
    numbers_of,
    positive_definite,
)

MOVING = {
    "robust": {"c"},
    "linear": {"K", "r"},
    "adaptive": {"c_n", "gain_rate", "leak_gain", "leak_theta", "Gamma"},
}
RULE = {"rate", "threshold", "rise", "fall", "schedule"}
RULE |= {"seek", "amplitude", "frequency", "speed", "effort", "seed"}


def check_online(document, stated_bounds):
    """The proven bound on limsup |e_1| for every motion of the gains."""
    demand("region" not in document, "gains that move have no region")
    (entry,) = document["proof"]
    demand(set(entry) == {"bound", "ends"}, "the proof has other keys")
    stages = entry["ends"]
    for stage in stages:
        numbers_of(stage)
        demand(stage["shift"] == "0", "no stage has a shift")
    shared = {(stage["alpha"], stage["bound"]) for stage in stages}
    demand(shared == {(stages[0]["alpha"], entry["bound"])}, "the ends do not share their numbers")
    demand(document["claim"] == f"limsup |e_1(t)| <= {entry['bound']}", "another claim")
    table = tomllib.loads(document["system"])
    first, other, online = ends_of(table)
    one = System(first, stated_bounds)
    check_premises(document["premises"], one, first)
    rate = None if "rate" not in online else number(online["rate"], one.constants)
    check_rule(online, rate, one.constants)
    check_level(table, online, one.constants)
    if one.adaptive:
        demand(len(stages) == 1, "there must be one stage")
        return check_adaptive(stages[0], one, System(other, stated_bounds), rate)
    demand(len(stages) == 2, "there must be a stage for each end")
    problems = [in_plant_coordinates(end, stated_bounds) for end in (first, other)]
    align(problems)
    if rate is None:
        demand(stages[0]["P"] == stages[1]["P"], "the ends do not share P")
        return max(check_stage(s, p, 0)[0] for s, p in zip(stages, problems, strict=True))
    return check_rates(stages, problems, rate)


def ends_of(table):
    """The tables of both ends, and what law.online says."""
    law = dict(table["law"])
    online = law.pop("online")
    demand(set(online) <= MOVING[law["kind"]] | RULE, "a gain moves that may not")
    demand(not {"integral", "sampled_feedforward"} & set(law), "integral action")
    changes = {name: value for name, value in online.items() if name not in RULE}
    moved = dict(law)
    if "c_n" in changes:
        moved["c"] = [*law["c"][:-1], changes.pop("c_n")]
    if "K" in changes:
        demand("r" in changes, "r of the other end must be stated")
    moved |= changes
    still = {name: part for name, part in table.items() if name != "implementation"}
    return still | {"law": law}, still | {"law": moved}, online


def check_rule(online, rate, constants):
    if rate is not None:
        for name in ("rise", "fall"):
            demand(number(online.get(name, 0), constants) <= rate, "the rule is faster")
    elif {"gain_rate", "Gamma"} & set(online):
        raise Refused("adaptation gains move at any speed")


def check_level(table, online, constants):
    """Where the level is a state, it is the last of the initial estimates."""
    estimates = table.get("simulation", {}).get("estimates")
    if estimates and {"threshold", "rate"} & set(online):
        demand(0 <= number(estimates[-1], constants) <= 1, "the level begins outside its ends")


def in_plant_coordinates(end, stated_bounds):
    """The problem of one end, in x - Pi Y."""
    design = System(end, stated_bounds)
    law = {
        "kind": "linear",
        "K": design.nu_x,
        "r": design.nu_Y[-1],
        "feedforward": design.q,
    }
    same = System(end | {"law": law}, stated_bounds)
    demand(same.nu_Y == design.nu_Y, "the law is no feedback of x - Pi Y")
    y = list(same.y)
    if same.Y[-1] and not any(same.R):  # a column that does not act, as the other end may have one
        y.append(None)
    return Problem(same.M, same.A_inverse, same.a, same.b, y, None, same.selections)


def align(problems):
    """Both with a column for y_d^(q+1), where it acts at one end."""
    n = len(problems[0].M)
    acts = any(None not in p.y for p in problems) and any(None in p.y for p in problems)
    for p in problems:
        p.y = [([Q(0)] * n,) * 2 if v is None else v for v in p.y if v is not None or acts]


def check_rates(stages, problems, rate):
    numbers = [numbers_of(stage) for stage in stages]
    n = len(problems[0].M)
    for (alpha, P, lam, nu, k, _, _), problem in zip(numbers, problems, strict=True):
        counts = (len(problem.a), len(problem.b), len(problem.y))
        demand((len(lam), len(nu), len(k)) == counts, "the multipliers have another number")
        demand(len(P) == n and all(len(row) == n for row in P), "P has another shape")
        demand(all(P[i][j] == P[j][i] for i in range(n) for j in range(n)), "P is not symmetric")
        demand(alpha > 0 and min([*lam, *nu, *k, Q(0)]) >= 0, "a sign is wrong")
        floor = [[v - (i == j == 0) for j, v in enumerate(row)] for i, row in enumerate(P)]
        demand(positive_definite(floor), "P is below its floor")
    alpha = numbers[0][0]
    change = [
        [b - a for a, b in zip(*rows, strict=True)]
        for rows in zip(numbers[0][1], numbers[1][1], strict=True)
    ]

    def minus_Q(i, j, speed):
        _, _, lam, nu, k, _, _ = numbers[j]
        form = negative_form(problems[j], numbers[i][1], lam, nu, k, alpha)
        for a in range(n):
            for b in range(n):
                form[a][b] -= speed * change[a][b] / 2
        return form

    def plus(a, b):
        return [[u + v for u, v in zip(*rows, strict=True)] for rows in zip(a, b, strict=True)]

    for speed in (rate, -rate):
        crossed = plus(minus_Q(0, 1, speed), minus_Q(1, 0, speed))
        for form in (minus_Q(0, 0, speed), minus_Q(1, 1, speed), crossed):
            demand(positive_definite(form), "the inequality does not hold")
    delta = max(sum(nu, Q(0)) + sum(k, Q(0)) for _, _, _, nu, k, _, _ in numbers)
    bound = decimal(stages[0]["bound"])
    demand(bound >= 0 and bound**2 >= 2 * delta / alpha, "the bound is too small")
    return bound


def share_all_but_the_last_gain(one, two):
    """A larger c_n may stand in M[n][n] alone; nothing else of the error system may differ."""
    for name in ("A", "B", "R", "a", "b", "y", "selections", "gains", "delta0", "theta0", "boxes"):
        demand(getattr(one, name) == getattr(two, name), f"the ends do not share {name}")
    for i, (here, there) in enumerate(zip(one.M, two.M, strict=True)):
        last = i == len(one.M) - 1
        demand(here[: len(here) - last] == there[: len(there) - last], "the ends do not share M")


def check_adaptive(stage, one, two, rate):
    share_all_but_the_last_gain(one, two)
    slower = min((one, two), key=lambda end: -end.M[-1][-1])
    gbar = min(one.gbar, two.gbar)
    falls = [Q(0), Q(0)]
    if one.gbar != two.gbar:
        falls[0] = rate * abs(one.gbar - two.gbar) / gbar
    r = len(one.Gamma)
    least = [[min(one.Gamma[i][j], two.Gamma[i][j]) for j in range(r)] for i in range(r)]
    if one.Gamma != two.Gamma:
        pairs = [(one.Gamma[i][i], two.Gamma[i][i]) for i in range(r)]
        falls[1] = rate * max(abs(a - b) / min(a, b) for a, b in pairs)
        least = [[least[i][j] if i == j else Q(0) for j in range(r)] for i in range(r)]
    one.gbar, one.Gamma = gbar, least

    def leakage(alpha):
        costs = []
        for leak in (one.gbar1, two.gbar1):
            s1 = 1 - (alpha + falls[0]) / (2 * gbar * leak)
            demand(s1 > 0, "alpha exceeds what the leakage of delta_hat allows")
            offsets = [abs(g) * (1 / g - one.delta0) ** 2 for g in one.gains]
            costs.append(leak * max(offsets) / (4 * s1))
        total = max(costs)
        costs = []
        for leak in (one.gbar2, two.gbar2) if r else ():
            one.gbar2 = leak
            costs.append(one.leakage_of_theta(alpha + falls[1], Q(0)))
        return total + max(costs, default=Q(0))

    problem = Problem(slower.M, one.A_inverse, one.a, one.b, one.y, leakage, one.selections)
    return check_stage(stage, problem, 0)[0]
