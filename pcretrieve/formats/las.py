"""The formats LAS and LAZ of laser scanners, in metres, read by laspy.

laspy follows what a damaged header declares, up to four thousand million records, and lazrs allocates what
the table of the chunks [1]_ and the list of the layers of a chunk declare, and ends the process if there is
not so much memory. Both are checked first.

References
----------
.. [1] Martin Isenburg, "LASzip: lossless compression of LiDAR data", PE&RS, 2013.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from pcretrieve.errors import ScanReadError
from pcretrieve.formats.format import Extra, Format, RawScan, incomplete

# Header: its size, the start of the points, and the number of records behind it, each of 54 bytes at least.
HEAD = struct.Struct("<94xHII")
RECORD_BYTES = 54
# Classes of points that are not on a surface: low noise, high noise.
NOISE = (7, 18)

LAZRS = Extra("las", ("lazrs",))
# Content of the record of LASzip: the method, the number of items, and the items by type, size and version.
LASZIP, ITEM = struct.Struct("<H30xH"), struct.Struct("<HHH")
# The method that stores a chunk as layers, and the number of layers of each item; extra bytes have one each.
LAYERED, LAYERS, EXTRA_BYTES = 3, {10: 9, 11: 1, 12: 2, 13: 1}, 14
# Number of points that are decompressed at a time, so that a file holds what is allocated for it.
AT_ONCE = 1 << 20


def read_las(path: Path) -> RawScan:
    """Read a LAS or LAZ file."""
    data = path.read_bytes()
    with _damage(path):
        import laspy

        _check_records(data)
        with laspy.open(io.BytesIO(data), read_evlrs=False) as reader:
            _check_points(data, reader.header)
            records = [*reader.chunk_iterator(AT_ONCE)]
        n_points = sum(map(len, records))
        if n_points != reader.header.point_count:
            raise ValueError(f"its header declares {reader.header.point_count} points, it holds {n_points}")
        if not records:
            return RawScan(np.empty((0, 3)), unit="m")
        points = np.concatenate([np.column_stack([part.x, part.y, part.z]) for part in records])
        noise = np.isin(np.concatenate([np.asarray(part.classification) for part in records]), NOISE)  # (n,)
    if not noise.any():
        return RawScan(points, unit="m")
    note = f"dropped {int(noise.sum())} of {len(points)} points that the file classifies as noise"
    return RawScan(points[~noise], notes=(note,), unit="m")


@contextmanager
def _damage(path: Path) -> Iterator[None]:
    """Turn what laspy and lazrs raise for a damaged file into an error of the file."""
    try:
        yield
    except (MemoryError, KeyboardInterrupt, SystemExit, ScanReadError):
        raise
    except struct.error as error:
        raise incomplete(path, "its header is cut short") from error
    # A panic of lazrs is no Exception of Python.
    except BaseException as error:
        raise incomplete(path, error) from error


def _check_records(data: bytes) -> None:
    """Check the number of records behind the header, which laspy reads one by one, beyond the end too."""
    if data[:4] != b"LASF" or len(data) < HEAD.size:
        raise ValueError("its first bytes are not those of LAS")
    if data[24] != 1:
        raise ValueError(f"its header says version {data[24]}.{data[25]}")
    size, start, n_records = HEAD.unpack_from(data)
    if not size <= start <= len(data):
        raise ValueError(f"its points begin at byte {start}, it has {len(data)}")
    if n_records * RECORD_BYTES > start - size:
        raise ValueError(f"its header declares {n_records} records in {start - size} bytes")


def _check_points(data: bytes, header: Any) -> None:
    """Check what the header declares of the points."""
    if not np.isfinite([header.scales, header.offsets]).all():
        raise ValueError("its scale is not finite")
    start, n_bytes = header.offset_to_point_data, header.point_format.size
    if not header.are_points_compressed:
        if header.point_count * n_bytes > len(data) - start:
            raise ValueError(
                f"its header declares {header.point_count} points, {len(data) - start} bytes follow"
            )
        return
    if LAZRS.missing:
        raise ScanReadError(f"its points are compressed, which needs lazrs: {LAZRS.command}")
    records = header.vlrs.get("LasZipVlr")
    if not records:
        raise ValueError("it does not say how its points are compressed")
    _check_chunks(data, start, records[0].record_data, n_bytes)


def _check_chunks(data: bytes, start: int, record: bytes, n_bytes: int) -> None:
    """Check that the chunks of compressed points fill the file, and their layers each chunk."""
    import lazrs

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
    file = io.BytesIO(data)
    file.seek(start)
    chunks = [size for _, size in lazrs.read_chunk_table(file, lazrs.LazVlr(record))]
    if start + 8 + sum(chunks) != table:
        raise ValueError(f"its chunks end at byte {start + 8 + sum(chunks)}, and not at {table}")
    if method != LAYERED:
        return
    n_layers = sum(size if kind == EXTRA_BYTES else LAYERS.get(kind, 0) for kind, size, _ in items)
    layers = struct.Struct(f"<{n_layers}I")
    at = start + 8
    for chunk in chunks:
        # The first point, the number of points, the sizes of the layers, and the layers.
        promised = n_bytes + 4 + layers.size + sum(layers.unpack_from(data, at + n_bytes + 4))
        if promised != chunk:
            raise ValueError(f"the layers of a chunk have {promised} bytes, the chunk has {chunk}")
        at += chunk


LAS = Format((".las",), read_las)
LAZ = Format((".laz",), read_las, extra=LAZRS)
