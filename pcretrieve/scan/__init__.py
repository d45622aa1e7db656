"""Raw points: readers by suffix, merging of posed views, cleaning, normals and their orientation."""

from pcretrieve.scan.clean import clean
from pcretrieve.scan.files import check_file
from pcretrieve.scan.normals import oriented_normals
from pcretrieve.scan.raw import RawScan
from pcretrieve.scan.read import read_scan, readers
from pcretrieve.scan.views import view_paths

__all__ = ["RawScan", "check_file", "clean", "oriented_normals", "read_scan", "readers", "view_paths"]
