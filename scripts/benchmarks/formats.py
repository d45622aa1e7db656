"""Write meshes of TOSCA whose parts touch by trimesh in each format, and print what is read.

    scripts/benchmark formats --data FOLDER

Parts touch where six pairs of vertices, near each other in space and far along the surface, lie at one
position. Printed are the defects, the outcome, and the largest change of a log-value of `r-bihdm`.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from benchmarks.measuring import (
    Column,
    Table,
    add_data,
    argument_parser,
    print_lines,
    use_one_core,
)
from pcretrieve.formats import read_scan
from pcretrieve.options import JUDGED
from pcretrieve.pipeline.inspecting import inspect_scan
from pcretrieve.pipeline.process import signature
from pcretrieve.values import TriangleMesh
from pcretrieve.values.conversion import as_mesh
from pcretrieve.values.topology import defects

TABLE = Table(
    Column("mesh", 8, align="<"),
    Column("file", 5, align="<"),
    Column("change", 6, ".3f"),
    Column("found", 0, align="<"),
)
SUFFIXES = ("ply", "obj", "off", "stl", "glb", "gltf", "3mf")
R_BIHDM = {"signature": JUDGED}
N_PAIRS = 6
# Largest distance of a pair in space and smallest along the surface, in diagonals.
NEAR, FAR = 0.08, 0.25


def main(arguments: Sequence[str] | None = None) -> None:
    """Print one line for each mesh and format."""
    parser = argument_parser(__doc__)
    add_data(parser)
    parser.add_argument(
        "--meshes", nargs="+", default=["cat0", "david0"], help="default: %(default)s"
    )
    given = parser.parse_args(arguments)
    use_one_core()
    print_lines(_lines(given.data / "tosca", given.meshes))


def _lines(folder: Path, names: Sequence[str]) -> Iterator[str]:
    yield TABLE.head
    for name in names:
        mesh = touching(as_mesh(read_scan(folder / f"{name}.off")))
        expected = np.log(signature(mesh, R_BIHDM).values)
        with tempfile.TemporaryDirectory() as place:
            for suffix in SUFFIXES:
                path = Path(place) / f"body.{suffix}"
                _write(mesh, path)
                change = np.abs(np.log(signature(path, R_BIHDM).values) - expected).max()
                outcome = inspect_scan(path, n_rescans=0).outcome
                yield TABLE.row(
                    name,
                    suffix,
                    change,
                    f"{defects(as_mesh(read_scan(path)))}; {outcome}",
                )


def touching(mesh: TriangleMesh) -> TriangleMesh:
    """A mesh in single precision, six pairs of whose vertices lie at one position."""
    vertices, faces = np.array(mesh.vertices), mesh.faces
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    lengths = np.linalg.norm(np.diff(vertices[ends], axis=1)[:, 0], axis=1)
    graph = coo_array((lengths, tuple(ends.T)), shape=(len(vertices),) * 2)
    along = dijkstra(graph.tocsr(), directed=False, limit=FAR * mesh.diagonal)
    pairs = cKDTree(vertices).query_pairs(NEAR * mesh.diagonal, output_type="ndarray")
    pairs = pairs[np.isinf(along[tuple(pairs.T)])]
    gaps = np.linalg.norm(np.diff(vertices[pairs], axis=1)[:, 0], axis=1)
    moved: list[int] = []
    for pair in pairs[np.argsort(gaps)].tolist():
        around = faces[np.isin(faces, pair).any(axis=1)]
        if len(moved) < 2 * N_PAIRS and not np.isin(around, moved).any():
            vertices[pair] = vertices[pair].mean(axis=0)
            moved += pair
    vertices = vertices.astype(np.float32)
    return TriangleMesh(vertices, faces)


def _write(mesh: TriangleMesh, path: Path) -> None:
    body: Any = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    if path.suffix == ".gltf":
        for name, data in body.export(file_type="gltf").items():
            (path if name.endswith(".gltf") else path.parent / name).write_bytes(data)
    elif path.suffix == ".3mf":
        body.scene().export(path)
    else:
        body.export(path, **({"digits": 9} if path.suffix == ".obj" else {}))
