"""Channels: what a range of constants adds to the sampled loop, as bounded inputs.

    x' = A x + b u + W w + sum_k B_k delta_k q_k,    q_k = C_k x + E_k u + c_k,    |delta_k| <= 1

The q_k are outputs of the loop as the states are, so that what cancels in them counts: a stiffness
error acts on the twist of a joint, which is small, and not on both of its angles.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Channel:
    """The output C x + E u; the constant of q is a bound of its column.

    Attributes
    ----------
    of_x : n rationals
    of_u : rational
    """

    of_x: tuple[Any, ...]
    of_u: Any
