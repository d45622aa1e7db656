"""Commands that measure how well scans find each other: evaluate, compare, calibrate, report."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import asdict, fields, replace
from functools import partial
from itertools import compress
from pathlib import Path
from typing import Any

import click

import pcretrieve as pr
from pcretrieve.cli.messages import say, shown_path
from pcretrieve.cli.options import (
    CATALOGUE,
    CATALOGUE_VARIABLE,
    COUNT,
    Axis,
    Comparison,
    catalogue_option,
    command,
    matrix_option,
    option,
    read_distances,
    up_option,
    verbose_option,
)
from pcretrieve.cli.output import (
    Result,
    write_lines,
    write_table,
)

# The columns of rows of measures, and of what they are the measures of.
COLUMNS = dict.fromkeys(("NN", "FT", "ST", "E", "DCG", "mAP"), "number")
MEASURES = tuple(name.lower() for name in COLUMNS)
METHODS = {"METHOD": "text"} | COLUMNS | {"95 % INTERVAL OF mAP": "text"}
COLUMNS |= {"": "words"}
CURVE = dict.fromkeys(("CLASSES", "RANK-1", "RANK-5"), "number")
CURVE |= {"95 % INTERVAL": "text", " ": "words"}
FALSE_MATCH_RATES = (0.01, 0.001)
RARE = ("ST", "E")  # of papers, not needed to judge a collection


@command("evaluate")
def evaluate_command(
    *,
    catalogue: str | None = option(
        "--catalogue -c FILE|URL",
        f"The catalogue; not with --matrix and --labels.  [env var: {CATALOGUE_VARIABLE}]",
        CATALOGUE,
    ),
    labels: str | None = option(
        "--labels CSV|LAYOUT",
        "Use these classes, not the stored ones; see `ingest --help`.",
    ),
    file: Path | None = matrix_option,
    good_only: bool = option(
        "--good-only", "Ask for good scans only; the others stay in the gallery."
    ),
    per_class: bool = option(
        "--per-class",
        "Add the means of each class, and which classes are confused with it.",
    ),
    curve: bool = option(
        "--curve",
        "Add how often the right class is found, by the number of classes; with --csv as a picture too.",
    ),
    folder: Path | None = option(
        "--csv FOLDER",
        "Write queries, classes, confusion, precision_recall, det and curve as .csv files to a folder.",
    ),
    is_verbose: bool = verbose_option,
    comparison: Comparison,
) -> Result:
    """Measure how well scans of one class find each other.

    Each shape is a query in all others; shapes that failed count as misses. The measures are nearest
    neighbour (NN), first tier (FT), discounted cumulative gain (DCG) and mean average precision (mAP), with
    --verbose also second tier (ST) and E-measure (E): means over the queries, with 95 % confidence intervals,
    and over the classes. Labels do not help the ranking.

    With --method given several times, print one table, with a row for each method and the interval of mAP.

    \b
    pcretrieve evaluate --catalogue bodies.sqlite --method hapt --method r-bihdm
    pcretrieve evaluate --catalogue bodies.sqlite --curve --csv bodies/
    pcretrieve evaluate --catalogue shrec11.sqlite --labels shrec11
    pcretrieve evaluate --matrix run1.txt --labels shrec11.cla
    """
    matrix = read_distances(file, used="rerank")
    options = None
    methods = (comparison.method or "").split(",")
    if catalogue is None and (matrix is None or labels is None):
        catalogue = os.environ.get(CATALOGUE_VARIABLE) or None
    if catalogue is not None and methods[1:]:
        store, options = replace(comparison, method=None).opened(catalogue)
        return _table(
            pr.evaluate_methods(
                store, methods, labels, options=options, good_only=good_only
            ),
            options,
            folder,
        )
    if catalogue is not None:
        store, options = comparison.opened(catalogue)
        found = pr.evaluate(
            store, options=options, labels=labels, matrix=matrix, good_only=good_only
        )
    elif matrix is None or labels is None:
        raise click.UsageError("give --catalogue, or both --matrix and --labels")
    elif good_only:
        raise click.UsageError("--good-only needs --catalogue, which has the grades")
    else:
        found = pr.evaluate(matrix, options=comparison.options(), labels=labels)
    how = _how(found, options, file, comparison.rerank)
    if rates := found.verification:
        how["equal_error_rate"] = rates.equal_error
        how["missed_at"] = {str(rate): rates.missed(rate) for rate in FALSE_MATCH_RATES}
    if folder is not None:
        paths = found.write(folder)
        say(f"{', '.join(path.stem for path in paths)}: .csv files in {folder}")
        if curve:
            found.draw_curve(folder / "curve.png")
            say(f"the curve: {folder / 'curve.png'}")
    document = _evaluation_document(found, how, per_class)
    points = list(map(asdict, found.curve)) if curve else []
    if curve:
        document["curve"] = [
            {name: None if value != value else value for name, value in point.items()}
            for point in points
        ]
    show = partial(_write_evaluation, found, how, per_class, points, is_verbose)
    return Result(document, options, show)


def _table(
    found: pr.Evaluations, options: pr.PipelineOptions, folder: Path | None
) -> Result:
    """A row for each method."""
    documents, rows = [], []
    for name, one in found.items():
        documents.append(_evaluation_document(one, {"method": name}, per_class=False))
        numbers = _numbers(getattr(one, measure) for measure in MEASURES)
        rows.append((name, *numbers, " to ".join(_numbers(one.interval[:, -1]))))
    if folder is not None:
        found.write(folder)
        say(f"methods.csv, and the files of each method, in {folder}")
    return Result(documents, options, lambda: write_table(METHODS, rows))


def _how(
    found: pr.Evaluation,
    options: pr.PipelineOptions | None,
    matrix: Path | None,
    rerank: str | None,
) -> dict[str, Any]:
    """How shapes were ranked."""
    if options is None or found.ranked.table is None:
        rerank = rerank or "none" if options is None else options.retrieval.rerank
        return {"matrix": str(matrix), "rerank": rerank}
    return {
        "method": found.ranked.table.kind,
        "n_values": found.ranked.table.values.shape[1],
        "scale": options.signature.scale,
        "size_weight": options.signature.size_weight,
        "distance": options.retrieval.distance,
        "whitening": options.retrieval.whitening,
        "whitening_used": found.ranked.whitening,
        "rerank": options.retrieval.rerank,
    }


def _evaluation_document(
    found: pr.Evaluation, how: dict[str, Any], per_class: bool
) -> dict[str, object]:
    """The JSON document of an evaluation."""
    low, high = found.interval.tolist()
    document: dict[str, object] = {
        part.name: getattr(found, part.name) for part in fields(pr.RetrievalMeasures)
    }
    document |= {"n_shapes": found.ranked.rankings.n_gallery} | how
    document["interval"] = {
        "level": found.level,
        "low": _named(low),
        "high": _named(high),
    }
    document["macro"] = _named(getattr(found.macro, name) for name in MEASURES)
    if per_class:
        document["classes"] = [
            {"label": one.label, "n_queries": one.n_queries}
            | _named(one.means.tolist())
            | {
                "confused": [
                    {"label": label, "n_queries": n} for label, n in one.confused
                ]
            }
            for one in found.classes
        ]
    return document


def _named(values: Iterable[float]) -> dict[str, float]:
    return dict(zip(MEASURES, values, strict=True))


def _rows(found: pr.Evaluation, rerank: str, per_class: bool) -> list[tuple[str, ...]]:
    """The rows of the table of an evaluation."""
    low, high = found.interval
    means = [(found, "micro-average"), (found.macro, "macro-average")]
    if rerank != "none":
        means[:1] = [
            (found.plain, "micro-average, plain"),
            (found, f"micro-average, {rerank}"),
        ]
    rows = [
        (*_numbers(getattr(one, name) for name in MEASURES), words)
        for one, words in means
    ]
    rows[-1:-1] = [
        (*_numbers(low), f"  {found.level:.0%} interval from"),
        (*_numbers(high), "  to"),
    ]
    for one in found.classes if per_class else ():
        others = ", ".join(f"{label or 'no class'} {n}" for label, n in one.confused)
        nearest = f"; nearest {others}" if others else ""
        rows.append(
            (*_numbers(one.means), f"{one.label}, {one.n_queries} queries{nearest}")
        )
    return rows


def _write_evaluation(
    found: pr.Evaluation,
    how: dict[str, Any],
    per_class: bool,
    points: list[dict[str, Any]],
    is_verbose: bool,
) -> None:
    columns = {
        name: kind for name, kind in COLUMNS.items() if is_verbose or name not in RARE
    }
    kept = [name in columns for name in COLUMNS]
    rows = _rows(found, str(how["rerank"]), per_class)
    write_table(columns, (tuple(compress(row, kept)) for row in rows))
    rankings, whitening = found.ranked.rankings, found.ranked.whitening
    by = f"scale {how['scale']}" if "scale" in how else f"distances of {how['matrix']}"
    if how.get("size_weight"):
        by += f", size weight {how['size_weight']:g}"
    n_asked, n_left_out = len(rankings.ids), found.ranked.n_left_out
    asked = f"{n_asked} of {n_asked + n_left_out}" if n_left_out else f"{n_asked}"
    say(
        f"{asked} queries in {rankings.n_gallery} shapes, {found.n_failed} failed shapes "
        f"count as misses; {by}"
    )
    if "missed_at" in how:
        missed = ", ".join(
            f"{share:.2%} at {rate}" for rate, share in how["missed_at"].items()
        )
        say(
            f"pairs: equal error rate {how['equal_error_rate']:.2%}; missed at a false-match rate: {missed}"
        )
    if whitening and is_verbose:
        say(f"whitening: {whitening}")
    if points:
        write_lines("")
        write_table(CURVE, map(_curve_row, points))


def _curve_row(point: dict[str, Any]) -> tuple[str, ...]:
    """A row below `CURVE`."""
    n, *rates, is_fitted = point.values()
    rank_1, rank_5, low, high = _numbers(rates)
    if is_fitted:
        return f"{n:,}", rank_1, "", "", "fitted"
    return f"{n:,}", rank_1, rank_5, f"{low} to {high}", ""


def _numbers(values: Iterable[float]) -> list[str]:
    """The measures of a row below `COLUMNS`."""
    return [f"{value:.4f}" for value in values]


@command("calibrate")
def calibrate_command(
    *,
    catalogue: str = catalogue_option,
    output: Path = option(
        "--output -o FILE",
        "Write this file, such as metric.npz.",
    ),
    comparison: Comparison,
) -> Result:
    """Learn from labelled scans which differences to ignore.

    Scan some bodies several times, in the way you will scan later: three people in ten poses will do. Use the
    file as `--whitening FILE` of query, evaluate and report, in any catalogue built with the same settings.
    With --method dl-supervised, that descriptor learns from the labels: use the file as `--config FILE`.

    \b
    pcretrieve ingest three_people/ --labels people.csv --catalogue three.sqlite
    pcretrieve lab calibrate --catalogue three.sqlite -o metric.npz
    pcretrieve query --catalogue bodies.sqlite new_scan.ply --whitening metric.npz
    pcretrieve lab calibrate -c three.sqlite --method dl-supervised -o atoms.toml
    """
    store, options = comparison.opened(catalogue)
    learnt = pr.calibrate(store, output, options=options)
    kind, reason = "config", "atoms of dl-supervised"
    if isinstance(learnt, pr.Whitening):
        kind, reason = "whitening", learnt.reason
    say(f"{output}: {reason}; use it by --{kind}")
    return Result({kind: str(output), "reason": reason}, options)


@command("report")
def report_command(
    *,
    catalogue: str = catalogue_option,
    output: Path = option("--output -o PAGE", "Write this HTML page."),
    n_queries: int = option(
        "--queries N",
        "Show at most N queries, the worst first.",
        COUNT,
        default=1000,
    ),
    k: int = option("-k N", "Number of results of each query.", COUNT, default=5),
    versus: str | None = option(
        "--versus RESULT",
        "Compare with another result, query by query: queries.csv of `evaluate --csv`, or a catalogue.",
        CATALOGUE,
    ),
    up: Axis | None = up_option,
    file: Path | None = matrix_option,
    comparison: Comparison,
) -> Result:
    """Write an HTML page of all queries with their results and measures, the worst first.

    The page has bars of the classes, mix-ups, a map, and the scans that failed. You can search and sort it
    without a server.

    \b
    pcretrieve report --catalogue bodies.sqlite -o bodies.html
    pcretrieve evaluate --catalogue bodies.sqlite --whitening none --csv none/
    pcretrieve report -c bodies.sqlite --versus none/queries.csv -o bodies.html
    """
    matrix = read_distances(file)
    store, options = comparison.opened(catalogue)
    page = pr.report(
        store,
        output,
        options=options,
        n_queries=n_queries,
        k=k,
        matrix=matrix,
        versus=versus,
        up=up,
    )
    return Result({"page": page}, options, lambda: write_lines(shown_path(str(page))))
