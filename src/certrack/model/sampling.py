"""Where in their distributions the members of an ensemble lie.

A member's numbers are a pure function of the seed and its index, so any member can be replayed
alone and any division of the work gives the same ensemble.
"""

from __future__ import annotations

import warnings

import numpy as np

from certrack.core.errors import InputError

SAMPLINGS = ("plain", "latin", "sobol")

#: Members that are drawn together; a Latin hypercube stratifies each of these groups.
MEMBERS_PER_DRAW = 1024

#: Largest number of members: so many points the scrambled Sobol sequence has.
MAX_MEMBERS = 2**30


def probabilities(sampling: str, seed: int, begin: int, end: int, count: int) -> np.ndarray:
    """Numbers in [0, 1) of the members begin ... end-1, shape (count, end - begin).

    Parameters
    ----------
    sampling : {"plain", "latin", "sobol"}
    seed : int
    begin, end : int
        Members, 0 <= begin < end <= :data:`MAX_MEMBERS`.
    count : int
        How many numbers a member has.

    Raises
    ------
    InputError
        If the sequence has no such members.
    """
    if not 0 <= begin < end <= MAX_MEMBERS:
        raise InputError("members", f"must be at most {MAX_MEMBERS}", end)
    if not count:
        return np.empty((0, end - begin))
    if sampling == "sobol":
        return _sobol_points(seed, count, begin, end)
    first, last = begin // MEMBERS_PER_DRAW, (end - 1) // MEMBERS_PER_DRAW
    draws = [_draw(sampling, seed, index, count) for index in range(first, last + 1)]
    table = np.concatenate(draws, axis=1)
    offset = first * MEMBERS_PER_DRAW
    return table[:, begin - offset : end - offset]


def _draw(sampling: str, seed: int, index: int, count: int) -> np.ndarray:
    """The members of one draw, shape (count, MEMBERS_PER_DRAW)."""
    rng = np.random.Generator(np.random.Philox(np.random.SeedSequence([seed, index])))
    if sampling == "plain":
        return rng.random((MEMBERS_PER_DRAW, count)).T
    from scipy.stats import qmc

    return qmc.LatinHypercube(count, rng=rng).random(MEMBERS_PER_DRAW).T


def _sobol_points(seed: int, count: int, begin: int, end: int) -> np.ndarray:
    from scipy.stats import qmc

    rng = np.random.Generator(np.random.Philox(np.random.SeedSequence([seed])))
    engine = qmc.Sobol(count, rng=rng)
    if begin:
        engine.fast_forward(begin)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a part of the sequence need not be a power of two
        points: np.ndarray = engine.random(end - begin).T
    return points
