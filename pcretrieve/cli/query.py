"""The command that searches: query."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pcretrieve.cli.parts import (
    catalogue_option,
    compared,
    comparison_options,
    json_option,
    limit_options,
    matrix_option,
    read_distances,
    write_json,
)

if TYPE_CHECKING:
    from pcretrieve.ingestion.isolation import Isolation
    from pcretrieve.options import PipelineOptions
    from pcretrieve.types import Signature

__all__ = ["query_command"]


@click.command("query")
@click.argument("scan", type=click.Path(path_type=Path))
@catalogue_option
@click.option("-k", "k", type=click.IntRange(min=1), default=10, show_default=True, help="How many.")
@matrix_option
@comparison_options
@limit_options("scan")
@json_option
def query_command(
    scan: Path,
    catalogue: Path,
    k: int,
    matrix: Path | None,
    timeout: float,
    memory: float | None,
    as_json: bool,
    **comparison: Any,
) -> None:
    """The shapes most like a scan, nearest first.

    The scan is processed with the catalogue's own options; one that the catalogue holds is looked up.

    \b
    pcretrieve query --catalogue bodies.sqlite scan.ply -k 5 --whitening pca
    """
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.ingestion.isolation import Isolation
    from pcretrieve.searching import search

    distances = read_distances(matrix, comparison)
    with Catalogue(catalogue) as store:
        options = compared(store, **comparison)
        isolation = Isolation(timeout, memory)
        neighbors = search(
            store,
            scan,
            k=k,
            options=options,
            matrix=distances,
            describe_scan=partial(_signature, isolation),
        )
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


def _signature(isolation: Isolation, scan: Path, options: PipelineOptions) -> Signature:
    return isolation.call(_isolated_signature, scan, options)


def _isolated_signature(scan: Path, options: PipelineOptions) -> Signature:
    """In a process of its own, the only one that imports the stages."""
    from pcretrieve.pipeline.process import signature

    return signature(scan, options)
