"""The command that shows the provenance of a shape: show."""

from __future__ import annotations

from dataclasses import asdict

import click

from pcretrieve.cli.commands import command
from pcretrieve.cli.completion import complete_ids
from pcretrieve.cli.documents import write_document
from pcretrieve.cli.messages import step_lines, write_line
from pcretrieve.cli.parts import catalogue_option, json_option

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
    for name, value in asdict(record).items():
        if name == "versions":
            value = ", ".join(f"{package} {version}" for package, version in record.versions.items())
        if name == "verdict":
            value = None if record.status == "failed" else str(record.verdict or "not judged")
        if name != "steps" and value is not None:
            write_line(f"{name:<15} {value}")
    parts = ", ".join(f"{name} {size / 1000:.1f}" for name, size in stored.items() if size)
    write_line(f"{'stored':<15} {sum(stored.values()) / 1000:.1f} kB" + (f": {parts}" if parts else ""))
    for line in step_lines(record.steps):
        write_line(line)
