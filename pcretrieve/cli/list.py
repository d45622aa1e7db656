"""The command that lists the shapes of a catalogue: list."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict
from typing import TYPE_CHECKING

import click

from pcretrieve.cli.commands import command
from pcretrieve.cli.documents import write_documents
from pcretrieve.cli.messages import say, shown_path
from pcretrieve.cli.parts import catalogue_option, json_option
from pcretrieve.cli.tables import Column, write_table

if TYPE_CHECKING:
    from pcretrieve.catalogue import Record

__all__ = ["list_command"]

ID, CLASS, FILE = Column("ID"), Column("CLASS"), Column("FILE", "path")
ALL = (ID, Column("VERDICT"), CLASS, Column("EULER", "number"), Column("SECONDS", "number"), FILE)
FAILED = (ID, Column("STAGE"), CLASS, FILE, Column("REASON", "words"))
DOUBTFUL = (ID, Column("VERDICT"), CLASS, FILE, Column("REASON", "words"))


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

    The verdict is sound, doubtful, unusable or failed, or done for a shape that was not judged.

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
        counts: Counter[str] = Counter()
        if failed:
            n_rows = write_table(FAILED, (_failed(record) for record in records))
        elif doubtful:
            n_rows = write_table(DOUBTFUL, (_doubtful(record) for record in records))
        else:
            n_rows = write_table(ALL, (_row(record, counts) for record in records))
    if counts:
        found = ", ".join(f"{n} {name}" for name, n in sorted(counts.items()))
        say(f"{found}; for reasons: {', '.join(f'--{name}' for name in sorted(counts))}")
    if not n_rows:
        which = "failed" if failed else "doubtful" if doubtful else "stored"
        say(f"no shape is {which} in {catalogue}" + (f" after the first {offset}" if offset else ""))


def _row(record: Record, counts: Counter[str]) -> tuple[str, ...]:
    """A row of all shapes; those that have reasons are counted by the option that lists them."""
    if record.status == "failed":
        counts["failed"] += 1
    elif record.is_doubtful:
        counts["doubtful"] += 1
    euler = "-" if record.euler is None else str(record.euler)
    label, file = record.label or "-", shown_path(record.path)
    return record.id, _verdict(record), label, euler, f"{record.seconds:.2f}", file


def _failed(record: Record) -> tuple[str, ...]:
    reason = (record.message or "").removeprefix(f"{record.path}: ")
    return record.id, record.stage or "-", record.label or "-", shown_path(record.path), reason


def _doubtful(record: Record) -> tuple[str, ...]:
    label, file = record.label or "-", shown_path(record.path)
    return record.id, _verdict(record), label, file, str(record.verdict or "")


def _verdict(record: Record) -> str:
    return record.verdict.judgement if record.verdict else record.status
