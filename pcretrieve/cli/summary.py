"""What `ingest` says about its scans at the end, as text and as a JSON document."""

from __future__ import annotations

from shlex import quote
from typing import TYPE_CHECKING

from pcretrieve.cli.messages import say, without_password

if TYPE_CHECKING:
    from pcretrieve.catalogue import Record
    from pcretrieve.ingestion.run import Summary

__all__ = ["record_facts", "say_summary", "summary_document"]

# Largest number of names in the message about names in a label file that match no scan.
QUOTED = 5


def say_summary(summary: Summary, catalogue: str, labels: str | None) -> None:
    """Print the summary of an ingest, or of what an ingest would do."""
    for path, original in _duplicates(summary):
        say(f"skipped {path}: the same content as {original.id} ({original.path})")
    if summary.unknown_labels:
        quoted = ", ".join(summary.unknown_labels[:QUOTED])
        more = len(summary.unknown_labels) - QUOTED
        say(
            f"{labels} names {len(summary.unknown_labels)} shapes that are not among the scans: {quoted}"
            + (f" and {more} more" if more > 0 else "")
        )
    failures, held = _failures(summary), _held(summary)
    counts = [
        f"{len(summary.planned)} to process" if summary.planned else f"{len(summary.done)} done",
        f"{len(failures)} failed",
        f"{len(held)} held already",
        f"{len(summary.duplicates)} duplicates",
    ]
    say(
        f"{', '.join(counts)}: {catalogue}"
        + ("; --retry-failed processes the failed shapes again" if failures else "")
    )
    doubts = _doubts(summary)
    if doubts:
        n_unusable = sum(record.verdict.judgement == "unusable" for record in doubts if record.verdict)
        say(
            f"{len(doubts) - n_unusable} doubtful, {n_unusable} unusable by the checks of their scans: "
            f"`pcretrieve list --doubtful -c {quote(catalogue)}` gives the reasons"
        )


def summary_document(summary: Summary, catalogue: str) -> dict[str, object]:
    """The JSON document of an ingest, or of what an ingest would do."""
    return {
        "catalogue": without_password(catalogue),
        "planned": [record.id for record in summary.planned],
        "done": [record.id for record in summary.done],
        "held": [record.id for record in _held(summary)],
        "doubtful": [record.id for record in _doubts(summary)],
        "duplicates": [{"path": path, "id": original.id} for path, original in _duplicates(summary)],
        "failed": [_failure_facts(record) for record in _failures(summary)],
        "unknown_labels": summary.unknown_labels,
    }


def record_facts(record: Record) -> dict[str, object]:
    """The values of a record in a line of JSON.

    Returns dict: id, path, status and seconds; of a failure also stage, error and message.
    """
    facts: dict[str, object] = {"status": record.status, "seconds": round(record.seconds, 3)}
    if record.status == "failed":
        return facts | _failure_facts(record)
    return facts | {"id": record.id, "path": record.path}


def _failure_facts(record: Record) -> dict[str, object]:
    return {
        "id": record.id,
        "path": record.path,
        "stage": record.stage,
        "error": record.error,
        "message": record.message,
    }


def _failures(summary: Summary) -> list[Record]:
    """The scans that failed now, and those that failed before."""
    return [*summary.failed, *(record for record in summary.held if record.status == "failed")]


def _held(summary: Summary) -> list[Record]:
    return [record for record in summary.held if record.status == "done"]


def _duplicates(summary: Summary) -> list[tuple[str, Record]]:
    """The printable path of each duplicate, and the record of its original."""
    from pcretrieve.ingestion.discover import printable

    return [(printable(path), original) for path, original in summary.duplicates]


def _doubts(summary: Summary) -> list[Record]:
    return [record for record in (*summary.done, *summary.held) if record.is_doubtful]
