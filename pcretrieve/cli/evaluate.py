"""The command that computes retrieval measures of a labelled catalogue or a distance matrix: evaluate."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pcretrieve.cli.commands import command, option
from pcretrieve.cli.comparison import compared, comparison_options, matrix_option, read_distances
from pcretrieve.cli.completion import CATALOGUE_VARIABLE
from pcretrieve.cli.documents import write_document
from pcretrieve.cli.messages import say
from pcretrieve.cli.parts import CATALOGUE, json_option, labels_option
from pcretrieve.cli.tables import Column, write_table

if TYPE_CHECKING:
    from pcretrieve.evaluation import RankedCatalogue
    from pcretrieve.options import RerankKind
    from pcretrieve.values import FloatArray

__all__ = ["COLUMNS", "evaluate_command", "numbers"]

#: The columns of rows of measures, and of what they are the measures of.
COLUMNS = (
    *(Column(name, "number") for name in ("NN", "FT", "ST", "E", "DCG", "mAP")),
    Column("", "words"),
)


@command("evaluate")
@click.option(
    "--catalogue",
    "-c",
    type=CATALOGUE,
    metavar="FILE|URL",
    help=f"The catalogue; not with --matrix and --labels.  [env var: {CATALOGUE_VARIABLE}]",
)
@labels_option
@matrix_option
@click.option("--sound-only", is_flag=True, help="Leave out shapes that are doubtful or unusable.")
@option(
    "--per-class",
    is_flag=True,
    help="Add the means of each class.",
    details="And of which other classes the nearest shapes of its queries are.",
)
@option(
    "--csv",
    "folder",
    type=click.Path(path_type=Path),
    metavar="FOLDER",
    help="Write the measures to CSV files in a folder.",
    details="They are queries.csv, classes.csv, confusion.csv (of the nearest shape) and "
    "precision_recall.csv.",
)
@comparison_options
@json_option
def evaluate_command(
    catalogue: str | None,
    labels: str | None,
    matrix: Path | None,
    sound_only: bool,
    per_class: bool,
    folder: Path | None,
    as_json: bool,
    **comparison: Any,
) -> None:
    """Compute retrieval measures of a labelled catalogue.

    Nearest neighbour (NN), first and second tier (FT, ST), E-measure (E), discounted cumulative gain (DCG)
    and mean average precision (mAP): means over the queries, with 95 % confidence intervals, and over the
    classes. Each shape is a query in all others; shapes that failed count as misses. Labels are not used for
    the whitening, or by cross-validation.

    \b
    pcretrieve evaluate --catalogue bodies.sqlite --per-class --csv bodies/
    pcretrieve evaluate --catalogue shrec11.sqlite --labels shrec11
    pcretrieve evaluate --matrix run1.txt --labels shrec11.cla
    """
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.evaluation import (
        LEVEL,
        MEASURES,
        PUBLISHED,
        bootstrap_interval,
        class_measures,
        evaluate_rankings,
        query_scores,
        rank_catalogue,
        rank_matrix,
        write_evaluation,
    )
    from pcretrieve.ingestion.layouts import LAYOUTS

    distances = read_distances(matrix, comparison, reranks=True)
    rerank: RerankKind = comparison["rerank"] or "none"
    how: dict[str, object] = {"matrix": str(matrix)}
    options = None
    if catalogue is None and (distances is None or labels is None):
        catalogue = os.environ.get(CATALOGUE_VARIABLE) or None
    if catalogue is None:
        if distances is None or labels is None:
            raise click.UsageError("give --catalogue, or both --matrix and --labels")
        if sound_only:
            raise click.UsageError("--sound-only needs --catalogue, which has the verdicts")
        ranked = rank_matrix(distances, labels, rerank=rerank)
    else:
        with Catalogue(catalogue) as store:
            options = compared(store, **comparison)
            ranked = rank_catalogue(store, options, labels=labels, matrix=distances, sound_only=sound_only)
        rerank = options.retrieval.rerank
        if ranked.table is not None:
            how = {
                "method": ranked.table.kind,
                "n_values": ranked.table.values.shape[1],
                "scale": options.compared.scale,
                "size_weight": options.signature.size_weight,
                "distance": options.retrieval.distance,
                "whitening": options.retrieval.whitening,
                "whitening_used": ranked.whitening,
            }
    how["rerank"] = rerank
    if folder is not None:
        write_evaluation(ranked.rankings, folder)
        say(f"queries, classes, confusion and precision_recall: .csv files in {folder}")
    measures = asdict(evaluate_rankings(ranked.rankings))
    macro = asdict(evaluate_rankings(ranked.rankings, average="macro"))
    low, high = bootstrap_interval(query_scores(ranked.rankings).columns)
    classes = class_measures(ranked.rankings) if per_class else ()
    published = PUBLISHED.get(labels or "", ())
    if as_json:
        counts = {"n_failed": ranked.n_failed, "n_shapes": ranked.rankings.n_gallery}
        document = measures | counts | how
        document["interval"] = {
            "level": LEVEL,
            "low": _named(MEASURES, low),
            "high": _named(MEASURES, high),
        }
        document["macro"] = {name: macro[name] for name in MEASURES}
        if per_class:
            document["classes"] = [
                {"label": one.label, "n_queries": one.n_queries}
                | _named(MEASURES, one.means)
                | {"confused": [{"label": label, "n_queries": n} for label, n in one.confused]}
                for one in classes
            ]
        if published:
            document["published"] = [
                {"method": one.method, "source": one.source} | dict(zip(MEASURES, one.measures, strict=True))
                for one in published
            ]
        write_document(document, options=options)
        return
    rows = []
    if rerank != "none":
        plain = asdict(evaluate_rankings(ranked.plain))
        rows.append((*numbers(plain[name] for name in MEASURES), "micro-average, plain"))
    micro = "micro-average" + (f", {rerank}" if rerank != "none" else "")
    rows += [
        (*numbers(measures[name] for name in MEASURES), micro),
        (*numbers(low), f"  {LEVEL:.0%} interval from"),
        (*numbers(high), "  to"),
        (*numbers(macro[name] for name in MEASURES), "macro-average"),
    ]
    for one in classes:
        others = ", ".join(f"{label or 'no class'} {n}" for label, n in one.confused)
        nearest = f"; nearest {others}" if others else ""
        rows.append((*numbers(one.means), f"{one.label}, {one.n_queries} queries{nearest}"))
    rows += [(*numbers(row.measures), f"published: {row.method} ({row.source})") for row in published]
    write_table(COLUMNS, rows)
    _say_how(ranked, how)
    if layout := LAYOUTS.get(labels or ""):
        say(f"{layout.name}: {layout.protocol}")


def _say_how(ranked: RankedCatalogue, how: Mapping[str, object]) -> None:
    by = f"scale {how['scale']}" if "scale" in how else f"distances of {how['matrix']}"
    if how.get("size_weight"):
        by += f", size weight {how['size_weight']:g}"
    say(
        f"{len(ranked.rankings.ids)} queries in {ranked.rankings.n_gallery} shapes, {ranked.n_failed} failed "
        f"shapes count as misses; {by}"
    )
    if ranked.whitening:
        say(f"whitening: {ranked.whitening}")


def numbers(values: Iterable[float | None], form: str = ".4f") -> list[str]:
    """The measures of a row below `COLUMNS`."""
    return ["-" if value is None else format(value, form) for value in values]


def _named(names: Iterable[str], values: FloatArray) -> dict[str, float]:
    return dict(zip(names, values.tolist(), strict=True))
