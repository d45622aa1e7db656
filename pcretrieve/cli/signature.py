"""The command that computes and prints signatures: signature."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pcretrieve.cli.commands import command, option
from pcretrieve.cli.comparison import method_option, n_values_option, scale_option, size_weight_option
from pcretrieve.cli.documents import write_document
from pcretrieve.cli.messages import failure_line, say, shown_path, write_row
from pcretrieve.cli.parts import (
    CATALOGUE,
    EXIT_SOME_FAILED,
    config_option,
    json_option,
    limit_options,
    load_options,
    surface_option,
    unit_option,
)
from pcretrieve.cli.progress import progress_option
from pcretrieve.cli.scans import each_scan, workers_option

if TYPE_CHECKING:
    from pcretrieve.catalogue import Record
    from pcretrieve.options import PipelineOptions
    from pcretrieve.values import Signature

    # A name; the signature, or the record of a failure; further values of the JSON document.
    Row = tuple[str, Signature | Record, dict[str, object]]

__all__ = ["signature_command"]


@command("signature")
@click.argument("paths", nargs=-1, metavar="[PATH|ID]...")
@click.option(
    "--from-catalogue",
    type=CATALOGUE,
    metavar="FILE|URL",
    help="Use shapes of a catalogue, by id, or all, not scans.",
)
@method_option
@n_values_option
@option(
    "--n-modes",
    type=click.IntRange(min=2),
    metavar="M",
    rare=True,
    help="Number of modes of the surface.  [default: 60]",
)
@scale_option
@size_weight_option
@config_option
@surface_option
@unit_option
@workers_option
@limit_options("scan")
@progress_option
@json_option
def signature_command(
    paths: tuple[str, ...],
    from_catalogue: str | None,
    method: str | None,
    n_values: int | None,
    n_modes: int | None,
    scale: str | None,
    size_weight: float | None,
    config: Path | None,
    surface: str | None,
    unit: str | None,
    workers: int | None,
    timeout: float,
    memory: float | None,
    progress: str,
    as_json: bool,
) -> None:
    """Print the signatures of scans, in one line each: path, then values.

    With --from-catalogue, signatures are computed from stored spectra and surfaces: id, then values.

    \b
    pcretrieve signature body.obj
    pcretrieve signature scans/ --method shape-dna --json
    pcretrieve signature --from-catalogue bodies.sqlite T12 T17 --method wks
    """
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.values import Signature

    if from_catalogue is not None and (config or surface or unit):
        raise click.UsageError("a catalogue has options of its own: leave out --config, --surface and --unit")
    if from_catalogue is None and not paths:
        raise click.UsageError("name at least one scan")
    given = {
        "method": method,
        "n_values": n_values,
        "n_modes": n_modes,
        "scale": scale,
        "size_weight": size_weight,
    }
    chosen = {name: value for name, value in given.items() if value is not None}
    if from_catalogue is not None:
        with Catalogue(from_catalogue) as store:
            options = store.options.changed(signature=chosen)
        rows = _of_catalogue(from_catalogue, paths, options)
    else:
        options = load_options(config, surface).changed(signature=chosen)
        if unit is not None:
            options = options.changed(scan={"unit": unit})
        # On a terminal, the signatures themselves show the progress, and would break a bar.
        shown = None if progress == "bar" and not as_json and sys.stdout.isatty() else progress
        rows = _of_scans(paths, options, workers=workers, timeout=timeout, memory=memory, progress=shown)
    found: list[dict[str, object]] = []
    n_failed = 0
    for name, outcome, facts in rows:
        if isinstance(outcome, Signature):
            facts |= {"kind": outcome.kind, "unit": outcome.unit, "values": outcome.values.tolist()}
            if outcome.deviation is not None:
                facts |= {"deviation": outcome.deviation.tolist()}
            if not as_json:
                write_row([shown_path(name), *(f"{value:.9g}" for value in outcome.values)])
        else:
            n_failed += 1
            if from_catalogue is not None:
                say(failure_line(outcome))
            facts |= {"error": outcome.error, "stage": outcome.stage, "message": outcome.message}
        found.append(facts)
    if as_json:
        write_document(found, options=options)
    if n_failed:
        click.get_current_context().exit(EXIT_SOME_FAILED)


def _of_scans(paths: tuple[str, ...], options: PipelineOptions, **limits: Any) -> Iterator[Row]:
    """Signatures of scans, or the records of their failures."""
    from pcretrieve.ingestion.discover import discover, printable

    for path, outcome in each_scan("signature", partial(_described, options), discover(paths), **limits):
        name = printable(path)
        if isinstance(outcome, tuple):
            signature, seconds = outcome
            yield name, signature, {"path": name, "seconds": round(seconds, 3)}
        else:
            yield name, outcome, {"path": name}


def _described(options: PipelineOptions, path: Path) -> tuple[Signature, float]:
    """A signature and its seconds, in a worker process, which imports the stages."""
    from pcretrieve.descriptors import describe
    from pcretrieve.errors import Stage, in_stage
    from pcretrieve.pipeline.process import process

    shape = process(path, options)
    with in_stage(Stage.SIGNATURE):
        signature = describe(shape, options.signature)
    return signature, sum(step.seconds for step in shape.provenance)


def _of_catalogue(location: str, ids: tuple[str, ...], options: PipelineOptions) -> Iterator[Row]:
    """Signatures of shapes of a catalogue, or the records of their failures."""
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.descriptors import DESCRIPTORS, describe
    from pcretrieve.errors import ShapeError
    from pcretrieve.ingestion.plan import failed

    with Catalogue(location) as store:
        needs = DESCRIPTORS[options.signature.method].needs
        records = [store.record(shape_id) for shape_id in ids] or store.records()
        for record in records:
            facts: dict[str, object] = {"id": record.id, "path": record.path}
            if record.status == "failed":
                if ids:
                    yield record.id, record, facts
                continue
            try:
                yield record.id, describe(store.shape(record.id, needs), options.signature), facts
            except ShapeError as error:
                yield record.id, failed(record, error), facts
