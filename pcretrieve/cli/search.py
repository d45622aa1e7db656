"""Commands that ask a catalogue which shapes are similar: query, duplicates, map, serve."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import pcretrieve as pr
from pcretrieve.cli.messages import say, shown_path
from pcretrieve.cli.options import (
    COUNT,
    GIBIBYTES,
    SECONDS,
    Axis,
    Comparison,
    Limits,
    Number,
    Unit,
    WholeNumber,
    argument,
    catalogue_option,
    classes_of,
    command,
    complete_labels,
    complete_queries,
    matrix_option,
    option,
    rare_option,
    read_distances,
    refuse,
    unit_option,
    up_option,
    verbose_option,
)
from pcretrieve.cli.output import (
    Result,
    check_one_form,
    failure_facts,
    write_csv,
    write_lines,
    write_table,
    write_words,
)
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
SAID = {"SCAN": "text", "VERDICT": "text", "CLASS": "text", "SCORE": "number"}

PAIR = {"DISTANCE": "number", "LIMIT": "number", "EVIDENCE": "text"}
PAIR |= {"FIRST": "text", "SECOND": "text"}
COLUMNS_OF_PAIRS = ("first", "second", "distance", "limit", "evidence")


@dataclass(frozen=True)
class Question:
    """What is asked of each query."""

    k: int = option("-k N", "Number of results.", COUNT, default=10)
    labels: list[str] | None = option(
        "--filter label=CLASS",
        "Search this class only; give it again for more classes.",
        str,
        multiple=True,
        callback=classes_of,
        shell_complete=complete_labels,
    )
    exclude_self: bool = rare_option(
        "--exclude-self", "Leave stored queries out of their results."
    )
    min_score: float | None = option(
        "--min-score SHARE",
        'Hide neighbours below this score; "stranger" if none is left.',
        Number(0, 1),
    )
    false_match_rate: float | None = rare_option(
        "--false-match-rate --far RATE",
        "Name a class only if so few pairs of two classes are as near.",
        Number(0, 1, min_open=True, max_open=True),
    )
    unit: Unit | None = unit_option


@command("query")
def query_command(
    *,
    queries: tuple[str, ...] = argument(
        "SCAN|FOLDER|ID...",
        required=True,
        shell_complete=complete_queries,
    ),
    catalogue: str = catalogue_option,
    asked: Question,
    file: Path | None = matrix_option,
    comparison: Comparison,
    limits: Limits,
    as_csv: bool = rare_option("--csv", "Print one table of all results, as CSV."),
    page: Path | None = option(
        "--html PAGE",
        "Write an HTML page of all queries too, with pictures.",
    ),
    is_verbose: bool = verbose_option,
    up: Axis | None = up_option,
) -> Result:
    """Find the shapes most similar to a scan, nearest first.

    A query is a scan, a folder of scans, or the id of a stored shape. The score tells how often two shapes so
    near are of one class. The last line is the verdict: sure of a class, between two, a stranger to this
    collection, or unknown. Several queries get a line each; -v shows their neighbours too.

    \b
    pcretrieve query --catalogue bodies.sqlite scan.ply -k 5
    pcretrieve query --catalogue bodies.sqlite cat0 dog1 --filter label=cat
    pcretrieve query --catalogue bodies.sqlite new_scan.ply --html page.html
    """
    check_one_form(as_csv=as_csv)
    matrix = read_distances(file)
    if matrix is not None:
        refuse("a matrix ranks stored shapes, and no scan is read", "unit", "memory")
    store, options = comparison.opened(catalogue)
    found = pr.search_many(
        store,
        queries,
        options=options,
        matrix=matrix,
        k=asked.k,
        labels=asked.labels,
        exclude_self=asked.exclude_self,
        min_score=asked.min_score,
        false_match_rate=asked.false_match_rate,
        unit=asked.unit,
        timeout=limits.timeout,
        memory=limits.memory,
    )
    if page is not None:
        known: list[Outcome] = []
        written = pr.query_page(
            store,
            queries,
            page,
            options=options,
            up=up,
            on_answer=lambda name, answer: known.append((name, answer)),
            matrix=matrix,
            timeout=limits.timeout,
            memory=limits.memory,
            **vars(asked),
        )
        say(f"page: {shown_path(str(written))}", is_broken=False)
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
            write_table(SAID, map(_said, outcomes))
        if is_verbose and matrix is None:
            index = pr.index(store, options=options)
            say(f"whitening: {index.whitening.reason}")
            say(f"score: {index.reason}")

    return Result(_documents(outcomes, store, options, matrix), options, show, failures)


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
            yield {"query": name} | failure_facts(outcome)
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
        write_lines(shown_path(name))
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
    write_table(columns, rows)
    write_words(f"{answer}, because {answer.because}")


def _write_csv(outcomes: Outcomes) -> None:
    """One row for each neighbour of each query."""
    from pcretrieve.values.files import csv_text

    answers = (
        (name, answer) for name, answer in outcomes if not isinstance(answer, ShapeError)
    )
    rows = (row for name, answer in answers for row in answer.table(name))
    write_csv(csv_text(pr.Answer.columns, rows))


@command("duplicates")
def duplicates_command(
    *,
    scans: tuple[str, ...] = argument("[SCAN|FOLDER...]"),
    catalogue: str = catalogue_option,
    threshold: float | None = option(
        "--threshold DISTANCE",
        "Find pairs up to this distance.  [default: moments up to .03]",
        Number(min=0),
    ),
    as_csv: bool = rare_option("--csv", "Print one table of all pairs, as CSV."),
    comparison: Comparison,
    page: Path | None = option(
        "--html PAGE",
        "Write an HTML page too, with both shapes of each pair.",
    ),
) -> Result:
    """Find copies of shapes: at another resolution, mirrored, or two scans of one body in one pose.

    With scans that are not stored, the pairs are those of one of them and a stored shape.

    The table has the distance, its limit, the evidence and both ids, nearest first; pairs of two classes are
    in a second table. Distances are those of the moments of the surfaces, which must be stored; the
    signatures of copies are alike too. The evidence is one file, one surface, or one body in one pose. With
    --threshold, distances are those of the signatures.

    \b
    pcretrieve duplicates --catalogue bodies.sqlite --html pairs.html
    pcretrieve duplicates new_scans --catalogue bodies.sqlite
    """
    check_one_form(as_csv=as_csv)
    if scans and page is not None:
        raise click.UsageError("a page shows stored shapes: leave out --html, or ingest")
    store, options = comparison.opened(catalogue)
    failures: list[ShapeError] = []
    if scans:
        copies = pr.copies(store, scans, options=options, threshold=threshold)
        pairs = sorted(_told_copies(failures, copies), key=lambda pair: pair.distance)
    else:
        pairs = pr.duplicates(store, options=options, threshold=threshold)
    if page is not None:
        compared = options.of_copies if threshold is None else options
        written = pr.duplicates_page(store, pairs, page, options=compared)
        say(f"page: {shown_path(str(written))}", is_broken=False)
    say(f"{len(pairs)} {'pair' if len(pairs) == 1 else 'pairs'}")
    show = partial(_write_pairs_csv if as_csv else _write_pairs, pairs)
    return Result([pair._asdict() for pair in pairs], options, show, failures)


def _told_copies(
    failures: list[ShapeError],
    found: Iterable[tuple[str, list[pr.NearPair] | ShapeError]],
) -> Iterator[pr.NearPair]:
    """The copies of all scans; messages tell of failures."""
    for _, pairs in found:
        if isinstance(pairs, ShapeError):
            failures.append(pairs)
            say(f"failed: {pairs}")
        else:
            yield from pairs


def _write_pairs(pairs: Sequence[pr.NearPair]) -> None:
    one_class = [pair for pair in pairs if pair.is_of_one_class]
    write_table(PAIR, map(_pair_row, one_class))
    if mixed := [pair for pair in pairs if not pair.is_of_one_class]:
        write_lines(
            *[""] * bool(one_class), "Of two classes: a wrong label, or two bodies"
        )
        columns = PAIR | {"CLASSES": "text"}
        rows = ((*_pair_row(pair), ", ".join(map(str, pair.classes))) for pair in mixed)
        write_table(columns, rows)


def _pair_row(pair: pr.NearPair) -> tuple[str, ...]:
    """A row below `PAIR`."""
    numbers = (f"{pair.distance:#.4g}", f"{pair.limit:#.4g}")
    return (*numbers, pair.evidence, pair.first, pair.second)


def _write_pairs_csv(pairs: Sequence[pr.NearPair]) -> None:
    from pcretrieve.values.files import csv_text

    header = (*COLUMNS_OF_PAIRS, "first_class", "second_class")
    rows = ((*pair[: len(COLUMNS_OF_PAIRS)], *pair.classes) for pair in pairs)
    write_csv(csv_text(header, rows))


@command("map")
def map_command(
    *,
    catalogue: str = catalogue_option,
    output: Path = option(
        "--output -o PNG|HTML",
        "Write this picture or this page.",
    ),
    up: Axis | None = up_option,
    comparison: Comparison,
) -> Result:
    """Plot a 2-D map of shapes: similar ones lie near each other.

    A page (.html) shows name and thumbnail of the shape under the pointer. A picture (.png) needs matplotlib.

    \b
    pcretrieve lab map --catalogue bodies.sqlite -o bodies.html
    """
    store, options = comparison.opened(catalogue)
    page = pr.draw_map(store, output, options=options, up=up)
    return Result({"page": page}, options, lambda: write_lines(shown_path(str(page))))


@command("serve", has_json=False)
def serve_command(
    *,
    catalogue: str = catalogue_option,
    port: int = option(
        "--port N",
        "Port at 127.0.0.1; 0 for any free one.",
        WholeNumber(0, 65535),
        default=8765,
    ),
    read_only: bool = option("--read-only", "Take no scans from browsers."),
    keep: Path | None = option(
        "--keep FOLDER",
        "Let people keep their scans: files in this folder, shapes in the catalogue.",
        click.Path(exists=True, file_okay=False, writable=True, path_type=Path),
    ),
    export: Path | None = option(
        "--export FOLDER",
        "Write the pages to a new folder, to mail or to put on a web server.",
        click.Path(file_okay=False, path_type=Path),
    ),
    max_upload: int = option(
        "--max-upload MB", "Refuse larger scans from browsers.", COUNT, default=200
    ),
    timeout: float = rare_option(
        "--timeout SECONDS",
        "Give up after this time for each scan from a browser.",
        SECONDS,
        default=300,
    ),
    memory: float | None = rare_option(
        "--memory GIB",
        "Give the process of a scan no more memory than this; 4 by default.",
        GIBIBYTES,
    ),
    up: Axis | None = up_option,
    comparison: Comparison,
) -> None:
    """Show a catalogue in the browser of this computer, until Ctrl-C.

    Open the address that is printed. It contains a secret: whoever has it can see the shapes, and search by
    scans. Scans run in an isolated process, and are deleted unless you give --keep. From another computer,
    use an SSH tunnel: ssh -L 8765:127.0.0.1:8765 HOST.

    \b
    pcretrieve serve --catalogue bodies.sqlite
    pcretrieve serve --catalogue bodies.sqlite --port 0 --keep scans/
    pcretrieve serve --catalogue bodies.sqlite --export site/
    """
    if read_only and keep is not None:
        raise click.UsageError("choose one of --read-only and --keep")
    with pr.Catalogue(catalogue) as store:
        options = comparison.options(store.options)
    pr.serve(
        catalogue,
        options=options,
        port=port,
        read_only=read_only,
        keep=keep,
        export=export,
        most_bytes=max_upload * MEGABYTE,
        timeout=timeout,
        memory=memory,
        up=up,
        on_start=_say_address,
    )
    if export is not None:
        write_lines(shown_path(str(export / "index.html")))


def _say_address(address: str) -> None:
    say("Open the address in a browser; end the server with Ctrl-C.")
    write_lines(address)
