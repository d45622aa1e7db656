"""Scan and mesh files.

In comes a path, and a point cloud or a triangle mesh goes out; or the reverse. Several files that belong
together, such as posed range scans, are read as one scan.
"""

from pcretrieve.formats.contents import is_scan, members_of, parts_of
from pcretrieve.formats.files import check_file
from pcretrieve.formats.format import Extra, Format, Part
from pcretrieve.formats.members import MARK
from pcretrieve.formats.raw import RawScan
from pcretrieve.formats.read import read_scan
from pcretrieve.formats.registry import missing_extra, split_member, suffixes
from pcretrieve.formats.remote import local_copy, remote_files, remote_version
from pcretrieve.formats.signatures import write_signatures
from pcretrieve.formats.trajectory import image_poses, trajectory_file
from pcretrieve.formats.urls import url_of
from pcretrieve.formats.write import check_output, write_cloud, write_mesh

__all__ = [
    "MARK",
    "Extra",
    "Format",
    "Part",
    "RawScan",
    "check_file",
    "check_output",
    "image_poses",
    "is_scan",
    "local_copy",
    "members_of",
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
