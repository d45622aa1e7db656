"""Commands on many scans: worker processes, progress, and results in the order of the scans."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import click

from pcretrieve.cli.messages import failure_line, say
from pcretrieve.cli.progress import Progress
from pcretrieve.cli.summary import record_facts

if TYPE_CHECKING:
    from pcretrieve.catalogue import Record
    from pcretrieve.errors import PcretrieveError

__all__ = ["each_scan", "failure_document", "output_files", "workers_option"]

Answer = TypeVar("Answer")

workers_option = click.option(
    "--workers",
    type=click.IntRange(min=1),
    show_default="one per core",
    metavar="N",
    help="Scans at a time.",
)


def each_scan(
    command: str,
    function: Callable[[Path], Answer],
    scans: Sequence[Path],
    *,
    workers: int | None,
    timeout: float,
    memory: float | None,
    progress: str | None,
) -> Iterator[tuple[Path, Answer | Record]]:
    """Apply a function to scans by the default executor, and show progress if there are several.

    timeout: longest time for one scan; seconds.
    """
    from pcretrieve.errors import PcretrieveError
    from pcretrieve.ingestion.discover import printable
    from pcretrieve.ingestion.isolation import in_processes

    finished: dict[Path, Answer | Record] = {}
    n_yielded = 0
    running = in_processes(function, scans, workers=workers, timeout=timeout, memory=memory)
    shown = Progress(command, len(scans), progress) if progress and len(scans) > 1 else nullcontext()
    with closing(running), shown as bar:
        for path, outcome in running:
            if isinstance(outcome, PcretrieveError):
                finished[path] = failure = _failure(path, outcome)
                facts, message = record_facts(failure), failure_line(failure)
            else:
                finished[path] = outcome
                facts, message = {"path": printable(path), "status": "done"}, None
            if bar is not None:
                bar.advance(facts, message)
            elif message is not None:
                say(message)
            while n_yielded < len(scans) and scans[n_yielded] in finished:
                yield scans[n_yielded], finished.pop(scans[n_yielded])
                n_yielded += 1


def failure_document(record: Record) -> dict[str, object]:
    """The JSON document of a scan that failed, in place of that of its result."""
    return {"scan": record.path, "error": record.error, "stage": record.stage, "message": record.message}


def output_files(folder: Path, scans: Sequence[Path], source: Path, suffix: str) -> dict[Path, Path]:
    """Name a file for each scan of a folder, and make the folder in which the files are written."""
    from pcretrieve.errors import InputError
    from pcretrieve.ingestion.discover import printable, shape_ids

    if folder.resolve().is_relative_to(source.resolve()):
        raise InputError(f"{folder} is in {source}, whose files are read: name another folder with -o")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make the folder {folder}: {error.strerror}; name another") from error
    ids = shape_ids([printable(scan) for scan in scans], {})
    return {scan: folder / f"{ids[printable(scan)]}{suffix}" for scan in scans}


def _failure(path: Path, error: PcretrieveError) -> Record:
    """The record of a scan that failed; errors that are not failures of a scan are raised."""
    from pcretrieve.catalogue import Record
    from pcretrieve.errors import ShapeError
    from pcretrieve.ingestion.discover import printable
    from pcretrieve.ingestion.plan import failed

    if not isinstance(error, ShapeError):
        raise error
    name = printable(path)
    return failed(Record(Path(name).stem, name, ""), error)
