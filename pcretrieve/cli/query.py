"""The command that searches a catalogue: query."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pcretrieve.cli.commands import command, option
from pcretrieve.cli.comparison import compared, comparison_options, matrix_option, read_distances
from pcretrieve.cli.completion import complete_labels, complete_queries
from pcretrieve.cli.documents import write_documents
from pcretrieve.cli.messages import say, shown_path, write_csv, write_line, write_words
from pcretrieve.cli.parts import (
    EXIT_SOME_FAILED,
    catalogue_option,
    json_option,
    limit_options,
    unit_option,
    up_option,
)
from pcretrieve.cli.tables import Column, write_table

if TYPE_CHECKING:
    from pcretrieve.errors import PcretrieveError, ShapeError
    from pcretrieve.options import PipelineOptions
    from pcretrieve.query import Answer, Described
    from pcretrieve.values import Verdict

__all__ = ["query_command"]

CSV_COLUMNS = ("query", "rank", "id", "label", "distance", "score", "path")

COLUMNS = (
    *(Column(heading, "number") for heading in ("RANK", "DISTANCE", "SCORE")),
    *(Column("CLASS"), Column("ID"), Column("FILE", "path")),
)
# Of a result whose signature is doubtful or unusable; `show` and --json give the reasons.
DOUBT = Column("VERDICT")

Row = dict[str, Any]
Outcomes = Iterator[tuple[str, "Answer | ShapeError"]]


class LabelFilter(click.ParamType):  # type: ignore[type-arg]  # generic since click 8.3 only
    """A condition ``label=CLASS`` on the shapes that are searched."""

    name = "label=CLASS"

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """The class of a condition."""
        key, mark, label = value.partition("=")
        if key != "label" or not mark:
            self.fail(f"must be label=CLASS, got {value!r}", param, ctx)
        return label


@command("query")
@click.argument(
    "queries", nargs=-1, required=True, metavar="SCAN|FOLDER|ID...", shell_complete=complete_queries
)
@catalogue_option
@click.option(
    "-k",
    "k",
    type=click.IntRange(min=1),
    default=10,
    show_default=True,
    metavar="N",
    help="Number of results.",
)
@click.option(
    "--filter",
    "labels",
    type=LabelFilter(),
    multiple=True,
    shell_complete=complete_labels,
    help="Search this class only; several times: these classes.",
)
@click.option("--exclude-self", is_flag=True, help="Leave stored queries out of their results.")
@click.option(
    "--min-score",
    type=click.FloatRange(0, 1),
    metavar="SHARE",
    help='Least score of a result; "no match" if none has it.',
)
@option(
    "--nearest",
    type=click.Choice(["auto", "scan", "tree", "faiss"]),
    rare=True,
    help="How the nearest shapes are found, always exactly: by lower bounds of the distances to blocks of "
    "shapes (scan), by a ball tree (tree), or by faiss (an extra).  [default: auto, or the catalogue's]",
    details="tree and faiss are for --distance log and d2. auto is scan, the fastest for large catalogues.",
)
@matrix_option
@comparison_options
@unit_option
@limit_options("scan")
@json_option
@click.option("--csv", "as_csv", is_flag=True, help="Print one table of all results, as CSV.")
@click.option(
    "--html",
    "page",
    type=click.Path(path_type=Path),
    metavar="PAGE",
    help="Also write an HTML page of all queries, with pictures.",
)
@up_option
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
    """Find the shapes most similar to scans, or to shapes of the catalogue, nearest first.

    A folder stands for all scans in it; what is neither a file nor a folder is the id of a shape. The score
    is the share of pairs of one class among all pairs of the catalogue that are as near. The last line is a
    verdict: the class that the results vote for, its margin, and which ranks could swap within the error bar
    of the query.

    \b
    pcretrieve query --catalogue bodies.sqlite scan.ply -k 5
    pcretrieve query --catalogue bodies.sqlite cat0 dog1 --filter label=cat
    pcretrieve query --catalogue bodies.sqlite new_scan.ply --html page.html
    """
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.query import Question, answers

    if as_json and as_csv:
        raise click.UsageError("choose one of --json and --csv")
    if page is not None:
        from pcretrieve.formats import check_output
        from pcretrieve.ingestion.discover import printable
        from pcretrieve.pages.query_page import write_query_page

        check_output(page, [Path(name) for name in (*queries, catalogue)])
    distances = read_distances(matrix, comparison)
    failures: list[ShapeError] = []
    with Catalogue(catalogue) as store:
        options = compared(store, **comparison)
        question = Question(options, k, labels or None, exclude_self, min_score, unit, distances)
        found = answers(store, queries, question, partial(_described, timeout, memory, page is not None, up))
        if page is not None:
            known = list(found)  # of all queries, before the first is printed
            written = write_query_page(
                page,
                store,
                known,
                options=options,
                matrix=distances,
                labels=labels,
                min_score=min_score,
                up=up,
            )
            say(f"page: {shown_path(printable(written))}", indent=None)
            found = iter(known)
        is_alone = len(queries) == 1 and not Path(queries[0]).is_dir()
        outcomes = _with_messages(found, failures, is_alone=is_alone)
        if as_json:
            distance = whitening = None
            if distances is None:
                distance, whitening = options.retrieval.distance, store.whitening(options).reason
            write_documents(
                (_document(name, outcome, distance, whitening) for name, outcome in outcomes),
                options=options,
            )
        elif as_csv:
            _print_csv(outcomes)
        else:
            _print_lines(outcomes, headed=not is_alone)
            if distances is None:
                index = store.index(options)
                scores = index.scores
                how = "all shapes of the classes compared" if labels else str(index.contents.filter)
                say(f"nearest: {how}")
                say(f"whitening: {store.whitening(options).reason}")
                say(f"score: {scores.reason if scores else 'none, because labels and shapes are too few'}")
    if failures:
        click.get_current_context().exit(EXIT_SOME_FAILED)


def _with_messages(outcomes: Outcomes, failures: list[ShapeError], *, is_alone: bool) -> Outcomes:
    """The outcomes of the queries; failures are printed and collected, that of a query alone is raised."""
    from pcretrieve.errors import ShapeError

    for name, outcome in outcomes:
        if isinstance(outcome, ShapeError):
            if is_alone:
                raise outcome
            failures.append(outcome)
            say(f"failed: {outcome}")
        yield name, outcome


def _document(name: str, outcome: Answer | ShapeError, distance: str | None, whitening: str | None) -> Row:
    """The outcome of one query, for JSON; with a matrix, there is no distance and no whitening."""
    from pcretrieve.query import Answer, result_rows

    if isinstance(outcome, Answer):
        vote = None if outcome.vote is None else asdict(outcome.vote)
        how = {"distance": distance, "whitening": whitening}
        return {"query": name, "results": result_rows(outcome), "vote": vote, "verdict": str(outcome)} | how
    error = {"error": type(outcome).__name__, "stage": outcome.stage, "message": outcome.message}
    return {"query": name, **error}


def _print_lines(outcomes: Outcomes, *, headed: bool) -> None:
    """A table of the results, below a line with the query if there are several, and the verdict."""
    from pcretrieve.query import Answer, result_rows

    for name, answer in outcomes:
        if not isinstance(answer, Answer):
            continue
        if headed:
            write_line(shown_path(name))
        columns = COLUMNS + ((DOUBT,) if any(record.is_doubtful for record in answer.records) else ())
        rows = (
            (
                str(row["rank"]),
                f"{row['distance']:#.4g}",
                "-" if row["score"] is None else f"{row['score']:.2f}",
                row["label"] or "-",
                row["id"],
                shown_path(row["path"]),
                _judged(record.verdict) if record.verdict and record.is_doubtful else "",
            )
            for row, record in zip(result_rows(answer), answer.records, strict=True)
        )
        write_table(columns, (cells[: len(columns)] for cells in rows))
        write_words(str(answer))


def _judged(verdict: Verdict) -> str:
    """A verdict without its reasons, which are longer than the other columns together."""
    return f"{verdict.judgement}, ± {verdict.uncertainty:.2g}"


def _print_csv(outcomes: Outcomes) -> None:
    """One row for each result of each query."""
    from pcretrieve.query import Answer, result_rows
    from pcretrieve.values.files import csv_text

    rows = (
        {"query": name, **row}
        for name, answer in outcomes
        if isinstance(answer, Answer)
        for row in result_rows(answer)
    )
    write_csv(csv_text(CSV_COLUMNS, ([row[column] for column in CSV_COLUMNS] for row in rows)))


def _described(
    timeout: float,
    memory: float | None,
    with_pictures: bool,
    up: str | None,
    scans: Sequence[Path],
    options: PipelineOptions,
) -> Iterator[tuple[Path, Described | PcretrieveError]]:
    """The signatures of scans, each computed in a worker process."""
    # Imported here, because it is not needed for shapes that the catalogue has.
    from pcretrieve.errors import PcretrieveError
    from pcretrieve.ingestion.discover import printable
    from pcretrieve.ingestion.isolation import Isolation

    isolated = partial(_isolated, options, with_pictures, up)
    for scan, outcome in Isolation(timeout, memory).each(isolated, scans):
        if not isinstance(outcome, PcretrieveError) and outcome.verdict and not outcome.verdict.is_sound:
            say(f"{shown_path(printable(scan))} is {outcome.verdict}")
        yield scan, outcome


def _isolated(options: PipelineOptions, with_picture: bool, up: str | None, scan: Path) -> Described:
    """The signature of a scan and the verdict on it, in a worker process, which imports the stages."""
    from pcretrieve.pipeline.process import judged_signature
    from pcretrieve.query import Described, pictured

    if with_picture:
        return pictured(scan, options, up)
    return Described(*judged_signature(scan, options))
