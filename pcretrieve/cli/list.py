"""The command that lists a catalogue: list."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from pcretrieve.cli.parts import (
    catalogue_option,
    json_option,
    write_json,
)

__all__ = ["list_command"]


@click.command("list")
@catalogue_option
@click.option("--failed", is_flag=True, help="Only shapes that failed, with the reason.")
@json_option
def list_command(catalogue: Path, failed: bool, as_json: bool) -> None:
    """The shapes of a catalogue: id, status, class, Euler characteristic, seconds, path.

    \b
    pcretrieve list --catalogue bodies.sqlite --failed
    """
    from pcretrieve.catalogue import Catalogue

    with Catalogue(catalogue) as store:
        records = [record for record in store.records() if not failed or record.status == "failed"]
    if as_json:
        write_json([asdict(record) | {"seconds": round(record.seconds, 3)} for record in records])
        return
    for record in records:
        euler = "-" if record.euler is None else str(record.euler)
        reason = f"  [{record.stage}] {record.message}" if record.status == "failed" else ""
        click.echo(
            f"{record.id:<24}  {record.status:<6}  {record.label or '-':<16}  {euler:>4}  "
            f"{record.seconds:6.2f}  {record.path}{reason}"
        )
