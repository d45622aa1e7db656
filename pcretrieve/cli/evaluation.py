"""Commands that measure how well scans find each other: evaluate, compare, calibrate, report."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import fields
from functools import partial
from itertools import compress
from pathlib import Path
from typing import Any

import click

import pcretrieve as pr
from pcretrieve.cli import options as opt, output as out
from pcretrieve.cli.messages import say, shown_path

# The columns of rows of measures, and of what they are the measures of.
COLUMNS = dict.fromkeys(("NN", "FT", "ST", "E", "DCG", "mAP"), "number")
MEASURES = tuple(name.lower() for name in COLUMNS)
COLUMNS |= {"": "words"}
FALSE_MATCH_RATES = (0.01, 0.001)
RARE = ("ST", "E")  # of papers, not needed to judge a collection


@opt.command("evaluate")
@opt.option(
    "--catalogue -c FILE|URL",
    f"The catalogue; not with --matrix and --labels.  [env var: {opt.CATALOGUE_VARIABLE}]",
    opt.CATALOGUE,
)
@opt.labels_option
@opt.matrix_option
@opt.option("--good-only", "Ask for good scans only; the others stay in the gallery.")
@opt.option(
    "--per-class", "Add the means of each class, and which classes are confused with it."
)
@opt.option(
    "--csv FOLDER",
    "Write queries.csv, classes.csv, confusion.csv, precision_recall.csv and det.csv to a folder.",
    opt.PATH,
    into="folder",
)
@opt.verbose_option
@opt.comparison_options
def evaluate_command(
    catalogue: str | None,
    labels: str | None,
    per_class: bool,
    folder: Path | None,
    is_verbose: bool,
    **values: Any,
) -> out.Result:
    """Measure how well scans of one class find each other.

    Each shape is a query in all others; shapes that failed count as misses. The measures are nearest
    neighbour (NN), first tier (FT), discounted cumulative gain (DCG) and mean average precision (mAP), with
    --verbose also second tier (ST) and E-measure (E): means over the queries, with 95 % confidence intervals,
    and over the classes. Labels do not help the ranking.

    \b
    pcretrieve evaluate --catalogue bodies.sqlite --per-class --csv bodies/
    pcretrieve evaluate --catalogue shrec11.sqlite --labels shrec11
    pcretrieve evaluate --matrix run1.txt --labels shrec11.cla
    """
    file, rerank, good_only = values["matrix"], values["rerank"], values["good_only"]
    matrix = opt.read_distances(
        values, *(name for name in opt.COMPARISON if name != "rerank")
    )
    options = None
    if catalogue is None and (matrix is None or labels is None):
        catalogue = os.environ.get(opt.CATALOGUE_VARIABLE) or None
    if catalogue is not None:
        store = opt.opened(catalogue)
        options = opt.compared(store, values)
        found = pr.evaluate(
            store, options=options, labels=labels, matrix=matrix, good_only=good_only
        )
    elif matrix is None or labels is None:
        raise click.UsageError("give --catalogue, or both --matrix and --labels")
    elif good_only:
        raise click.UsageError("--good-only needs --catalogue, which has the grades")
    else:
        found = pr.evaluate(matrix, options=opt.changes(values), labels=labels)
    how = _how(found, options, file, rerank)
    if rates := found.verification:
        how["equal_error_rate"] = rates.equal_error
        how["missed_at"] = {str(rate): rates.missed(rate) for rate in FALSE_MATCH_RATES}
    if folder is not None:
        found.write(folder)
        say(f"queries, classes, confusion, precision_recall, det: .csv files in {folder}")
    show = partial(_write_evaluation, found, how, per_class, is_verbose)
    return out.Result(_evaluation_document(found, how, per_class), options, show)


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
    macro = found.macro
    document: dict[str, object] = {
        part.name: getattr(found, part.name) for part in fields(pr.RetrievalMeasures)
    }
    document |= {"n_shapes": found.ranked.rankings.n_gallery} | how
    document["interval"] = {
        "level": found.level,
        "low": _named(low),
        "high": _named(high),
    }
    document["macro"] = {name: getattr(macro, name) for name in MEASURES}
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
    found: pr.Evaluation, how: dict[str, Any], per_class: bool, is_verbose: bool
) -> None:
    columns = {
        name: kind for name, kind in COLUMNS.items() if is_verbose or name not in RARE
    }
    kept = [name in columns for name in COLUMNS]
    rows = _rows(found, str(how["rerank"]), per_class)
    out.write_table(columns, (tuple(compress(row, kept)) for row in rows))
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


def _numbers(values: Iterable[float], form: str = ".4f") -> list[str]:
    """The measures of a row below `COLUMNS`."""
    return [format(value, form) for value in values]


@opt.command("calibrate")
@opt.catalogue_option
@opt.option(
    "--output -o FILE", "Write this file, such as metric.npz.", opt.PATH, required=True
)
@opt.on_catalogue
def calibrate_command(
    store: pr.Catalogue, options: pr.PipelineOptions, output: Path
) -> out.Result:
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
    learnt = pr.calibrate(store, output, options=options)
    kind, reason = "config", "atoms of dl-supervised"
    if isinstance(learnt, pr.Whitening):
        kind, reason = "whitening", learnt.reason
    say(f"{output}: {reason}; use it by --{kind}")
    return out.Result({kind: str(output), "reason": reason}, options)


@opt.command("report")
@opt.catalogue_option
@opt.option("--output -o PAGE", "Write this HTML page.", opt.PATH, required=True)
@opt.option(
    "--queries N",
    "Show at most N queries, the worst first.",
    opt.COUNT,
    into="n_queries",
    default=1000,
)
@opt.option("-k N", "Number of results of each query.", opt.COUNT, into="k", default=5)
@opt.option(
    "--versus RESULT",
    "Compare with another result, query by query: queries.csv of `evaluate --csv`, or a catalogue.",
    opt.CATALOGUE,
)
@opt.up_option
@opt.matrix_option
@opt.on_catalogue
def report_command(
    store: pr.Catalogue, options: pr.PipelineOptions, output: Path, **shown: Any
) -> out.Result:
    """Write an HTML page of all queries with their results and measures, the worst first.

    The page has bars of the classes, mix-ups, a map, and the scans that failed. You can search and sort it
    without a server.

    \b
    pcretrieve report --catalogue bodies.sqlite -o bodies.html
    pcretrieve evaluate --catalogue bodies.sqlite --whitening none --csv none/
    pcretrieve report -c bodies.sqlite --versus none/queries.csv -o bodies.html
    """
    page = pr.report(store, output, options=options, **shown)
    return out.Result(
        {"page": page}, options, lambda: out.write_lines(shown_path(str(page)))
    )
