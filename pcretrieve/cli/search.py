"""Commands that ask a catalogue which shapes are similar: query, duplicates, map, serve."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import pcretrieve as pr
from pcretrieve.cli import options as opt, output as out
from pcretrieve.cli.messages import say, shown_path
from pcretrieve.errors import ShapeError

if TYPE_CHECKING:
    # The name of each query, and its answer or its error.
    Outcome = tuple[str, pr.Answer | ShapeError]
    Outcomes = Iterator[Outcome]

MEGABYTE = 1_000_000

COLUMNS = {"RANK": "number", "DISTANCE": "number", "SCORE": "number"}
COLUMNS |= {"CLASS": "text", "ID": "text", "FILE": "path"}
# Of a result whose scan is incomplete; `show` and --json give the reasons.
SCAN = {"SCAN": "text"}

# Of several queries: what is said of each, and the score of its nearest shape.
SAID = {"SCAN": "path", "VERDICT": "text", "CLASS": "text", "SCORE": "number"}

PAIR = {"DISTANCE": "number", "LIMIT": "number", "FIRST": "text", "SECOND": "text"}


@opt.command("query")
@click.argument(
    "queries",
    nargs=-1,
    required=True,
    metavar="SCAN|FOLDER|ID...",
    shell_complete=opt.complete_queries,
)
@opt.catalogue_option
@opt.option("-k N", "Number of results.", opt.COUNT, into="k", default=10)
@opt.option(
    "--filter label=CLASS",
    "Search this class only; give it again for more classes.",
    str,
    into="labels",
    multiple=True,
    callback=opt.classes_of,
    shell_complete=opt.complete_labels,
)
@opt.rare_option("--exclude-self", "Leave stored queries out of their results.")
@opt.option(
    "--min-score SHARE",
    'Hide neighbours below this score; "stranger" if none is left.',
    click.FloatRange(0, 1),
)
@opt.rare_option(
    "--false-match-rate --far RATE",
    "Name a class only if so few pairs of two classes are as near.",
    click.FloatRange(0, 1, min_open=True, max_open=True),
)
@opt.matrix_option
@opt.on_catalogue
@opt.unit_option
@opt.limit_options
@opt.rare_option("--csv", "Print one table of all results, as CSV.", into="as_csv")
@opt.option(
    "--html PAGE",
    "Write an HTML page of all queries too, with pictures.",
    opt.PATH,
    into="page",
)
@opt.verbose_option
@opt.up_option
def query_command(
    store: pr.Catalogue,
    options: pr.PipelineOptions,
    queries: tuple[str, ...],
    as_csv: bool,
    is_verbose: bool,
    page: Path | None,
    up: str | None,
    **asked: Any,
) -> out.Result:
    """Find the shapes most similar to a scan, nearest first.

    A query is a scan, a folder of scans, or the id of a stored shape. The score tells how often two shapes so
    near are of one class. The last line is the verdict: sure of a class, between two, a stranger to this
    collection, or unknown. Several queries get a line each; -v shows their neighbours too.

    \b
    pcretrieve query --catalogue bodies.sqlite scan.ply -k 5
    pcretrieve query --catalogue bodies.sqlite cat0 dog1 --filter label=cat
    pcretrieve query --catalogue bodies.sqlite new_scan.ply --html page.html
    """
    if out.prints_json() and as_csv:
        raise click.UsageError("choose one of --json and --csv")
    asked["labels"] = asked["labels"] or None
    if asked["matrix"] is not None:
        opt.refuse("a matrix ranks stored shapes, and no scan is read", "unit", "memory")
    found = pr.search_many(store, queries, options=options, **asked)
    if page is not None:
        known: list[tuple[str, pr.Answer | ShapeError]] = []
        asked["on_answer"] = lambda name, answer: known.append((name, answer))
        written = pr.query_page(store, queries, page, options=options, up=up, **asked)
        say(f"page: {shown_path(str(written))}", indent=None)
        found = iter(known)
    is_alone = len(queries) == 1 and not Path(queries[0]).is_dir()
    failures: list[ShapeError] = []
    outcomes = map(partial(_told, failures, is_alone), found)

    def show() -> None:
        if as_csv:
            _write_csv(outcomes)
            return
        if is_alone or is_verbose:
            for name, answer in outcomes:
                if not isinstance(answer, ShapeError):
                    _write_answer(answer, None if is_alone else name)
        else:
            out.write_table(SAID, map(_said, outcomes))
        if is_verbose and asked["matrix"] is None:
            index = pr.index(store, options=options)
            say(f"whitening: {index.whitening.reason}")
            say(f"score: {index.reason}")

    return out.Result(
        _documents(outcomes, store, options, asked["matrix"]), options, show, failures
    )


def _told(failures: list[ShapeError], is_alone: bool, found: Outcome) -> Outcome:
    """An outcome; messages tell of failures and incomplete queries, and a failure alone is raised."""
    name, outcome = found
    if isinstance(outcome, ShapeError):
        if is_alone:
            raise outcome
        failures.append(outcome)
        say(f"failed: {outcome}")
    else:
        if outcome.scan and not outcome.scan.is_good:
            say(f"{shown_path(name)} is {outcome.scan}")
        for note in outcome.notes:
            say(f"{shown_path(name)}: {note}")
        if isinstance(outcome.query, str) and outcome.query != name:
            say(f"{shown_path(name)} is stored as {outcome.query}")
    return found


def _documents(
    outcomes: Outcomes,
    store: pr.Catalogue,
    options: pr.PipelineOptions,
    matrix: pr.DistanceMatrix | None,
) -> Iterator[dict[str, Any]]:
    """The outcome of each query, for JSON, with how shapes are compared: by no distance if by a matrix."""
    how: dict[str, str | None] = {"distance": None, "whitening": None}
    if matrix is None:
        whitening = pr.index(store, options=options).whitening.reason
        how = {"distance": options.retrieval.distance, "whitening": whitening}
    for name, outcome in outcomes:
        if isinstance(outcome, ShapeError):
            yield {"query": name} | out.failure_facts(outcome)
        else:
            yield {"query": name} | outcome.document() | how


def _said(outcome: Outcome) -> tuple[str, str, str, str]:
    """The row of one of several queries."""
    name, answer = outcome
    if isinstance(answer, ShapeError):
        return shown_path(name), "-", "-", "-"
    scores = [f"{row['score']:.2f}" for row in answer.rows() if row["score"] is not None]
    return shown_path(name), answer.verdict, answer.named or "-", (scores or ["-"])[0]


def _write_answer(answer: pr.Answer, name: str | None) -> None:
    """A table of the neighbours, below a line with the query if there are several, and the verdict."""
    if name is not None:
        out.write_lines(shown_path(name))
    columns = COLUMNS | (
        SCAN if any(record.is_incomplete for record in answer.records) else {}
    )
    rows = []
    for row in answer.rows():
        score = "-" if row["score"] is None else f"{row['score']:.2f}"
        grade = row["grade"]
        scan = "" if grade is None or grade["name"] == "good" else grade["name"]
        label, path = row["label"] or "-", shown_path(row["path"])
        cells = (
            str(row["rank"]),
            f"{row['distance']:#.4g}",
            score,
            label,
            row["id"],
            path,
            scan,
        )
        rows.append(cells[: len(columns)])
    out.write_table(columns, rows)
    out.write_words(f"{answer}, because {answer.because}")


def _write_csv(outcomes: Outcomes) -> None:
    """One row for each neighbour of each query."""
    from pcretrieve.values.files import csv_text

    answers = (
        (name, answer) for name, answer in outcomes if not isinstance(answer, ShapeError)
    )
    rows = (row for name, answer in answers for row in answer.table(name))
    out.write_csv(csv_text(pr.Answer.columns, rows))


@opt.command("duplicates")
@opt.catalogue_option
@opt.option(
    "--threshold DISTANCE",
    "Find pairs up to this distance.  [default: moments up to .03]",
    click.FloatRange(min=0),
)
@opt.on_catalogue
@opt.option(
    "--html PAGE",
    "Write an HTML page too, with both shapes of each pair.",
    opt.PATH,
    into="page",
)
def duplicates_command(
    store: pr.Catalogue,
    options: pr.PipelineOptions,
    threshold: float | None,
    page: Path | None,
) -> out.Result:
    """Find copies of shapes: at another resolution, mirrored, or two scans of one body in one pose.

    The table has the distance, its limit and both ids, nearest first. Distances are those of the moments of
    the surfaces, which must be stored; with --threshold, those of the signatures.

    \b
    pcretrieve duplicates --catalogue bodies.sqlite --html pairs.html
    """
    pairs = pr.duplicates(store, options=options, threshold=threshold)
    if page is not None:
        compared = options.of_copies if threshold is None else options
        written = pr.query_page(store, pairs, page, options=compared)
        say(f"page: {shown_path(str(written))}", indent=None)
    rows = (
        (f"{one.distance:#.4g}", f"{one.limit:#.4g}", one.first, one.second)
        for one in pairs
    )
    say(f"{len(pairs)} {'pair' if len(pairs) == 1 else 'pairs'}")
    return out.Result(
        [pair._asdict() for pair in pairs], options, partial(out.write_table, PAIR, rows)
    )


@opt.command("map")
@opt.catalogue_option
@opt.option(
    "--output -o PNG|HTML", "Write this picture or this page.", opt.PATH, required=True
)
@opt.up_option
@opt.on_catalogue
def map_command(
    store: pr.Catalogue, options: pr.PipelineOptions, output: Path, up: str | None
) -> out.Result:
    """Plot a 2-D map of shapes: similar ones lie near each other.

    A page (.html) shows name and thumbnail of the shape under the pointer. A picture (.png) needs matplotlib.

    \b
    pcretrieve lab map --catalogue bodies.sqlite -o bodies.html
    """
    page = pr.draw_map(store, output, options=options, up=up)
    return out.Result(
        {"page": page}, options, lambda: out.write_lines(shown_path(str(page)))
    )


@opt.command("serve", has_json=False)
@opt.catalogue_option
@opt.option(
    "--port N",
    "Port at 127.0.0.1; 0 for any free one.",
    click.IntRange(0, 65535),
    default=8765,
)
@opt.option("--read-only", "Take no scans from browsers.")
@opt.option(
    "--keep FOLDER",
    "Let people keep their scans: files in this folder, shapes in the catalogue.",
    click.Path(exists=True, file_okay=False, writable=True, path_type=Path),
)
@opt.option(
    "--max-upload MB", "Refuse larger scans from browsers.", opt.COUNT, default=200
)
@partial(opt.limit_options, unit="scan from a browser", time=300, memory=4)
@opt.up_option
@opt.comparison_options
def serve_command(catalogue: str, max_upload: int, **chosen: Any) -> None:
    """Show a catalogue in the browser of this computer, until Ctrl-C.

    Open the address that is printed. It contains a secret: whoever has it can see the shapes, and search by
    scans. Scans run in an isolated process, and are deleted unless you give --keep. From another computer,
    use an SSH tunnel: ssh -L 8765:127.0.0.1:8765 HOST.

    \b
    pcretrieve serve --catalogue bodies.sqlite
    pcretrieve serve --catalogue bodies.sqlite --port 0 --keep scans/
    """
    if chosen["read_only"] and chosen["keep"] is not None:
        raise click.UsageError("choose one of --read-only and --keep")
    with pr.Catalogue(catalogue) as store:
        options = opt.compared(store, chosen)
    chosen |= {"most_bytes": max_upload * MEGABYTE, "on_start": _say_address}
    pr.serve(catalogue, options=options, **chosen)


def _say_address(address: str) -> None:
    say("Open the address in a browser; end the server with Ctrl-C.")
    out.write_lines(address)
