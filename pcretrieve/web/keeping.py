"""Uploaded scans that are kept: a file in a folder of the server, and a shape of the catalogue."""

from __future__ import annotations

import re
import shutil
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from pcretrieve.catalogue import Catalogue, Record
from pcretrieve.errors import InputError
from pcretrieve.ingestion.run import ingest_files
from pcretrieve.web.folders import without_folders

__all__ = ["Collection"]

# An id that is the name of a file on every system, and no hidden one.
ID = re.compile(r"\w[\w .+-]{0,99}(?<![ .])")

LONGEST_LABEL = 200


@dataclass(frozen=True, slots=True)
class Collection:
    """Where scans are kept.

    timeout: longest time for a scan; seconds.
    """

    location: str
    folder: Path
    timeout: float
    memory: float

    def add(self, scan: Path, shape_id: str, label: str | None) -> Record:
        """Store a scan as `pcretrieve ingest` does, which processes it once more."""
        label = label or None
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
            if store.get(shape_id) is not None or any(self.folder.glob(f"{shape_id}.*")):
                raise InputError(f"there is a shape {shape_id!r} already: choose another name")
            try:
                shutil.copyfile(scan, target)
                return self._ingested(store, target, label)
            except BaseException:
                with suppress(OSError):
                    target.unlink()
                raise

    def _ingested(self, store: Catalogue, target: Path, label: str | None) -> Record:
        labels = None if label is None else {target.name: label}
        done = ingest_files(
            [target], store, labels=labels, workers=1, timeout=self.timeout, memory=self.memory
        )
        for _, other in done.duplicates:
            raise InputError(f"the catalogue has this scan already, as {other.id!r}")
        for record in done.failed:
            store.remove(record.id)
            raise InputError(f"the scan failed in {record.stage}: {without_folders(record.message or '')}")
        (record,) = done.done + done.held
        return record
