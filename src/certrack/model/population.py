"""What varies between the members of an ensemble."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.core.keys import check_fields, keyed, keys_of, set_fields
from certrack.model.coefficients import check_gain, check_within
from certrack.model.distribution import Distribution, as_distribution
from certrack.model.disturbance import known_disturbances
from certrack.model.plant import Plant
from certrack.model.sampling import SAMPLINGS
from certrack.model.truth import Truth

DISTURBANCES = ("file", "multisine")

#: Sines of a random disturbance; each costs a number per state and member.
MAX_SINES = 50

#: Intervals of the time grid of the quantile bands.
MAX_POINTS = 10_000


@dataclass(frozen=True)
class Population:
    """What varies between members, and how; what is left out is as in the system.

    Parameters
    ----------
    x0 : n distributions, optional
        Initial plant states; those of the truth where it has states of its own.
    estimates : distributions, optional
        Initial controller states.
    input_gain : distribution, optional
        True g_n.
    theta : r distributions, optional
        True theta.
    tau : n distributions, optional
        True strengths of the disturbances.
    constants : mapping of names to distributions, optional
        True values of plant constants.
    amplitude, frequency : distribution, optional
        Factors on the reference and on its time: amplitude y_d(frequency t).
    disturbance : {"file", "multisine"} or a registered kind
        The system's omega, or w_k = s_k(t) (gamma_k ||x|| + beta_k) where s_k is a sum of sines of
        random weight, frequency and phase with |s_k| <= 1: always within Assumption 1.
    sines : int
        Terms of each s_k.
    frequencies : (low, high), rad/s
        Of the sines, log-uniform.
    sampling : {"plain", "latin", "sobol"}
        Independent members; Latin hypercubes of 1024 members each; or a scrambled Sobol sequence.
    points : int
        Intervals of the time grid on which quantile bands are kept.
    limit : float > 0, optional
        A member whose tail error exceeds it counts as a violation; the certificate if left out.

    Raises
    ------
    InputError
        If a number is out of its limits. What needs plant, truth or law (how many states, which
        constants, the ranges) is checked when a system is made of them.
    """

    x0: tuple[Distribution, ...] | None = keyed(
        "distributions",
        None,
        help="initial states",
        shape="one per simulated state",
        otherwise="simulation.x0",
    )
    estimates: tuple[Distribution, ...] | None = keyed(
        "distributions",
        None,
        help="initial controller states",
        shape="one per controller state",
        otherwise="simulation.estimates",
    )
    input_gain: Distribution | None = keyed(
        "distribution", None, help="true g_n, within its range", otherwise="truth.input_gain"
    )
    theta: tuple[Distribution, ...] | None = keyed(
        "distributions",
        None,
        help="true theta, within its ranges",
        shape="one per regressor",
        otherwise="truth.theta",
    )
    tau: tuple[Distribution, ...] | None = keyed(
        "distributions",
        None,
        help="true strengths of the uncertain terms",
        shape="one per state",
        least=0,
        otherwise="truth.tau",
    )
    constants: tuple[tuple[str, Distribution], ...] = keyed(
        "distributions by name",
        (),
        help="true value of a constant of the plant or of the truth",
        otherwise="as in the truth",
    )
    amplitude: Distribution | None = keyed(
        "distribution",
        None,
        help="factor A of A y_d(F t)",
        path="reference.amplitude",
        otherwise="1",
    )
    frequency: Distribution | None = keyed(
        "distribution",
        None,
        help="factor F of A y_d(F t)",
        above=0,
        path="reference.frequency",
        otherwise="1",
    )
    disturbance: str = keyed(
        "choice",
        "file",
        help="omega as it stands, random sines that are always admissible, or a registered family",
        choices=DISTURBANCES,
    )
    sines: int = keyed(
        "integer", 3, help="terms of each random disturbance", least=1, most=MAX_SINES
    )
    frequencies: tuple[float, float] = keyed(
        "interval", (0.1, 10.0), help="range of their frequencies", unit="rad/s", above=0
    )
    sampling: str = keyed(
        "choice",
        "plain",
        help="independent members, hypercubes of 1024 members, or a scrambled sequence",
        choices=SAMPLINGS,
    )
    points: int = keyed(
        "integer",
        200,
        help="intervals of the time grid of the bands",
        least=2,
        most=MAX_POINTS,
    )
    limit: float | None = keyed(
        "number",
        None,
        help="a member with a larger tail error is a violation",
        above=0,
        otherwise="the certificate",
    )

    def __post_init__(self) -> None:
        keys = keys_of(self)
        values: dict[str, Any] = {}
        for name in ("x0", "estimates", "theta", "tau"):
            entries, key = getattr(self, name), f"ensemble.{name}"
            if entries is not None:
                entries = checks.sequence(key, entries, None, keys[name].shape)
                values[name] = tuple(
                    as_distribution(f"{key}[{i}]", entry) for i, entry in enumerate(entries)
                )
        for name in ("input_gain", "amplitude", "frequency"):
            entry, key = getattr(self, name), f"ensemble.{keys[name].path or name}"
            if entry is not None:
                values[name] = as_distribution(key, entry)
        pairs = checks.name_value_pairs("ensemble.constants", self.constants)
        values["constants"] = tuple(
            (name, as_distribution(f"ensemble.constants.{name}", value)) for name, value in pairs
        )
        set_fields(self, **values)
        for i, entry in enumerate(self.tau or ()):
            if entry.low < 0:
                raise InputError(f"ensemble.tau[{i}]", "must be zero or positive", entry.low)
        if self.frequency is not None and self.frequency.low <= 0:
            low = self.frequency.low
            raise InputError("ensemble.reference.frequency", "must be positive", low)
        checks.choice("ensemble.disturbance", self.disturbance, known_disturbances())
        check_fields(
            self,
            "ensemble",
            *("sines", "frequencies", "sampling", "points", "limit"),
        )

    def bound_to(self, plant: Plant, truth: Truth, estimates: int) -> Population:
        """This population checked against plant, truth and the number of controller states."""
        if truth.states:
            self._refuse_design_form()
        if self.input_gain is not None:
            for end in (self.input_gain.low, self.input_gain.high):
                check_gain("ensemble.input_gain", end, plant.gain_sign)
                check_within("ensemble.input_gain", end, plant.input_gain_range, "input_gain")
        _check_count("theta", self.theta, plant.r, "one per regressor")
        ranges = plant.theta_range or ()
        for i, (entry, box) in enumerate(zip(self.theta or (), ranges, strict=False)):
            for end in (entry.low, entry.high):
                check_within(f"ensemble.theta[{i}]", end, box, "theta")
        _check_count("tau", self.tau, plant.n, "one per state")
        for name, entry in self.constants:
            for end in (entry.low, entry.high):
                within = plant.constant_boxes.get(name)
                check_within(f"ensemble.constants.{name}", end, within, name)
            if name not in (*plant.constant_values, *dict(truth.constants)):
                message = "is not a constant of the plant or of the truth"
                raise InputError(f"ensemble.constants.{name}", message)
        what = "one per state of the truth" if truth.states else "one per state"
        _check_count("x0", self.x0, len(truth.states or plant.states), what)
        _check_count("estimates", self.estimates, estimates, "one per controller state")
        return self

    def _refuse_design_form(self) -> None:
        """What a truth with states of its own has no place for."""
        where = "where the truth has states of its own"
        for name in ("input_gain", "theta", "tau"):
            if getattr(self, name) is not None:
                remedy = "Vary ensemble.constants and ensemble.x0"
                raise InputError(f"ensemble.{name}", f"must be left out {where}", remedy=remedy)
        if self.disturbance != "file":
            message = f"must be file {where}: its rates hold the disturbances"
            raise InputError("ensemble.disturbance", message, self.disturbance)

    @classmethod
    def default(cls, plant: Plant, truth: Truth) -> Population:
        """Every plant within the ranges, under every disturbance within the bounds.

        A truth with states of its own says itself what it is; then nothing varies.
        """
        if truth.states:
            return cls()

        def uniform(box: tuple[float, float]) -> Distribution:
            return Distribution("uniform", box)

        gain, theta, u = plant.input_gain_range, plant.theta_range, plant.uncertainty
        disturbed = any(t and u.acts(k) for k, t in enumerate(u.tau))
        return cls(
            input_gain=uniform(gain) if gain else None,
            theta=tuple(uniform(box) for box in theta) if theta else None,
            constants=tuple((k, uniform(box)) for k, box in plant.constant_boxes.items()),
            disturbance="multisine" if disturbed else "file",
        )


def _check_count(name: str, entries: Sequence[Distribution] | None, count: int, what: str) -> None:
    """Refuse a list of distributions that has not one for everything it speaks of."""
    if entries is not None and len(entries) != count:
        written = f"[{', '.join(map(str, entries))}]"
        raise InputError(f"ensemble.{name}", f"must be a list of {count}: {what}", written)
