"""Scan and mesh files.

In comes a path, and a point cloud or a triangle mesh goes out; or the reverse. Several files that belong
together, such as posed range scans, are read as one scan.
"""

from pcretrieve.formats.files import (
    ScanLike,
    as_scan,
    located,
    read_scan,
    write_cloud,
    write_mesh,
)
from pcretrieve.formats.format import Extra, Format, Part, RawScan
from pcretrieve.formats.registry import (
    ScanPath,
    is_scan,
    members_of,
    parts_of,
)

__all__ = [
    "Extra",
    "Format",
    "Part",
    "RawScan",
    "ScanLike",
    "ScanPath",
    "as_scan",
    "is_scan",
    "located",
    "members_of",
    "parts_of",
    "read_scan",
    "write_cloud",
    "write_mesh",
]
