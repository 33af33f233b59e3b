"""What is proven of a design, as far as a tuning waits for it."""

from __future__ import annotations

from certrack.certificates.bootstrap.certify import certify_bootstrap
from certrack.certificates.certificate import Certificate
from certrack.certificates.certify import certify
from certrack.certificates.implemented.certify import KIND
from certrack.certificates.methods import smallest
from certrack.certificates.ranges.certify import certify_ranges
from certrack.certificates.scope import has_ranges
from certrack.systems.system import System


def certified(system: System, *, bootstrap: bool = True) -> Certificate:
    """The best certificate of a system: that of the loop as implemented, else the smallest.

    Ranges are cut into cells, which takes seconds: gains that were searched for the corners may be
    too sharp for one proof of the whole box. The loop as implemented, of which the cells take
    a minute or more, is tried for the whole box only.

    Parameters
    ----------
    system : System
    bootstrap : bool
        Whether the bootstrap, which takes a second or two, may be it.
    """
    result = certify(system, "fast")
    if result.best.kind == KIND or result.contradicted:
        return result.best
    later, others = system.long_run, []
    if has_ranges(system):
        others.append(certify_ranges(later).best)
    elif bootstrap and result.cascade_proof is not None:
        others.append(certify_bootstrap(later, first=result.cascade_proof[0])[0])
    return smallest((*others, result.best)) or result.best
