"""How far the searches of the tests go: a few cases in every run, many in `make hunt`.

A search that every run repeats with the same cases finds nothing new after the first: what it is
worth there is that it would fail if the claim were broken.
"""

from hypothesis import settings


def depth(few, many):
    """How many cases a search tries."""
    return many if settings.get_current_profile_name() == "hunt" else few
