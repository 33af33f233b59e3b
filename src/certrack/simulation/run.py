"""The result of one simulation: samples, metrics, and a labelled dataset with provenance."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from certrack.core.errors import InputError, shorten
from certrack.core.files import read_netcdf, write_netcdf
from certrack.core.notebook import ShownInNotebooks
from certrack.core.version import version
from certrack.integrators.base import Outcome, Trajectory, subdivide
from certrack.integrators.sampled.solution import SampledSolution
from certrack.integrators.single.extremes import SeriesSignals
from certrack.integrators.single.taylor import TaylorSeries
from certrack.loops.continuous import INTEGRAL_SCALE, INTEGRALS
from certrack.loops.plant import measured
from certrack.references.rests import moves_of
from certrack.simulation.messages import outcome_message
from certrack.simulation.metrics import Metrics, measure, measure_series, settling_band
from certrack.simulation.moves import MoveMetrics, measure_moves
from certrack.simulation.step_metrics import measure_steps
from certrack.systems.reader import loads
from certrack.systems.system import System
from certrack.systems.writer import to_text

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True)
class Run(ShownInNotebooks):
    """One simulated run.

    Attributes
    ----------
    system : System
    trajectory : Trajectory
        Dense output of all states.
    input_of : callable
        u at given times and states.
    notes : texts
        What the user should know of how the run was carried out.
    smooth_steps : bool
        Whether no kink lies inside a step, so that peaks may be refined there.
    signals : SeriesSignals, optional
        Error and input for the metrics in compiled C.
    """

    system: System
    trajectory: Trajectory
    input_of: Callable[[np.ndarray, np.ndarray], np.ndarray]
    notes: tuple[str, ...] = ()
    smooth_steps: bool = True
    signals: SeriesSignals | None = None

    @property
    def outcome(self) -> Outcome:
        """How the run ended."""
        return self.trajectory.outcome

    @property
    def message(self) -> str:
        """How it ended, in words, with what can be done."""
        return outcome_message(self.outcome, self.system)

    @cached_property
    def t(self) -> np.ndarray:
        """Sample times, shape (N,), s: every integration step cut into equal parts."""
        return subdivide(self.trajectory.times, self.trajectory.parts)

    @cached_property
    def _states(self) -> np.ndarray:
        dense = self.trajectory.interpolate
        if isinstance(dense, (TaylorSeries, SampledSolution)) and len(self.trajectory.times) > 1:
            return dense.subdivided(self.trajectory.times, self.trajectory.parts)
        return dense(self.t)

    @cached_property
    def x(self) -> np.ndarray:
        """States of the design as the controller measures them, shape (n, N)."""
        return measured(self.system, self._states)

    @property
    def z(self) -> np.ndarray:
        """Controller states (estimates), N columns."""
        return self._states[len(self.system.simulated_states) : -len(INTEGRALS)]

    @cached_property
    def y_d(self) -> np.ndarray:
        """Reference, shape (N,)."""
        return self.system.reference.values(self.t, 0)[0]

    @cached_property
    def u(self) -> np.ndarray:
        """Control input, shape (N,)."""
        return self.input_of(self.t, self._states)

    @cached_property
    def e(self) -> np.ndarray:
        """Error coordinates e = A x - B Y, shape (n, N); the first is the tracking error."""
        return self._errors(self.t, self.x)

    @cached_property
    def metrics(self) -> Metrics:
        """What the run is judged by."""
        settings, dense = self.system.settings, self.trajectory.interpolate
        band = settling_band(settings, self.system.reference)
        if isinstance(dense, SampledSolution):
            return measure_steps(dense, band, settings.tail_start)
        if self.signals is not None and isinstance(dense, TaylorSeries):
            measured_in_c = measure_series(
                self.trajectory, dense, self.signals, band, settings.tail_start, self.smooth_steps
            )
            if measured_in_c is not None:
                return measured_in_c
        integrals = self._states[-len(INTEGRALS) :] * INTEGRAL_SCALE
        error = self.x[0] - self.y_d
        return measure(
            self.t,
            error,
            self.u,
            integrals,
            band,
            settings.tail_start,
            per_step=self.trajectory.parts + 1,
            dense=self._signals,
            smooth=self.smooth_steps,
        )

    @cached_property
    def moves(self) -> tuple[MoveMetrics, ...]:
        """What every move from rest to rest is judged by; empty for a reference without rests."""
        system = self.system
        known = moves_of(system.reference, self.trajectory.end)
        if not known:
            return ()
        per_step = self.trajectory.parts + 1 if self.smooth_steps else None
        return measure_moves(known, self.t, self.x[0], self.y_d, system.settings.band, per_step)

    def _signals(self, t: np.ndarray) -> np.ndarray:
        """e_1, u and the integral of e_1 at any times, a row each."""
        states = self.trajectory.interpolate(t)
        error = measured(self.system, states)[0] - self.system.reference.values(t, 0)[0]
        return np.array([error, self.input_of(t, states), states[-1] * INTEGRAL_SCALE])

    def __repr__(self) -> str:
        metrics, trajectory = self.metrics, self.trajectory
        end = f"{self.outcome.name} at {trajectory.end:g} s by {trajectory.method}"
        figures = f"tail error {metrics.tail_error:.5g}, peak input {metrics.peak_input:.5g}"
        seconds = metrics.settling_time
        settling = f"settled after {seconds:.4g} s" if math.isfinite(seconds) else "not settled"
        return f"Run({shorten(self.system.title)!r}: {end}; {figures}, {settling})"

    @property
    def final_state(self) -> dict[str, float]:
        """Simulated plant's and controller's states at the last time reached, by name."""
        names = (*self.system.simulated_states, *(s.name for s in self.system.controller.states))
        return dict(zip(names, self._states[: len(names), -1].tolist(), strict=True))

    def summary(self) -> dict[str, Any]:
        """Metrics, final state and outcome, ready for JSON.

        Returns
        -------
        dict

        Examples
        --------
        >>> import certrack
        >>> run = certrack.simulate(certrack.load("example1"))
        >>> run.summary()["outcome"]
        'finished'
        """
        return {
            **self.metrics.as_dict(),
            "moves": [move.as_dict() for move in self.moves],
            "final_time": self.trajectory.end,
            "final_state": self.final_state,
            "outcome": self.outcome.name,
            "message": self.message,
            "integrator": self.trajectory.method,
            "steps": len(self.trajectory.times) - 1,
            "notes": list(self.notes),
        }

    def dataset(self, samples: int | None = None) -> xarray.Dataset:
        """Labelled result with units and provenance.

        Parameters
        ----------
        samples : int, optional
            Number of equidistant times; if left out, the integrator's own steps, subdivided, which
            resolve every layer and peak.

        Returns
        -------
        xarray.Dataset
            Variables ``x`` and ``e`` (time, state), ``u`` and ``y_d`` (time), ``estimate``
            (time, parameter), ``truth`` (time, truth_state) where the truth has states of its own,
            ``sticking`` (time, surface) where sign() of a state may hold it; the attributes hold
            version, system text and metrics.

        Examples
        --------
        >>> import certrack
        >>> run = certrack.simulate(certrack.load("example1"))
        >>> dict(run.dataset(samples=101).sizes)
        {'time': 101, 'state': 2, 'parameter': 2}
        """
        import xarray

        system, n = self.system, self.system.plant.n
        t = self.t if samples is None else np.linspace(0.0, self.trajectory.end, samples)
        states = self._states if samples is None else self.trajectory.interpolate(t)
        simulated, x = system.simulated_states, measured(system, states)
        units = system.plant.units or ("1",) * (n + 1)
        y_d = system.reference.values(t, 0)[0]
        data: dict[str, Any] = {
            "x": (("time", "state"), x.T, {"long_name": "plant state"}),
            "e": (("time", "state"), self._errors(t, x).T, {"long_name": "error"}),
            "y_d": ("time", y_d, {"long_name": "reference", "units": units[0]}),
            "u": ("time", self.input_of(t, states), {"long_name": "input", "units": units[n]}),
        }
        coords: dict[str, Any] = {
            "time": ("time", t, {"units": "s", "long_name": "time"}),
            "state": list(system.plant.states),
            "state_units": ("state", list(units[:n])),
        }
        if system.truth.states:
            table = states[: len(simulated)].T
            data["truth"] = (("time", "truth_state"), table, {"long_name": "state of the truth"})
            coords["truth_state"] = list(simulated)
        estimates = [state.name for state in system.controller.states]
        if estimates:
            z = states[len(simulated) : len(simulated) + len(estimates)].T
            data["estimate"] = (("time", "parameter"), z, {"long_name": "estimate"})
            coords["parameter"] = estimates
        modes = self.trajectory.modes
        if modes is not None:
            table = modes.stuck(t).T.astype(np.int8)
            data["sticking"] = (("time", "surface"), table, {"long_name": "slides along it"})
            coords["surface"] = list(modes.surfaces)
        summary = {k: v for k, v in self.metrics.as_dict().items() if v is not None}
        attributes = {
            "title": system.title,
            "source": f"certrack {version()}",
            "integrator": self.trajectory.method,
            "tolerance": system.settings.tolerance,
            "outcome": self.outcome.name,
            "notes": " ".join(self.notes),
            "system": to_text(system),
        }
        return xarray.Dataset(data, coords, attributes | summary)

    def save(self, path: str | Path, samples: int | None = None) -> None:
        """Write the dataset as NetCDF; the file appears only when it is complete.

        Parameters
        ----------
        path : path
        samples : int, optional
            As for :meth:`dataset`.

        Returns
        -------
        None

        Raises
        ------
        InputError
            If the file cannot be written.

        Examples
        --------
        >>> import certrack
        >>> run = certrack.simulate(certrack.load("example1"))
        >>> run.save("run.nc")
        """
        write_netcdf(Path(path), self.dataset(samples))

    @classmethod
    def load(cls, path: str | Path) -> Run:
        """A run that :meth:`save` has written.

        Its samples and metrics are the stored ones; between the samples it is linear.

        Parameters
        ----------
        path : path

        Returns
        -------
        Run

        Raises
        ------
        InputError
            If the file cannot be read or holds no run.
        """
        data = read_netcdf(Path(path))
        try:
            system, t = loads(data.attrs["system"], str(path)), data.time.values
            plant = data.truth if system.truth.states else data.x
            parts = [plant.values.T, np.full((len(INTEGRALS), len(t)), np.nan)]
            if system.controller.states:
                parts.insert(1, data.estimate.values.T)
            stored = {"t": t, "_states": np.concatenate(parts), "x": data.x.values.T}
            stored |= {"e": data.e.values.T, "u": data.u.values, "y_d": data.y_d.values}
            names = [entry.name for entry in fields(Metrics)]
            metrics = Metrics(**{name: float(data.attrs.get(name, np.nan)) for name in names})
            outcome, method = Outcome[data.attrs["outcome"]], str(data.attrs["integrator"])
            notes = data.attrs["notes"]
        except (KeyError, AttributeError, ValueError) as problem:
            if isinstance(problem, InputError):
                raise
            raise InputError(str(path), f"holds no run of certrack ({problem})") from None

        def states(times: np.ndarray) -> np.ndarray:
            return np.array([np.interp(times, t, row) for row in stored["_states"]])

        def inputs(times: np.ndarray, _: np.ndarray) -> np.ndarray:
            return np.interp(times, t, stored["u"])

        trajectory = Trajectory(t, states, outcome, method, parts=1)
        run = cls(system, trajectory, inputs, (notes,) if notes else ())
        vars(run).update(stored, metrics=metrics)  # where cached_property looks
        return run

    def _errors(self, t: np.ndarray, x: np.ndarray) -> np.ndarray:
        coordinates = self.system.controller.coordinates
        Y = self.system.reference.values(t, coordinates.q)
        return coordinates.A @ x - coordinates.B @ Y
