"""Commands that say what is wrong with a scan: inspect, report-problem."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import click

import pcretrieve as pr
from pcretrieve.cli import options as opt
from pcretrieve.cli import output as out
from pcretrieve.cli.messages import say, shown_path
from pcretrieve.cli.scans import alone, each_scan, failure_document, output_files, scans_options


@opt.command("inspect")
@click.argument("scan", type=click.Path(path_type=Path), metavar="SCAN|FOLDER")
@opt.option(
    "--output -o PAGE|FOLDER",
    "Write this HTML page; for a folder of scans, a folder.  [default: the scan's name with .html, here]",
    opt.PATH,
)
@opt.option("--png FILE", "Write all pictures to one PNG file too.", opt.PATH)
@opt.option(
    "--rescans N",
    "Simulate so many rescans for the error bar of the signature.",
    opt.NUMBER,
    default=4,
    details="Each has nine tenths of the points; the standard deviation of their signatures is shown.",
)
@opt.option(
    "--catalogue -c FILE|URL",
    "Compare the error bar with the distance to the next body in this catalogue, and use its "
    "settings.  [default: the distance of people]",
    opt.CATALOGUE,
)
@opt.config_option
@opt.surface_option
@scans_options
@opt.json_option
def inspect_command(
    scan: Path,
    output: Path | None,
    png: Path | None,
    rescans: int,
    catalogue: str | None,
    config: Path | None,
    surface: str | None,
    as_json: bool,
    timeout: float,
    **run: Any,
) -> None:
    """Show what is wrong with a scan, and what to do about it, on an HTML page.

    The page shows points, normals and surface from all sides and in 3D; points that were removed; gaps that
    were filled, and parts that were cut or joined; and the signature with its error bar. If a stage fails,
    the page shows the stages before it, and the exit code is 3. Each scan of a folder gets a page and a line.

    \b
    pcretrieve inspect scan.ply
    pcretrieve inspect scan.ply -o page.html --png sheet.png --rescans 0
    pcretrieve inspect scans/ -o pages/ --workers 2
    """
    from pcretrieve.errors import InputError
    from pcretrieve.formats import check_output, split_member
    from pcretrieve.ingestion.discover import printable

    base = None
    if catalogue is not None:
        with pr.Catalogue(catalogue) as store:
            base = store.options
    options = opt.load_options(config, surface, base=base)
    run["timeout"] = timeout * (1 + rescans)
    if scan.is_dir():
        if output is None or png is not None:
            raise click.UsageError("name a folder for the pages of the scans with -o, and leave out --png")
        _inspect_folder(scan, output, options, rescans, catalogue, as_json, **run)
        return
    if not split_member(scan)[0].is_file():
        raise InputError(f"there is no scan {printable(scan)}: name a file")
    page = output or Path(scan.stem + ".html")
    for target in (page, png):
        if target is not None:
            check_output(target, [scan])
    limits = {"timeout": run["timeout"], "memory": run["memory"]}
    found = alone(_inspected, options, rescans, catalogue, {scan: page}, png, scan, **limits)
    _say_checks(found)
    if as_json:
        out.write_document(_document(found, page.absolute(), png), options=options)
    else:
        out.write_line(shown_path(printable(page.absolute())))
    opt.exit_if(found.failure is not None)


def _say_checks(found: pr.Inspection) -> None:
    for check in found.checks:
        advice = "" if check.verdict == "passed" else f": {check.words}"
        say(f"{check.verdict:<6}  {check.name:<16}  {check.shown}{advice}", indent=26)
    if found.shape_verdict is not None:
        say(f"The shape is {found.shape_verdict}.")
        say(found.next_body.source)
    say(found.summary)


def _inspect_folder(
    folder: Path,
    output: Path,
    options: pr.PipelineOptions,
    n_rescans: int,
    catalogue: str | None,
    as_json: bool,
    **run: Any,
) -> None:
    """Write a page for each scan of a folder, and print page, verdict and summary when all have ended."""
    from pcretrieve.ingestion.discover import discover, printable
    from pcretrieve.values import Failure

    scans = discover([folder])
    pages = output_files(output, scans, folder, ".html")
    inspected = partial(_document_of, options, n_rescans, catalogue, pages)
    documents = [
        {"scan": printable(path)} | failure_document(found) if isinstance(found, Failure) else found
        for path, found in each_scan("inspect", inspected, scans, **run)
    ]
    if as_json:
        out.write_document(documents, options=options)
    else:
        for one in documents:
            if "page" in one:
                out.write_line(f"{shown_path(str(one['page']))}  {one['verdict']}  {one['summary']}")
    opt.exit_if(any("page" not in one or one["failure"] is not None for one in documents))


def _document_of(
    options: pr.PipelineOptions, n_rescans: int, catalogue: str | None, pages: dict[Path, Path], scan: Path
) -> dict[str, object]:
    """The JSON document of an inspection, whose page is written, in a worker process."""
    found = _inspected(options, n_rescans, catalogue, pages, None, scan)
    return _document(found, pages[scan].absolute(), None)


def _inspected(
    options: pr.PipelineOptions,
    n_rescans: int,
    catalogue: str | None,
    pages: dict[Path, Path],
    png: Path | None,
    scan: Path,
) -> pr.Inspection:
    """An inspection, whose page is written, in a worker process, which imports the stages."""
    from pcretrieve.pages import write_inspection_png

    found = pr.inspect(scan, options, n_rescans=n_rescans, page=pages[scan], catalogue=catalogue)
    if png is not None:
        write_inspection_png(found, png)
    return found


def _document(inspection: pr.Inspection, page: Path, png: Path | None) -> dict[str, object]:
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


@opt.command("report-problem")
@click.argument("scan", type=click.Path(path_type=Path), metavar="SCAN")
@opt.option("--output -o ZIP", "Write this file.  [default: SCAN-problem.zip]", opt.PATH)
@opt.option("--with-scan", "Pack the scan too.")
@opt.config_option
@opt.surface_option
@opt.unit_option
@opt.limit_options
@opt.json_option
def report_problem_command(
    scan: Path,
    output: Path | None,
    with_scan: bool,
    config: Path | None,
    surface: str | None,
    unit: str | None,
    as_json: bool,
    **limits: Any,
) -> None:
    """Pack one file to send to us when a scan fails. It does not contain the scan.

    The scan is processed once more. The ZIP file has versions, settings, the error, the log, and name, size,
    hash and measurements of the scan. It has no points, unless you give --with-scan, and no folder names.

    \b
    pcretrieve report-problem scan.ply
    """
    from pcretrieve.formats import split_member
    from pcretrieve.ingestion.discover import printable

    options = opt.load_options(config, surface, unit)
    output = output or Path(f"{split_member(scan)[0].stem}-problem.zip")
    found = pr.report_problem(scan, output, options, with_scan=with_scan, **limits)
    failure = found["failure"]
    if isinstance(failure, dict):
        say(f"failed in {failure['stage']}: {failure['message']}")
    else:
        say("the scan does not fail with these options; give those with which it failed")
    say(f"attach this file to your report; it has {'the' if with_scan else 'no'} points of the scan")
    if as_json:
        out.write_document({"file": printable(output), "failure": failure}, options=options)
    else:
        out.write_line(printable(output))
