"""Command line. Each verb loads, computes, prints; the work is done elsewhere.

Results go to standard output (``--json`` for programs), diagnostics to standard error. Exit code 0
means success, 2 bad input with one line that says what is wrong, 1 a run that did not finish, a
premise that the file's own truth contradicts, a certificate that does not hold (or does not exist,
with ``--require``) or an alarm of the falsifier, 130 an interruption, 143 a termination.
"""

from __future__ import annotations

import gc
import sys
import warnings
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import click

from certrack.cli.cache import cache
from certrack.cli.checks import check
from certrack.cli.designer import app
from certrack.cli.dossiers import report
from certrack.cli.energy import energy
from certrack.cli.exports import export
from certrack.cli.files import design, list_systems, new
from certrack.cli.margins import margin
from certrack.cli.optimal import optimal
from certrack.cli.papers import reproduce
from certrack.cli.proofs import certify, falsify, verify
from certrack.cli.runs import compare, ensemble, simulate
from certrack.cli.surroundings import (
    REFUSALS,
    TERMINATED_CODE,
    ended_by_exception,
    flushed,
    trouble,
)
from certrack.cli.tune import tune
from certrack.core.blas import one_thread_from_now_on
from certrack.core.errors import CertrackError, one_line

#: New objects, after which Python looks for circles of dead ones: seldom, since most of what a verb
#: loads lives as long as the process.
NEW_OBJECTS = 50_000


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(package_name="certrack")
def cli() -> None:
    """Design, tune, certify, simulate, deploy tracking controllers for uncertain nonlinear systems.

    FILE is a system file (TOML) or the name of a shipped system, see `certrack list`.

    \b
    Example: certrack simulate example1
    """


for verb in (
    app,
    list_systems,
    new,
    design,
    simulate,
    compare,
    ensemble,
    margin,
    optimal,
    energy,
    tune,
    check,
    certify,
    verify,
    falsify,
    report,
    reproduce,
    export,
    cache,
):
    cli.add_command(verb)


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point of the ``certrack`` command."""
    one_thread_from_now_on()
    gc.set_threshold(NEW_OBJECTS)
    with warnings.catch_warnings():
        warnings.showwarning = _show_warning
        code = _run(arguments)
        if not flushed(sys.stdout) and not code:
            _say("standard output cannot be written")
            code = 2
        flushed(sys.stderr)
        sys.exit(code)


def _run(arguments: Sequence[str] | None) -> int:
    try:
        with ended_by_exception():
            code = cli.main(
                args=None if arguments is None else list(arguments),
                prog_name="certrack",
                standalone_mode=False,
            )
    except CertrackError as problem:
        _say(str(problem))
        return 2
    except click.exceptions.NoArgsIsHelpError as problem:
        click.echo(problem.format_message(), err=True)
        return 2
    except click.UsageError as problem:
        where = f" (see {problem.ctx.command_path} --help)" if problem.ctx else ""
        _say(f"{problem.format_message()}{where}")
        return 2
    except (click.Abort, KeyboardInterrupt):
        _say("interrupted")
        return 130
    except BrokenPipeError:  # the reader of our output went away
        flushed(sys.stdout)
        return 1
    except SystemExit as end:  # by SIGTERM; or click's, where the reader of our output went away
        if end.code != TERMINATED_CODE:
            return 1
        _say("terminated")
        return TERMINATED_CODE
    except REFUSALS as problem:
        _say(trouble(problem))
        return 2
    return code if isinstance(code, int) else 0


def _say(text: str) -> None:
    """One line on standard error, if there is one that takes it."""
    with suppress(OSError):
        click.echo(f"certrack: {one_line(text)}", err=True)


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    _say(f"note: {message}")
