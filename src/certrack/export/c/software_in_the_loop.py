"""Software in the loop: a sampled run whose controller is the exported C code.

Called by ``ctypes``, as the compiled ensembles are: no further dependency, and one call per sample
(a microsecond) is little beside the plant.
"""

from __future__ import annotations

import ctypes

import numpy as np

from certrack.core.arrays import Array
from certrack.core.compilers import function_of, load_library
from certrack.core.errors import InputError
from certrack.core.expressions import TIME
from certrack.core.lowering import numpy_callable, rows
from certrack.export.c.source import CCode, c_code
from certrack.integrators.sampled.maps import SampledMaps, Scalar
from certrack.loops.sampled import SampledLoop
from certrack.simulation.run import Run
from certrack.simulation.sampled import SampledSimulator
from certrack.systems.system import System, require_system

#: As strict as the language allows.
STRICT_FLAGS = (
    "-std=c99 -O2 -Wall -Wextra -Wpedantic -Werror -ffp-contract=off -shared -fPIC".split()
)


class CMaps:
    """Maps whose controller is compiled C, of ``double`` numbers; the plant stays as it is.

    Parameters
    ----------
    maps : SampledMaps
        For the plant.
    loop : SampledLoop
    code : CCode
        Of the system that is run: its gains are in the code, not in the parameters.
    """

    def __init__(self, maps: SampledMaps, loop: SampledLoop, code: CCode) -> None:
        self._maps = maps
        sources = {f"{code.name}.h": code.header, f"{code.name}.c": code.source}
        self._library = load_library(sources, STRICT_FLAGS)
        self._step = function_of(self._library, f"{code.name}_step")
        self._step.argtypes = [ctypes.c_void_p] * 3
        self._step.restype = ctypes.c_double
        formulas = code.system.reference.formulas(len(code.program.Y) - 1)
        self._reference = numpy_callable([TIME, [*loop.parameters, *loop.pieces]], formulas)

    def control(self, t: Scalar, measured: Array, states: Array, p: Array) -> tuple[Array, Array]:
        with np.errstate(all="ignore"):
            Y = rows(self._reference(t, p), measured.shape[1])
        u, after = np.empty(measured.shape[1]), np.empty(states.shape[::-1])
        for i in range(len(u)):
            x, y_d = np.ascontiguousarray(measured[:, i]), np.ascontiguousarray(Y[:, i])
            state = np.append(states[:, i], 0.0)  # the member of a structure without states
            u[i] = self._step(state.ctypes.data, x.ctypes.data, y_d.ctypes.data)
            after[i] = state[:-1]
        return u, after.T

    def step(
        self, t: Scalar, h: Scalar, allowed: Scalar, x: Array, u: Array, totals: Array, p: Array
    ) -> tuple[Array, Array, Array]:
        return self._maps.step(t, h, allowed, x, u, totals, p)


def simulate_with_c(system: System) -> Run:
    """Run a system with its controller in C.

    Parameters
    ----------
    system : System
        With an implementation.

    Returns
    -------
    Run

    Raises
    ------
    InputError
        If it has none.
    CompilerError
        If there is no C compiler, or it failed.

    Examples
    --------
    >>> import certrack
    >>> run = certrack.simulate_with_c(certrack.load("dual-motor-drive"))
    >>> run.outcome.name
    'finished'
    """
    require_system(system)
    if system.implementation is None:
        raise InputError(
            "implementation",
            "is missing: only a sampled controller runs as C",
            remedy="Add a table [implementation] with a period",
        )
    code = c_code(system)

    def with_c(maps: SampledMaps, loop: SampledLoop) -> SampledMaps:
        return CMaps(maps, loop, code)

    controller = code.program.controller
    return SampledSimulator(system, around=with_c, controller=controller).run(system)


def difference_from_python(run: Run) -> float:
    """Largest |u - u of the same run with its controller in Python|, at the times of both."""
    in_python = SampledSimulator(run.system).run(run.system)
    return float(abs(in_python.dataset().u - run.dataset().u).max())
