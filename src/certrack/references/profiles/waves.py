"""References for measurements: a sine whose frequency is swept, and a sum of sines."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from flint import fmpq

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.core.rationals import float_above
from certrack.references.base import require_order, round_up
from certrack.references.extremes import largest_derivative
from certrack.references.profiles.polynomial import smooth_step
from certrack.references.symbolic import SymbolicReference

#: More sines than this are refused.
MAX_REFERENCE_SINES = 50


@dataclass(frozen=True)
class SweptSine(SymbolicReference):
    """offset + A sin(phi(t)), whose bounds follow from those of phi', phi'', ...

    The n-th derivative of e^(i phi) is e^(i phi) times the complete Bell polynomial of i phi',
    i phi'', ...; its real and imaginary part are bounded term by term.
    """

    def bound_of(self, i: int) -> tuple[float, str]:
        """Y_i alone, and where it comes from."""
        require_order(self, i, "the bound asked for")
        return self._size(i), "proven"

    def lipschitz_bound(self, order: int, *, between_jumps: bool = False) -> float | None:
        """That of y_d^(order); see :func:`certrack.references.lipschitz_bound`."""
        if order > self.order or (order == self.order and not between_jumps):
            return None
        return self._size(order + 1)

    def _size(self, i: int) -> float:
        """Upper bound of |y_d^(i)| between the jumps, i >= 0."""
        try:
            return self._exact_size(i)
        except OverflowError:
            what = f"must not be so large or fast that |y_d^({i})| overflows"
            raise InputError("reference", what) from None

    def _exact_size(self, i: int) -> float:
        stated = dict(self.fields)
        amplitude = abs(Fraction(stated["amplitude"]))
        if i == 0:
            return float_above(abs(Fraction(stated.get("offset", 0.0))) + amplitude)
        low, high = map(Fraction, stated["frequencies"])
        step, pace = smooth_step(2 * stated.get("smoothness", 0) + 1), Fraction(stated["duration"])
        rates = [max(low, high)]
        for k in range(1, i):
            steepest = Fraction(largest_derivative(step, k, fmpq(1)))
            rates.append(abs(high - low) * steepest / pace**k)
        sizes = [(Fraction(1), Fraction(0))]  # of the real and the imaginary part
        for n in range(i):
            terms = [(math.comb(n, k) * rates[k], sizes[n - k]) for k in range(n + 1)]
            real = sum((rate * size[1] for rate, size in terms), Fraction(0))
            imaginary = sum((rate * size[0] for rate, size in terms), Fraction(0))
            sizes.append((real, imaginary))
        real, imaginary = sizes[i]
        return round_up(math.sqrt(amplitude**2 * (real**2 + imaginary**2)))


def chirp(
    amplitude: float,
    frequencies: tuple[float, float],
    duration: float,
    offset: float = 0.0,
    smoothness: int = 0,
    bound: float | None = None,
) -> SweptSine:
    """A sine whose frequency goes from one value to another, and then stays.

    Parameters
    ----------
    amplitude : float
        Unit of the output.
    frequencies : two numbers, rad/s
        At the begin and at the end of the sweep.
    duration : float, s
        Of the sweep.
    offset : float
        Mean value, unit of the output.
    smoothness : {0, 1, 2, 3}
        Derivatives of the frequency that are continuous; with 0 it is a straight line. The order of
        the reference is two more.
    bound : float, optional
        D of Assumption 2.

    Returns
    -------
    SweptSine

    Examples
    --------
    >>> from certrack.references.profiles.waves import chirp
    >>> chirp(0.1, (1, 20), duration=10).order
    2.0
    """
    amplitude = checks.real("reference.amplitude", amplitude, nonzero=True)
    low, high = checks.reals("reference.frequencies", frequencies, 2, "begin and end", above=0)
    if low == high:
        raise InputError("reference.frequencies[1]", "must differ from the first", high)
    duration = checks.real("reference.duration", duration, above=0)
    offset = checks.real("reference.offset", offset)
    smoothness = checks.integer("reference.smoothness", smoothness, 0, 3)
    swept = smooth_step(2 * smoothness + 1).integral()
    share, t, D = f"(min(t, {duration!r})/{duration!r})", "t", repr(duration)
    powers = [f"({c.p}/{c.q})*{share}**{k}" for k, c in enumerate(swept.coeffs()) if c]
    change = f"({high!r} - {low!r})*({D}*({' + '.join(powers)}) + {t} - min({t}, {D}))"
    signal = f"{offset!r} + {amplitude!r}*sin({low!r}*{t} + {change})"
    written = {"amplitude": amplitude, "frequencies": (low, high), "duration": duration}
    more = {"offset": offset, "smoothness": smoothness}
    others = {k: v for k, v in more.items() if v}
    fields = (("kind", "chirp"), *written.items(), *others.items())
    return SweptSine(signal, bound=bound, fields=fields)  # type: ignore[arg-type]


def multisine(
    amplitudes: tuple[float, ...],
    frequencies: tuple[float, ...],
    phases: tuple[float, ...] | None = None,
    offset: float = 0.0,
    bound: float | None = None,
) -> SymbolicReference:
    """A sum of sines, offset + sum_k a_k sin(w_k t + p_k).

    Parameters
    ----------
    amplitudes : m numbers
        Unit of the output.
    frequencies : m numbers, rad/s
    phases : m numbers, rad, optional
        Schroeder's, -pi k (k - 1)/m, if left out: they keep the peaks low.
    offset : float
        Unit of the output.
    bound : float, optional
        D of Assumption 2.

    Returns
    -------
    SymbolicReference

    Examples
    --------
    >>> from certrack.references.profiles.waves import multisine
    >>> multisine((0.1, 0.2), (1, 3)).bounds(1).origin
    ('proven', 'proven')
    """
    amplitudes = checks.reals("reference.amplitudes", amplitudes, None, "one per sine")
    count = len(amplitudes)
    if not 1 <= count <= MAX_REFERENCE_SINES:
        raise InputError(
            "reference.amplitudes", f"must be 1 to {MAX_REFERENCE_SINES} numbers", count
        )
    frequencies = checks.reals("reference.frequencies", frequencies, count, "one per sine", above=0)
    offset = checks.real("reference.offset", offset)
    written: dict[str, Any] = {"amplitudes": amplitudes, "frequencies": frequencies}
    angles: Sequence[str] = [f"-pi*{k * (k + 1)}/{count}" for k in range(count)]
    if phases is not None:
        phases = checks.reals("reference.phases", phases, count, "one per sine")
        written["phases"] = phases
        angles = list(map(repr, phases))
    sines = (
        f"{a!r}*sin({w!r}*t + {p})" for a, w, p in zip(amplitudes, frequencies, angles, strict=True)
    )
    signal = " + ".join([repr(offset), *sines])
    written |= {"offset": offset} if offset else {}
    fields = (("kind", "multisine"), *written.items())
    return SymbolicReference(signal, bound=bound, fields=fields)  # type: ignore[arg-type]
