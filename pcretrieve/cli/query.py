"""The command that searches a catalogue: query."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pcretrieve.cli.comparison import compared, comparison_options, matrix_option, read_distances
from pcretrieve.cli.messages import say, write_json
from pcretrieve.cli.parts import catalogue_option, json_option, limit_options, unit_option

if TYPE_CHECKING:
    from pcretrieve.options import PipelineOptions
    from pcretrieve.types import Signature, Verdict

__all__ = ["query_command"]


@click.command("query")
@click.argument("scan", metavar="SCAN|ID")
@catalogue_option
@click.option("-k", "k", type=click.IntRange(min=1), default=10, show_default=True, help="Number of results.")
@matrix_option
@comparison_options
@unit_option
@limit_options("scan")
@json_option
def query_command(
    scan: str,
    catalogue: str,
    k: int,
    matrix: Path | None,
    unit: str | None,
    timeout: float,
    memory: float | None,
    as_json: bool,
    **comparison: Any,
) -> None:
    """Find the shapes most similar to a scan, or to a shape of the catalogue, nearest first.

    The scan is processed with the options of the catalogue, unless the catalogue has it already. An argument
    that is not a file is the id of a shape.

    \b
    pcretrieve query --catalogue bodies.sqlite scan.ply -k 5 --whitening pca
    pcretrieve query --catalogue bodies.sqlite cat0
    """
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.searching import search

    distances = read_distances(matrix, comparison)
    with Catalogue(catalogue) as store:
        options = compared(store, **comparison)
        neighbors = search(
            store,
            scan,
            k=k,
            options=options,
            matrix=distances,
            unit=unit,
            describe_scan=partial(_signature, timeout, memory),
        )
        records = [store.record(shape_id) for shape_id in neighbors.ids]
        if distances is None and not as_json:
            say(f"whitening: {store.whitening(options).reason}")
    found = [
        {
            "rank": rank,
            "id": record.id,
            "path": record.path,
            "label": record.label,
            "distance": float(gap),
            "verdict": None if record.verdict is None else asdict(record.verdict),
        }
        for rank, (record, gap) in enumerate(zip(records, neighbors.distances, strict=True), start=1)
    ]
    if as_json:
        write_json(found)
        return
    for row, record in zip(found, records, strict=True):
        doubt = f"  [{record.verdict}]" if record.is_doubtful else ""
        click.echo(
            f"{row['rank']:>4}  {row['distance']:<10.4g}  {row['label'] or '-':<16}  {row['id']:<24}  "
            f"{row['path']}{doubt}"
        )


def _signature(timeout: float, memory: float | None, scan: Path, options: PipelineOptions) -> Signature:
    # Imported here, because it is not needed for shapes that the catalogue has.
    from pcretrieve.ingestion.discover import printable
    from pcretrieve.ingestion.isolation import Isolation

    described, verdict = Isolation(timeout, memory).call(_isolated_signature, scan, options)
    if not verdict.is_sound:
        say(f"{printable(scan)} is {verdict}")
    return described


def _isolated_signature(scan: Path, options: PipelineOptions) -> tuple[Signature, Verdict]:
    """The signature of a scan and the verdict on it, in a worker process, which imports the stages."""
    from pcretrieve.pipeline.process import judged_signature

    return judged_signature(scan, options)
