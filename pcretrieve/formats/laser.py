"""Files of laser scanners, in metres: LAS and LAZ by laspy, E57 [2]_ by pye57.

laspy follows what a damaged header declares, up to four thousand million records, and lazrs allocates what
the table of the chunks [1]_ and the list of the layers of a chunk declare, and on several threads what the
size of a chunk does, and ends the process if there is not so much memory. The first two are checked, and one
thread reads. E57 files hold scans with the poses of their sensors.

References
----------
.. [1] Martin Isenburg, "LASzip: lossless compression of LiDAR data", PE&RS, 2013.
.. [2] ASTM E2807-11, "Standard Specification for 3D Imaging Data Exchange", 2011.
"""

from __future__ import annotations

import io
import os
import re
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from pcretrieve.errors import ScanReadError
from pcretrieve.formats.format import (
    Cut,
    Damaged,
    Extra,
    RawScan,
    distinct_names,
    joined,
    without_zeros,
)
from pcretrieve.values import FloatArray
from pcretrieve.values.files import check_members

# Header of LAS: its size, the start of the points, and the number of records behind it, each of 54 bytes at
# least.
HEAD = struct.Struct("<94xHII")
RECORD_BYTES = 54
# Classes of points that are not on a surface: low noise, high noise.
NOISE = (7, 18)

LAZRS = Extra("las", ("lazrs",))
# Content of the record of LASzip: the method, the number of items, and the items by type, size and version.
LASZIP = struct.Struct("<H30xH")
ITEM = struct.Struct("<HHH")
# The method that stores a chunk as layers, and the number of layers of each item; extra bytes have one each.
LAYERED = 3
LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
EXTRA_BYTES = 14
# Number of points that are decompressed at a time, so that a file holds what is allocated for it.
AT_ONCE = 1 << 20

# Pages of an E57 file, each with a checksum at its end; bytes. In the header: where the XML part begins in
# the file, and its size without checksums.
PAGE = 1024
CHECKSUM = 4
XML = struct.Struct("<24xQQ")
# Beginning of the XML part: E57 requires UTF-8, in which declarations of entities can be found.
UTF_8 = re.compile(
    rb"""(\xef\xbb\xbf)?\s*(<\?xml\s+version\s*=\s*['"]1\.[01]['"](\s+encoding\s*=\s*['"]utf-8['"])?"""
    rb"""(\s+standalone\s*=\s*['"](yes|no)['"])?\s*\?>)?\s*<[a-z!]""",
    re.IGNORECASE,
)


# --- LAS and LAZ ------------------------------------------------------------------------------------------


def read_las(path: Path) -> RawScan:
    """Read a LAS or LAZ file."""
    import laspy

    data = path.read_bytes()
    _check_records(data)
    try:
        with laspy.open(
            io.BytesIO(data), laz_backend=laspy.LazBackend.Lazrs, read_evlrs=False
        ) as reader:
            _check_points(data, reader.header)
            records = [*reader.chunk_iterator(AT_ONCE)]
    except BaseException as error:
        if (
            type(error).__name__ == "PanicException"
        ):  # of lazrs, which is no Exception of Python
            raise Damaged(str(error)) from error
        raise
    n_points = sum(map(len, records))
    if n_points != reader.header.point_count:
        raise Cut(
            f"its header declares {reader.header.point_count} points, it holds {n_points}"
        )
    if not records:
        return RawScan(np.empty((0, 3)))
    points = np.concatenate(
        [np.column_stack([part.x, part.y, part.z]) for part in records]
    )
    noise = np.concatenate(
        [np.isin(part.classification, NOISE) | (part.withheld != 0) for part in records]
    )  # (n,)
    scan = RawScan(points, unit="m", is_assumed=True)
    if noise.any() and not noise.all():
        note = f"dropped {int(noise.sum())} of {len(points)} points that the file calls noise or withheld"
        scan = scan._replace(points=points[~noise], notes=(note,))
    return without_zeros(scan)


def _check_records(data: bytes) -> None:
    """Check the number of records behind the header, which laspy reads one by one, beyond the end too."""
    if data[:4] != b"LASF" or len(data) < HEAD.size:
        raise Damaged("its first bytes are not those of LAS")
    if data[24] != 1:
        raise Damaged(f"its header says version {data[24]}.{data[25]}")
    size, start, n_records = HEAD.unpack_from(data)
    if not size <= start <= len(data):
        raise Cut(f"its points begin at byte {start}, it has {len(data)}")
    if n_records * RECORD_BYTES > start - size:
        raise Damaged(f"its header declares {n_records} records in {start - size} bytes")


def _check_points(data: bytes, header: Any) -> None:
    """Check what the header declares of the points."""
    if not np.isfinite([header.scales, header.offsets]).all():
        raise Damaged("its scale is not finite")
    start, n_bytes = header.offset_to_point_data, header.point_format.size
    if not header.are_points_compressed:
        if header.point_count * n_bytes > len(data) - start:
            raise Cut(
                f"its header declares {header.point_count} points, {len(data) - start} bytes follow"
            )
        return
    if LAZRS.missing:
        raise ScanReadError(
            f"its points are compressed, which needs lazrs: {LAZRS.command}"
        )
    records = header.vlrs.get("LasZipVlr")
    if not records:
        raise Damaged("it does not say how its points are compressed")
    _check_chunks(data, start, records[0].record_data, n_bytes)


def _check_chunks(data: bytes, start: int, record: bytes, n_bytes: int) -> None:
    """Check that the chunks of compressed points fill the file, and their layers each chunk."""
    import lazrs

    method, n_items = LASZIP.unpack_from(record)
    items = [
        ITEM.unpack_from(record, LASZIP.size + k * ITEM.size) for k in range(n_items)
    ]
    if sum(size for _, size, _ in items) != n_bytes:
        raise Damaged(
            f"its compressed points do not have the {n_bytes} bytes that its header says"
        )
    (table,) = struct.unpack_from("<q", data, start)
    if table == -1:  # a file that was written to a stream has the position at its end
        (table,) = struct.unpack_from("<q", data, len(data) - 8)
    if not start + 8 <= table <= len(data) - 8:
        raise Cut(f"its chunks are listed at byte {table}, it has {len(data)}")
    (n_chunks,) = struct.unpack_from("<I", data, table + 4)
    if n_chunks > len(data):
        raise Damaged(f"it declares {n_chunks} chunks in {len(data)} bytes")
    file = io.BytesIO(data)
    file.seek(start)
    chunks = [size for _, size in lazrs.read_chunk_table(file, lazrs.LazVlr(record))]
    if start + 8 + sum(chunks) != table:
        raise Damaged(
            f"its chunks end at byte {start + 8 + sum(chunks)}, and not at {table}"
        )
    if method != LAYERED:
        return
    n_layers = sum(
        size if kind == EXTRA_BYTES else LAYERS.get(kind, 0) for kind, size, _ in items
    )
    layers = struct.Struct(f"<{n_layers}I")
    at = start + 8
    for chunk in chunks:
        # The first point, the number of points, the sizes of the layers, and the layers.
        promised = (
            n_bytes + 4 + layers.size + sum(layers.unpack_from(data, at + n_bytes + 4))
        )
        if promised != chunk:
            raise Damaged(
                f"the layers of a chunk have {promised} bytes, the chunk has {chunk}"
            )
        at += chunk


# --- E57 --------------------------------------------------------------------------------------------------


def read_e57(path: Path, name: str | None = None) -> RawScan:
    """Read the scans in an E57 file as one, or the scan of a name."""
    with _opened(path) as (file, numbers):
        chosen = [_scan(file, numbers[own]) for own in numbers if name in (None, own)]
        return joined(chosen)


def e57_names(path: Path) -> tuple[str, ...]:
    """The names of the scans in an E57 file."""
    with _opened(path) as (_, numbers):
        return tuple(numbers)


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, dict[str, int]]]:
    """The open file, and the numbers of its scans by name, whose sizes are checked before they are read.

    Scanners write scans without points too, which pye57 does not read.
    """
    import pye57

    _check_xml(path)
    n_bytes = path.stat().st_size
    # As bytes, because a name need not be UTF-8.
    with pye57.E57(os.fsencode(path)) as file:
        # A file of images alone has no list of scans.
        n_scans = file.scan_count if file.root.isDefined("data3D") else 0
        check_members(n_scans)
        headers = {
            number: header
            for number in range(n_scans)
            if (header := file.get_header(number)).point_count
        }
        if not headers:
            raise ScanReadError("the file holds no scans that have points")
        for header in headers.values():
            # A point has at least one bit: its three coordinates cannot all be constant.
            if int(header.point_count) > 8 * n_bytes:
                raise Damaged(
                    f"it declares {header.point_count} points in {n_bytes} bytes"
                )
        named = (
            header["name"].value() if header.node.isDefined("name") else ""
            for header in headers.values()
        )
        yield file, dict(zip(distinct_names(map(str, named)), headers, strict=True))


def _scan(file: Any, number: int) -> RawScan:
    """The points of a scan in the frame of the file, without those that the file marks as invalid."""
    from pye57.utils import convert_spherical_to_cartesian
    from scipy.spatial.transform import Rotation

    header = file.get_header(number)
    data = file.read_scan(number, transform=False, ignore_missing_fields=True)
    points = np.column_stack([*data.values()])
    if "sphericalRange" in data:
        points = convert_spherical_to_cartesian(points)
    position = _pose_part(header.node, "translation", x=0.0, y=0.0, z=0.0)
    rotation = _pose_part(header.node, "rotation", x=0.0, y=0.0, z=0.0, w=1.0)
    points = Rotation.from_quat(rotation).apply(points) + position
    # The default pose, at the origin, is that of a sensor if the points are the grid that it measured.
    is_grid = header.has_pose() and {"rowIndex", "columnIndex"} <= {*header.point_fields}
    return without_zeros(
        RawScan(
            points, viewpoints=position if is_grid or position.any() else None, unit="m"
        )
    )


def _pose_part(node: Any, name: str, **usual: float) -> FloatArray:
    """The numbers of a part of a pose by their names, because pye57 takes them in the order of the file."""
    if node.isDefined(f"pose/{name}"):
        usual = {axis: node[f"pose/{name}/{axis}"].value() for axis in usual}
    return np.array([*usual.values()])


def _check_xml(path: Path) -> None:
    """Refuse XML with a document type, whose entities pye57 would fetch from any file and address."""
    with path.open("rb") as file:
        start, n_bytes = XML.unpack(file.read(XML.size))
        if start + n_bytes > path.stat().st_size:
            raise Cut("its XML part is cut short")
        file.seek(start // PAGE * PAGE)
        pages = iter(lambda: file.read(PAGE)[:-CHECKSUM], b"")
        before, content = start % PAGE, bytearray()
        while len(content) < before + n_bytes and (page := next(pages, b"")):
            content += page
    xml = content[before : before + n_bytes]
    if not UTF_8.match(xml):
        raise Damaged("its XML part is not UTF-8")
    if re.search(rb"<!(doctype|entity)", xml, re.IGNORECASE):
        raise ScanReadError(
            "its XML part has a document type, which E57 does not allow: export it again"
        )
