"""Commands that ask a catalogue which shapes are similar: query, matrix, duplicates, cluster, map."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import pcretrieve as pr
from pcretrieve.cli import options as opt
from pcretrieve.cli import output as out
from pcretrieve.cli.messages import failure_line, say, shown_path
from pcretrieve.cli.scans import failure_document
from pcretrieve.errors import PcretrieveError, ShapeError

if TYPE_CHECKING:
    from pcretrieve.query import Described, Question
    from pcretrieve.values import Failure

    Outcomes = Iterator[tuple[str, pr.Answer | ShapeError]]

CSV_COLUMNS = ("query", "rank", "id", "label", "distance", "score", "path")

COLUMNS = (
    *(out.Column(heading, "number") for heading in ("RANK", "DISTANCE", "SCORE")),
    *(out.Column("CLASS"), out.Column("ID"), out.Column("FILE", "path")),
)
# Of a result whose signature is doubtful or unusable; `show` and --json give the reasons.
DOUBT = out.Column("VERDICT")


@opt.command("query")
@click.argument(
    "queries", nargs=-1, required=True, metavar="SCAN|FOLDER|ID...", shell_complete=opt.complete_queries
)
@opt.catalogue_option
@opt.option("-k N", "Number of results.", opt.COUNT, into="k", default=10)
@opt.option(
    "--filter",
    "Search this class only; several times: these classes.",
    opt.LabelFilter(),
    into="labels",
    multiple=True,
    shell_complete=opt.complete_labels,
)
@opt.option("--exclude-self", "Leave stored queries out of their results.")
@opt.option(
    "--min-score SHARE", 'Hide results below this score; "no match" if none is left.', click.FloatRange(0, 1)
)
@opt.matrix_option
@opt.comparison_options
@opt.unit_option
@opt.limit_options
@opt.json_option
@opt.option("--csv", "Print one table of all results, as CSV.", into="as_csv")
@opt.option("--html PAGE", "Write an HTML page of all queries too, with pictures.", opt.PATH, into="page")
@opt.up_option
def query_command(
    queries: tuple[str, ...],
    catalogue: str,
    k: int,
    labels: tuple[str, ...],
    exclude_self: bool,
    min_score: float | None,
    matrix: Path | None,
    unit: str | None,
    timeout: float,
    memory: float | None,
    as_json: bool,
    as_csv: bool,
    page: Path | None,
    up: str | None,
    **comparison: Any,
) -> None:
    """Find the shapes most similar to a scan, nearest first.

    A query is a scan, a folder of scans, or the id of a stored shape. The score tells how often two shapes so
    near are of one class. The last line is the verdict: the class that the results vote for, the margin, and
    which ranks could swap within the error bar of the scan.

    \b
    pcretrieve query --catalogue bodies.sqlite scan.ply -k 5
    pcretrieve query --catalogue bodies.sqlite cat0 dog1 --filter label=cat
    pcretrieve query --catalogue bodies.sqlite new_scan.ply --html page.html
    """
    from pcretrieve.query import Question, answers

    if as_json and as_csv:
        raise click.UsageError("choose one of --json and --csv")
    if page is not None:
        _check_page(page, (*queries, catalogue))
    distances = opt.read_distances(matrix, comparison)
    failures: list[ShapeError] = []
    with opt.opened(catalogue, comparison) as (store, options):
        question = Question(options, k, labels or None, exclude_self, min_score, unit, distances)
        describe = partial(_described, timeout, memory, page is not None, up)
        found = answers(store, queries, question, describe)
        if page is not None:
            found = _written(page, store, list(found), question, up)
        is_alone = len(queries) == 1 and not Path(queries[0]).is_dir()
        outcomes = _with_messages(found, failures, is_alone=is_alone)
        if as_json:
            out.write_documents(_documents(outcomes, store, question), options=options)
        elif as_csv:
            _write_csv(outcomes)
        else:
            _write_tables(outcomes, headed=not is_alone)
            _say_how(store, question)
    opt.exit_if(failures)


def _check_page(page: Path, names: Sequence[str]) -> None:
    from pcretrieve.formats import check_output

    check_output(page, [Path(name) for name in names])


def _written(
    page: Path,
    store: pr.Catalogue,
    known: list[tuple[str, pr.Answer | ShapeError]],
    question: Question,
    up: str | None,
) -> Outcomes:
    """The answers, after they were written on a page, before the first is printed."""
    from pcretrieve.ingestion.discover import printable
    from pcretrieve.pages import write_query_page

    written = write_query_page(page, store, known, question, up=up)
    say(f"page: {shown_path(printable(written))}", indent=None)
    return iter(known)


def _with_messages(outcomes: Outcomes, failures: list[ShapeError], *, is_alone: bool) -> Outcomes:
    """The outcomes of the queries; failures are printed and collected, that of a query alone is raised."""
    for name, outcome in outcomes:
        if isinstance(outcome, ShapeError):
            if is_alone:
                raise outcome
            failures.append(outcome)
            say(f"failed: {outcome}")
        yield name, outcome


def _documents(outcomes: Outcomes, store: pr.Catalogue, question: Question) -> Iterator[dict[str, Any]]:
    """The outcome of each query, for JSON; with a matrix, there is no distance and no whitening."""
    from pcretrieve.query import result_rows

    how: dict[str, str | None] = {"distance": None, "whitening": None}
    if question.matrix is None:
        reason = store.whitening(question.options).reason
        how = {"distance": question.options.retrieval.distance, "whitening": reason}
    for name, outcome in outcomes:
        if isinstance(outcome, ShapeError):
            error = {"error": type(outcome).__name__, "stage": outcome.stage, "message": outcome.message}
            yield {"query": name} | error
        else:
            vote = None if outcome.vote is None else asdict(outcome.vote)
            found = {"results": result_rows(outcome), "vote": vote, "verdict": str(outcome)}
            yield {"query": name} | found | how


def _write_tables(outcomes: Outcomes, *, headed: bool) -> None:
    """A table of the results, below a line with the query if there are several, and the verdict."""
    from pcretrieve.query import result_rows

    for name, answer in outcomes:
        if isinstance(answer, ShapeError):
            continue
        if headed:
            out.write_line(shown_path(name))
        columns = COLUMNS + ((DOUBT,) if any(record.is_doubtful for record in answer.records) else ())
        rows = (
            (
                str(row["rank"]),
                f"{row['distance']:#.4g}",
                "-" if row["score"] is None else f"{row['score']:.2f}",
                row["label"] or "-",
                row["id"],
                shown_path(row["path"]),
                # Without its reasons, which are longer than the other columns together.
                f"{record.verdict.judgement}, ± {record.verdict.uncertainty:.2g}"
                if record.verdict and record.is_doubtful
                else "",
            )
            for row, record in zip(result_rows(answer), answer.records, strict=True)
        )
        out.write_table(columns, (cells[: len(columns)] for cells in rows))
        out.write_words(str(answer))


def _say_how(store: pr.Catalogue, question: Question) -> None:
    """Say how shapes were compared, unless by a matrix."""
    if question.matrix is not None:
        return
    index = store.index(question.options)
    how = "all shapes of the classes compared" if question.labels else index.search
    say(f"nearest: {how}")
    say(f"whitening: {store.whitening(question.options).reason}")
    say(f"score: {index.scores.reason if index.scores else 'none, because labels and shapes are too few'}")


def _write_csv(outcomes: Outcomes) -> None:
    """One row for each result of each query."""
    from pcretrieve.query import result_rows
    from pcretrieve.values.files import csv_text

    rows = (
        {"query": name, **row}
        for name, answer in outcomes
        if not isinstance(answer, ShapeError)
        for row in result_rows(answer)
    )
    out.write_csv(csv_text(CSV_COLUMNS, ([row[column] for column in CSV_COLUMNS] for row in rows)))


def _described(
    timeout: float,
    memory: float | None,
    with_pictures: bool,
    up: str | None,
    scans: Sequence[Path],
    options: pr.PipelineOptions,
) -> Iterator[tuple[Path, Described | PcretrieveError]]:
    """The signatures of scans, each computed in a worker process."""
    # Imported here, because it is not needed for shapes that the catalogue has.
    from pcretrieve.ingestion import in_processes
    from pcretrieve.ingestion.discover import printable

    isolated = partial(_isolated, options, with_pictures, up)
    for scan, outcome in in_processes(isolated, scans, workers=1, timeout=timeout, memory=memory):
        if not isinstance(outcome, PcretrieveError) and outcome.verdict and not outcome.verdict.is_sound:
            say(f"{shown_path(printable(scan))} is {outcome.verdict}")
        yield scan, outcome


def _isolated(options: pr.PipelineOptions, with_picture: bool, up: str | None, scan: Path) -> Described:
    """The signature of a scan and the verdict on it, in a worker process, which imports the stages."""
    from pcretrieve.query import described, pictured

    if with_picture:
        return pictured(scan, options, up)
    ((_, outcome),) = described([scan], options)
    if isinstance(outcome, PcretrieveError):
        raise outcome
    return outcome


@opt.command("matrix")
@opt.catalogue_option
@opt.option(
    "--output -o FILE", "Write the distances to this file: .npy, or plain text.", opt.PATH, required=True
)
@opt.option(
    "--matcher",
    "Compare pairs of surfaces, not signatures.",
    click.Choice(["heat-hausdorff", "hks-bow-gallery", "mds-cm-bof", "meshsift"]),
)
@opt.comparison_options
@opt.json_option
def matrix_command(
    catalogue: str, output: Path, matcher: str | None, as_json: bool, **comparison: Any
) -> None:
    """Write the distances of all pairs of shapes, as the SHREC (Shape Retrieval Contest) tracks ask for them.

    The value in row i and column j is the distance from the query i to the shape j. The ids of the rows are
    written beside it, to a file of the same name that ends in .ids. Shapes that the matcher cannot compare
    are named and left out.

    \b
    pcretrieve matrix --catalogue bodies.sqlite -o bodies.txt
    pcretrieve evaluate --catalogue bodies.sqlite --matrix bodies.txt
    """
    if matcher is not None and (given := opt.given_flags(comparison)):
        raise click.UsageError(f"a matcher has no signatures: leave out {given}")
    if comparison["rerank"] is not None:
        raise click.UsageError("distances are not re-ranked: leave out --rerank, and give it to `evaluate`")
    failures: list[Failure] = []
    with opt.opened(catalogue, comparison) as (store, options):
        found = pr.matrix(store, options=options, matcher=matcher, on_failure=failures.append)
    pr.write_matrix(found, output)
    for failure in failures:
        say(failure_line(failure))
    ids = str(output.with_suffix(".ids"))
    say(f"{len(found)} shapes: distances in {output}, ids in {ids}")
    if as_json:
        failed = [{"id": one.shape_id} | failure_document(one) for one in failures]
        files = {"matrix": str(output), "ids": ids}
        out.write_document(files | {"n_shapes": len(found), "failed": failed}, options=options)
    opt.exit_if(failures)


@opt.command("duplicates")
@opt.catalogue_option
@opt.option(
    "--threshold DISTANCE",
    "Find pairs up to this distance.  [default: the error bars of both]",
    click.FloatRange(min=0),
)
@opt.comparison_options
@opt.json_option
def duplicates_command(catalogue: str, threshold: float | None, as_json: bool, **comparison: Any) -> None:
    """Find shapes that look the same, such as two scans of one body in one pose.

    The table has the distance, its limit and both ids, nearest first. Without --threshold, distances are
    those of log-signatures without whitening, and doubtful shapes are left out.

    \b
    pcretrieve duplicates --catalogue bodies.sqlite
    """
    with opt.opened(catalogue, comparison) as (store, options):
        pairs = pr.duplicates(store, options=options, threshold=threshold)
    if as_json:
        out.write_document([pair._asdict() for pair in pairs], options=options)
        return
    out.write_table(
        (
            out.Column("DISTANCE", "number"),
            out.Column("LIMIT", "number"),
            out.Column("FIRST"),
            out.Column("SECOND"),
        ),
        ((f"{one.distance:#.4g}", f"{one.limit:#.4g}", one.first, one.second) for one in pairs),
    )
    say(f"{len(pairs)} {'pair' if len(pairs) == 1 else 'pairs'}")


@opt.command("cluster")
@opt.catalogue_option
@opt.option("--min-size N", "Least number of shapes of a cluster.", click.IntRange(min=2), default=3)
@opt.option(
    "--output -o CSV", "Write this file.  [default: standard output; a terminal shows a table]", opt.PATH
)
@opt.comparison_options
@opt.json_option
def cluster_command(
    catalogue: str, min_size: int, output: Path | None, as_json: bool, **comparison: Any
) -> None:
    """Group similar shapes, without using their classes.

    The method is HDBSCAN. The table has the columns id and label; a shape in no cluster has no label.

    \b
    pcretrieve cluster --catalogue bodies.sqlite -o clusters.csv
    """
    from pcretrieve.values.files import csv_text, write_file

    with opt.opened(catalogue, comparison) as (store, options):
        labels = pr.cluster(store, options=options, min_size=min_size)
    text = csv_text(("id", "label"), labels.items())
    if output is not None:
        write_file(output, text.encode())
    if as_json:
        document = [{"id": shape_id, "label": label} for shape_id, label in labels.items()]
        out.write_document(document, options=options)
    elif output is None and sys.stdout.isatty():
        out.write_table(
            (out.Column("ID"), out.Column("CLUSTER")),
            ((name, label or "-") for name, label in labels.items()),
        )
    elif output is None:
        out.write_csv(text)
    n_none = sum(label is None for label in labels.values())
    say(f"{len({*labels.values()} - {None})} clusters of {len(labels)} shapes, {n_none} of them in none")


@opt.command("map")
@opt.catalogue_option
@opt.option("--output -o PNG|HTML", "Write this picture or this page.", opt.PATH, required=True)
@opt.up_option
@opt.comparison_options
@opt.json_option
def map_command(catalogue: str, output: Path, up: str | None, as_json: bool, **comparison: Any) -> None:
    """Plot a 2-D map of shapes: similar ones lie near each other.

    A page (.html) shows name and thumbnail of the shape under the pointer. A picture (.png) needs matplotlib.

    \b
    pcretrieve map --catalogue bodies.sqlite -o bodies.html
    """
    with opt.opened(catalogue, comparison) as (store, options):
        page = pr.draw_map(store, output, options=options, up=up)
    if as_json:
        out.write_document({"page": str(page)}, options=options)
    else:
        out.write_line(shown_path(str(page)))
