"""The verb that opens the designer: app."""

from __future__ import annotations

import click


@click.command()
@click.argument("file", required=False)
@click.option(
    "--port", type=click.IntRange(0, 65535), default=0, help="Port; default: one that is free."
)
@click.option(
    "--host",
    default="127.0.0.1",
    show_default=True,
    help="Address to listen on. Any other than this machine's own lets others in who have the key.",
)
@click.option("--no-browser", is_flag=True, help="Print the address only.")
def app(file: str | None, port: int, host: str, no_browser: bool) -> None:
    """Open the designer in the browser, with live guarantees.

    FILE is a system file or the name of a shipped system; without it the shipped ones and an empty
    plant are offered. Files are read and written in the folder of FILE, else in the present one,
    and nowhere else. Ctrl-C ends it.

    \b
    Example: certrack app example1
    """
    from certrack.app.launch import serve_designer

    serve_designer(file, host=host, port=port, browser=not no_browser, say=click.echo)
