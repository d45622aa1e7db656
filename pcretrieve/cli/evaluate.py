"""The command that computes retrieval measures of a labelled catalogue or a distance matrix: evaluate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from pcretrieve.cli.comparison import compared, comparison_options, matrix_option, read_distances
from pcretrieve.cli.messages import say, write_json
from pcretrieve.cli.parts import CATALOGUE, json_option

__all__ = ["evaluate_command"]

MEASURES = {"nn": "NN", "ft": "FT", "st": "ST", "e": "E", "dcg": "DCG", "map": "mAP"}


@click.command("evaluate")
@click.option(
    "--catalogue",
    "-c",
    type=CATALOGUE,
    metavar="FILE|URL",
    help="The catalogue. Not needed with both --matrix and --labels.",
)
@click.option(
    "--labels", type=click.Path(path_type=Path), metavar="CSV", help="Classes that replace the stored ones."
)
@matrix_option
@click.option(
    "--sound-only", is_flag=True, help="Leave out shapes of the catalogue that are doubtful or unusable."
)
@comparison_options
@json_option
def evaluate_command(
    catalogue: str | None,
    labels: Path | None,
    matrix: Path | None,
    sound_only: bool,
    as_json: bool,
    **comparison: Any,
) -> None:
    """Retrieval measures of a labelled catalogue.

    Printed are nearest neighbour (NN), first and second tier (FT, ST), E-measure (E), discounted cumulative
    gain (DCG) and mean average precision (mAP). Each shape is a query in all other shapes; shapes that failed
    count as misses. The default whitening does not use the labels. Within-class whitening is cross-validated
    by folds of classes: it is evaluated on classes to which it was not fitted.

    \b
    pcretrieve evaluate --catalogue shrec11.sqlite --n-values 45 --whitening pca
    pcretrieve evaluate --matrix run1.txt --labels shrec11.cla
    """
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.evaluation import RankedCatalogue, evaluate_rankings, rank_catalogue, rank_matrix

    distances = read_distances(matrix, comparison)
    how: dict[str, object] = {"matrix": str(matrix)}
    if catalogue is None:
        if distances is None or labels is None:
            raise click.UsageError("give --catalogue, or both --matrix and --labels")
        if sound_only:
            raise click.UsageError("--sound-only needs --catalogue, which has the verdicts")
        ranked = RankedCatalogue(rank_matrix(distances, labels), 0, None)
    else:
        with Catalogue(catalogue) as store:
            options = compared(store, **comparison)
            ranked = rank_catalogue(store, options, labels=labels, matrix=distances, sound_only=sound_only)
        if ranked.table is not None:
            how = {
                "method": ranked.table.kind,
                "n_values": ranked.table.values.shape[1],
                "scale": options.compared.scale,
                "size_weight": options.signature.size_weight,
                "distance": options.retrieval.distance,
                "whitening": options.retrieval.whitening,
                "whitening_used": ranked.whitening,
                "rerank": options.retrieval.rerank,
            }
    measures = evaluate_rankings(ranked.rankings)
    counts = {"n_failed": ranked.n_failed, "n_shapes": ranked.rankings.n_gallery}
    document = asdict(measures) | counts | how
    if as_json:
        write_json(document)
        return
    click.echo("  ".join(f"{name:>6}" for name in MEASURES.values()))
    rerank = how.get("rerank", "none")
    if ranked.plain is not None and rerank != "none":
        click.echo(f"{_row(asdict(evaluate_rankings(ranked.plain)))}  plain")
    click.echo(_row(document) + (f"  {rerank}" if rerank != "none" else ""))
    by = f"scale {how['scale']}" if "scale" in how else f"distances of {matrix}"
    if how.get("size_weight"):
        by += f", size weight {how['size_weight']:g}"
    say(
        f"{measures.n_queries} queries in {counts['n_shapes']} shapes, {ranked.n_failed} failed shapes count "
        f"as misses; {by}"
    )
    if ranked.whitening:
        say(f"whitening: {ranked.whitening}")


def _row(measures: Mapping[str, Any]) -> str:
    return "  ".join(f"{measures[name]:6.4f}" for name in MEASURES)
