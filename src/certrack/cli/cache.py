"""The verb about compiled libraries that are kept on disk."""

from __future__ import annotations

import click

from certrack.cli.base import json_option


@click.command("cache")
@click.option("--clear", "is_clear", is_flag=True, help="Remove all of them.")
@json_option
def cache(is_clear: bool, as_json: bool) -> None:
    """Show or clear the compiled libraries that are kept on disk.

    What ensembles and other runs compile is kept in the user's cache folder, so that nothing is
    compiled twice. The environment variable CERTRACK_CACHE names another folder by its absolute
    path; CERTRACK_CACHE=off turns the cache off.

    \b
    Example: certrack cache --clear
    """
    from certrack.cli import console
    from certrack.core import library_cache

    state = library_cache.clear() if is_clear else library_cache.state()
    if as_json:
        click.echo(
            console.to_json(
                {
                    "place": None if state.place is None else str(state.place),
                    "libraries": state.libraries,
                    "bytes": state.size,
                    "max_bytes": library_cache.MAX_BYTES,
                    "trouble": state.trouble or None,
                    "cleared": is_clear,
                }
            )
        )
        return
    if state.trouble:
        click.echo(f"Not used: {state.trouble}")
        if state.place is None:
            return
    count = f"{state.libraries} compiled {'library' if state.libraries == 1 else 'libraries'}"
    size = f"{state.size / 2**20:.2f} MB"
    if is_clear:
        click.echo(f"{count} ({size}) removed from {state.place}")
    else:
        most = f"{library_cache.MAX_BYTES / 2**20:.0f} MB"
        click.echo(f"{count}, {size} of at most {most}, in {state.place}")
