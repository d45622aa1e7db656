"""Commands that fill a catalogue with scans: ingest, status, watch; and the demo of all."""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from importlib import resources
from pathlib import Path
from shlex import join, quote
from typing import NoReturn

import click

import pcretrieve as pr
from pcretrieve.cli.catalogue import cells_of
from pcretrieve.cli.messages import (
    Progress,
    duration,
    failure_line,
    log_to,
    say,
    shown_path,
    stop_waiting,
    without_password,
)
from pcretrieve.cli.options import (
    COUNT,
    NUMBER,
    Number,
    Processes,
    ScanSettings,
    argument,
    catalogue_option,
    command,
    option,
    rare_option,
)
from pcretrieve.cli.output import (
    EXIT_INTERRUPTED,
    Result,
    failure_facts,
    write_table,
    write_words,
)
from pcretrieve.errors import CatalogueError, InputError

# Largest number of names in the message about names in a label file that match no scan.
QUOTED = 5

# Number of the worst scans that an ingest ends with.
WORST = 3
WORST_COLUMNS = {"GRADE": "text", "ERROR": "number", "REASON": "words"}

# Share of a batch from which on a reason that its scans have in common is said once.
COMMON = 1 / 3

# The scan that the demo searches for; it ingests the others of its folder. See `scripts/sample demo`.
DEMO_QUERY = Path("new", "person-1", "person-1_hands_on_hips.ply")


@dataclass(frozen=True)
class Batch:
    """Which scans of a batch are processed, and by whom."""

    labels: str | None = option(
        "--labels CSV|LAYOUT",
        "Classes: a CSV file (columns file, class), a .cla file, or folders (named like classes), "
        "csv (labels.csv beside scans), shrec11, shrec14-real, shrec14-synthetic, faust, tosca, psb.",
    )
    scheduler: str | None = rare_option(
        "--scheduler ADDRESS",
        "Process the scans on the Dask cluster of this scheduler.",
    )
    scheduler_file: Path | None = rare_option(
        "--scheduler-file FILE",
        "The same, by the file that `dask scheduler --scheduler-file` writes.",
    )
    retry_failed: bool = option("--retry-failed", "Process failed scans again too.")
    retries: int = rare_option(
        "--retries N",
        "Try failing scans again, at most N times, with changes.",
        NUMBER,
        default=0,
    )
    max_failures: int | None = rare_option(
        "--max-failures N",
        "Stop after N scans have failed. The same command goes on from there.",
        COUNT,
    )
    dry_run: bool = rare_option("--dry-run", "Show what would be done, and do nothing.")
    shard: str | None = rare_option(
        "--shard I/N",
        "Process only part I of N, as one task of a job array; `catalogue merge` joins the catalogues.",
    )


@command("ingest")
def ingest_command(
    *,
    paths: tuple[str, ...] = argument("PATH..."),
    catalogue: str = catalogue_option,
    settings: ScanSettings,
    without_meshes: bool = rare_option(
        "--no-meshes",
        "Leave meshes out of a new catalogue: a scan takes some 60 kB, not some 350 kB, but pages "
        "have no views in 3-D, nothing can be exported, and only descriptors of the spectrum work.",
    ),
    batch: Batch,
    run: Processes,
    quiet: bool = rare_option("--quiet -q", "Print warnings and failures only."),
    log_file: Path | None = rare_option(
        "--log-file FILE",
        "Append each stage of each scan, and each repair, to a file.",
    ),
) -> Result:
    """Process scans, and store them in a catalogue.

    PATH is a file, a folder, a glob pattern, or a list of files (.txt, .csv). Scans that are stored already
    are skipped: after an interruption, run the same command again.

    \b
    pcretrieve ingest scans/ --labels scans/labels.csv --catalogue bodies.sqlite
    pcretrieve ingest 'tosca/*.off' --surface keep --catalogue tosca.sqlite
    """
    if not paths:
        raise click.UsageError("name at least one scan")
    if log_file is not None:
        log_to(log_file)
    options = _new_options(settings, without_meshes)
    ingest = partial(pr.ingest, paths, catalogue)
    if batch.scheduler is not None or batch.scheduler_file is not None:
        cluster = pr.DaskExecutor(batch.scheduler, batch.scheduler_file)
        ingest = partial(ingest, executor=cluster)
    mode = "none" if quiet and run.progress == "bar" else run.progress
    with Progress("ingest", mode) as shown:
        try:
            summary = ingest(
                labels=batch.labels,
                options=options,
                workers=run.workers,
                timeout=run.timeout,
                memory=run.memory,
                retry_failed=batch.retry_failed,
                retries=batch.retries,
                max_failures=batch.max_failures,
                dry_run=batch.dry_run,
                shard=batch.shard,
                on_start=shown.start,
                on_shape=partial(_advance, shown),
            )
        except (KeyboardInterrupt, SystemExit) as stop:
            shown.__exit__()
            _stopped(stop, catalogue)
    if not quiet:
        _say_summary(summary, catalogue, batch.labels)
    return _result(summary, catalogue, options)


def _new_options(
    settings: ScanSettings, without_meshes: bool = False
) -> pr.PipelineOptions | None:
    """The options of a new catalogue; None for those of the catalogue, if nothing was given."""
    options = settings.options()
    if without_meshes:
        keep = set(options.catalogue.keep) - {"meshes"}
        options = options.changed(catalogue={"keep": keep})
    return options if without_meshes or any(vars(settings).values()) else None


def _stopped(stop: BaseException, catalogue: str) -> NoReturn:
    """End the command after Ctrl-C or a signal, and say what is stored."""
    try:
        with pr.Catalogue(catalogue) as store:
            say(
                f"stopped; {len(store)} shapes are in {catalogue}, and the same command goes on from there"
            )
    except CatalogueError:  # there is none yet
        say("stopped")
    sys.exit(stop.code if isinstance(stop, SystemExit) else EXIT_INTERRUPTED)


def _advance(shown: Progress, record: pr.Record) -> None:
    """Count a scan that a catalogue has now, and show it."""
    facts = {"status": record.status, "seconds": round(record.seconds, 3)} | _facts(
        record
    )
    is_failed = record.status == "failed"
    shown.advance(
        facts,
        failure_line(record.id, record, record.path) if is_failed else None,
    )


def _facts(record: pr.Record) -> dict[str, object]:
    """Id and path of a record, in JSON; of a failure with its stage, its kind and its message."""
    facts: dict[str, object] = {"id": record.id, "path": record.path}
    return facts | failure_facts(record) if record.status == "failed" else facts


@command("watch", has_json=False)
def watch_command(
    *,
    folder: Path = argument("FOLDER"),
    catalogue: str = catalogue_option,
    settings: ScanSettings,
    interval: float = option(
        "--interval SECONDS",
        "Look again after this time; files must stay the same meanwhile.",
        Number(min=0.1),
        default=5,
    ),
    run: Processes,
) -> None:
    """Ingest scans as soon as they arrive in a folder, until Ctrl-C.

    Scans that are there already come first. A file is read when it has stopped growing.

    \b
    pcretrieve watch scanner/ --catalogue bodies.sqlite
    """
    stop_waiting()
    options = _new_options(settings)
    try:
        say(f"watching {folder} every {interval:g} s, until Ctrl-C")
        for summary in pr.watch(
            folder,
            catalogue,
            options=options,
            interval=interval,
            workers=run.workers,
            timeout=run.timeout,
            memory=run.memory,
            on_shape=_tell,
        ):
            _say_summary(summary, catalogue)
    except (KeyboardInterrupt, SystemExit) as stop:
        _stopped(stop, catalogue)


def _tell(record: pr.Record) -> None:
    if record.status == "failed":
        say(failure_line(record.id, record, record.path))
    else:
        say(f"done: [{record.id}] {shown_path(record.path)}")


@command("status")
def status_command(catalogue: str = catalogue_option) -> Result:
    """Show the progress of the last ingest, while it runs and afterwards.

    \b
    pcretrieve status -c bodies.sqlite
    """
    found = pr.status(catalogue)
    document = {"catalogue": without_password(catalogue)} | asdict(found)
    return Result(document, show=lambda: _write_status(catalogue, found))


def _write_status(catalogue: str, found: pr.BatchStatus) -> None:
    for line in _progress_lines(found):
        write_words(line)
    n_failed = sum(found.failures.values())
    write_words(f"{catalogue}: {found.n_shapes} shapes, {n_failed} failed")
    rows = ((str(number), kind) for kind, number in found.failures.items())
    write_table({"NUMBER": "number", "FAILURE": "text"}, rows)


def _progress_lines(found: pr.BatchStatus) -> Iterator[str]:
    if found.state == "none":
        yield "no ingest into it is known on this computer"
        return
    counts = _counts(found.n_done, found.n_failed, found.n_known, found.n_duplicates)
    n_finished = found.n_done + found.n_failed + found.n_known + found.n_duplicates
    yield f"ingest {found.state}: {n_finished} of {found.n_scans} scans: {counts}"
    yield f"started {found.started}, last counted {found.updated}"
    rate = f"rate: {found.scans_per_second * 60:.3g} scans/min"
    if found.seconds_left is not None:
        rate += f", about {duration(found.seconds_left)} left"
    yield rate
    if found.stages:
        shares = sorted(found.stages.items(), key=lambda stage: -stage[1])
        yield "time: " + ", ".join(f"{name} {share:.0%}" for name, share in shares)
    if found.state in ("stopped", "killed"):
        yield "the same command of ingest goes on from there"


def _counts(
    n_done: int, n_failed: int, n_known: int, n_duplicates: int, done: str = "done"
) -> str:
    """What became of scans, as `ingest` and `status` say it."""
    return f"{n_done} {done}, {n_failed} failed, {n_known} known already, {n_duplicates} duplicates"


def _say_summary(summary: pr.Summary, catalogue: str, labels: str | None = None) -> None:
    """Print the summary of an ingest, or of what an ingest would do."""
    for path, original in summary.duplicates:
        say(f"skipped {path}: the same content as {original.id} ({original.path})")
    if summary.unknown_labels:
        quoted = ", ".join(summary.unknown_labels[:QUOTED])
        more = len(summary.unknown_labels) - QUOTED
        say(
            f"{labels} names {len(summary.unknown_labels)} shapes that are not among the scans: {quoted}"
            + (f" and {more} more" if more > 0 else "")
        )
    failures = _failures(summary)
    done, word = (
        (summary.planned, "to process") if summary.planned else (summary.done, "done")
    )
    counts = _counts(
        len(done), len(failures), len(_known(summary)), len(summary.duplicates), word
    )
    again = "; --retry-failed processes the failed shapes again" if failures else ""
    say(f"{counts}: {catalogue}{again}")
    if incomplete := _incomplete(summary):
        grades = Counter(record.grade.name for record in incomplete if record.grade)
        counts = " and ".join(f"{n} {grade}" for grade, n in sorted(grades.items()))
        listed = f"`pcretrieve list --incomplete -c {quote(catalogue)}`"
        say(f"{counts}, which may answer wrongly: {listed} gives the reasons")
        reason, n = _commonest_reason(incomplete)
        if n > COMMON * len([*summary.done, *summary.held]):
            say(f"the same is wrong with {n} of them: {reason}")
    if not summary.planned:
        _say_worst([*failures, *incomplete])


def _say_worst(records: Sequence[pr.Record]) -> None:
    """Print the worst scans and why, but for those that somebody has accepted."""
    worst = sorted(
        (record for record in records if record.mark != "accept"),
        key=lambda record: record.grade.error if record.grade else math.inf,
        reverse=True,
    )
    cells = map(cells_of, worst[:WORST])
    rows = ([one[name] or "-" for name in ("ID", *WORST_COLUMNS)] for one in cells)
    write_table({"WORST SCANS": "text"} | WORST_COLUMNS, rows, err=True)


def _result(
    summary: pr.Summary, catalogue: str, options: pr.PipelineOptions | None = None
) -> Result:
    """What an ingest did, or would do; its options are those of the catalogue, if there is one."""
    if not summary.planned:
        with suppress(CatalogueError), pr.Catalogue(catalogue) as store:
            options = store.options
    document = {
        "catalogue": without_password(catalogue),
        "planned": [record.id for record in summary.planned],
        "done": [record.id for record in summary.done],
        "held": [record.id for record in _known(summary)],
        "incomplete": [record.id for record in _incomplete(summary)],
        "duplicates": [
            {"path": path, "id": original.id} for path, original in summary.duplicates
        ],
        "failed": [_facts(record) for record in _failures(summary)],
        "unknown_labels": summary.unknown_labels,
    }
    return Result(document, options, failed=_failures(summary))


def _failures(summary: pr.Summary) -> list[pr.Record]:
    """The scans that failed now, and those that failed before."""
    return [
        *summary.failed,
        *(record for record in summary.held if record.status == "failed"),
    ]


def _known(summary: pr.Summary) -> list[pr.Record]:
    return [record for record in summary.held if record.status == "done"]


def _commonest_reason(records: Sequence[pr.Record]) -> tuple[str, int]:
    """The most frequent first reason of scans that are not good, without its place; and how often."""
    firsts = [
        reason
        for record in records
        if record.grade
        for reason in record.grade.reasons[:1]
    ]
    counts = Counter(reason.partition(", near (")[0] for reason in firsts)
    return counts.most_common(1)[0] if counts else ("", 0)


def _incomplete(summary: pr.Summary) -> list[pr.Record]:
    return [record for record in (*summary.done, *summary.held) if record.is_incomplete]


@command("demo", has_json=False)
def demo_command(
    folder: Path = argument("[FOLDER]", default=Path("pcretrieve-demo")),
) -> None:
    """Try everything on simulated scans: ingest, query, evaluate, and a page of the results.

    The demo takes about a minute, and prints each command before it runs. All files are in FOLDER
    (pcretrieve-demo by default): scans of people, their catalogue, and the page.

    \b
    pcretrieve demo
    pcretrieve demo elsewhere
    """
    from pcretrieve.values.files import write_file

    scans, catalogue = folder / "scans", folder / "bodies.sqlite"
    new = folder / DEMO_QUERY
    say(
        f"Scans of four simulated people are put into {scans}, and a new scan of one: {new}."
    )
    shipped = Path(str(resources.files(__package__).joinpath("demo")))
    try:
        for file in sorted(shipped.rglob("*.*")):
            target = folder / file.relative_to(shipped)
            target.parent.mkdir(parents=True, exist_ok=True)
            write_file(target, file.read_bytes())
    except OSError as error:
        raise InputError(
            f"cannot write scans into {folder}: {error.strerror}; name another"
        ) from error

    page = folder / "index.html"
    steps: dict[str, list[str | Path]] = {
        "Store the signature of each scan.": [
            "ingest",
            scans,
            "--labels",
            scans / "labels.csv",
        ],
        "Find whom the new scan shows.": ["query", new, "-k", "5"],
        "Measure how well scans of one body find each other: 1 is best.": ["evaluate"],
        "Write the results with pictures on an HTML page.": ["report", "--output", page],
    }
    context = click.get_current_context()
    root = context.find_root().command
    for purpose, words in steps.items():
        arguments = [*map(str, words), "--catalogue", str(catalogue)]
        for line in ("", purpose, f"$ {join(['pcretrieve', *arguments])}"):
            say(line)
        if code := root.main(arguments, prog_name="pcretrieve", standalone_mode=False):
            context.exit(code)
    say("")
    say(f"Open this page in a browser: {page.resolve().as_uri()}")
