"""A scan that fails → one file with what is needed to report it, without the scan itself unless asked."""

from __future__ import annotations

import io
import json
import logging
import platform
import zipfile
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from sqlite3 import sqlite_version

from pcretrieve.errors import PcretrieveError, ScanReadError
from pcretrieve.formats import ScanPath, parts_of
from pcretrieve.formats.files import check_output
from pcretrieve.formats.identity import content_hash
from pcretrieve.ingestion.plan import versions
from pcretrieve.ingestion.pool import alone
from pcretrieve.options import OptionsLike, PipelineOptions, describe_options
from pcretrieve.values.files import write_file


def report_problem(
    scan: str | Path,
    output: str | Path,
    options: OptionsLike = None,
    *,
    with_scan: bool = False,
    timeout: float = 600.0,
    memory: float | None = None,
) -> dict[str, object]:
    """Process a scan, and write a ZIP file with what is needed to report that it fails.

    The file has ``problem.json`` (versions, computer, size and hash of the scan, error with its stage, checks
    and steps of the stages before), ``options.toml`` and ``log.txt``. The folder of the scan is left out.
    Files that a scan names and that are missing, such as a view of a ``.conf`` file, are listed.

    Parameters
    ----------
    scan : str or Path
        The scan.
    output : str or Path
        The file to be written.
    options : OptionsLike, optional
        The options with which the scan fails: options, a preset's name, a TOML file, or a mapping.
    with_scan : bool, default False
        Whether the file also has the scan, with the other files that belong to it, in the folder ``scan``.
    timeout : float, default 600
        Longest time for the processing, which is in a process of its own; seconds.
    memory : float, optional
        Largest heap of this process; GiB.

    Returns
    -------
    dict
        The content of ``problem.json``.

    Raises
    ------
    InputError
        If the file cannot be written.
    ScanReadError
        If the scan cannot be opened.
    """
    output, options = Path(output), PipelineOptions.of(options)
    place = ScanPath.parse(scan)
    file = place.file
    check_output(output, [file])
    parts: list[Path] = []
    with suppress(ScanReadError, OSError):  # which is then what is reported
        parts += [part.path for part in parts_of(file)]
    missing = [part.name for part in parts if not part.is_file()]
    found: dict[str, object] = {
        "versions": versions()
        | {"python": platform.python_version(), "sqlite": sqlite_version},
        "computer": platform.platform(),
        "options_digest": options.digest,
        "scan": {
            "name": file.name,
            "member": place.member,
            "bytes": file.stat().st_size if file.is_file() else None,
            "content_hash": None if missing else content_hash(place),
            "missing": missing,
        },
    }
    log = "The process ended before it returned its log.\n"
    try:
        measured, log = alone(_measured, place, options, timeout=timeout, memory=memory)
        found |= measured
    except PcretrieveError as error:  # the process crashed, or exceeded its limits
        found["failure"] = {
            "stage": error.stage,
            "error": type(error).__name__,
            "message": error.message,
        }
    text = _without_folder(json.dumps(found, indent=2, ensure_ascii=False), file)
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("problem.json", text + "\n")
        archive.writestr("options.toml", describe_options(options))
        archive.writestr("log.txt", _without_folder(log, file))
        if with_scan:
            for part in (file, *parts):
                if part.is_file():
                    archive.write(part, f"scan/{part.name}")
    write_file(output, packed.getvalue())
    document: dict[str, object] = json.loads(text)
    return document


def _without_folder(text: str, file: Path) -> str:
    """A text in which the path of a file is its name, as it is or as JSON writes it."""
    for folder in (file.absolute().parent, file.parent):
        if folder.name:  # not the current or the root folder
            for written in (
                f"{folder}/",
                json.dumps(f"{folder}/", ensure_ascii=False)[1:-1],
            ):
                text = text.replace(written, "")
    return text


def _measured(scan: ScanPath, options: PipelineOptions) -> tuple[dict[str, object], str]:
    """What can be measured of a scan, and the log of its processing, in a process of its own."""
    log = io.StringIO()
    handler = logging.StreamHandler(log)
    handler.setFormatter(
        logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s")
    )
    logger = logging.getLogger("pcretrieve")
    logger.addHandler(handler)
    logger.setLevel(logging.DEBUG)
    from pcretrieve.pipeline.inspecting import inspect_scan

    inspection = inspect_scan(scan, options, n_rescans=0)
    return {
        "failure": None if inspection.failure is None else asdict(inspection.failure),
        "checks": [asdict(check) for check in inspection.checks],
        "steps": [asdict(step) for step in inspection.steps],
    }, log.getvalue()
