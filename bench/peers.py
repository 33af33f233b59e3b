"""Ways to integrate an ensemble of one closed loop, behind one signature.

``solve(x0, gain, theta, tol)`` takes initial states (4, N), true input gains (N,) and true
parameters (N,), and returns the states (4, N) at `T_END`. Every member has its own step size.
"""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
from collections.abc import Callable
from functools import cache
from math import cos, log, sin, sqrt
from pathlib import Path
from typing import Any

import numpy as np

Solve = Callable[[np.ndarray, np.ndarray, np.ndarray, float], np.ndarray]

T_END = 20.0
HERE = Path(__file__).parent
#: The first scheduling pass of gcc is off by default; it shortens the dependency chains.
FLAGS = ("-O3", "-march=native", "-fschedule-insns", "-fopenmp", "-Wno-psabi", "-shared", "-fPIC")
#: What the vector functions of the C library need.
VECTORISED = ("-mprefer-vector-width=512", "-fno-math-errno", "-fno-trapping-math")


def ensemble(members: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random initial states, gains and parameters; the first members do not depend on `members`."""
    low, high = np.array([[-1, -2, 1.5, 1.5], [1, 2, 2.5, 2.5]])
    x1, x2, gain, theta = np.random.default_rng(seed).uniform(low, high, (members, 4)).T.copy()
    return np.array([x1, x2, 0 * x1, 0 * x1]), gain, theta


def rates(t: float, y: np.ndarray, gain: float, theta: float) -> list[float]:
    """Right-hand side of one member, for the solvers that call Python."""
    x1, x2, delta_hat, theta_hat = y.tolist()  # floats are much faster than numpy's scalars
    sin_t, cos_t = sin(t), cos(t)
    square = x1 * x1 + x2 * x2
    drift = x1 * x1 * x2
    phi = 1 + x1 * sin(x2)
    e_2 = 1.75 * x1 + x2 - 0.65 * cos_t
    ubar = 0.16015625 * x1 - 5.265625 * x2 + 1.54765625 * cos_t - 0.65 * sin_t
    ubar -= theta_hat * phi + drift
    return [
        -3 * x1 + 2 * x2 + 0.1 * sqrt(square) * sin_t * cos_t,
        drift + gain * delta_hat * ubar + theta * phi + 0.04 * log(1 + square) + 0.02 / (1 + t),
        -0.6 * (delta_hat - 0.4) - e_2 * ubar,
        phi * e_2 - 0.6 * (theta_hat - 2.1),
    ]


# ---- hand-written C ------------------------------------------------------------------------------


@cache
def compiled(name: str, *flags: str) -> ctypes.CDLL:
    """A C file of this folder, compiled for this machine."""
    with tempfile.TemporaryDirectory() as folder:
        built = Path(folder) / "peer.so"
        command = ["gcc", *FLAGS, *flags, "-o", str(built), str(HERE / name), "-lmvec", "-lm"]
        subprocess.run(command, check=True)
        code = ctypes.CDLL(str(built))
    array, real = ctypes.c_void_p, ctypes.c_double
    code.integrate.argtypes = [ctypes.c_int, array, array, array, real, real, ctypes.c_int, array]
    return code


def library() -> ctypes.CDLL:
    """``floor.c``, compiled for this machine."""
    floor = compiled("floor.c")
    array, real = ctypes.c_void_p, ctypes.c_double
    floor.right_hand_side.argtypes = [real, array, real, real, array]
    floor.right_hand_side.restype = None
    return floor


def c_rates(t: float, y: np.ndarray, gain: float, theta: float) -> np.ndarray:
    """Right-hand side of one member as ``floor.c`` computes it."""
    y, rates = np.ascontiguousarray(y, dtype=float), np.empty(4)
    library().right_hand_side(t, y.ctypes.data, gain, theta, rates.ctypes.data)
    return rates


def c_tsit5(threads: int = 1, *, plain: bool = False) -> Solve:
    """Tsit5 in SIMD lanes: as fast as the hardware allows, or as plain C."""
    integrate = (compiled("plain.c", *VECTORISED) if plain else library()).integrate

    def solve(x0: np.ndarray, gain: np.ndarray, theta: np.ndarray, tol: float) -> np.ndarray:
        x0, gain, theta = (np.ascontiguousarray(value, dtype=float) for value in (x0, gain, theta))
        final = np.empty_like(x0)
        pointers = (value.ctypes.data for value in (x0, gain, theta))
        failed = integrate(gain.size, *pointers, tol, T_END, threads, final.ctypes.data)
        if failed:
            raise RuntimeError(f"{failed} members did not arrive")
        return final

    return solve


# ---- one member after the other ------------------------------------------------------------------


def looped(member: Callable[[np.ndarray, float, float, float], np.ndarray]) -> Solve:
    """Solve an ensemble with a function that solves one member."""

    def solve(x0: np.ndarray, gain: np.ndarray, theta: np.ndarray, tol: float) -> np.ndarray:
        cases = zip(x0.T, gain.tolist(), theta.tolist(), strict=True)
        return np.transpose([member(x, g, th, tol) for x, g, th in cases])

    return solve


def scipy_solver(method: str) -> Solve:
    """``solve_ivp`` with the given method, or ``odeint``, whose step loop is not in Python."""
    from scipy.integrate import odeint, solve_ivp

    def by_odeint(x: np.ndarray, gain: float, theta: float, tol: float) -> np.ndarray:
        options: dict[str, Any] = {"rtol": tol, "atol": tol, "mxstep": 1_000_000}
        return odeint(rates, x, [0, T_END], args=(gain, theta), tfirst=True, **options)[-1]

    def by_solve_ivp(x: np.ndarray, gain: float, theta: float, tol: float) -> np.ndarray:
        options: dict[str, Any] = {"method": method, "rtol": tol, "atol": tol}
        solution = solve_ivp(rates, (0, T_END), x, args=(gain, theta), t_eval=[T_END], **options)
        if not solution.success:
            raise RuntimeError(solution.message)
        return solution.y[:, -1]

    return looped(by_odeint if method == "odeint" else by_solve_ivp)


def python_control() -> Solve:
    """``input_output_response`` of an autonomous nonlinear system, with its default RK45."""
    import control

    def update(t: float, y: np.ndarray, u: np.ndarray, params: dict[str, float]) -> list[float]:
        return rates(t, y, params["gain"], params["theta"])

    system = control.nlsys(update, None, inputs=0, states=4)

    def member(x: np.ndarray, gain: float, theta: float, tol: float) -> np.ndarray:
        solution = control.input_output_response(
            system,
            [0, T_END],
            initial_state=x,
            params={"gain": gain, "theta": theta},
            solve_ivp_kwargs={"rtol": tol, "atol": tol},
        )
        return solution.states[:, -1]

    return looped(member)


# ---- diffrax -------------------------------------------------------------------------------------


def diffrax_tsit5() -> Solve:
    """Tsit5, vmapped over members and jitted; the first call with a new N compiles."""
    import diffrax
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)

    def field(t: Any, y: tuple[Any, ...], parameters: tuple[Any, Any]) -> tuple[Any, ...]:
        (x1, x2, delta_hat, theta_hat), (gain, theta) = y, parameters
        sin_t, cos_t = jnp.sin(t), jnp.cos(t)
        square = x1 * x1 + x2 * x2
        drift = x1 * x1 * x2
        phi = 1 + x1 * jnp.sin(x2)
        e_2 = 1.75 * x1 + x2 - 0.65 * cos_t
        ubar = 0.16015625 * x1 - 5.265625 * x2 + 1.54765625 * cos_t - 0.65 * sin_t
        ubar -= theta_hat * phi + drift
        disturbance = 0.04 * jnp.log(1 + square) + 0.02 / (1 + t)
        return (
            -3 * x1 + 2 * x2 + 0.1 * jnp.sqrt(square) * sin_t * cos_t,
            drift + gain * delta_hat * ubar + theta * phi + disturbance,
            -0.6 * (delta_hat - 0.4) - e_2 * ubar,
            phi * e_2 - 0.6 * (theta_hat - 2.1),
        )

    term, solver = diffrax.ODETerm(field), diffrax.Tsit5()

    def member(x: Any, gain: Any, theta: Any, tol: Any) -> Any:
        solution = diffrax.diffeqsolve(
            term,
            solver,
            t0=0.0,
            t1=T_END,
            dt0=None,
            y0=tuple(x),
            args=(gain, theta),
            saveat=diffrax.SaveAt(t1=True),
            stepsize_controller=diffrax.PIDController(rtol=tol, atol=tol),
            max_steps=1_000_000,
        )
        return jnp.concatenate(solution.ys)

    compiled = jax.jit(jax.vmap(member, in_axes=(1, 0, 0, None), out_axes=1))

    def solve(x0: np.ndarray, gain: np.ndarray, theta: np.ndarray, tol: float) -> np.ndarray:
        return np.asarray(compiled(x0, gain, theta, tol))

    return solve


# ---- errors --------------------------------------------------------------------------------------


@cache
def reference(members: int) -> np.ndarray:
    """Final states of the first members of `ensemble`, from a tight DOP853."""
    return scipy_solver("DOP853")(*ensemble(members), 1e-12)


def errors(solve: Solve, tol: float, members: int = 20) -> np.ndarray:
    """Largest error of a final state, per member."""
    return abs(solve(*ensemble(members), tol) - reference(members)).max(axis=0)
