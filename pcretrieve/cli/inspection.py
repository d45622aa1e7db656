"""Commands that say what is wrong with a scan: inspect, report-problem."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import click

import pcretrieve as pr
from pcretrieve.cli.messages import say, shown_path
from pcretrieve.cli.options import (
    NUMBER,
    Limits,
    Processes,
    ScanSettings,
    SurfaceSettings,
    argument,
    command,
    option,
)
from pcretrieve.cli.output import (
    Result,
    write_lines,
    write_table,
)
from pcretrieve.cli.scans import each_scan

# What JSON has of an inspection, beside the files and the signature.
FOUND = (
    "outcome",
    "summary",
    "grade",
    "checks",
    "cuts",
    "bridges",
    "rescan_errors",
    "rescan_error",
    "failure",
    "steps",
)


@command("inspect")
def inspect_command(
    *,
    scan: Path = argument("SCAN|FOLDER"),
    output: Path | None = option(
        "--output -o PAGE|FOLDER",
        "Write this HTML page; for a folder of scans, a folder.  "
        "[default: the scan's name with .html, here]",
    ),
    png: Path | None = option("--png FILE", "Write all pictures to one PNG file too."),
    n_rescans: int = option(
        "--rescans N",
        "Simulate so many rescans, of nine tenths of the points, for the error bar of the signature.",
        NUMBER,
        default=4,
    ),
    settings: SurfaceSettings,
    run: Processes,
) -> Result:
    """Show what is wrong with a scan, and what to do about it, on an HTML page.

    The page shows points, normals and surface from all sides and in 3D; points that were removed; gaps that
    were filled, and parts that were cut or joined; and the error bar of the signature. If a stage fails,
    the page shows the stages before it, and the exit code is 3. Each scan of a folder gets a page and a line.

    \b
    pcretrieve inspect scan.ply
    pcretrieve inspect scan.ply -o page.html --png sheet.png --rescans 0
    pcretrieve inspect scans/ -o pages/ --workers 2
    """
    is_alone = not scan.is_dir()
    if not is_alone and (output is None or png is not None):
        raise click.UsageError(
            "name a folder for the pages of the scans with -o, and leave out --png"
        )
    options = settings.options()
    # A rescan takes as long as the scan.
    run = replace(run, timeout=run.timeout * (1 + n_rescans))
    found = list(
        each_scan(
            "inspect",
            partial(_inspected, options, n_rescans, png),
            scan,
            run,
            output=output or Path(scan.stem + ".html"),
            suffix=".html",
            is_alone=is_alone,
        )
    )
    if is_alone:
        _say_checks(found[0])

    def show() -> None:
        for one in found:
            if "page" in one:
                words = "" if is_alone else f"  {one['outcome']}  {one['summary']}"
                write_lines(shown_path(one["page"]) + words)

    failed = any("page" not in one or one["failure"] is not None for one in found)
    return Result(found[0] if is_alone else found, options, show, failed)


def _inspected(
    options: pr.PipelineOptions, n_rescans: int, png: Path | None, scan: Path, page: Path
) -> dict[str, Any]:
    """Inspect a scan in a worker process, which writes the page. Returns what JSON has of it."""
    found = pr.inspect(scan, options, n_rescans=n_rescans, page=page, png=png)
    signature = None if found.signature is None else found.signature.values
    written = {"page": str(page.absolute()), "png": png, "signature": signature}
    return written | {name: getattr(found, name) for name in FOUND}


def _say_checks(found: dict[str, Any]) -> None:
    rows = []
    for check in found["checks"]:
        advice = "" if check.outcome == "passed" else f": {check.words}"
        rows.append((check.outcome, check.name, check.shown + advice))
    write_table({"": "text", " ": "text", "  ": "words"}, rows, err=True)
    if found["grade"] is not None:
        say(f"The scan is {found['grade']}.")
    say(found["summary"])


@command("report-problem")
def report_problem_command(
    *,
    scan: Path = argument("SCAN"),
    output: Path | None = option(
        "--output -o ZIP", "Write this file.  [default: SCAN-problem.zip]"
    ),
    with_scan: bool = option("--with-scan", "Pack the scan too."),
    settings: ScanSettings,
    limits: Limits,
) -> Result:
    """Pack one file to send to us when a scan fails. It does not contain the scan.

    The scan is processed once more. The ZIP file has versions, settings, the error, the log, and name, size,
    hash and measurements of the scan. It has no points, unless you give --with-scan, and no folder names.

    \b
    pcretrieve lab report-problem scan.ply
    """
    options = settings.options()
    output = output or Path(f"{scan.stem}-problem.zip")
    found = pr.report_problem(
        scan,
        output,
        options,
        with_scan=with_scan,
        timeout=limits.timeout,
        memory=limits.memory,
    )
    failure = found["failure"]
    if isinstance(failure, dict):
        say(f"failed in {failure['stage']}: {failure['message']}")
    else:
        say("the scan does not fail with these options; give those with which it failed")
    described = found["scan"]
    if isinstance(described, dict) and described["missing"]:
        say(f"missing, and not in the file: {', '.join(described['missing'])}")
    say(
        f"attach this file to your report; it has {'the' if with_scan else 'no'} points of the scan"
    )
    return Result(
        {"file": output, "failure": failure},
        options,
        lambda: write_lines(str(output)),
    )
