"""A nonlinear program solved by IPOPT, an interior-point method, through CasADi.

Source: A. Waechter, L. T. Biegler, Mathematical Programming 106 (2006) 25-57.
"""

from __future__ import annotations

import math
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from time import monotonic
from typing import Any

import numpy as np

from certrack.core.arrays import Array
from certrack.studies.optimal.program import NonlinearProgram

#: Iterations at most, and the tolerance of the scaled program.
MAX_IPOPT_ITERATIONS, TOLERANCE = 500, 1e-8

#: Time of one solution at most, s: kinks of the plant may take IPOPT very long.
MAX_SOLUTION_SECONDS = 100.0

#: Why a solution ends that has no time left; and the least that each gets, s.
OUT_OF_TIME, LEAST_SECONDS = "it did not settle in the time it had", 1.0

#: What IPOPT's words mean.
MEANINGS = {
    "Infeasible_Problem_Detected": "the limits contradict each other near where it searched",
    "Maximum_Iterations_Exceeded": f"it did not settle within {MAX_IPOPT_ITERATIONS} iterations",
    "Restoration_Failed": "it found no way back to what the limits admit",
    "Invalid_Number_Detected": "a formula leaves its domain",
    "Maximum_CpuTime_Exceeded": OUT_OF_TIME,
    "User_Requested_Stop": OUT_OF_TIME,
}


@dataclass(frozen=True)
class SolverAnswer:
    """How a solution ended.

    Attributes
    ----------
    converged : bool
        Whether it is a local optimum.
    reason : str
        Why not; empty if it is.
    vector : (Z,) array
    minimum : float
        The objective there.
    """

    converged: bool
    reason: str
    vector: Array
    minimum: float


def minimise(
    ca: Any, program: NonlinearProgram, called: Callable[[], None], seconds: float = math.inf
) -> SolverAnswer:
    """Solve a program.

    Parameters
    ----------
    ca : module
        ``casadi``.
    program : NonlinearProgram
    called : callable
        Called at every iteration; an exception that it raises ends the search and is raised again.
    seconds : float
        After which it ends, too.
    """
    seconds = min(MAX_SOLUTION_SECONDS, max(seconds, LEAST_SECONDS))
    end = monotonic() + seconds
    problem = {"x": program.vector, "f": program.objective, "g": program.constraints}
    raised: list[BaseException] = []
    arrived: list[int] = []

    class Reporter(ca.Callback):
        def __init__(self) -> None:
            ca.Callback.__init__(self)
            self.construct("reporter", {})

        def get_n_in(self) -> int:
            return ca.nlpsol_n_out()

        def get_n_out(self) -> int:
            return 1

        def get_name_in(self, i: int) -> str:
            return ca.nlpsol_out(i)

        def get_sparsity_in(self, i: int) -> Any:
            name = ca.nlpsol_out(i)
            if name == "f":
                return ca.Sparsity.scalar()
            if name in ("x", "lam_x"):
                return ca.Sparsity.dense(len(program.start))
            if name in ("g", "lam_g"):
                return ca.Sparsity.dense(len(program.lower))
            return ca.Sparsity(0, 0)

        def eval(self, _: Any) -> list[int]:
            try:
                called()
            except BaseException as problem:
                raised.append(problem)
            return [1 if raised or arrived or monotonic() > end else 0]

    reporter = Reporter()
    solver = ca.nlpsol(
        "optimal",
        "ipopt",
        problem,
        {
            "print_time": False,
            "iteration_callback": reporter,
            "ipopt": {
                "print_level": 0,
                "sb": "yes",
                "max_iter": MAX_IPOPT_ITERATIONS,
                "max_cpu_time": seconds,
                "tol": TOLERANCE,
            },
        },
    )
    with noted_signals(arrived):
        answer = solver(
            x0=program.start,
            lbx=program.low,
            ubx=program.high,
            lbg=program.lower,
            ubg=program.upper,
        )
    if raised:
        raise raised[0]
    status = solver.stats()
    word = str(status["return_status"])
    converged = bool(status["success"])
    return SolverAnswer(
        converged,
        "" if converged else MEANINGS.get(word, word.replace("_", " ").lower()),
        np.array(answer["x"]).reshape(-1),
        float(answer["f"]),
    )


@contextmanager
def noted_signals(arrived: list[int]) -> Iterator[None]:
    """Note SIGINT and SIGTERM, and raise them again at the end.

    CasADi catches the exception of a signal that arrives in its own evaluations, and goes on.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {
        number: signal.signal(number, lambda which, _: arrived.append(which))
        for number in (signal.SIGINT, signal.SIGTERM)
        if signal.getsignal(number) is not signal.SIG_IGN
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for which in arrived[:1]:
            signal.raise_signal(which)
