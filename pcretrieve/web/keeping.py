"""What worker processes make of an uploaded scan: its signature, its inspection page, and a kept shape."""

from __future__ import annotations

import logging
import re
import shutil
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from pcretrieve import Catalogue, PipelineOptions
from pcretrieve.errors import InputError
from pcretrieve.gallery.answers import Described, described_scan
from pcretrieve.ingestion.pool import tell
from pcretrieve.pages.html import without_folders

if TYPE_CHECKING:
    from pcretrieve import Record

# An id that is the name of a file on every system, and no hidden one.
ID = re.compile(r"\w[\w .+-]{0,99}(?<![ .])")

LONGEST_LABEL = 200


class _Progress(logging.Handler):
    """Tells the server of each stage that has ended, and of its time in seconds."""

    def emit(self, record: logging.LogRecord) -> None:
        step = getattr(record, "step", None)
        if step is not None:
            tell((step.stage, step.seconds))


def described(options: PipelineOptions, item: tuple[Path, str | None]) -> Described:
    """The signature and the picture of a scan, in a worker process, which tells of its stages.

    item: (Path, str or None), the file, and the axis that points upwards on its picture.
    """
    scan, up = item
    stages = logging.getLogger("pcretrieve.pipeline")
    progress = _Progress()
    stages.setLevel(logging.INFO)
    stages.addHandler(progress)
    try:
        return described_scan(options, True, up, scan)
    finally:
        stages.removeHandler(progress)


def inspection_page(
    title: str, options: PipelineOptions, item: tuple[str, str, Path]
) -> bytes:
    """The page of a scan as by `pcretrieve inspect --rescans 0`; in a worker process.

    item: (str, str, Path), the name of the file, as the browser gave it; the address of the page of the
        nearest shapes; the file.
    """
    # Imported here, because the server does not need the stages.
    from pcretrieve import inspect
    from pcretrieve.pages.inspection_page import inspection_html

    name, back, scan = item
    found = inspect(scan, options, n_rescans=0)
    return inspection_html(replace(found, name=name), (title, back))


@dataclass(frozen=True, slots=True)
class Collection:
    """Where scans are kept: a file in a folder of the server, and a shape of the catalogue.

    timeout: longest time for a scan; seconds.
    """

    location: str
    folder: Path
    timeout: float
    memory: float | None

    def add(self, scan: Path, shape_id: str, label: str | None) -> Record:
        """Store a scan as `pcretrieve ingest` does, which processes it once more."""
        if not ID.fullmatch(shape_id):
            raise InputError(
                f"a name must be letters, digits and . _ + - or blanks, at most 100, got {shape_id[:100]!r}"
            )
        if label is not None and (len(label) > LONGEST_LABEL or not label.isprintable()):
            raise InputError(
                f"a class must be at most {LONGEST_LABEL} printable characters, got {label[:100]!r}"
            )
        target = self.folder / f"{shape_id}{scan.suffix}"
        with Catalogue(self.location) as store:
            if store.rows.several([shape_id]) or any(self.folder.glob(f"{shape_id}.*")):
                raise InputError(
                    f"there is a shape {shape_id!r} already: choose another name"
                )
            try:
                shutil.copyfile(scan, target)
                return self._ingested(store, target, label)
            except BaseException:
                with suppress(OSError):
                    target.unlink()
                raise

    def _ingested(self, store: Catalogue, target: Path, label: str | None) -> Record:
        from pcretrieve import ingest  # here, because the server does not need the stages

        labels = None if label is None else {target.name: label}
        done = ingest(
            [target],
            store,
            labels=labels,
            workers=1,
            timeout=self.timeout,
            memory=self.memory,
        )
        for _, other in done.duplicates:
            raise InputError(f"the catalogue has this scan already, as {other.id!r}")
        for record in done.failed:
            # Not by `remove`, which writes the whole file again: a failure has no body.
            store.rows.revise(removed=[record.path])
            raise InputError(
                f"the scan failed in {record.stage}: {without_folders(record.message or '')}"
            )
        (record,) = done.done + done.held
        return record
