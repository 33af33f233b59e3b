"""An axis with Coulomb and Stribeck friction on a drive, and a PID controller for it.

1 kHz, a period of delay, an encoder of 5 um, speeds by filtered differences. The controllers know
the mass 20 % too small, and Coulomb friction 10 %.
"""

import math

import certrack

#: Mass, viscous and Coulomb friction, offset and force constant.
M, F_V, F_C, OFFSET, G = 95.1, 203.5, 20.4, -3.2, 35.15
MASS_FACTOR, FRICTION_FACTOR = 1.2, 1.1
STRIBECK = 0.3 * F_C / M
T, FILTER, STEP = 1e-3, 0.003, 5e-6
AMPLITUDE, RATE = 0.1, 1.5


def adaptive(c, integral, duration):
    """The axis with the adaptive law, as a system."""
    return certrack.loads(f"""
[plant]
states = ["x1", "x2"]
chain = [1]
drift = "-{F_V / M}*x2 - ({OFFSET / M})"
regressor = ["-tanh(x2/0.002)"]
gain_sign = 1
[plant.uncertainty]
tau = [0, 1]
gamma = [0, 0]
beta = [0, 1]
[truth]
input_gain = {G / (MASS_FACTOR * M)}
theta = [{FRICTION_FACTOR * F_C / M}]
omega = [0, "0.03*sin(9*t) - {STRIBECK}*exp(-(x2/0.01)**2)*tanh(x2/0.002)"]
[reference]
signal = "{AMPLITUDE}*(1 - cos({RATE}*t))"
[law]
kind = "adaptive"
c = [{c}, {c}]
feedforward = 1
{f"integral = {integral}" if integral else ""}
gain_rate = 100
leak_gain = 0.01
leak_theta = 0.01
delta0 = {M / G}
theta0 = [{F_C / M}]
Gamma = [100]
[implementation]
period = {T}
delay = 1
measurement_quantum = [{STEP}, 0]
velocity = ["x2"]
velocity_filter = {FILTER}
saturation = [-10, 10]
[simulation]
x0 = [0, 0]
duration = {duration}
tail = {duration / 2}
tolerance = 1e-8
estimates = [{M / G}, {F_C / M}{", 0" if integral else ""}]
""")


def pid_tail(p, duration, steps=4):
    """Largest error of the second half under a PID with three poles at p, and feed-forward."""
    q = v = speed = total = waiting = acting = largest = 0.0
    before = None
    share, h = 1 - math.exp(-T / FILTER), T / steps

    def rate(q, v, t, u):
        sliding = math.tanh(v / 0.002)
        friction = sliding * (FRICTION_FACTOR * F_C / M + STRIBECK * math.exp(-((v / 0.01) ** 2)))
        push = G / (MASS_FACTOR * M) * u + 0.03 * math.sin(9 * t)
        return -F_V / M * v - OFFSET / M - friction + push

    for k in range(round(duration / T)):
        t = k * T
        y = AMPLITUDE * (1 - math.cos(RATE * t))
        y1, y2 = AMPLITUDE * RATE * math.sin(RATE * t), AMPLITUDE * RATE**2 * math.cos(RATE * t)
        seen = round(q / STEP) * STEP
        speed += share * ((0.0 if before is None else (seen - before) / T) - speed)
        before = seen
        total += (y - seen) * T
        a = y2 + 3 * p * (y1 - speed) + 3 * p * p * (y - seen) + p**3 * total
        waiting, acting = (M * a + F_V * y1 + F_C * math.tanh(y1 / 0.002) + OFFSET) / G, waiting
        if t >= duration / 2:
            largest = max(largest, abs(q - y))
        for i in range(steps):
            at = t + i * h
            k1 = rate(q, v, at, acting)
            k2 = rate(q + h / 2 * v, v + h / 2 * k1, at + h / 2, acting)
            q, v = q + h * v + h * h / 2 * k1, v + h * k2
    return largest
