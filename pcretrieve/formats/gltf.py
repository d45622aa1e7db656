"""The formats glTF 2.0 [1]_ and GLB: triangles and points of the scene, without materials.

A file is a tree in JSON, and buffers with the values: a part of a GLB file, data URIs, or files below the
folder of a glTF file. trimesh allocates what an accessor declares before it can be checked, takes minutes for
nodes that lie deep in each other, reads normalised positions as whole numbers, and leaves out fans.

References
----------
.. [1] Khronos Group, "glTF 2.0 Specification", 2021,
   https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html.
"""

from __future__ import annotations

import base64
import json
import re
import struct
from functools import cache, partial
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote, urlsplit

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import ScanReadError
from pcretrieve.formats.format import (
    Cut,
    Damaged,
    Part,
    RawScan,
    check_file,
    distinct_names,
    joined,
)
from pcretrieve.formats.meshes import Scene, check_size, moved
from pcretrieve.values import FloatArray, polygon_triangles, strip_triangles
from pcretrieve.values.files import check_members

COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
# Largest JSON part; bytes. Beyond it are values as text (data URIs), which a GLB file holds as they are.
MOST_JSON_BYTES = 1 << 26
# Largest number of values in it, each of which takes up to 300 bytes of memory. 1,000 bodies with materials
# have about 150,000.
MOST_JSON_VALUES = 250_000
# Extensions that store or place vertices otherwise; others are of materials, or may be left out.
UNREAD = re.compile("compression|quantized|instancing")
WIDTHS = {"SCALAR": 1, "VEC3": 3}
# Modes of a primitive with triangles; the others are points and lines.
TRIANGLES = 4
STRIP = 5
FAN = 6


def gltf_scene(path: Path) -> Scene:
    """The bodies of a glTF or GLB file."""
    tree, buffers, n_bytes = _document(path)
    placed = _placed(tree, n_bytes)
    nodes = tree["nodes"]
    meshes = tree["meshes"]
    labels = (
        nodes[node].get("name") or meshes[placed[node][0]].get("name") or ""
        for node in sorted(placed)
    )
    names = zip(distinct_names(map(str, labels)), sorted(placed), strict=True)

    @cache
    def parts(mesh: int) -> list[RawScan]:
        return [
            _primitive(tree, buffers, primitive)
            for primitive in meshes[mesh]["primitives"]
        ]

    def body(mesh: int, motion: FloatArray) -> RawScan:
        empty = RawScan(np.empty((0, 3)))  # of a mesh without primitives
        return joined([empty, *(moved(part, motion) for part in parts(mesh))])._replace(
            unit="m"
        )

    return {name: partial(body, *placed[node]) for name, node in names}


def buffer_files(path: Path) -> tuple[Part, ...]:
    """The files that hold the buffers of a glTF file."""
    check_file(path)
    with path.open("rb") as file:
        tree = _tree(file.read(MOST_JSON_BYTES + 1))
    uris = [str(buffer["uri"]) for buffer in tree.get("buffers", [])]
    check_members(len(uris))
    return tuple(
        map(
            Part,
            dict.fromkeys(
                _file(path, uri) for uri in uris if not uri.startswith("data:")
            ),
        )
    )


def _tree(text: bytes) -> Any:
    """The tree of a JSON part, whose size is checked before it is parsed."""
    # Each value of a tree follows one of these signs.
    n_values = sum(map(text.count, (b"{", b"[", b",")))
    if len(text) > MOST_JSON_BYTES or n_values > MOST_JSON_VALUES:
        raise ScanReadError(
            f"the JSON of glTF must have at most {MOST_JSON_BYTES >> 20} MiB and {MOST_JSON_VALUES} values, "
            f"this one has {len(text) / (1 << 20):.1f} MiB or more with {n_values} values: export the bodies "
            "alone, without animations, as .glb"
        )
    return json.loads(text)


def _document(path: Path) -> tuple[Any, list[bytes], int]:
    """The tree of a file, its buffers by number, and the size of both; bytes."""
    data = path.read_bytes()
    is_glb = path.suffix.lower() == ".glb"
    text, binary = _chunks(data) if is_glb else (data, b"")
    tree = _tree(text)
    for name in tree.get("extensionsRequired", []):
        if UNREAD.search(name):
            raise ScanReadError(
                f"its meshes are stored by the extension {name}: export them without it, uncompressed"
            )
    if not is_glb and not str(tree["asset"]["version"]).startswith("2."):
        raise Damaged(f"it is not glTF 2.0, but {str(tree['asset']['version'])[:10]}")
    buffers = []
    for buffer in tree.get("buffers", []):
        if is_glb and not str(buffer.get("uri", "data:")).startswith("data:"):
            raise Damaged(
                "its values lie outside of it: export it with everything in one file"
            )
        buffers.append(
            binary
            if is_glb and "uri" not in buffer
            else _buffer(path, str(buffer["uri"]))
        )
    return tree, buffers, len(data) + (0 if is_glb else sum(map(len, buffers)))


def _chunks(data: bytes) -> tuple[bytes, bytes]:
    """The JSON part and the binary part of a GLB file."""
    if data[:4] != b"glTF":
        raise Damaged("its first bytes are not those of glTF")
    version, length, length_of_tree, kind = struct.unpack_from("<III4s", data, 4)
    if version != 2 or kind != b"JSON":
        raise Damaged("it is not glTF 2.0")
    start = 20 + length_of_tree
    if not start <= length <= len(data):
        raise Cut(f"its header declares {length} bytes, it has {len(data)}")
    text, binary = data[20:start], b""
    while start + 8 <= length and not binary:
        size, kind = struct.unpack_from("<I4s", data, start)
        start += 8 + size
        if start > length:
            raise Cut("its binary part is cut short")
        if kind == b"BIN\0":
            binary = data[start - size : start]
    return text, binary


def _buffer(path: Path, uri: str) -> bytes:
    if uri.startswith("data:"):
        return base64.b64decode(uri.partition(",")[2])
    file = _file(path, uri)
    try:
        check_file(file)
        return file.read_bytes()
    except OSError as error:
        raise Damaged(f"its buffer {file.name}: {error.strerror or error}") from error
    except ScanReadError as error:
        raise Damaged(f"its buffer {file.name}: {error.message}") from error


def _file(path: Path, uri: str) -> Path:
    """The file of a URI, which may not lead out of the folder of the glTF file."""
    name = PurePosixPath(unquote(uri))
    if (
        urlsplit(uri).scheme
        or name.is_absolute()
        or ".." in name.parts
        or "\0" in str(name)
    ):
        raise Damaged(f"its buffers must be files below its own folder, got {uri[:80]!r}")
    return path.parent / name


def _placed(tree: Any, n_bytes: int) -> dict[int, tuple[int, FloatArray]]:
    """The number of the mesh of each node, whose sizes are checked, and its (4, 4) motion to the scene."""
    nodes = tree.get("nodes", [])
    placed: dict[int, tuple[int, FloatArray]] = {}
    seen = set()
    waiting = [
        (root, np.eye(4))
        for root in tree["scenes"][tree.get("scene", 0)].get("nodes", [])
    ]
    while waiting:
        number, motion = waiting.pop()
        if number in seen:
            raise Damaged(f"node {number} has more than one parent")
        seen.add(number)
        motion = motion @ _transform(nodes[number])
        waiting += [(child, motion) for child in nodes[number].get("children", [])]
        if "mesh" in nodes[number]:
            placed[number] = nodes[number]["mesh"], motion
    sizes = {
        mesh: sum(
            int(tree["accessors"][accessor]["count"])
            for accessor in _accessors(tree, mesh)
        )
        for mesh in {mesh for mesh, _ in placed.values()}
    }
    check_size(sum(sizes[mesh] for mesh, _ in placed.values()), n_bytes)
    check_members(len(placed))
    return placed


def _transform(node: Any) -> FloatArray:
    """The (4, 4) transform from the frame of a node to that of its parent: M T R S."""
    import trimesh

    transformations: Any = trimesh.transformations
    matrix = np.array(node.get("matrix", np.eye(4)), dtype=np.float64).reshape(4, 4).T
    translation = np.eye(4)
    translation[:3, 3] = node.get("translation", 0)
    x, y, z, w = node.get("rotation", (0, 0, 0, 1))
    rotation = transformations.quaternion_matrix([w, x, y, z])
    scale = np.diag([*node.get("scale", (1, 1, 1)), 1.0])
    return np.asarray(matrix @ translation @ rotation @ scale)


def _accessors(tree: Any, mesh: int) -> list[int]:
    """The accessors of the positions and of the indices of a mesh."""
    primitives = tree["meshes"][mesh]["primitives"]
    indices = [primitive["indices"] for primitive in primitives if "indices" in primitive]
    return [primitive["attributes"]["POSITION"] for primitive in primitives] + indices


def _primitive(tree: Any, contents: list[bytes], primitive: Any) -> RawScan:
    """The vertices of a primitive, in the frame of its mesh, and its triangles."""
    vertices = _values(
        tree, contents, primitive["attributes"]["POSITION"], "VEC3"
    ).astype(np.float64)
    mode = primitive.get("mode", TRIANGLES)
    if mode not in (TRIANGLES, STRIP, FAN):
        return RawScan(vertices)
    corners = np.arange(len(vertices))
    if "indices" in primitive:
        corners = _values(tree, contents, primitive["indices"], "SCALAR")[:, 0].astype(
            np.int64
        )
        if len(corners) and not 0 <= corners.min() <= corners.max() < len(vertices):
            raise Damaged(f"its faces name vertex {corners.max()}, of {len(vertices)}")
    faces = corners.reshape(-1, 3) if mode == TRIANGLES else corners[None]
    return RawScan(
        vertices,
        strip_triangles(corners) if mode == STRIP else polygon_triangles([faces]),
    )


def _values(tree: Any, contents: list[bytes], accessor: int, kind: str) -> NDArray[Any]:
    """The (count, width) values of an accessor; normalised integers as numbers from −1 to 1."""
    declared = tree["accessors"][accessor]
    if "sparse" in declared or "bufferView" not in declared:
        raise ScanReadError("its values are sparse or compressed: export it plainly")
    if declared["type"] != kind:
        raise Damaged(
            f"positions must be VEC3 and indices SCALAR, one is {declared['type']}"
        )
    view = tree["bufferViews"][declared["bufferView"]]
    if not 0 <= view["buffer"] < len(contents):
        raise Damaged(
            "its values lie outside of it: export it with everything in one file"
        )
    binary = contents[view["buffer"]]
    count = declared["count"]
    width = WIDTHS[kind]
    dtype = np.dtype(COMPONENTS[declared["componentType"]])
    stride = view.get("byteStride", width * dtype.itemsize)
    start = view.get("byteOffset", 0)
    first = start + declared.get("byteOffset", 0)
    stop = first + (count - 1) * stride + width * dtype.itemsize
    if not 0 <= start <= first <= stop <= start + view["byteLength"] <= len(binary):
        raise Cut(f"its binary part is too short for {count} values")
    values: NDArray[Any] = np.ndarray(
        (count, width), dtype, binary, first, (stride, dtype.itemsize)
    )
    if declared.get("normalized", False) and dtype.kind != "f":
        return np.maximum(values / np.iinfo(dtype).max, -1)
    return values
