"""The command that lists the shapes of a catalogue: list."""

from __future__ import annotations

from dataclasses import asdict

import click

from pcretrieve.cli.commands import command
from pcretrieve.cli.documents import write_documents
from pcretrieve.cli.messages import write_line
from pcretrieve.cli.parts import catalogue_option, json_option

__all__ = ["list_command"]


@command("list")
@catalogue_option
@click.option("--failed", is_flag=True, help="Only shapes that failed, with the reason.")
@click.option("--doubtful", is_flag=True, help="Only shapes that are doubtful or unusable, with the reasons.")
@click.option("--limit", type=click.IntRange(min=1), metavar="N", help="Largest number of shapes.")
@click.option(
    "--offset", type=click.IntRange(min=0), default=0, metavar="N", help="Number of shapes to skip."
)
@json_option
def list_command(
    catalogue: str, failed: bool, doubtful: bool, limit: int | None, offset: int, as_json: bool
) -> None:
    """List the shapes of a catalogue: id, verdict, class, Euler characteristic, seconds, path.

    The verdict is sound, doubtful or unusable, or done for a shape that was not judged.

    \b
    pcretrieve list --catalogue bodies.sqlite --failed
    """
    from pcretrieve.catalogue import stored_shapes

    with stored_shapes(catalogue) as store:
        pages = store.pages(
            status="failed" if failed else None, doubtful=doubtful, offset=offset, limit=limit
        )
        records = (record for page in pages for record in page)
        if as_json:
            write_documents(asdict(record) | {"seconds": round(record.seconds, 3)} for record in records)
            return
        for record in records:
            euler = "-" if record.euler is None else str(record.euler)
            reason = f"  [{record.stage}] {record.message}" if record.status == "failed" else ""
            reason += f"  [{record.verdict}]" if record.verdict and record.is_doubtful else ""
            status = record.verdict.judgement if record.verdict else record.status
            write_line(
                f"{record.id:<24}  {status:<8}  {record.label or '-':<16}  {euler:>4}  "
                f"{record.seconds:6.2f}  {record.path}{reason}"
            )
