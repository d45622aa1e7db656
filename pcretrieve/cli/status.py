"""The command that says how far an ingest is: status."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

from pcretrieve.cli.commands import command
from pcretrieve.cli.documents import write_document
from pcretrieve.cli.messages import without_password, write_words
from pcretrieve.cli.parts import catalogue_argument, json_option
from pcretrieve.cli.progress import duration
from pcretrieve.cli.tables import Column, write_table

if TYPE_CHECKING:
    from pcretrieve.ingestion import BatchStatus

__all__ = ["status_command"]


@command("status")
@catalogue_argument
@json_option
def status_command(catalogue: str, as_json: bool) -> None:
    """Say how far the last ingest into a catalogue is, while it runs and afterwards.

    \b
    pcretrieve status bodies.sqlite
    """
    from pcretrieve.interface.batches import status

    found = status(catalogue)
    if as_json:
        write_document({"catalogue": without_password(catalogue)} | asdict(found))
        return
    for line in _lines(found):
        write_words(line)
    write_words(f"{catalogue}: {found.n_shapes} shapes, {sum(found.failures.values())} failed")
    rows = ((str(number), kind) for kind, number in found.failures.items())
    write_table((Column("NUMBER", "number"), Column("FAILURE")), rows)


def _lines(found: BatchStatus) -> list[str]:
    if found.state == "none":
        return ["no ingest into it is known on this computer"]
    n_finished = found.n_done + found.n_failed + found.n_skipped
    lines = [
        f"ingest {found.state}: {n_finished} of {found.n_scans} scans: {found.n_done} done, "
        f"{found.n_failed} failed, {found.n_skipped} held already or duplicates",
        f"started {found.started}, last counted {found.updated}",
        f"rate: {found.scans_per_second * 60:.3g} scans/min"
        + ("" if found.seconds_left is None else f", about {duration(found.seconds_left)} left"),
    ]
    if found.stages:
        shares = sorted(found.stages.items(), key=lambda stage: -stage[1])
        lines.append("time: " + ", ".join(f"{name} {share:.0%}" for name, share in shares))
    if found.state in ("stopped", "killed"):
        lines.append("the same command of ingest goes on from there")
    return lines
