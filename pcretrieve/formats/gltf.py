"""The formats glTF 2.0 and GLB: triangles and points of the scene, without materials.

A mesh of the scene is a body. Its vertices are placed by the nodes of the scene; those at the same place are
merged, because the format duplicates vertices for faces of different materials and normals.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import ScanReadError
from pcretrieve.formats.format import Format, Part
from pcretrieve.formats.gltf_document import (
    Document,
    buffer_files,
    read_glb_document,
    read_gltf_document,
    values_of,
)
from pcretrieve.formats.members import Members, distinct_names
from pcretrieve.formats.raw import RawScan, incomplete, merged_vertices
from pcretrieve.formats.trimesh import mesh_bytes
from pcretrieve.values import FloatArray

__all__ = ["GLB", "GLTF"]

Result = TypeVar("Result")

# Modes of a primitive with triangles; the others are points and lines.
TRIANGLES, STRIP, FAN = 4, 5, 6

# A mesh is repeated in the scene for each node that refers to it. The number of vertices and indices in the
# scene is limited to the number of bytes of the file, or to this number if the file is smaller.
MOST_OF_SMALL_FILE = 1_000_000


class Placed(NamedTuple):
    """A mesh of the scene: the node that places it, both by their numbers, and the motion to its frame."""

    node: int
    mesh: int
    motion: FloatArray  # (4, 4)


class Primitive(NamedTuple):
    """The vertices of a primitive, in the frame of its mesh, and its triangles."""

    vertices: NDArray[Any]
    faces: NDArray[np.int64]


def _format(
    suffix: str,
    read_document: Callable[[Path], Document],
    parts: Callable[[Path], tuple[Part, ...]] = lambda path: (),
    **options: Any,
) -> Format:
    """The format of a suffix. The readers raise ScanReadError if a file is damaged, or has no vertices."""
    return Format(
        (suffix,),
        partial(_read, read_document),
        parts,
        members=Members(partial(_names, read_document), partial(_read, read_document)),
        **options,
    )


def _read(read_document: Callable[[Path], Document], path: Path, name: str | None = None) -> RawScan:
    """All bodies of the scene as one scan, or the body of a name."""

    def read(document: Document) -> RawScan:
        placed = _placed(document)
        return _scan(document, placed if name is None else [_named(document, placed)[name]])

    return _parsed(read_document, path, read)


def _names(read_document: Callable[[Path], Document], path: Path) -> tuple[str, ...]:
    return _parsed(read_document, path, lambda document: tuple(_named(document, _placed(document))))


def _parsed(
    read_document: Callable[[Path], Document], path: Path, use: Callable[[Document], Result]
) -> Result:
    """What a function makes of the document of a file, with its exceptions as those of a damaged file."""
    try:
        return use(read_document(path))
    except ScanReadError as error:
        raise incomplete(path, error.message) from error
    # Missing members of the tree, members of a wrong type, and invalid references.
    except (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError) as error:
        raise incomplete(path, f"its JSON part is broken: {type(error).__name__} {error}") from error


def _named(document: Document, placed: list[Placed]) -> dict[str, Placed]:
    """The bodies in the order of their nodes, by the names of those, or of their meshes."""
    nodes, meshes = document.tree["nodes"], document.tree["meshes"]
    bodies = sorted(placed, key=lambda body: body.node)
    names = (nodes[body.node].get("name") or meshes[body.mesh].get("name") or "" for body in bodies)
    return dict(zip(distinct_names(map(str, names)), bodies, strict=True))


def _placed(document: Document) -> list[Placed]:
    """The meshes of the scene, whose size is checked before they are read."""
    tree = document.tree
    placed = list(_placed_meshes(tree))
    sizes = {mesh: _n_values(tree, mesh) for mesh in {body.mesh for body in placed}}
    n_values, most = sum(sizes[body.mesh] for body in placed), max(document.n_bytes, MOST_OF_SMALL_FILE)
    if n_values > most:
        raise ScanReadError(f"its scene declares {n_values} values, it has {document.n_bytes} bytes")
    return placed


def _scan(document: Document, placed: list[Placed]) -> RawScan:
    """The bodies in the frame of the scene."""
    meshes = {
        mesh: [_primitive(document, primitive) for primitive in document.tree["meshes"][mesh]["primitives"]]
        for mesh in {body.mesh for body in placed}
    }
    points, triangles, n_points = [], [], 0
    for body in placed:
        for vertices, faces in meshes[body.mesh]:
            points.append(_moved(vertices.astype(np.float64), body.motion))
            # A reflection reverses the orientation of triangles.
            mirrored = np.linalg.det(body.motion[:3, :3]) < 0
            triangles.append((faces[:, ::-1] if mirrored else faces) + n_points)
            n_points += len(vertices)
    if not n_points:
        raise ScanReadError("its scene has no vertices")
    merged, numbers = merged_vertices(np.concatenate(points), np.concatenate(triangles))
    return RawScan(merged, numbers if len(numbers) else None, unit="m")


def _placed_meshes(tree: Any) -> Iterator[Placed]:
    """Yield the mesh of each node of the scene."""
    nodes, seen = tree.get("nodes", []), set()
    waiting = [(root, np.eye(4)) for root in tree["scenes"][tree.get("scene", 0)].get("nodes", [])]
    while waiting:
        number, motion = waiting.pop()
        if number in seen:
            raise ScanReadError(f"node {number} has more than one parent")
        seen.add(number)
        node = nodes[number]
        motion = motion @ _transform(node)
        waiting += [(child, motion) for child in node.get("children", [])]
        if "mesh" in node:
            yield Placed(number, node["mesh"], motion)


def _transform(node: Any) -> FloatArray:
    """The (4, 4) transform from the frame of a node to that of its parent."""
    matrix = np.array(node.get("matrix", np.eye(4).ravel()), dtype=np.float64).reshape(4, 4).T
    if "translation" in node:
        translation = np.eye(4)
        translation[:3, 3] = node["translation"]
        matrix = matrix @ translation
    if "rotation" in node:
        rotation = np.eye(4)
        rotation[:3, :3] = _rotation(np.array(node["rotation"], dtype=np.float64))
        matrix = matrix @ rotation
    if "scale" in node:
        matrix = matrix @ np.diag([*node["scale"], 1.0])
    return np.asarray(matrix)


def _rotation(quaternion: FloatArray) -> FloatArray:
    """The (3, 3) rotation matrix of a quaternion x, y, z, w."""
    x, y, z, w = quaternion * np.sqrt(2 / (quaternion @ quaternion))
    return np.array(
        [
            [1 - y * y - z * z, x * y - z * w, x * z + y * w],
            [x * y + z * w, 1 - x * x - z * z, y * z - x * w],
            [x * z - y * w, y * z + x * w, 1 - x * x - y * y],
        ]
    )


def _moved(points: FloatArray, motion: FloatArray) -> FloatArray:
    if np.array_equal(motion, np.eye(4)):
        return points
    homogeneous = np.column_stack([points, np.ones(len(points))])  # (n, 4)
    return np.asarray((motion @ homogeneous.T).T[:, :3])


# --- meshes ----------------------------------------------------------------------------------------------


def _n_values(tree: Any, mesh: int) -> int:
    """The declared number of vertices and indices of a mesh."""
    return sum(
        int(tree["accessors"][accessor]["count"])
        for primitive in tree["meshes"][mesh]["primitives"]
        for accessor in (primitive["attributes"]["POSITION"], primitive.get("indices"))
        if accessor is not None
    )


def _primitive(document: Document, primitive: Any) -> Primitive:
    vertices = values_of(document, primitive["attributes"]["POSITION"], "VEC3")
    mode = primitive.get("mode", TRIANGLES)
    if mode not in (TRIANGLES, STRIP, FAN):
        return Primitive(vertices, np.empty((0, 3), dtype=np.int64))
    corners = np.arange(len(vertices))
    if "indices" in primitive:
        corners = values_of(document, primitive["indices"], "SCALAR")[:, 0].astype(np.int64)
        if len(corners) and not 0 <= corners.min() <= corners.max() < len(vertices):
            raise ScanReadError(f"its faces name vertex {corners.max()}, of {len(vertices)}")
    if mode == TRIANGLES:
        return Primitive(vertices, corners.reshape(-1, 3))
    k = np.arange(max(len(corners) - 2, 0))
    # Every second triangle of a strip has the opposite orientation.
    order = (k, k + 1 + k % 2, k + 2 - k % 2) if mode == STRIP else (k + 1, k + 2, 0 * k)
    return Primitive(vertices, corners[np.column_stack(order)])


def _buffers(path: Path) -> tuple[Part, ...]:
    return tuple(Part(file) for file in buffer_files(path))


GLB = _format(".glb", read_glb_document, write_mesh=partial(mesh_bytes, file_type="glb"))
GLTF = _format(".gltf", read_gltf_document, _buffers)
