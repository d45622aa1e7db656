"""The command that serves the search page of a catalogue: serve."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from pcretrieve.cli.commands import command, option
from pcretrieve.cli.comparison import compared, comparison_options
from pcretrieve.cli.messages import say, write_line
from pcretrieve.cli.parts import catalogue_option, up_option

__all__ = ["serve_command"]


@command("serve")
@catalogue_option
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=8765,
    show_default=True,
    metavar="N",
    help="The port at 127.0.0.1; 0 for any free one.",
)
@click.option("--read-only", is_flag=True, help="Take no scans from browsers.")
@click.option(
    "--keep",
    type=click.Path(exists=True, file_okay=False, writable=True, path_type=Path),
    metavar="FOLDER",
    help="Let scans from browsers be kept when asked to: files here, shapes in the catalogue.",
)
@click.option(
    "--max-upload",
    type=click.IntRange(min=1),
    default=200,
    show_default=True,
    metavar="MB",
    help="Largest size of a scan from a browser.",
)
@option(
    "--timeout",
    type=click.FloatRange(min=1),
    default=300,
    show_default=True,
    metavar="SECONDS",
    rare=True,
    help="Longest time for a scan from a browser.",
)
@option(
    "--memory",
    type=click.FloatRange(min=0.5),
    default=4,
    show_default=True,
    metavar="GIB",
    rare=True,
    help="Largest heap of the process for scans from browsers.",
)
@up_option
@comparison_options
def serve_command(
    catalogue: str,
    port: int,
    read_only: bool,
    keep: Path | None,
    max_upload: int,
    timeout: float,
    memory: float,
    up: str | None,
    **comparison: Any,
) -> None:
    """Serve the search page of a catalogue to browsers of this computer, until Ctrl-C.

    Printed is the address to open. It contains a random token, without which nothing is answered; whoever has
    the address can see the shapes, and search by scans, which are processed in an isolated process, and
    removed unless --keep is given. From another computer, use an SSH tunnel:
    ssh -L 8765:127.0.0.1:8765 HOST. Needs the extra web: pip install 'pcretrieve[web]'.

    \b
    pcretrieve serve --catalogue bodies.sqlite
    pcretrieve serve --catalogue bodies.sqlite --port 0 --keep scans/
    """
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.web import serve

    if read_only and keep is not None:
        raise click.UsageError("choose one of --read-only and --keep")
    with Catalogue(catalogue) as store:
        options = compared(store, **comparison)
    say("Open the address in a browser; end the server with Ctrl-C.")
    serve(
        catalogue,
        options=options,
        port=port,
        read_only=read_only,
        most_bytes=max_upload * 1_000_000,
        timeout=timeout,
        memory=memory,
        up=up,
        keep=keep,
        on_start=write_line,
    )
