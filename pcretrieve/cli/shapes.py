"""Commands on single scans: reconstruct, signature."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from pcretrieve.cli.parts import (
    EXIT_SOME_FAILED,
    config_option,
    failure_line,
    json_option,
    load_options,
    say,
    step_lines,
    surface_option,
    write_json,
)

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
@click.argument("paths", nargs=-1, metavar="PATH...")
@click.option(
    "--method", type=click.Choice(["r-bihdm", "shape-dna"]), help="The descriptor.  [default: r-bihdm]"
)
@click.option("--n-values", type=click.IntRange(min=1), metavar="L", help="Its length.  [default: 23]")
@config_option
@surface_option
@json_option
def signature_command(
    paths: tuple[str, ...],
    method: str | None,
    n_values: int | None,
    config: Path | None,
    surface: str | None,
    as_json: bool,
) -> None:
    """Signatures of scans, one line each: path, then values.

    \b
    pcretrieve signature body.obj
    pcretrieve signature scans/ --method shape-dna --json
    """
    from pcretrieve.batch.discover import discover, printable
    from pcretrieve.batch.pipeline import process
    from pcretrieve.batch.plan import failed
    from pcretrieve.catalogue import Record
    from pcretrieve.errors import ShapeError
    from pcretrieve.signatures import describe

    if not paths:
        raise click.UsageError("name at least one scan")
    options = load_options(config, surface)
    chosen = {
        key: value for key, value in {"method": method, "n_values": n_values}.items() if value is not None
    }
    options = options.changed(signature=chosen)
    found: list[dict[str, object]] = []
    n_failed = 0
    for path in discover(paths):
        name = printable(path)
        try:
            shape = process(path, options)
        except ShapeError as error:
            n_failed += 1
            record = failed(Record(Path(name).stem, name, ""), error)
            say(failure_line(record))
            found.append(
                {"path": name, "error": record.error, "stage": record.stage, "message": record.message}
            )
            continue
        signature = describe(shape.spectrum, options.signature)
        found.append(
            {
                "path": name,
                "kind": signature.kind,
                "values": signature.values.tolist(),
                "seconds": round(sum(step.seconds for step in shape.mesh.provenance), 3),
            }
        )
        if not as_json:
            click.echo("\t".join([name, *(f"{value:.9g}" for value in signature.values)]))
    if as_json:
        write_json(found)
    if n_failed:
        click.get_current_context().exit(EXIT_SOME_FAILED)


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
