"""``certrack`` and ``python -m certrack``: the command line, loaded so that Ctrl-C may end it."""

import os
import signal
import sys
from types import FrameType


def launch() -> None:
    """Load the command line and run it."""
    is_usual = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if is_usual:  # a shell may have told it to ignore interruptions
        signal.signal(signal.SIGINT, _interrupted)
    from certrack.cli import main as command_line

    if is_usual:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    command_line()


def _interrupted(_signal: int, _frame: FrameType | None) -> None:
    """End at once: an exception would be told by whatever library is just being loaded."""
    os.write(sys.__stderr__.fileno() if sys.__stderr__ else 2, b"certrack: interrupted\n")
    os._exit(130)


if __name__ == "__main__":
    launch()
