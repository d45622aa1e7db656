"""Print what very fine meshes cost, and what their simplification changes, by `surface.max_faces`.

    .venv/bin/python scripts/benchmark_large_meshes --data FOLDER

First, seconds and memory of `pcretrieve signature` of closed meshes, as they are and simplified. Then meshes
of the set `tosca` are refined, to 16 and to 64 times as many faces, and smoothed: by how much the default
signature of one mesh of each class moves if the mesh of 640,000 faces is simplified, and the retrieval
measures of all meshes, with 160,000 faces and simplified to 50,000, which is a larger change.

About 20 minutes on two cores of a 2.5 GHz Xeon; `--limit 8` leaves out most meshes. Without the set, the
second part is left out.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path

import numpy as np

from pcretrieve.atomic import write_file
from pcretrieve.benchmarks.arguments import add_data, argument_parser, positive
from pcretrieve.benchmarks.commands import run_command
from pcretrieve.benchmarks.sets import SETS, Item, ingested, left_out
from pcretrieve.benchmarks.surfaces import bumpy_sphere, quartered
from pcretrieve.benchmarks.tables import Column, Table, print_lines
from pcretrieve.formats import write_mesh
from pcretrieve.interface import evaluate
from pcretrieve.options import PipelineOptions
from pcretrieve.pipeline.process import signature
from pcretrieve.surface.smooth import smoothed
from pcretrieve.values import FloatArray, TriangleMesh

__all__ = ["main"]

FACES = (500_000, 2_000_000)
# Limits of faces: none, and those that are compared; the first of them is the default.
NONE = 10**9
LIMITS = (200_000, 100_000, 50_000)
RETRIEVED = (NONE, 50_000)
N_ROUNDS = 10

COSTS = Table(
    Column("faces", 10), Column("max_faces", 10), Column("seconds", 8, ".1f"), Column("peak, MiB", 10, ".0f")
)
DRIFTS = Table(
    Column("mesh", 14, align="<"),
    Column("faces", 8),
    Column("max_faces", 10),
    Column("norm of the change of the log-signature", 41, ".4f"),
    Column("largest", 8, ".4f"),
)
MEASURES = Table(Column("max_faces", 10), Column("NN", 6, ".3f"), Column("mAP", 6, ".3f"))


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables.

    Parameters
    ----------
    arguments : sequence of str, optional
        By default the arguments of the command line.
    """
    parser = argument_parser(__doc__)
    add_data(parser)
    parser.add_argument(
        "--faces", type=positive, nargs="*", default=FACES, help="faces of the meshes (default: %(default)s)"
    )
    parser.add_argument("--limit", type=positive, help="number of meshes of the set (default: all)")
    given = parser.parse_args(arguments)
    print_lines(_lines(given.faces, given.data, given.limit))


def _lines(sizes: Sequence[int], data: Path, limit: int | None) -> Iterator[str]:
    with tempfile.TemporaryDirectory() as folder:
        yield COSTS.head
        for n_faces in sizes:
            yield from _costs(Path(folder), n_faces)
        if note := left_out("the drift of signatures", data / "tosca"):
            yield note
            return
        items = SETS["tosca"](data, limit)
        yield DRIFTS.head
        for _, group in groupby(items, key=lambda item: item.label):
            yield from _drifts(next(group))
        yield MEASURES.head
        yield from _measures(Path(folder), items)


def _options(max_faces: int) -> PipelineOptions:
    return PipelineOptions().changed(surface={"max_faces": max_faces})


def _costs(folder: Path, n_faces: int) -> Iterator[str]:
    mesh = bumpy_sphere(n_faces // 2 + 2)
    write_mesh(mesh, folder / "fine.ply")
    for max_faces in (NONE, LIMITS[0]):
        write_file(folder / "limit.toml", f"[surface]\nmax_faces = {max_faces}\n".encode())
        seconds, peak = run_command(
            *("signature", str(folder / "fine.ply"), "--config", str(folder / "limit.toml"))
        )
        yield COSTS.row(f"{len(mesh.faces):,}", _limit(max_faces), seconds, peak)


def _drifts(item: Item) -> Iterator[str]:
    mesh = _refined(item.mesh, 3)
    whole = _log_signature(mesh, NONE)
    for max_faces in LIMITS:
        change = np.abs(_log_signature(mesh, max_faces) - whole)
        faces = f"{len(mesh.faces):,}"
        yield DRIFTS.row(item.name, faces, _limit(max_faces), np.linalg.norm(change), change.max())


def _measures(folder: Path, items: Sequence[Item]) -> Iterator[str]:
    meshes = folder / "meshes"
    meshes.mkdir()
    for item in items:
        write_mesh(_refined(item.mesh, 2), meshes / f"{item.name}.ply")
    labels = {item.name: item.label for item in items}
    for max_faces in RETRIEVED:
        path = folder / f"{max_faces}.sqlite"
        with ingested(meshes, path, _options(max_faces), labels):
            found = evaluate(path)
        yield MEASURES.row(_limit(max_faces), found.nn, found.map)


def _refined(mesh: TriangleMesh, n: int) -> TriangleMesh:
    """A smooth surface with 4ⁿ times as many faces."""
    for _ in range(n):
        mesh = quartered(mesh)
        everywhere = np.arange(len(mesh.vertices))
        mesh = TriangleMesh(smoothed(mesh.vertices, mesh.faces, everywhere, N_ROUNDS), mesh.faces)
    return mesh


def _log_signature(mesh: TriangleMesh, max_faces: int) -> FloatArray:
    return np.log(signature(mesh, _options(max_faces)).values)


def _limit(max_faces: int) -> str:
    return "none" if max_faces == NONE else f"{max_faces:,}"
