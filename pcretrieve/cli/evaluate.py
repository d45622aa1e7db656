"""The command that scores a labelled catalogue: evaluate."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pcretrieve.cli.parts import (
    catalogue_option,
    compared,
    comparison_options,
    json_option,
    say,
    write_json,
)

if TYPE_CHECKING:
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.options import PipelineOptions
    from pcretrieve.types import SignatureTable

__all__ = ["evaluate_command"]


@click.command("evaluate")
@catalogue_option
@click.option(
    "--labels", type=click.Path(path_type=Path), metavar="CSV", help="Classes, in place of the stored ones."
)
@comparison_options
@json_option
def evaluate_command(
    catalogue: Path,
    labels: Path | None,
    as_json: bool,
    **comparison: Any,
) -> None:
    """Retrieval measures of a labelled catalogue: NN, FT, ST, E, DCG, mAP.

    Each shape is a query against all others; shapes that failed count as misses. Within-class whitening is
    evaluated by five folds of classes, never on those that it was fitted on.

    \b
    pcretrieve evaluate --catalogue shrec11.sqlite --n-values 45 --whitening pca
    """
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.evaluation.folds import evaluate

    with Catalogue(catalogue) as store:
        options = compared(store, **comparison)
        table, failed = _labelled(store, labels, options)
        measured = options.retrieval.whitening == "resolution"
        whitening = store.whitening(options) if measured else None
        measures = evaluate(table, options.retrieval, whitening=whitening, failed_labels=failed)
    signature = options.compared
    document = asdict(measures) | {
        "n_failed": len(failed),
        "n_shapes": len(table),
        "method": table.kind,
        "n_values": table.values.shape[1],
        "scale": signature.scale,
        "size_weight": signature.size_weight,
        "distance": options.retrieval.distance,
        "whitening": options.retrieval.whitening,
    }
    if as_json:
        write_json(document)
        return
    names = ("nn", "ft", "st", "e", "dcg", "map")
    click.echo("  ".join(f"{name.upper() if name != 'map' else 'mAP':>6}" for name in names))
    click.echo("  ".join(f"{document[name]:6.4f}" for name in names))
    say(
        f"{measures.n_queries} queries in {len(table)} shapes, {len(failed)} failed ones count as misses; "
        f"scale {signature.scale}"
        + (f", size weight {signature.size_weight:g}" if signature.size_weight else "")
    )


def _labelled(
    store: Catalogue, labels: Path | None, options: PipelineOptions
) -> tuple[SignatureTable, list[str | None]]:
    """The signatures with their classes, and the classes of the shapes that failed."""
    from dataclasses import replace

    from pcretrieve.errors import BenchmarkError
    from pcretrieve.ingest.labels import match_labels, read_labels

    table, records = store.signatures(options), store.records()
    classes = {record.id: record.label for record in records}
    if labels is not None:
        matched, unknown = match_labels(read_labels(labels), {record.id: record.path for record in records})
        if unknown:
            say(f"{labels} names {len(unknown)} shapes that are not in {store.path}, such as {unknown[0]}")
        classes = {shape_id: matched.get(shape_id) for shape_id in classes}
    if not any(classes.values()):
        advice = f"no name in {labels} fits one" if labels else "give --labels"
        raise BenchmarkError(f"no shape in {store.path} has a class: {advice}")
    failed = [classes[record.id] for record in records if record.status == "failed"]
    return replace(table, labels=tuple(classes[shape_id] for shape_id in table.ids)), failed
