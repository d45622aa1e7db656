"""The format PCD of the Point Cloud Library: text, binary and compressed, with the position of the sensor."""

from __future__ import annotations

import io
import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import ScanReadError
from pcretrieve.formats.format import Format, RawScan, columns_of, incomplete
from pcretrieve.values import PointCloud

HEADER = re.compile(rb"\A(.*?)^DATA[ \t]+(\w+)[ \t]*\r?\n", re.MULTILINE | re.DOTALL)
# A header has ten lines, and comments.
MOST_HEADER_BYTES = 1 << 20
KINDS = {"F": "<f", "I": "<i", "U": "<u"}
SIZES = {"F": (4, 8), "I": (1, 2, 4, 8), "U": (1, 2, 4, 8)}

# Largest compression ratio of LZF: 264 bytes in 3.
LZF_RATIO = 88
# Largest number of values of a point. The largest descriptor of PCL has 1980.
MOST_VALUES = 4096

# The default of VIEWPOINT, tx ty tz qw qx qy qz: the origin without rotation.
NO_VIEWPOINT = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


class Header(NamedTuple):
    """The type of a point, the number of points, and the pose of the sensor."""

    record: np.dtype[np.void]
    n_points: int
    viewpoint: tuple[float, ...]


def read_pcd(path: Path) -> RawScan:
    """Read a PCD file.

    The positions of the sensors are those of the fields ``vp_x vp_y vp_z`` (PCL's PointWithViewpoint), or
    else VIEWPOINT of the header, which is in the frame of the points. Its default is written by programs that
    do not know the sensor, and is ignored.
    """
    data = path.read_bytes()
    found = HEADER.match(data[:MOST_HEADER_BYTES])
    if found is None:
        raise incomplete(path, "its header has no line DATA")
    try:
        header = _header(found[1].decode("utf-8"))
        column = _column(header, found[2].decode(), memoryview(data)[found.end() :])
    # Numbers of the header that are none, types that do not exist, and text that is no table.
    except (ArithmeticError, LookupError, TypeError, ValueError, struct.error) as error:
        raise incomplete(path, error) from error
    names = header.record.names or ()

    def columns(*wanted: str) -> NDArray[np.float64] | None:
        if not {*wanted} <= {name for name in names if not header.record[name].shape}:
            return None
        table = np.empty((len(column(wanted[0])), len(wanted)))
        for k, name in enumerate(wanted):
            table[:, k] = column(name)
        return table

    points = columns("x", "y", "z")
    if points is None:
        raise ScanReadError(f"a PCD scan must have the fields x y z, this one has {' '.join(names)}")
    if len(points) != header.n_points:
        raise incomplete(path, f"it declares {header.n_points} points and holds {len(points)}")
    viewpoints = columns("vp_x", "vp_y", "vp_z")
    if viewpoints is None and header.viewpoint != NO_VIEWPOINT:
        viewpoints = np.array(header.viewpoint[:3])
    return RawScan(points, None, columns("normal_x", "normal_y", "normal_z"), viewpoints)


def _header(text: str) -> Header:
    lines = [line.split() for line in text.splitlines() if not line.startswith("#")]
    values = {words[0]: words[1:] for words in lines if words}
    # Fields that only fill up the row have the name _, all of them.
    names = [f"_{k}" if name == "_" else name for k, name in enumerate(values["FIELDS"])]
    counts = [int(count) for count in values.get("COUNT", ["1"] * len(names))]
    if sum(counts) > MOST_VALUES:
        raise ValueError(f"its header declares {sum(counts)} values a point, {MOST_VALUES} may be")
    fields: list[Any] = []
    for name, kind, size, count in zip(names, values["TYPE"], values["SIZE"], counts, strict=True):
        if int(size) not in SIZES[kind] or count < 1:
            raise ValueError(f"its header declares {name} of the type {kind}, {size} bytes, {count} times")
        fields.append((name, f"{KINDS[kind]}{int(size)}", *([(count,)] if count > 1 else [])))
    (n_points,) = map(int, values["POINTS"])
    viewpoint = tuple(map(float, values.get("VIEWPOINT", NO_VIEWPOINT)))
    if n_points < 0 or len(viewpoint) != len(NO_VIEWPOINT):
        raise ValueError(f"its header declares {n_points} points, and {len(viewpoint)} numbers of VIEWPOINT")
    return Header(np.dtype(fields), n_points, viewpoint)


def _column(header: Header, encoding: str, body: memoryview) -> Callable[[str], NDArray[Any]]:
    """How the (n,) values of a field are found; the size of the file is checked before they are."""
    record, n, _ = header
    if encoding == "ascii":
        rows = np.loadtxt(io.BytesIO(body), record, ndmin=1) if n else np.empty(0, record)
        return rows.__getitem__
    if encoding == "binary":
        _check_promise(header, len(body))
        return np.frombuffer(body, record, n).__getitem__
    if encoding not in ("binary_compressed", "binaryscompressed"):
        raise ValueError(f"its data are {encoding}")
    if not n:
        return np.empty(0, record).__getitem__
    import lzf

    packed, size = struct.unpack_from("<II", body)
    if packed > len(body) - 8 or size > LZF_RATIO * packed:
        raise ValueError(f"it declares {size} bytes in {packed}, {len(body) - 8} follow")
    _check_promise(header, size)
    whole = lzf.decompress(bytes(body[8 : 8 + packed]), size)
    if whole is None or len(whole) != size:
        raise ValueError(f"its points do not expand to {size} bytes")
    # All values of the first field, then all of the second.
    starts = {name: record.fields[name][1] * n for name in record.names or ()} if record.fields else {}
    return lambda name: np.frombuffer(whole, record[name], n, starts[name])


def _check_promise(header: Header, n_bytes: int) -> None:
    if header.n_points * header.record.itemsize > n_bytes:
        raise ValueError(f"its header declares {header.n_points} points, {n_bytes} bytes follow")


def _pcd_bytes(cloud: PointCloud) -> bytes:
    # The point types of PCL are of single precision, and its programs expect such files.
    fields, table = columns_of(cloud, "x y z", "normal_x normal_y normal_z", "vp_x vp_y vp_z")
    n = len(table)

    def repeated(word: str) -> str:
        return " ".join([word] * len(fields))

    header = (
        "# .PCD v0.7 - Point Cloud Data file format\n"
        f"VERSION 0.7\nFIELDS {' '.join(fields)}\nSIZE {repeated('4')}\nTYPE {repeated('F')}\n"
        f"COUNT {repeated('1')}\nWIDTH {n}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA binary\n"
    )
    return header.encode() + table.astype("<f4").tobytes()


PCD = Format((".pcd",), read_pcd, write_cloud=_pcd_bytes)
