"""The command that shows a catalogue in the browser: serve."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from pcretrieve.cli.messages import say
from pcretrieve.cli.options import catalogue_option, command, comparison_options, opened, option, up_option
from pcretrieve.cli.output import write_line

MEGABYTE = 1_000_000


@command("serve")
@catalogue_option
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=8765,
    show_default=True,
    metavar="N",
    help="Port at 127.0.0.1; 0 for any free one.",
)
@click.option("--read-only", is_flag=True, help="Take no scans from browsers.")
@click.option(
    "--keep",
    type=click.Path(exists=True, file_okay=False, writable=True, path_type=Path),
    metavar="FOLDER",
    help="Let people keep their scans: files in this folder, shapes in the catalogue.",
)
@click.option(
    "--max-upload",
    type=click.IntRange(min=1),
    default=200,
    show_default=True,
    metavar="MB",
    help="Refuse larger scans from browsers.",
)
@option(
    "--timeout",
    type=click.FloatRange(min=1),
    default=300,
    show_default=True,
    metavar="SECONDS",
    rare=True,
    help="Give up on a scan from a browser after this time.",
)
@option(
    "--memory",
    type=click.FloatRange(min=0.5),
    default=4,
    show_default=True,
    metavar="GIB",
    rare=True,
    help="Give the process for scans from browsers no more memory than this.",
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
    """Show a catalogue in the browser of this computer, until Ctrl-C.

    Open the address that is printed. It contains a secret: whoever has it can see the shapes, and search by
    scans. Scans run in an isolated process, and are deleted unless you give --keep. From another computer,
    use an SSH tunnel: ssh -L 8765:127.0.0.1:8765 HOST. Needs pip install 'pcretrieve[web]'.

    \b
    pcretrieve serve --catalogue bodies.sqlite
    pcretrieve serve --catalogue bodies.sqlite --port 0 --keep scans/
    """
    from pcretrieve import serve

    if read_only and keep is not None:
        raise click.UsageError("choose one of --read-only and --keep")
    with opened(catalogue, comparison) as (_, options):
        pass
    say("Open the address in a browser; end the server with Ctrl-C.")
    serve(
        catalogue,
        options=options,
        port=port,
        read_only=read_only,
        most_bytes=max_upload * MEGABYTE,
        timeout=timeout,
        memory=memory,
        up=up,
        keep=keep,
        on_start=write_line,
    )
