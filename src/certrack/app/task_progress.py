"""What a long computation says in the bottom bar: which part is at work, how far it is."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from certrack.app.frames import FrameKind, pack_frame
from certrack.app.responses import number_text
from certrack.core.progress import Progress

#: Reports of a part are passed on at most so often, s; its first one always.
REPORT_INTERVAL = 0.1


@dataclass(frozen=True)
class TaskProgress:
    """The parts of one computation.

    Attributes
    ----------
    task : str
        One of :data:`certrack.app.messages.TASKS`, or ``"export"``.
    design : int
        Of which design it is.
    send : callable
        Gets the frames.
    """

    task: str
    design: int
    send: Callable[[bytes], None]

    def part(
        self,
        noun: str,
        extreme: str = "",
        unit: str = "",
        at_work: Callable[[float], str] | None = None,
    ) -> Progress:
        """The `progress` of a part.

        Parameters
        ----------
        noun : str
            What is counted, in the plural.
        extreme, unit : str
            What its extreme value is called, and its unit with a blank before it; without a name
            the value is not shown.
        at_work : callable, optional
            Names what is at work when so much is done.

        Returns
        -------
        callable
        """
        last = -math.inf

        def report(done: float, total: float | None, best: float | None, /) -> None:
            nonlocal last
            now = time.monotonic()
            if now - last < REPORT_INTERVAL:
                return
            last = now
            words = count_text(noun, done, total)
            if at_work is not None:
                words = f"{at_work(done)}, {words}"
            if extreme and best is not None:
                words += f" \N{MIDDLE DOT} {extreme} {number_text(best)}{unit}"
            self.say(words, done / total if total else None)

        return report

    def say(self, words: str, share: float | None = None) -> None:
        """Show `words`, and how full the bar is; None where that is not known."""
        header = {"task": self.task, "state": "running", "words": words, "share": share}
        self.send(pack_frame(FrameKind.TASK, header, design=self.design))


def count_text(noun: str, done: float, total: float | None) -> str:
    """How much is done.

    Examples
    --------
    >>> count_text("runs", 40, 6000), count_text("values tried", 7, None)
    ('40 of 6000 runs', 'values tried 7')
    """
    return f"{noun} {done:.0f}" if total is None else f"{done:.0f} of {total:.0f} {noun}"
