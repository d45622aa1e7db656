"""Scan and mesh files.

In comes a path, and a point cloud or a triangle mesh goes out; or the reverse. Several files that belong
together, such as posed range scans, are read as one scan.
"""

from pcretrieve.formats.conf import image_poses, trajectory_file
from pcretrieve.formats.format import Extra, Format, Part, RawScan, check_file, url_of
from pcretrieve.formats.meshes import mesh_bytes
from pcretrieve.formats.read import ScanLike, as_scan, read_scan
from pcretrieve.formats.registry import (
    MARK,
    is_scan,
    members_of,
    missing_extra,
    parts_of,
    split_member,
    suffixes,
)
from pcretrieve.formats.remote import local_copy, remote_files, remote_version
from pcretrieve.formats.write import check_output, write_cloud, write_mesh, write_signatures

__all__ = [
    "MARK",
    "Extra",
    "Format",
    "Part",
    "RawScan",
    "ScanLike",
    "as_scan",
    "check_file",
    "check_output",
    "image_poses",
    "is_scan",
    "local_copy",
    "members_of",
    "mesh_bytes",
    "missing_extra",
    "parts_of",
    "read_scan",
    "remote_files",
    "remote_version",
    "split_member",
    "suffixes",
    "trajectory_file",
    "url_of",
    "write_cloud",
    "write_mesh",
    "write_signatures",
]
