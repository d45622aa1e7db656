"""The command that shows a catalogue in the browser: serve."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

import pcretrieve as pr
from pcretrieve.cli import options as opt
from pcretrieve.cli import output as out
from pcretrieve.cli.messages import say

MEGABYTE = 1_000_000


@opt.command("serve")
@opt.catalogue_option
@opt.option("--port N", "Port at 127.0.0.1; 0 for any free one.", click.IntRange(0, 65535), default=8765)
@opt.option("--read-only", "Take no scans from browsers.")
@opt.option(
    "--keep FOLDER",
    "Let people keep their scans: files in this folder, shapes in the catalogue.",
    click.Path(exists=True, file_okay=False, writable=True, path_type=Path),
)
@opt.option("--max-upload MB", "Refuse larger scans from browsers.", opt.COUNT, default=200)
@opt.option(
    "--timeout SECONDS",
    "Give up on a scan from a browser after this time.",
    click.FloatRange(min=1),
    default=300,
    rare=True,
)
@opt.option(
    "--memory GIB",
    "Give the process for scans from browsers no more memory than this.",
    click.FloatRange(min=0.5),
    default=4,
    rare=True,
)
@opt.up_option
@opt.comparison_options
def serve_command(catalogue: str, max_upload: int, **chosen: Any) -> None:
    """Show a catalogue in the browser of this computer, until Ctrl-C.

    Open the address that is printed. It contains a secret: whoever has it can see the shapes, and search by
    scans. Scans run in an isolated process, and are deleted unless you give --keep. From another computer,
    use an SSH tunnel: ssh -L 8765:127.0.0.1:8765 HOST.

    \b
    pcretrieve serve --catalogue bodies.sqlite
    pcretrieve serve --catalogue bodies.sqlite --port 0 --keep scans/
    """
    if chosen["read_only"] and chosen["keep"] is not None:
        raise click.UsageError("choose one of --read-only and --keep")
    flags = {name: chosen.pop(name) for name in opt.COMPARISON}
    with opt.opened(catalogue, flags) as (_, options):
        pass
    say("Open the address in a browser; end the server with Ctrl-C.")
    chosen |= {"most_bytes": max_upload * MEGABYTE, "on_start": out.write_line}
    pr.serve(catalogue, options=options, **chosen)
