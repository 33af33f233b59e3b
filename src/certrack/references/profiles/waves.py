"""References for measurements: a sine whose frequency is swept, and a sum of sines."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.references.profiles.polynomial import smooth_step
from certrack.references.symbolic import SymbolicReference

#: More sines than this are refused.
MAX_SINES = 50


def chirp(
    amplitude: float,
    frequencies: tuple[float, float],
    duration: float,
    offset: float = 0.0,
    smoothness: int = 0,
    bound: float | None = None,
) -> SymbolicReference:
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
    SymbolicReference

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
    return _stated("chirp", signal, written, {k: v for k, v in more.items() if v}, bound)


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
    if not 1 <= count <= MAX_SINES:
        raise InputError("reference.amplitudes", f"must be 1 to {MAX_SINES} numbers", count)
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
    return _stated("multisine", signal, written, {"offset": offset} if offset else {}, bound)


def _stated(
    kind: str, signal: str, written: dict[str, Any], more: dict[str, Any], bound: float | None
) -> SymbolicReference:
    fields = (("kind", kind), *written.items(), *more.items())
    return SymbolicReference(signal, bound=bound, fields=fields)  # type: ignore[arg-type]
