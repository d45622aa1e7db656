"""The command that reconstructs the surface of a scan: reconstruct."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pcretrieve.cli.messages import say, step_lines, write_json
from pcretrieve.cli.parts import config_option, json_option, limit_options, load_options, surface_option

if TYPE_CHECKING:
    from pcretrieve.options import PipelineOptions
    from pcretrieve.types import TriangleMesh

__all__ = ["reconstruct_command"]


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
@click.option("--report", is_flag=True, help="Print the steps, with repairs and fallbacks.")
@config_option
@surface_option
@limit_options("scan")
@json_option
def reconstruct_command(
    scan: Path,
    output: Path,
    report: bool,
    config: Path | None,
    surface: str | None,
    timeout: float,
    memory: float | None,
    as_json: bool,
) -> None:
    """Reconstruct a closed, oriented, manifold surface from a scan, and write it to a mesh file.

    \b
    pcretrieve reconstruct scan.ply -o body.obj --report
    """
    from pcretrieve.formats import check_output, write_mesh
    from pcretrieve.ingestion.isolation import Isolation

    check_output(output, [scan], "mesh")
    mesh = Isolation(timeout, memory).call(_surface, scan, load_options(config, surface))
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


def _surface(scan: Path, options: PipelineOptions) -> TriangleMesh:
    """The surface of a scan, in a worker process, which imports the stages."""
    from pcretrieve.pipeline.process import reconstruct

    return reconstruct(scan, options)
