"""The format PCD of the Point Cloud Library: text, binary and compressed, with the position of the sensor."""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcretrieve.formats.format import (
    Cut,
    Damaged,
    RawScan,
    fields_of,
    numbers_in,
    scan_of_fields,
)
from pcretrieve.values import PointCloud

HEADER = re.compile(rb"\A(.*?)^DATA[ \t]+(\w+)[ \t]*\r?\n", re.MULTILINE | re.DOTALL)
# A header has ten lines, and comments.
MOST_HEADER_BYTES = 1 << 20
SIZES = {"F": (4, 8), "I": (1, 2, 4, 8), "U": (1, 2, 4, 8)}
NORMAL_FIELDS = "normal_x normal_y normal_z"

# Largest compression ratio, of a cloud with few answers, and number of bytes to which any may expand.
MOST_RATIO = 30
ANY_SIZE = 1 << 24
# Largest number of values of a point. The largest descriptor of PCL has 1980.
MOST_VALUES = 4096

# The default of VIEWPOINT, tx ty tz qw qx qy qz: the origin without rotation.
NO_VIEWPOINT = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


def read_pcd(path: Path) -> RawScan:
    """Read a PCD file.

    The positions of the sensors are those of the fields ``vp_x vp_y vp_z`` (PCL's PointWithViewpoint), or
    else VIEWPOINT of the header, which is in the frame of the points. Its default is written by programs that
    do not know the sensor, and is ignored.
    """
    data = path.read_bytes()
    found = HEADER.match(data[:MOST_HEADER_BYTES])
    if found is None:
        raise Damaged("its header has no line DATA")
    record, n_points, viewpoint = _header(found[1].decode("utf-8", "replace"))
    column = _column(record, n_points, found[2].decode(), memoryview(data)[found.end() :])
    scan = scan_of_fields(
        [name for name in record.names or () if not record[name].shape], column
    )
    if len(scan.points) != n_points:
        raise Cut(f"it declares {n_points} points and holds {len(scan.points)}")
    if scan.viewpoints is None and viewpoint != NO_VIEWPOINT:
        return scan._replace(viewpoints=np.array(viewpoint[:3]))
    return scan


def _header(text: str) -> tuple[np.dtype[np.void], int, tuple[float, ...]]:
    """The type of a point, the number of points, and the pose of the sensor."""
    lines = [line.split() for line in text.splitlines() if not line.startswith("#")]
    values = {words[0]: words[1:] for words in lines if words}
    # Fields that only fill up the row have the name _, all of them.
    names = [f"_{k}" if name == "_" else name for k, name in enumerate(values["FIELDS"])]
    counts = [int(count) for count in values.get("COUNT", ["1"] * len(names))]
    if sum(counts) > MOST_VALUES:
        raise Damaged(
            f"its header declares {sum(counts)} values a point, {MOST_VALUES} may be"
        )
    fields: list[Any] = []
    for name, kind, size, count in zip(
        names, values["TYPE"], values["SIZE"], counts, strict=True
    ):
        if int(size) not in SIZES[kind.upper()] or count < 0:
            raise Damaged(
                f"its header declares {name} of the type {kind}, {size} bytes, {count} times"
            )
        # A field of no values, by which lidars fill up a row, takes no bytes.
        fields.append(
            (name, f"<{kind.lower()}{int(size)}", () if count == 1 else (count,))
        )
    (n_points,) = map(int, values["POINTS"])
    viewpoint = tuple(map(float, values.get("VIEWPOINT", NO_VIEWPOINT)))
    if n_points < 0 or len(viewpoint) != len(NO_VIEWPOINT):
        raise Damaged(
            f"its header declares {n_points} points, and {len(viewpoint)} numbers of VIEWPOINT"
        )
    return np.dtype(fields), n_points, viewpoint


def _column(
    record: np.dtype[np.void], n: int, encoding: str, body: memoryview
) -> Callable[[str], NDArray[Any]]:
    """How the (n,) values of a field are found; the size of the file is checked before they are."""
    n_bytes = len(body)
    if encoding == "ascii":
        names = record.names or ()
        *places, width = np.cumsum(
            [0, *(math.prod(record[name].shape) for name in names)]
        )
        numbers = numbers_in(bytes(body).decode("latin-1"), "lines of points")
        if len(numbers) % width:
            raise Cut("its last line lacks values")
        first = dict(zip(names, places, strict=True))
        return lambda name: numbers[first[name] :: width]
    if encoding not in ("binary", "binary_compressed"):
        raise Damaged(f"its data are {encoding}")
    if encoding != "binary" and n:
        packed, n_bytes = struct.unpack_from("<II", body)
        if packed > len(body) - 8 or n_bytes > max(ANY_SIZE, MOST_RATIO * packed):
            raise Cut(f"it declares {n_bytes} bytes in {packed}, {len(body) - 8} follow")
    if n * record.itemsize > n_bytes:
        raise Cut(f"its header declares {n} points, {n_bytes} bytes follow")
    if encoding == "binary" or not n:
        return np.frombuffer(body, record, n).__getitem__
    import lzf

    whole = lzf.decompress(bytes(body[8 : 8 + packed]), n_bytes)
    if whole is None or len(whole) != n_bytes:
        raise Damaged(f"its points do not expand to {n_bytes} bytes")
    # All values of the first field, then all of the second.
    starts = {name: place[1] * n for name, place in (record.fields or {}).items()}
    return lambda name: np.frombuffer(whole, record[name], n, starts[name])


def pcd_bytes(cloud: PointCloud) -> bytes:
    """The content of a file of points, in single precision as the point types of PCL and its programs."""
    fields, table = fields_of(cloud, NORMAL_FIELDS)
    n, repeated = len(table), {word: " ".join([word] * len(fields)) for word in "4F1"}
    header = (
        "# .PCD v0.7 - Point Cloud Data file format\n"
        f"VERSION 0.7\nFIELDS {' '.join(fields)}\nSIZE {repeated['4']}\nTYPE {repeated['F']}\n"
        f"COUNT {repeated['1']}\nWIDTH {n}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA binary\n"
    )
    return header.encode() + table.astype("<f4").tobytes()
