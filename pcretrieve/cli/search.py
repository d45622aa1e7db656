"""Commands that compare shapes: query, evaluate, report."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pcretrieve.cli.parts import (
    catalogue_option,
    distance_option,
    json_option,
    method_option,
    n_values_option,
    say,
    scale_option,
    size_weight_option,
    whitening_option,
    write_json,
)

if TYPE_CHECKING:
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.options import SignatureOptions
    from pcretrieve.types import SignatureTable

__all__ = ["evaluate_command", "query_command", "report_command"]

# Bodies whose areas differ by more than this may be in different units: from a mouse to a horse it is less,
# from centimetres to metres more.
MIXED_UNITS = 3000


@click.command("query")
@click.argument("scan", type=click.Path(path_type=Path))
@catalogue_option
@click.option("-k", "k", type=click.IntRange(min=1), default=10, show_default=True, help="How many.")
@distance_option
@whitening_option
@method_option
@n_values_option
@scale_option
@size_weight_option
@json_option
def query_command(
    scan: Path,
    catalogue: Path,
    k: int,
    distance: str,
    whitening: str,
    method: str | None,
    n_values: int | None,
    scale: str | None,
    size_weight: float | None,
    as_json: bool,
) -> None:
    """The shapes most like a scan, nearest first.

    The scan is processed with the catalogue's own options; one that the catalogue holds is looked up.

    \b
    pcretrieve query --catalogue bodies.sqlite scan.ply -k 5 --whitening pca
    """
    from pcretrieve.batch.search import search
    from pcretrieve.catalogue import Catalogue

    with Catalogue(catalogue) as store:
        options = _signature_options(store, whitening, method, n_values, scale, size_weight)
        neighbors = search(store, scan, k=k, distance=distance, whitening=whitening, options=options)
        records = [store.record(shape_id) for shape_id in neighbors.ids]
    found = [
        {"rank": rank, "id": record.id, "path": record.path, "label": record.label, "distance": float(gap)}
        for rank, (record, gap) in enumerate(zip(records, neighbors.distances, strict=True), start=1)
    ]
    if as_json:
        write_json(found)
        return
    for row in found:
        click.echo(
            f"{row['rank']:>4}  {row['distance']:<10.4g}  {row['label'] or '-':<16}  {row['id']:<24}  "
            f"{row['path']}"
        )


@click.command("evaluate")
@catalogue_option
@click.option(
    "--labels", type=click.Path(path_type=Path), metavar="CSV", help="Classes, in place of the stored ones."
)
@distance_option
@whitening_option
@method_option
@n_values_option
@scale_option
@size_weight_option
@json_option
def evaluate_command(
    catalogue: Path,
    labels: Path | None,
    distance: str,
    whitening: str,
    method: str | None,
    n_values: int | None,
    scale: str | None,
    size_weight: float | None,
    as_json: bool,
) -> None:
    """Retrieval measures of a labelled catalogue: NN, FT, ST, E, DCG, mAP.

    Each shape is a query against all others; shapes that failed count as misses. Within-class whitening is
    evaluated by five folds of classes, never on those that it was fitted on.

    \b
    pcretrieve evaluate --catalogue shrec11.sqlite --n-values 45 --whitening pca
    """
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.evaluation.folds import evaluate
    from pcretrieve.retrieval import resolution_whitening

    with Catalogue(catalogue) as store:
        options = _signature_options(store, whitening, method, n_values, scale, size_weight)
        table, failed = _labelled(store, labels, options)
        used = resolution_whitening(options) if whitening == "resolution" else whitening
        measures = evaluate(table, distance=distance, whitening=used, failed_labels=failed)
    document = asdict(measures) | {
        "n_failed": len(failed),
        "n_shapes": len(table),
        "method": table.kind,
        "n_values": table.values.shape[1],
        "scale": options.scale,
        "size_weight": options.size_weight,
        "distance": distance,
        "whitening": whitening,
    }
    if as_json:
        write_json(document)
        return
    names = ("nn", "ft", "st", "e", "dcg", "map")
    click.echo("  ".join(f"{name.upper() if name != 'map' else 'mAP':>6}" for name in names))
    click.echo("  ".join(f"{document[name]:6.4f}" for name in names))
    say(
        f"{measures.n_queries} queries in {len(table)} shapes, {len(failed)} failed ones count as misses; "
        f"scale {options.scale}" + (f", size weight {options.size_weight:g}" if options.size_weight else "")
    )


@click.command("report")
@catalogue_option
@click.option(
    "--output",
    "-o",
    type=click.Path(path_type=Path),
    required=True,
    metavar="PAGE",
    help="The HTML page to write.",
)
@click.option(
    "--queries", type=click.IntRange(min=1), default=8, show_default=True, help="Rows of results, most."
)
@click.option("-k", "k", type=click.IntRange(min=1), default=5, show_default=True, help="Results in a row.")
@distance_option
@whitening_option
@method_option
@n_values_option
@scale_option
@size_weight_option
def report_command(
    catalogue: Path,
    output: Path,
    queries: int,
    k: int,
    distance: str,
    whitening: str,
    method: str | None,
    n_values: int | None,
    scale: str | None,
    size_weight: float | None,
) -> None:
    """An HTML page: retrieval measures, and pictures of queries and their ranked results.

    Queries are the first shape of each class, or of all where there are no classes.

    \b
    pcretrieve report --catalogue bodies.sqlite -o bodies.html
    """
    from pcretrieve.batch.pages import retrieval_page
    from pcretrieve.catalogue import Catalogue

    with Catalogue(catalogue) as store:
        page = retrieval_page(
            store,
            output,
            n_queries=queries,
            k=k,
            distance=distance,
            whitening=whitening,
            options=_signature_options(store, whitening, method, n_values, scale, size_weight),
        )
    click.echo(str(page))


def _signature_options(
    store: Catalogue,
    whitening: str,
    method: str | None,
    n_values: int | None,
    scale: str | None,
    size_weight: float | None,
) -> SignatureOptions:
    """The catalogue's own, with what the command line names in its place.

    By area is the better default but for PCA whitening, which takes the values relative in its place.
    """
    if scale is None and whitening == "pca" and store.options.signature.scale == "area":
        scale = "relative"
    given = {"method": method, "n_values": n_values, "scale": scale, "size_weight": size_weight}
    chosen = {name: value for name, value in given.items() if value is not None}
    options = store.options.changed(signature=chosen).signature
    if options.size_weight or options.scale == "absolute":
        _warn_of_mixed_units(store)
    return options


def _warn_of_mixed_units(store: Catalogue) -> None:
    areas = [record.area for record in store.records() if record.area]
    if areas and max(areas) > MIXED_UNITS * min(areas):
        say(
            f"the largest body in {store.path} has {max(areas) / min(areas):.0f} times the area of the "
            "smallest: size tells them apart only if all files have one unit"
        )


def _labelled(
    store: Catalogue, labels: Path | None, options: SignatureOptions
) -> tuple[SignatureTable, list[str | None]]:
    """The signatures with their classes, and the classes of the shapes that failed."""
    from dataclasses import replace

    from pcretrieve.batch.labels import match_labels, read_labels
    from pcretrieve.errors import BenchmarkError

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
