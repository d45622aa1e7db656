"""Commands that fill a catalogue with scans: ingest, status, watch; and the demo of all."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict
from functools import partial
from importlib import resources
from pathlib import Path
from shlex import join, quote
from typing import Any, NoReturn

import click

import pcretrieve as pr
from pcretrieve.cli import messages, options as opt, output as out
from pcretrieve.errors import CatalogueError, InputError
from pcretrieve.values.files import write_file

# Largest number of names in the message about names in a label file that match no scan.
QUOTED = 5

# Share of a batch from which on a reason that its scans have in common is said once.
COMMON = 1 / 3

# The scan that the demo searches for; it ingests the others of its folder. See `scripts/sample demo`.
DEMO_QUERY = Path("new", "person-1", "person-1_hands_on_hips.ply")


@opt.command("ingest")
@click.argument("paths", nargs=-1, metavar="PATH...")
@opt.catalogue_option
@opt.option(
    "--labels CSV|LAYOUT",
    "Classes: a CSV file (columns file, class), a .cla file, or folders (named like classes), "
    "csv (labels.csv beside scans), shrec11, shrec14-real, shrec14-synthetic, faust, tosca, psb.",
)
@opt.settings_options
@opt.rare_option(
    "--no-meshes",
    "Leave meshes out of a new catalogue: a scan takes some 60 kB, not some 350 kB, but pages "
    "have no views in 3-D, nothing can be exported, and only descriptors of the spectrum work.",
)
@opt.workers_option
@opt.limit_options
@opt.rare_option(
    "--scheduler ADDRESS", "Process the scans on the Dask cluster of this scheduler."
)
@opt.rare_option(
    "--scheduler-file FILE",
    "The same, by the file that `dask scheduler --scheduler-file` writes.",
    opt.PATH,
)
@opt.option("--retry-failed", "Process failed scans again too.")
@opt.rare_option(
    "--retries N",
    "Try failing scans again, at most N times, with changes.",
    opt.NUMBER,
    default=0,
)
@opt.rare_option(
    "--max-failures N",
    "Stop after N scans have failed. The same command goes on from there.",
    opt.COUNT,
)
@opt.rare_option("--dry-run", "Show what would be done, and do nothing.")
@opt.progress_option
@opt.rare_option("--quiet -q", "Print warnings and failures only.")
@opt.rare_option(
    "--log-file FILE",
    "Append each stage of each scan, and each repair, to a file.",
    opt.PATH,
)
@opt.rare_option(
    "--shard I/N",
    "Process only part I of N, as one task of a job array; `catalogue merge` joins the catalogues.",
)
def ingest_command(
    paths: tuple[str, ...],
    catalogue: str,
    progress: str,
    quiet: bool,
    log_file: Path | None,
    **values: Any,
) -> out.Result:
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
        messages.log_to(log_file)
    options = _new_options(values)
    if cluster := opt.taken(values, "scheduler", "scheduler_file"):
        values["executor"] = pr.DaskExecutor(**cluster)
    with messages.Progress(
        "ingest", "none" if quiet and progress == "bar" else progress
    ) as shown:
        try:
            values |= {"on_start": shown.start, "on_shape": partial(_advance, shown)}
            summary = pr.ingest(paths, catalogue, options=options, **values)
        except (KeyboardInterrupt, SystemExit) as stop:
            shown.__exit__()
            _stopped(stop, catalogue)
    if not quiet:
        _say_summary(summary, catalogue, values["labels"])
    return _result(summary, catalogue, options)


def _new_options(values: dict[str, Any]) -> pr.PipelineOptions | None:
    """The options of a new catalogue; None for those of the catalogue, if nothing was given."""
    without_meshes = values.pop("no_meshes", False)
    is_given = without_meshes or any(
        values[name] for name in ("config", "surface", "unit")
    )
    options = opt.load_options(values)
    if without_meshes:
        options = options.changed(
            catalogue={"keep": set(options.catalogue.keep) - {"meshes"}}
        )
    return options if is_given else None


def _stopped(stop: BaseException, catalogue: str) -> NoReturn:
    """End the command after Ctrl-C or a signal, and say what is stored."""
    try:
        with pr.Catalogue(catalogue) as store:
            messages.say(
                f"stopped; {len(store)} shapes are in {catalogue}, and the same command goes on from there"
            )
    except CatalogueError:  # there is none yet
        messages.say("stopped")
    sys.exit(stop.code if isinstance(stop, SystemExit) else out.EXIT_INTERRUPTED)


def _advance(shown: messages.Progress, record: pr.Record) -> None:
    """Count a scan that a catalogue has now, and show it."""
    facts = {"status": record.status, "seconds": round(record.seconds, 3)} | _facts(
        record
    )
    is_failed = record.status == "failed"
    shown.advance(
        facts,
        messages.failure_line(record.id, record, record.path) if is_failed else None,
    )


def _facts(record: pr.Record) -> dict[str, object]:
    """Id and path of a record, in JSON; of a failure with its stage, its kind and its message."""
    facts: dict[str, object] = {"id": record.id, "path": record.path}
    return facts | out.failure_facts(record) if record.status == "failed" else facts


@opt.command("watch", has_json=False)
@click.argument("folder", type=opt.PATH)
@opt.catalogue_option
@opt.settings_options
@opt.option(
    "--interval SECONDS",
    "Look again after this time; files must stay the same meanwhile.",
    click.FloatRange(min=0.1),
    default=5,
)
@opt.workers_option
@opt.limit_options
def watch_command(folder: Path, catalogue: str, **values: Any) -> None:
    """Ingest scans as soon as they arrive in a folder, until Ctrl-C.

    Scans that are there already come first. A file is read when it has stopped growing.

    \b
    pcretrieve watch scanner/ --catalogue bodies.sqlite
    """
    messages.stop_waiting()
    options = _new_options(values)
    try:
        messages.say(f"watching {folder} every {values['interval']:g} s, until Ctrl-C")
        for summary in pr.watch(
            folder, catalogue, options=options, on_shape=_tell, **values
        ):
            _say_summary(summary, catalogue)
    except (KeyboardInterrupt, SystemExit) as stop:
        _stopped(stop, catalogue)


def _tell(record: pr.Record) -> None:
    if record.status == "failed":
        messages.say(messages.failure_line(record.id, record, record.path))
    else:
        messages.say(f"done: [{record.id}] {messages.shown_path(record.path)}")


@opt.command("status")
@opt.catalogue_option
def status_command(catalogue: str) -> out.Result:
    """Show the progress of the last ingest, while it runs and afterwards.

    \b
    pcretrieve status -c bodies.sqlite
    """
    found = pr.status(catalogue)
    document = {"catalogue": messages.without_password(catalogue)} | asdict(found)
    return out.Result(document, show=lambda: _write_status(catalogue, found))


def _write_status(catalogue: str, found: pr.BatchStatus) -> None:
    for line in _progress_lines(found):
        out.write_words(line)
    out.write_words(
        f"{catalogue}: {found.n_shapes} shapes, {sum(found.failures.values())} failed"
    )
    rows = ((str(number), kind) for kind, number in found.failures.items())
    out.write_table({"NUMBER": "number", "FAILURE": "text"}, rows)


def _progress_lines(found: pr.BatchStatus) -> list[str]:
    if found.state == "none":
        return ["no ingest into it is known on this computer"]
    counts = _counts(found.n_done, found.n_failed, found.n_known, found.n_duplicates)
    n_finished = found.n_done + found.n_failed + found.n_known + found.n_duplicates
    left = (
        ""
        if found.seconds_left is None
        else f", about {messages.duration(found.seconds_left)} left"
    )
    lines = [
        f"ingest {found.state}: {n_finished} of {found.n_scans} scans: {counts}",
        f"started {found.started}, last counted {found.updated}",
        f"rate: {found.scans_per_second * 60:.3g} scans/min{left}",
    ]
    if found.stages:
        shares = sorted(found.stages.items(), key=lambda stage: -stage[1])
        lines.append(
            "time: " + ", ".join(f"{name} {share:.0%}" for name, share in shares)
        )
    if found.state in ("stopped", "killed"):
        lines.append("the same command of ingest goes on from there")
    return lines


def _counts(
    n_done: int, n_failed: int, n_known: int, n_duplicates: int, done: str = "done"
) -> str:
    """What became of scans, as `ingest` and `status` say it."""
    return f"{n_done} {done}, {n_failed} failed, {n_known} known already, {n_duplicates} duplicates"


def _say_summary(summary: pr.Summary, catalogue: str, labels: str | None = None) -> None:
    """Print the summary of an ingest, or of what an ingest would do."""
    for path, original in summary.duplicates:
        messages.say(
            f"skipped {path}: the same content as {original.id} ({original.path})"
        )
    if summary.unknown_labels:
        quoted = ", ".join(summary.unknown_labels[:QUOTED])
        more = len(summary.unknown_labels) - QUOTED
        messages.say(
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
    messages.say(f"{counts}: {catalogue}{again}")
    if incomplete := _incomplete(summary):
        grades = Counter(record.grade.name for record in incomplete if record.grade)
        counts = " and ".join(f"{n} {grade}" for grade, n in sorted(grades.items()))
        listed = f"`pcretrieve list --incomplete -c {quote(catalogue)}`"
        messages.say(f"{counts}, which may answer wrongly: {listed} gives the reasons")
        reason, n = _commonest_reason(incomplete)
        if n > COMMON * len([*summary.done, *summary.held]):
            messages.say(f"the same is wrong with {n} of them: {reason}")


def _result(
    summary: pr.Summary, catalogue: str, options: pr.PipelineOptions | None = None
) -> out.Result:
    """What an ingest did, or would do; its options are those of the catalogue, if there is one."""
    if not summary.planned:
        with suppress(CatalogueError), pr.Catalogue(catalogue) as store:
            options = store.options
    document = {
        "catalogue": messages.without_password(catalogue),
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
    return out.Result(document, options, failed=_failures(summary))


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


@opt.command("demo", has_json=False)
@click.argument(
    "folder",
    type=click.Path(path_type=Path),
    default=Path("pcretrieve-demo"),
    metavar="[FOLDER]",
)
def demo_command(folder: Path) -> None:
    """Try everything on simulated scans: ingest, query, evaluate, and a page of the results.

    The demo takes about a minute, and prints each command before it runs. All files are in FOLDER
    (pcretrieve-demo by default): scans of people, their catalogue, and the page.

    \b
    pcretrieve demo
    pcretrieve demo elsewhere
    """
    scans, catalogue = folder / "scans", folder / "bodies.sqlite"
    new = folder / DEMO_QUERY
    messages.say(
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

    inside, page = ("--catalogue", catalogue), folder / "index.html"
    steps: list[tuple[str, list[str | Path]]] = [
        (
            "Store the signature of each scan.",
            ["ingest", scans, "--labels", scans / "labels.csv", *inside],
        ),
        ("Find whom the new scan shows.", ["query", *inside, new, "-k", "5"]),
        (
            "Measure how well scans of one body find each other: 1 is best.",
            ["evaluate", *inside],
        ),
        (
            "Write the results with pictures on an HTML page.",
            ["report", *inside, "--output", page],
        ),
    ]
    for purpose, words in steps:
        arguments = [str(word) for word in words]
        for line in ("", purpose, f"$ {join(['pcretrieve', *arguments])}"):
            messages.say(line)
        context = click.get_current_context()
        command = context.find_root().command
        if code := command.main(arguments, prog_name="pcretrieve", standalone_mode=False):
            context.exit(code)
    messages.say("")
    messages.say(f"Open this page in a browser: {page.resolve().as_uri()}")
