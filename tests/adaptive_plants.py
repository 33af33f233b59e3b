"""Random plants under the adaptive law: orders 1 to 4, 0 to 3 parameters, ranges, full Gamma."""

import numpy as np

import certrack

#: A plant of first order that is certified and attacked in seconds.
EASY = """
[plant]
states = ["x"]
regressor = ["x"]
gain_sign = 1
[plant.uncertainty]
tau = [1]
gamma = [0]
beta = [0.1]
[truth]
input_gain = 1
theta = [0.5]
omega = ["0.1*sin(t)"]
[reference]
signal = "0.2*sin(t)"
[law]
kind = "adaptive"
c = [2]
gain_rate = 1
leak_gain = 1
leak_theta = 1
delta0 = 1
theta0 = [0.5]
[simulation]
x0 = [0]
duration = 10
"""

DRIFTS = ["0", "-0.5*x1", "0.3*sin(x1)", "-0.3*{last}", "0.2*x1**2*{last}", "0.2*tanh(x1)"]
REGRESSORS = ["1", "sin(x1)", "{last}", "1 + x1*sin({last})", "cos(x1)", "tanh(2*{last})", "x1"]


def random_plant(seed):
    """Plant number `seed`, with an omega near its bounds."""
    rng = np.random.default_rng([seed, 19])
    n, r = int(rng.integers(1, 5)), int(rng.integers(0, 4))
    last, states = f"x{n}", [f"x{i + 1}" for i in range(n)]

    def some(low, high):
        return round(float(rng.uniform(low, high)), 3)

    gain = some(0.6, 2) * (1 if rng.random() < 0.8 else -1)
    regressor = [REGRESSORS[i].format(last=last) for i in rng.permutation(len(REGRESSORS))[:r]]
    theta = [some(-1, 1) for _ in regressor]
    tau = [some(0, 0.3) * int(rng.random() < 0.5) for _ in range(n - 1)] + [some(0.1, 0.4)]
    gamma = [some(0, 0.3) * int(rng.random() < 0.6) for _ in range(n)]
    beta = [some(0, 0.3) for _ in range(n)]
    Gamma = [some(0.5, 2) for _ in regressor]
    if r and rng.random() < 0.5:
        basis = np.linalg.qr(rng.normal(size=(r, r)))[0]
        full = basis @ np.diag(Gamma) @ basis.T
        Gamma = np.round((full + full.T) / 2, 4).tolist()
    ranges = []
    if rng.random() < 0.4:
        ends = sorted([round(gain * some(0.85, 1), 4), round(gain * some(1, 1.2), 4)])
        ranges = ["[plant.ranges]", f"input_gain = {ends}"]
        pairs = [[round(v - some(0, 0.2), 3), round(v + some(0, 0.2), 3)] for v in theta]
        ranges += [f"theta = {pairs}"] if r else []
    norm = f"sqrt({' + '.join(f'{x}**2' for x in states)})"
    omega = [
        f"0.99*({b} + {c}*{norm})*sin({some(0.3, 3)}*t + {some(0, 6)})"
        for b, c in zip(beta, gamma, strict=True)
    ]
    text = [
        "[plant]",
        f"states = {states}",
        f"chain = {[some(0.7, 2) for _ in range(n - 1)]}",
        f"linear = {[[some(-0.5, 0.5) for _ in range(i + 1)] for i in range(n - 1)]}",
        f'drift = "{DRIFTS[int(rng.integers(len(DRIFTS)))].format(last=last)}"',
        f"regressor = {regressor}",
        f"gain_sign = {1 if gain > 0 else -1}",
        *ranges,
        "[plant.uncertainty]",
        f"tau = {tau}",
        f"gamma = {gamma}",
        f"beta = {beta}",
        "[truth]",
        f"input_gain = {gain}",
        f"theta = {theta}",
        f"omega = {omega}",
        "[reference]",
        f'signal = "{some(0.1, 0.3)}*sin({some(0.3, 1.2)}*t)"',
        "[law]",
        'kind = "adaptive"',
        f"c = {[some(1, 2.5) for _ in range(n)]}",
        f"feedforward = {int(rng.integers(0, n))}",
        f"gain_rate = {some(0.3, 1.5)}",
        f"leak_gain = {some(0.3, 0.8)}",
        f"leak_theta = {some(0.3, 0.8)}",
        f"delta0 = {round(some(0.8, 1.2) / gain, 3)}",
        f"theta0 = {[round(v + some(-0.2, 0.2), 3) for v in theta]}",
        *([f"Gamma = {Gamma}"] if r else []),
        "[simulation]",
        f"x0 = {[0.0] * n}",
        "duration = 40",
        "tail = 20",
    ]
    return certrack.loads("\n".join(text).replace("'", '"'))
