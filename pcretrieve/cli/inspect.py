"""The command that checks a scan and shows what is wrong with it: inspect."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pcretrieve.cli.commands import command, option
from pcretrieve.cli.documents import write_document
from pcretrieve.cli.messages import say, shown_path, write_line
from pcretrieve.cli.parts import (
    CATALOGUE,
    EXIT_SOME_FAILED,
    config_option,
    json_option,
    limit_options,
    load_options,
    surface_option,
)
from pcretrieve.cli.progress import progress_option
from pcretrieve.cli.scans import each_scan, failure_document, output_files, workers_option

if TYPE_CHECKING:
    from pcretrieve.catalogue import Record
    from pcretrieve.inspection.inspection import Inspection
    from pcretrieve.options import PipelineOptions

__all__ = ["inspect_command"]


@command("inspect")
@click.argument("scan", type=click.Path(path_type=Path), metavar="SCAN|FOLDER")
@option(
    "--output",
    "-o",
    type=click.Path(path_type=Path),
    metavar="PAGE|FOLDER",
    help="The HTML page, or for a folder of scans a folder.",
    details="By default the name of the scan with .html, in the current folder. A folder is made if there is "
    "none.",
)
@option(
    "--png",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Also write all pictures into one PNG file.",
)
@option(
    "--rescans",
    type=click.IntRange(min=0),
    default=4,
    show_default=True,
    metavar="N",
    help="Number of rescans, for the error of the signature.",
    details="Each is reconstructed from nine tenths of the points; the standard deviation of their "
    "signatures is shown. 0 for none.",
)
@click.option(
    "--catalogue",
    "-c",
    type=CATALOGUE,
    metavar="FILE|URL",
    help="Compare the error bar of the signature with the distance to the next body in this catalogue; the "
    "scan is processed with its options. By default this distance is that of people.",
)
@config_option
@surface_option
@workers_option
@limit_options("scan, and for each rescan")
@progress_option
@json_option
def inspect_command(
    scan: Path,
    output: Path | None,
    png: Path | None,
    rescans: int,
    catalogue: str | None,
    config: Path | None,
    surface: str | None,
    workers: int | None,
    timeout: float,
    memory: float | None,
    progress: str,
    as_json: bool,
) -> None:
    """Write an HTML page that shows what is wrong with a scan, and what to do about it.

    The page shows points, normals and surface from all sides and in a 3D viewer; which points were removed;
    where the surface was filled in, separated and connected; and the signature with its error bar, which the
    verdict compares with the distance to the next body.
    If a stage fails, the page shows the results of the earlier stages, and the exit code is 3. Of a folder,
    each scan has a page, which is named like the scan, and a line: page, verdict and summary.

    \b
    pcretrieve inspect scan.ply
    pcretrieve inspect scan.ply -o page.html --png sheet.png --rescans 0
    pcretrieve inspect scans/ -o pages/ --workers 2
    """
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.errors import InputError
    from pcretrieve.formats import check_output, split_member
    from pcretrieve.ingestion.discover import discover, printable
    from pcretrieve.ingestion.isolation import Isolation

    base = None
    if catalogue is not None:
        with Catalogue(catalogue) as store:
            base = store.options
    options = load_options(config, surface, base=base)
    timeout *= 1 + rescans
    if scan.is_dir():
        if output is None or png is not None:
            raise click.UsageError("name a folder for the pages of the scans with -o, and leave out --png")
        scans = discover([scan])
        pages = output_files(output, scans, scan, ".html")
        inspect = partial(_inspected_to, pages, options, rescans, catalogue)
        _write_outcomes(
            each_scan(
                "inspect", inspect, scans, workers=workers, timeout=timeout, memory=memory, progress=progress
            ),
            options if as_json else None,
        )
        return
    if not split_member(scan)[0].is_file():
        raise InputError(f"there is no scan {printable(scan)}: name a file")
    page = output or Path(scan.stem + ".html")
    for target in (page, png):
        if target is not None:
            check_output(target, [scan])
    inspection, page = Isolation(timeout, memory).call(
        _inspected, scan, options, rescans, catalogue, page, png
    )
    for check in inspection.checks:
        advice = "" if check.verdict == "passed" else f": {check.words}"
        say(f"{check.verdict:<6}  {check.name:<16}  {check.shown}{advice}", indent=26)
    if inspection.shape_verdict is not None:
        say(f"The shape is {inspection.shape_verdict}.")
        say(inspection.next_body.source)
    say(inspection.summary)
    if as_json:
        write_document(_document(inspection, page, png), options=options)
    else:
        write_line(shown_path(printable(page)))
    if inspection.failure is not None:
        click.get_current_context().exit(EXIT_SOME_FAILED)


def _write_outcomes(
    outcomes: Iterable[tuple[Path, dict[str, object] | Record]], options: PipelineOptions | None
) -> None:
    """Print page, verdict and summary of each inspection, or a document with options, when all have ended."""
    documents = [found if isinstance(found, dict) else failure_document(found) for _, found in outcomes]
    if options is not None:
        write_document(documents, options=options)
    else:
        for found in documents:
            if "page" in found:
                write_line(f"{shown_path(str(found['page']))}  {found['verdict']}  {found['summary']}")
    if any("page" not in found or found["failure"] is not None for found in documents):
        click.get_current_context().exit(EXIT_SOME_FAILED)


def _inspected_to(
    pages: dict[Path, Path], options: PipelineOptions, n_rescans: int, catalogue: str | None, scan: Path
) -> dict[str, object]:
    """The JSON document of an inspection, whose page is written, in a worker process."""
    inspection, page = _inspected(scan, options, n_rescans, catalogue, pages[scan], None)
    return _document(inspection, page, None)


def _inspected(
    scan: Path,
    options: PipelineOptions,
    n_rescans: int,
    catalogue: str | None,
    page: Path,
    png: Path | None,
) -> tuple[Inspection, Path]:
    """An inspection and its page, in a worker process, which imports the stages."""
    from pcretrieve.interface.scans import inspect
    from pcretrieve.pages.inspection_sheet import write_inspection_png

    inspection = inspect(scan, options, n_rescans=n_rescans, page=page, catalogue=catalogue)
    written = page.absolute()
    if png is not None:
        write_inspection_png(inspection, png)
    return inspection, written


def _document(inspection: Inspection, page: Path, png: Path | None) -> dict[str, object]:
    """The JSON document of an inspection."""
    signature, deviation = inspection.signature, inspection.rescan_deviation
    judged = inspection.shape_verdict
    return {
        "scan": inspection.path,
        "page": str(page),
        "png": None if png is None else str(png),
        "verdict": inspection.verdict,
        "summary": inspection.summary,
        "shape_verdict": None if judged is None else asdict(judged),
        "next_body": asdict(inspection.next_body),
        "checks": [asdict(check) for check in inspection.checks],
        "cuts": inspection.cuts.tolist(),
        "bridges": inspection.bridges.tolist(),
        "signature": None if signature is None else signature.values.tolist(),
        "rescan_deviation": None if deviation is None else deviation.tolist(),
        "spread": inspection.spread,
        "failure": None if inspection.failure is None else asdict(inspection.failure),
        "steps": [asdict(step) for step in inspection.steps],
    }
