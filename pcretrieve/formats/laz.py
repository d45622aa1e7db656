"""The compressed points of LAZ files [1]_, whose tables are checked before lazrs uses them.

Points are compressed in chunks. lazrs allocates what the table of the chunks and the list of the layers of a
chunk declare, and ends the process if there is not so much memory.

References
----------
.. [1] Martin Isenburg, "LASzip: lossless compression of LiDAR data", PE&RS, 2013.
"""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from pcretrieve.formats.lazrs import chunk_sizes, decompressed

__all__ = ["laszip_record", "unpacked"]

# Header of a variable length record: its user, its number, and the size of its content.
RECORD = struct.Struct("<2x16sHH32x")
LASZIP_USER, LASZIP_NUMBER = b"laszip encoded", 22204
# Content of the record of LASzip: the method, the number of items, and the items by type, size and version.
LASZIP, ITEM = struct.Struct("<H30xH"), struct.Struct("<HHH")
# The method that stores a chunk as layers, and the number of layers of each item; extra bytes have one each.
LAYERED, LAYERS, EXTRA_BYTES = 3, {10: 9, 11: 1, 12: 2, 13: 1}, 14
# Number of points that are decompressed at a time.
AT_ONCE = 1 << 20


def laszip_record(records: bytes, n_records: int) -> bytes:
    """The variable length record that describes the compression of the points."""
    at = 0
    for _ in range(n_records):
        user, number, size = RECORD.unpack_from(records, at)
        at += RECORD.size
        if user.rstrip(b"\0") == LASZIP_USER and number == LASZIP_NUMBER:
            return records[at : at + size]
        at += size
    raise ValueError("it does not say how its points are compressed")


def unpacked(data: bytes, start: int, record: bytes, n_points: int, n_bytes: int) -> NDArray[np.uint8]:
    """Decompress the points of a file.

    start: position of the points; bytes.
    Returns (n, b) uint8: the bytes of the points.
    """
    method, n_items = LASZIP.unpack_from(record)
    items = [ITEM.unpack_from(record, LASZIP.size + k * ITEM.size) for k in range(n_items)]
    if sum(size for _, size, _ in items) != n_bytes:
        raise ValueError(f"its compressed points do not have the {n_bytes} bytes that its header says")
    (table,) = struct.unpack_from("<q", data, start)
    if table == -1:  # a file that was written to a stream has the position at its end
        (table,) = struct.unpack_from("<q", data, len(data) - 8)
    if not start + 8 <= table <= len(data) - 8:
        raise ValueError(f"its chunks are listed at byte {table}, it has {len(data)}")
    (n_chunks,) = struct.unpack_from("<I", data, table + 4)
    if n_chunks > len(data):
        raise ValueError(f"it declares {n_chunks} chunks in {len(data)} bytes")
    chunks = chunk_sizes(data, start, record)
    if start + 8 + sum(chunks) != table:
        raise ValueError(f"its chunks end at byte {start + 8 + sum(chunks)}, and not at {table}")
    if method == LAYERED:
        n_layers = sum(size if kind == EXTRA_BYTES else LAYERS.get(kind, 0) for kind, size, _ in items)
        _check_layers(data, start + 8, chunks, n_layers, n_bytes)
    return decompressed(data, start, record, n_points, n_bytes, AT_ONCE)


def _check_layers(data: bytes, start: int, chunks: list[int], n_layers: int, n_bytes: int) -> None:
    """Check that the layers fill each chunk, behind its first point, its number of points and their sizes."""
    sizes = struct.Struct(f"<{n_layers}I")
    head = n_bytes + 4 + sizes.size
    for chunk in chunks:
        promised = head + sum(sizes.unpack_from(data, start + n_bytes + 4))
        if promised != chunk:
            raise ValueError(f"the layers of a chunk have {promised} bytes, the chunk has {chunk}")
        start += chunk
