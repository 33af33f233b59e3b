"""certrack: certified tracking control for uncertain nonlinear systems.

>>> import certrack
>>> system = certrack.load("example1")
>>> run = certrack.simulate(system)
>>> round(run.metrics.settling_time, 2)
2.15

The public names and their modules stand in ``__init__.pyi``, for type checkers and for the loader
alike: a module is imported when one of its names is first used.
"""

import lazy_loader as _lazy

_public, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    if name in __all__ or name.startswith("_"):
        return _public(name)
    from certrack.core.spelling import hint

    message = f"module 'certrack' has no attribute {name!r}. {hint(name, __all__)}"
    raise AttributeError(message.strip())
