"""The command that reconstructs the surfaces of scans: reconstruct."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import click

from pcretrieve.cli.commands import command, option
from pcretrieve.cli.documents import write_document
from pcretrieve.cli.messages import say, shown_path, write_line
from pcretrieve.cli.parts import (
    EXIT_SOME_FAILED,
    config_option,
    json_option,
    limit_options,
    load_options,
    surface_option,
)
from pcretrieve.cli.progress import progress_option
from pcretrieve.cli.scans import each_scan, failure_document, output_files, workers_option
from pcretrieve.cli.tables import write_steps

if TYPE_CHECKING:
    from pcretrieve.options import PipelineOptions
    from pcretrieve.values import Step

__all__ = ["reconstruct_command"]


@command("reconstruct")
@click.argument("scan", type=click.Path(path_type=Path), metavar="SCAN|FOLDER")
@option(
    "--output",
    "-o",
    type=click.Path(path_type=Path),
    required=True,
    metavar="MESH|FOLDER",
    help=".ply .obj .off .stl .glb; for a folder, a folder.",
    details="A folder is made if there is none.",
)
@option(
    "--suffix",
    type=click.Choice([".ply", ".obj", ".off", ".stl", ".glb"]),
    metavar="SUFFIX",
    help="Format of the meshes of a folder of scans.  [default: .ply]",
)
@option("--report", is_flag=True, help="Print the steps, with repairs and fallbacks.")
@config_option
@surface_option
@workers_option
@limit_options("scan")
@progress_option
@json_option
def reconstruct_command(
    scan: Path,
    output: Path,
    suffix: str | None,
    report: bool,
    config: Path | None,
    surface: str | None,
    workers: int | None,
    timeout: float,
    memory: float | None,
    progress: str,
    as_json: bool,
) -> None:
    """Reconstruct a closed, oriented, manifold surface from a scan, and write it to a mesh file.

    Of a folder, each scan is reconstructed, and its mesh is named like the scan.

    \b
    pcretrieve reconstruct scan.ply -o body.obj --report
    pcretrieve reconstruct scans/ -o meshes/ --workers 2
    """
    from pcretrieve.formats import check_output
    from pcretrieve.ingestion.discover import discover, printable
    from pcretrieve.ingestion.isolation import Isolation

    options = load_options(config, surface)
    if not scan.is_dir():
        if suffix is not None:
            raise click.UsageError("--suffix is for folders: give the suffix of the mesh with -o")
        check_output(output, [scan], "mesh")
        made = Isolation(timeout, memory).call(_reconstructed, options, {scan: output}, scan)
        if as_json:
            write_document(made.document(), options=options)
            return
        if report:
            write_steps(made.steps)
        say(made.summary())
        return
    scans = discover([scan])
    files = output_files(output, scans, scan, suffix or ".ply")
    documents: list[dict[str, object]] = []
    n_failed = 0
    outcomes = each_scan(
        "reconstruct",
        partial(_reconstructed, options, files),
        scans,
        workers=workers,
        timeout=timeout,
        memory=memory,
        progress=progress,
    )
    found: list[tuple[str, _Made]] = []  # printed at the end, because they would break a bar
    for path, outcome in outcomes:
        if isinstance(outcome, _Made):
            documents.append({"scan": printable(path)} | outcome.document())
            found.append((printable(path), outcome))
        else:
            n_failed += 1
            documents.append(failure_document(outcome))
    if as_json:
        write_document(documents, options=options)
    elif report:
        for name, made in found:
            write_line(shown_path(name))
            write_steps(made.steps)
    say(f"{len(scans) - n_failed} surfaces are in {output}, {n_failed} scans failed")
    if n_failed:
        click.get_current_context().exit(EXIT_SOME_FAILED)


class _Made(NamedTuple):
    """What is known of a mesh that was written."""

    facts: dict[str, str | float]
    steps: tuple[Step, ...]

    def document(self) -> dict[str, object]:
        return self.facts | {"steps": [asdict(step) for step in self.steps]}

    def summary(self) -> str:
        return "  ".join(
            f"{name} {value:.6g}" if isinstance(value, float) else f"{name} {value}"
            for name, value in self.facts.items()
        )


def _reconstructed(options: PipelineOptions, files: dict[Path, Path], scan: Path) -> _Made:
    """Write the surface of a scan, in a worker process, which imports the stages."""
    from pcretrieve.formats import write_mesh
    from pcretrieve.pipeline.process import reconstruct

    mesh = reconstruct(scan, options)
    write_mesh(mesh, files[scan])
    facts: dict[str, str | float] = {
        "mesh": str(files[scan]),
        "vertices": len(mesh.vertices),
        "faces": len(mesh.faces),
        "euler": mesh.euler_characteristic,
        "area": mesh.area,
        "volume": mesh.volume,
    }
    return _Made(facts, mesh.provenance)
