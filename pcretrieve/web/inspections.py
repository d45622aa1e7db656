"""An uploaded scan → its inspection page, without the folders of the server."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from pcretrieve.options import PipelineOptions
from pcretrieve.web.folders import without_folders

if TYPE_CHECKING:
    from pcretrieve.inspection import Inspection

__all__ = ["inspection_page"]


def inspection_page(
    location: str, title: str, options: PipelineOptions, item: tuple[str, str, Path]
) -> bytes:
    """The page of a scan as by `pcretrieve inspect --rescans 0 --catalogue`; in a worker process.

    item: (str, str, Path), the name of the file, as the browser gave it; the address of the page of the
        nearest shapes; the file.
    """
    # Imported here, because the server does not need the stages.
    from pcretrieve.interface.scans import inspect
    from pcretrieve.pages.inspection_page import Served, inspection_html

    name, back, scan = item
    found = inspect(scan, options, n_rescans=0, catalogue=location)
    page = inspection_html(_shown(found, name), Served(title, back))
    return page.encode("utf-8", errors="replace")


def _shown(found: Inspection, name: str) -> Inspection:
    """An inspection whose texts name no folder."""
    failure = found.failure
    return replace(
        found,
        name=name,
        path="",
        checks=tuple(
            replace(check, shown=without_folders(check.shown), words=without_folders(check.words))
            for check in found.checks
        ),
        failure=failure and replace(failure, message=without_folders(failure.message)),
        steps=tuple(
            replace(step, notes=tuple(without_folders(note) for note in step.notes)) for step in found.steps
        ),
        next_body=replace(found.next_body, source=without_folders(found.next_body.source)),
    )
