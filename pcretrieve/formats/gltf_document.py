"""The parts of a glTF 2.0 file [1]_: the JSON tree, and the buffers with the values.

A GLB file holds both. A glTF file is the tree alone; its buffers are data URIs, or files below its folder.

References
----------
.. [1] Khronos Group, "glTF 2.0 Specification", 2021,
   https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html.
"""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple
from urllib.parse import unquote, urlsplit

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import ScanReadError
from pcretrieve.formats.files import check_file

__all__ = ["Document", "buffer_files", "read_glb_document", "read_gltf_document", "values_of"]

MAGIC, VERSION = b"glTF", 2
JSON_CHUNK, BINARY_CHUNK = b"JSON", b"BIN\0"

COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC3": 3}


class Document(NamedTuple):
    """The JSON tree of a file, its buffers, and the size of the file and of the buffers; bytes."""

    tree: Any
    buffers: tuple[bytes, ...]
    n_bytes: int


def read_glb_document(path: Path) -> Document:
    """Read a GLB file: a header, a chunk of JSON, and a binary chunk, the buffer without an address."""
    data = path.read_bytes()
    if data[:4] != MAGIC or len(data) < 20:
        raise ScanReadError("its first bytes are not those of glTF")
    version, length, length_of_tree = struct.unpack_from("<III", data, 4)
    if version != VERSION or data[16:20] != JSON_CHUNK:
        raise ScanReadError("it is not glTF 2.0")
    if not 20 + length_of_tree <= length <= len(data):
        raise ScanReadError(f"its header declares {length} bytes, it has {len(data)}")
    tree = _tree(data[20 : 20 + length_of_tree])
    start, binary = 20 + length_of_tree, b""
    while start + 8 <= length and not binary:
        size, kind = struct.unpack_from("<I4s", data, start)
        start += 8 + size
        if start > length:
            raise ScanReadError("its binary part is cut short")
        if kind == BINARY_CHUNK:
            binary = data[start - size : start]
    buffers = tuple(
        _data(str(buffer["uri"])) if "uri" in buffer else binary for buffer in tree.get("buffers", [])
    )
    return Document(tree, buffers, len(data))


def read_gltf_document(path: Path) -> Document:
    """Read a glTF file and its buffers."""
    data = path.read_bytes()
    tree = _tree(data)
    if not str(tree["asset"]["version"]).startswith(f"{VERSION}."):
        raise ScanReadError(f"it is not glTF 2.0, but {str(tree['asset']['version'])[:10]}")
    buffers = tuple(_buffer(path, str(buffer["uri"])) for buffer in tree.get("buffers", []))
    return Document(tree, buffers, len(data) + sum(map(len, buffers)))


def buffer_files(path: Path) -> tuple[Path, ...]:
    """The files that hold the buffers of a glTF file."""
    check_file(path)
    try:
        uris = [str(buffer["uri"]) for buffer in _tree(path.read_bytes()).get("buffers", [])]
    except (AttributeError, LookupError, RecursionError, TypeError, ValueError) as error:
        raise ScanReadError(f"its list of buffers is damaged: {type(error).__name__} {error}") from error
    return tuple(dict.fromkeys(_file(path, uri) for uri in uris if not uri.startswith("data:")))


def values_of(document: Document, accessor: int, kind: str) -> NDArray[Any]:
    """The values of an accessor.

    Returns (count, width) array: a view of the buffer; normalised integers as numbers from −1 to 1.
    """
    declared = document.tree["accessors"][accessor]
    if "sparse" in declared or "bufferView" not in declared:
        raise ScanReadError("its values are sparse or compressed: export it plainly")
    if declared["type"] != kind:
        raise ScanReadError(f"positions must be VEC3 and indices SCALAR, one is {declared['type']}")
    view = document.tree["bufferViews"][declared["bufferView"]]
    if not 0 <= view["buffer"] < len(document.buffers):
        raise ScanReadError("its values lie outside of it: export it with everything in one file")
    binary = document.buffers[view["buffer"]]
    count, width, dtype = declared["count"], WIDTHS[kind], np.dtype(COMPONENTS[declared["componentType"]])
    stride = view.get("byteStride", width * dtype.itemsize)
    start = view.get("byteOffset", 0)
    first = start + declared.get("byteOffset", 0)
    stop = first + (count - 1) * stride + width * dtype.itemsize
    if not 0 <= start <= first <= stop <= start + view["byteLength"] <= len(binary):
        raise ScanReadError(f"its binary part is too short for {count} values")
    values: NDArray[Any] = np.ndarray((count, width), dtype, binary, first, (stride, dtype.itemsize))
    if declared.get("normalized", False) and dtype.kind != "f":
        return np.maximum(values / np.iinfo(dtype).max, -1)
    return values


def _tree(data: bytes) -> Any:
    try:
        return json.loads(data)
    except UnicodeDecodeError as error:
        raise ScanReadError("its JSON part holds bytes that are no text") from error


def _data(uri: str) -> bytes:
    """The content of a data URI."""
    if not uri.startswith("data:"):
        raise ScanReadError("its values lie outside of it: export it with everything in one file")
    return base64.b64decode(uri.partition(",")[2])


def _buffer(path: Path, uri: str) -> bytes:
    if uri.startswith("data:"):
        return _data(uri)
    file = _file(path, uri)
    try:
        check_file(file)
        return file.read_bytes()
    except OSError as error:
        raise ScanReadError(f"its buffer {file.name}: {error.strerror or error}") from error
    except ScanReadError as error:
        raise ScanReadError(f"its buffer {file.name}: {error.message}") from error


def _file(path: Path, uri: str) -> Path:
    """The file of a URI, which may not lead out of the folder of the glTF file."""
    name = PurePosixPath(unquote(uri))
    if urlsplit(uri).scheme or name.is_absolute() or ".." in name.parts or "\0" in str(name):
        raise ScanReadError(f"its buffers must be files below its own folder, got {uri[:80]!r}")
    return path.parent / name
