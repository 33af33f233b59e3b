"""Results that are kept with an object that never changes."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Concatenate, ParamSpec, TypeVar

Subject = TypeVar("Subject")
Other = TypeVar("Other")
Further = ParamSpec("Further")
Answer = TypeVar("Answer")

#: Where they are kept, among the attributes of the object.
RESULTS = "_results"


def once(
    function: Callable[Concatenate[Subject, Further], Answer],
) -> Callable[Concatenate[Subject, Further], Answer]:
    """The function, computed once for each object and each further arguments.

    For frozen objects with a ``__dict__`` and results that nobody changes; what raises is computed
    anew. Two threads may both compute the same.
    """

    @wraps(function)
    def recall(subject: Subject, /, *further: Further.args, **named: Further.kwargs) -> Answer:
        results = vars(subject).setdefault(RESULTS, {})
        key = function, further, tuple(sorted(named.items()))
        if key not in results:
            results[key] = function(subject, *further, **named)
        result: Answer = results[key]
        return result

    return recall


def once_for_newest(
    function: Callable[[Subject, Other], Answer],
) -> Callable[[Subject, Other], Answer]:
    """The function of an object and another one, not computed again while that stays the same.

    Only the last answer is remembered, so that an object that lives long holds on to no more.
    """

    @wraps(function)
    def recall(subject: Subject, other: Other, /) -> Answer:
        results = vars(subject).setdefault(RESULTS, {})
        known = results.get(function)
        if known is None or known[0] is not other:
            known = results[function] = other, function(subject, other)
        answer: Answer = known[1]
        return answer

    return recall


def without_results(state: dict[str, object]) -> dict[str, object]:
    """The attributes of an object that are pickled and copied."""
    return {name: value for name, value in state.items() if name != RESULTS}
