"""The reference among the variables: y_i = y_d^(i) / Y_i, i = 0 ... q, follow each other.

y_i' = (Y_{i+1} / Y_i) y_{i+1}. A function that may depend on them knows that y_d' cannot push into
one direction for ever, and how large x is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from certrack.certificates.bootstrap.forms import Corner, Forms
from certrack.certificates.bootstrap.loop import AdaptiveLoop


def knows_reference(loop: AdaptiveLoop) -> bool:
    """Whether y_d ... y_d^(q) all move; those that are zero would have no unit."""
    return all(size > 0 for size in loop.Y[:-1])


def with_reference(loop: AdaptiveLoop, forms: Forms) -> Forms:
    """The same forms with y_0 ... y_q behind the errors."""
    size, count = forms.size, len(loop.Y) - 1
    begin = size + 1 + loop.Ua.shape[1] + loop.Ub.shape[1]
    moved = list(range(begin, begin + count))
    others = [i for i in range(size, forms.width) if i not in moved]
    order = [*range(size), *moved, *others]
    at = {old: new for new, old in enumerate(order)}
    rates = np.zeros((count, forms.width), dtype=forms.middle.dtype) + 0 * forms.middle[0]
    for i, place in enumerate(moved):
        rates[i, at[place + 1]] = loop.Y[i + 1] / loop.Y[i]
    corners = tuple(
        Corner(np.vstack([corner.F[:, order], rates]), corner.relation[order])
        for corner in forms.corners
    )
    one, zero = 1 + 0 * forms.middle[0], 0 * forms.middle[0]
    wider = size + count + 1
    sectors = np.full((len(forms.sectors) + count, wider), zero, dtype=forms.middle.dtype)
    sectors[: -count or None, [*range(size), -1]] = forms.sectors
    for i in range(count):
        sectors[len(forms.sectors) + i, size + i] = one
    return replace(
        forms,
        size=size + count,
        corners=corners,
        squares=tuple((rows[:, order], at[place]) for rows, place in forms.squares),
        products=tuple(
            (tuple(at[i] for i in first), tuple(at[i] for i in second))
            for first, second in forms.products
        ),
        sectors=sectors,
        middle=np.append(forms.middle, [zero] * count),
        radius=np.append(forms.radius, loop.Y[:-1]),
    )
