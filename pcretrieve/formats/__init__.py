"""Scan and mesh files.

In comes a path, and a point cloud or a triangle mesh goes out; or the reverse. Several files that belong
together, such as posed range scans, are read as one scan.
"""

from pcretrieve.formats.files import check_file
from pcretrieve.formats.raw import RawScan
from pcretrieve.formats.read import read_scan, readers
from pcretrieve.formats.signatures import write_signatures
from pcretrieve.formats.views import view_paths
from pcretrieve.formats.write import write_cloud
from pcretrieve.formats.write_mesh import write_mesh

__all__ = [
    "RawScan",
    "check_file",
    "read_scan",
    "readers",
    "view_paths",
    "write_cloud",
    "write_mesh",
    "write_signatures",
]
