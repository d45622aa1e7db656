"""The command that packs what is needed to report a scan that fails: report-problem."""

from __future__ import annotations

from pathlib import Path

import click

from pcretrieve.cli.commands import command
from pcretrieve.cli.documents import write_document
from pcretrieve.cli.messages import say, write_line
from pcretrieve.cli.parts import (
    config_option,
    json_option,
    limit_options,
    load_options,
    surface_option,
    unit_option,
)

__all__ = ["report_problem_command"]


@command("report-problem")
@click.argument("scan", type=click.Path(path_type=Path), metavar="SCAN")
@click.option(
    "--output",
    "-o",
    type=click.Path(path_type=Path),
    metavar="ZIP",
    help="The file to write.  [default: SCAN-problem.zip]",
)
@click.option("--with-scan", is_flag=True, help="Pack the scan too.")
@config_option
@surface_option
@unit_option
@limit_options("scan")
@json_option
def report_problem_command(
    scan: Path,
    output: Path | None,
    with_scan: bool,
    config: Path | None,
    surface: str | None,
    unit: str | None,
    timeout: float,
    memory: float | None,
    as_json: bool,
) -> None:
    """Pack what is needed to report a scan that fails into one file, without the scan itself.

    The scan is processed once more. The ZIP file has versions, options, the stage and the error, the log,
    and the name, the size, the hash and measurements of the scan; not its points, unless --with-scan is
    given, and not its folder.

    \b
    pcretrieve report-problem scan.ply
    """
    from pcretrieve.formats import split_member
    from pcretrieve.ingestion.discover import printable
    from pcretrieve.inspection import report_problem

    options = load_options(config, surface)
    if unit is not None:
        options = options.changed(scan={"unit": unit})
    output = output or Path(f"{split_member(scan)[0].stem}-problem.zip")
    found = report_problem(scan, output, options, with_scan=with_scan, timeout=timeout, memory=memory)
    failure = found["failure"]
    if isinstance(failure, dict):
        say(f"failed in {failure['stage']}: {failure['message']}")
    else:
        say("the scan does not fail with these options; give those with which it failed")
    say(f"attach this file to your report; it has {'the' if with_scan else 'no'} points of the scan")
    if as_json:
        write_document({"file": printable(output), "failure": failure}, options=options)
    else:
        write_line(printable(output))
