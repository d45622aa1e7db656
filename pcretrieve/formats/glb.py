"""The format GLB, the binary form of glTF 2.0 [1]_: triangles and points of the scene, without materials.

External files and data URIs are not read.

References
----------
.. [1] Khronos Group, "glTF 2.0 Specification", 2021,
   https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.adapters.trimesh import mesh_bytes
from pcretrieve.errors import ScanReadError
from pcretrieve.formats.format import Format
from pcretrieve.formats.raw import RawScan, incomplete, merged_vertices
from pcretrieve.types import FloatArray

__all__ = ["GLB", "read_glb"]

MAGIC, VERSION = b"glTF", 2
JSON_CHUNK, BINARY_CHUNK = b"JSON", b"BIN\0"

COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC3": 3}
# Modes of a primitive with triangles; the others are points and lines.
TRIANGLES, STRIP, FAN = 4, 5, 6

# A mesh is repeated in the scene for each node that refers to it. The number of vertices and indices in the
# scene is limited to the number of bytes of the file, or to this number if the file is smaller.
MOST_OF_SMALL_FILE = 1_000_000


class Document(NamedTuple):
    """The JSON tree of a file, its binary chunk, and its size; bytes."""

    tree: Any
    binary: bytes
    n_bytes: int


class Primitive(NamedTuple):
    """The vertices of a primitive, in the frame of its mesh, and its triangles."""

    vertices: NDArray[Any]
    faces: NDArray[np.int64]


def read_glb(path: Path) -> RawScan:
    """Read a GLB file.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    RawScan
        Vertices and triangles of all nodes of the scene, in metres. Vertices at the same place are merged,
        because the format duplicates them for faces of different materials and normals.

    Raises
    ------
    OSError
        If the file cannot be read.
    ScanReadError
        If the file is not a GLB file, is truncated, is compressed, or its scene has no vertices.
    """
    data = path.read_bytes()
    try:
        vertices, faces = _scene(_document(data))
    except ScanReadError as error:
        raise incomplete(path, error.message) from error
    # Missing members of the tree, members of a wrong type, and invalid references.
    except (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError) as error:
        raise incomplete(path, f"its JSON part is broken: {type(error).__name__} {error}") from error
    vertices, faces = merged_vertices(vertices, faces)
    return RawScan(vertices, faces if len(faces) else None)


def _document(data: bytes) -> Document:
    if data[:4] != MAGIC or len(data) < 20:
        raise ScanReadError("its first bytes are not those of glTF")
    version, length, length_of_tree = struct.unpack_from("<III", data, 4)
    if version != VERSION or data[16:20] != JSON_CHUNK:
        raise ScanReadError("it is not glTF 2.0")
    if not 20 + length_of_tree <= length <= len(data):
        raise ScanReadError(f"its header promises {length} bytes, it has {len(data)}")
    try:
        tree = json.loads(data[20 : 20 + length_of_tree])
    except UnicodeDecodeError as error:
        raise ScanReadError("its JSON part holds bytes that are no text") from error
    start, binary = 20 + length_of_tree, b""
    while start + 8 <= length and not binary:
        size, kind = struct.unpack_from("<I4s", data, start)
        start += 8 + size
        if start > length:
            raise ScanReadError("its binary part is cut short")
        if kind == BINARY_CHUNK:
            binary = data[start - size : start]
    return Document(tree, binary, len(data))


def _scene(document: Document) -> tuple[NDArray[Any], NDArray[Any]]:
    """(n, 3) vertices in the frame of the scene, and (m, 3) triangles."""
    tree = document.tree
    placed = list(_placed_meshes(tree))
    sizes = {mesh: _n_values(tree, mesh) for mesh in {mesh for mesh, _ in placed}}
    n_values, most = sum(sizes[mesh] for mesh, _ in placed), max(document.n_bytes, MOST_OF_SMALL_FILE)
    if n_values > most:
        raise ScanReadError(f"its scene promises {n_values} values, it has {document.n_bytes} bytes")
    meshes = {
        mesh: [_primitive(document, primitive) for primitive in tree["meshes"][mesh]["primitives"]]
        for mesh in sizes
    }
    points, triangles, n_points = [], [], 0
    for mesh, motion in placed:
        for vertices, faces in meshes[mesh]:
            points.append(_moved(vertices.astype(np.float64), motion))
            # A reflection reverses the orientation of triangles.
            triangles.append((faces[:, ::-1] if np.linalg.det(motion[:3, :3]) < 0 else faces) + n_points)
            n_points += len(vertices)
    if not n_points:
        raise ScanReadError("its scene has no vertices")
    return np.concatenate(points), np.concatenate(triangles)


def _placed_meshes(tree: Any) -> Iterator[tuple[int, FloatArray]]:
    """Yield the mesh of each node, with the (4, 4) transform to the frame of the scene."""
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
            yield node["mesh"], motion


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
    vertices = _values(document, primitive["attributes"]["POSITION"], "VEC3")
    mode = primitive.get("mode", TRIANGLES)
    if mode not in (TRIANGLES, STRIP, FAN):
        return Primitive(vertices, np.empty((0, 3), dtype=np.int64))
    corners = np.arange(len(vertices))
    if "indices" in primitive:
        corners = _values(document, primitive["indices"], "SCALAR")[:, 0].astype(np.int64)
        if len(corners) and not 0 <= corners.min() <= corners.max() < len(vertices):
            raise ScanReadError(f"its faces name vertex {corners.max()}, of {len(vertices)}")
    if mode == TRIANGLES:
        return Primitive(vertices, corners.reshape(-1, 3))
    k = np.arange(max(len(corners) - 2, 0))
    # Every second triangle of a strip has the opposite orientation.
    order = (k, k + 1 + k % 2, k + 2 - k % 2) if mode == STRIP else (k + 1, k + 2, 0 * k)
    return Primitive(vertices, corners[np.column_stack(order)])


def _values(document: Document, accessor: int, kind: str) -> NDArray[Any]:
    """The (count, width) values of an accessor."""
    declared = document.tree["accessors"][accessor]
    if "sparse" in declared or "bufferView" not in declared:
        raise ScanReadError("its values are sparse or compressed: export it plainly")
    if declared["type"] != kind:
        raise ScanReadError(f"positions must be VEC3 and indices SCALAR, one is {declared['type']}")
    view = document.tree["bufferViews"][declared["bufferView"]]
    if view["buffer"] != 0 or "uri" in document.tree["buffers"][0]:
        raise ScanReadError("its values lie outside of it: export it with everything in one file")
    count, width, dtype = declared["count"], WIDTHS[kind], np.dtype(COMPONENTS[declared["componentType"]])
    stride = view.get("byteStride", width * dtype.itemsize)
    start = view.get("byteOffset", 0)
    first = start + declared.get("byteOffset", 0)
    stop = first + (count - 1) * stride + width * dtype.itemsize
    if not 0 <= start <= first <= stop <= start + view["byteLength"] <= len(document.binary):
        raise ScanReadError(f"its binary part is too short for {count} values")
    values: NDArray[Any] = np.ndarray((count, width), dtype, document.binary, first, (stride, dtype.itemsize))
    if declared.get("normalized", False) and dtype.kind != "f":
        return np.maximum(values / np.iinfo(dtype).max, -1)
    return values


GLB = Format((".glb",), read_glb, write_mesh=partial(mesh_bytes, file_type="glb"))
