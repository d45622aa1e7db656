"""The command that copies a catalogue to one file: backup."""

from __future__ import annotations

from pathlib import Path

import click

from pcretrieve.cli.commands import command
from pcretrieve.cli.documents import write_document
from pcretrieve.cli.messages import say
from pcretrieve.cli.parts import CATALOGUE, json_option

__all__ = ["backup_command"]

MIB = 1 << 20


@command("backup")
@click.argument("catalogue", type=CATALOGUE)
@click.argument("file", type=click.Path(dir_okay=False, path_type=Path))
@json_option
def backup_command(catalogue: str, file: Path, as_json: bool) -> None:
    """Copy a catalogue to one SQLite file, which is a catalogue, while others may write the catalogue.

    The copy of a file is one state of it. Of a database, all shapes are copied to a file; `pg_dump` is faster
    for large ones, and its copy is one state. Indexes are not copied: they are made again when needed.

    \b
    pcretrieve backup bodies.sqlite bodies-monday.sqlite
    """
    from pcretrieve.interface import backup

    say(f"copying {catalogue}")
    size = backup(catalogue, file)
    say(f"{size / MIB:.1f} MiB: {file}")
    if as_json:
        write_document({"file": str(file), "bytes": size})
