"""The command that shows the provenance of a shape: show."""

from __future__ import annotations

from dataclasses import asdict

import click

from pcretrieve.cli.commands import command
from pcretrieve.cli.completion import complete_ids
from pcretrieve.cli.documents import write_document
from pcretrieve.cli.messages import print_text, shown_path
from pcretrieve.cli.parts import catalogue_option, json_option
from pcretrieve.cli.tables import Column, write_steps, write_table

__all__ = ["show_command"]


@command("show")
@click.argument("shape_id", metavar="ID", shell_complete=complete_ids)
@catalogue_option
@json_option
def show_command(shape_id: str, catalogue: str, as_json: bool) -> None:
    """Show the provenance of a shape: its file, the steps of each stage, and the size of what is stored.

    \b
    pcretrieve show cat0 --catalogue bodies.sqlite
    """
    from pcretrieve.catalogue import stored_shapes

    with stored_shapes(catalogue) as store:
        record, stored = store.record(shape_id), store.stored_bytes(shape_id)
    if as_json:
        write_document(asdict(record) | {"seconds": round(record.seconds, 3), "stored_bytes": stored})
        return
    rows = []
    for name, value in asdict(record).items():
        if name == "versions":
            value = ", ".join(f"{package} {version}" for package, version in record.versions.items())
        if name == "verdict":
            value = None if record.status == "failed" else str(record.verdict or "not judged")
        if name == "path":
            value = shown_path(record.path)
        if name != "steps" and value is not None:
            rows.append((name, str(value)))
    parts = ", ".join(f"{name} {size / 1000:.1f}" for name, size in stored.items() if size)
    rows.append(("stored", f"{sum(stored.values()) / 1000:.1f} kB" + (f": {parts}" if parts else "")))
    write_table((Column(""), Column("", "words")), rows)
    print_text("")
    write_steps(record.steps)
