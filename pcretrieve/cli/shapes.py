"""Commands on single scans: reconstruct, signature."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pcretrieve.cli.parts import (
    EXIT_SOME_FAILED,
    config_option,
    failure_line,
    json_option,
    load_options,
    method_option,
    n_values_option,
    say,
    scale_option,
    size_weight_option,
    step_lines,
    surface_option,
    write_json,
)

if TYPE_CHECKING:
    from pcretrieve.catalogue import Record
    from pcretrieve.options import PipelineOptions
    from pcretrieve.types import Signature

    # Name, what came of it, and what else a JSON document tells.
    Row = tuple[str, Signature | Record, dict[str, object]]

__all__ = ["reconstruct_command", "signature_command"]


@click.command("reconstruct")
@click.argument("scan", type=click.Path(path_type=Path))
@click.option(
    "--output",
    "-o",
    type=click.Path(path_type=Path),
    required=True,
    metavar="MESH",
    help=".ply .obj .off .stl .glb",
)
@click.option("--report", is_flag=True, help="Print what was done, repaired and fallen back to.")
@config_option
@surface_option
@json_option
def reconstruct_command(
    scan: Path, output: Path, report: bool, config: Path | None, surface: str | None, as_json: bool
) -> None:
    """Points to a closed, oriented, manifold surface.

    \b
    pcretrieve reconstruct scan.ply -o body.obj --report
    """
    from pcretrieve.batch.pipeline import reconstruct
    from pcretrieve.surface import write_mesh

    _check_output(output, scan)
    options = load_options(config, surface)
    mesh = reconstruct(scan, options)
    write_mesh(mesh, output)
    facts = {
        "mesh": str(output),
        "vertices": len(mesh.vertices),
        "faces": len(mesh.faces),
        "euler": mesh.euler_characteristic,
        "area": mesh.area,
        "volume": mesh.volume,
    }
    if as_json:
        write_json(facts | {"steps": [asdict(step) for step in mesh.provenance]})
        return
    if report:
        click.echo("\n".join(step_lines(mesh.provenance)))
    say(
        "  ".join(
            f"{name} {value:.6g}" if isinstance(value, float) else f"{name} {value}"
            for name, value in facts.items()
        )
    )


@click.command("signature")
@click.argument("paths", nargs=-1, metavar="[PATH|ID]...")
@click.option(
    "--from-catalogue",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Take shapes of a catalogue, by id or all of them, and no scans.",
)
@method_option
@n_values_option
@click.option(
    "--n-modes", type=click.IntRange(min=2), metavar="M", help="Modes of the surface.  [default: 60]"
)
@scale_option
@size_weight_option
@config_option
@surface_option
@json_option
def signature_command(
    paths: tuple[str, ...],
    from_catalogue: Path | None,
    method: str | None,
    n_values: int | None,
    n_modes: int | None,
    scale: str | None,
    size_weight: float | None,
    config: Path | None,
    surface: str | None,
    as_json: bool,
) -> None:
    """Signatures of scans, one line each: path, then values.

    With --from-catalogue, of shapes that it holds, computed from what it stores: id, then values.

    \b
    pcretrieve signature body.obj
    pcretrieve signature scans/ --method shape-dna --json
    pcretrieve signature --from-catalogue bodies.sqlite T12 T17 --method wks --n-values 40
    """
    from pcretrieve.catalogue import Record

    if from_catalogue is not None and (config or surface):
        raise click.UsageError("a catalogue has options of its own: leave out --config and --surface")
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
        rows = _of_catalogue(from_catalogue, paths, chosen)
    else:
        rows = _of_scans(paths, load_options(config, surface).changed(signature=chosen))
    found: list[dict[str, object]] = []
    n_failed = 0
    for name, outcome, facts in rows:
        if isinstance(outcome, Record):
            n_failed += 1
            say(failure_line(outcome))
            facts |= {"error": outcome.error, "stage": outcome.stage, "message": outcome.message}
        else:
            facts |= {"kind": outcome.kind, "values": outcome.values.tolist()}
            if outcome.deviation is not None:
                facts |= {"deviation": outcome.deviation.tolist()}
            if not as_json:
                click.echo("\t".join([name, *(f"{value:.9g}" for value in outcome.values)]))
        found.append(facts)
    if as_json:
        write_json(found)
    if n_failed:
        click.get_current_context().exit(EXIT_SOME_FAILED)


def _of_scans(paths: tuple[str, ...], options: PipelineOptions) -> Iterator[Row]:
    """Signatures of scans, or the records of their failures."""
    from pcretrieve.batch.discover import discover, printable
    from pcretrieve.batch.pipeline import process
    from pcretrieve.batch.plan import failed
    from pcretrieve.catalogue import Record
    from pcretrieve.errors import ShapeError
    from pcretrieve.signatures import describe

    for path in discover(paths):
        name = printable(path)
        try:
            shape = process(path, options)
            signature = describe(shape, options.signature)
        except ShapeError as error:
            yield name, failed(Record(Path(name).stem, name, ""), error), {"path": name}
            continue
        seconds = sum(step.seconds for step in shape.mesh.provenance)
        yield name, signature, {"path": name, "seconds": round(seconds, 3)}


def _of_catalogue(path: Path, ids: tuple[str, ...], chosen: dict[str, Any]) -> Iterator[Row]:
    """Signatures of shapes that a catalogue holds, or the records of their failures."""
    from pcretrieve.batch.plan import failed
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.errors import ShapeError
    from pcretrieve.signatures import describe

    with Catalogue(path) as store:
        options = store.options.changed(signature=chosen).signature
        records = [store.record(shape_id) for shape_id in ids] or store.records()
        for record in records:
            facts: dict[str, object] = {"id": record.id, "path": record.path}
            if record.status == "failed":
                if ids:
                    yield record.id, record, facts
                continue
            try:
                yield record.id, describe(store.shape(record.id), options), facts
            except ShapeError as error:
                yield record.id, failed(record, error), facts


def _check_output(output: Path, scan: Path) -> None:
    """Before minutes of work: whether its result could be written."""
    from pcretrieve.errors import InputError
    from pcretrieve.surface.write import SUFFIXES

    if output.suffix.lower() not in SUFFIXES:
        raise InputError(f"a mesh file must end in one of {' '.join(SUFFIXES)}, got {output}")
    if not output.parent.is_dir():
        raise InputError(f"there is no folder {output.parent} to put {output.name} into: make it first")
    if output.is_dir():
        raise InputError(f"{output} is a folder: name a file for the mesh")
    if output.exists() and scan.exists() and output.samefile(scan):
        raise InputError(f"{output} is the scan itself: name another file for the mesh")
