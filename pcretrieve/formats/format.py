"""The record of a file format: what its files are called, and the functions that read and write them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from pcretrieve.arrays import FloatArray
from pcretrieve.formats.members import Members
from pcretrieve.formats.raw import RawScan
from pcretrieve.values import PointCloud, TriangleMesh

__all__ = ["Extra", "Format", "Part"]


class Extra(NamedTuple):
    """What must be installed for a format."""

    name: str
    modules: tuple[str, ...]

    @property
    def command(self) -> str:
        """The command that installs the extra."""
        return f"pip install 'pcretrieve[{self.name}]'"

    @property
    def missing(self) -> tuple[str, ...]:
        """The modules that are not installed."""
        return tuple(module for module in self.modules if find_spec(module) is None)


class Part(NamedTuple):
    """A file that belongs to another file.

    pose: (4, 4) float64 or None, rigid motion from the frame of the part to the frame of the scan, if the
        part is a view; in the unit of the file.
    """

    path: Path
    pose: FloatArray | None = None


def _no_parts(path: Path) -> tuple[Part, ...]:
    return ()


@dataclass(frozen=True, slots=True)
class Format:
    """A file format.

    Attributes
    ----------
    suffixes : tuple of str
        Suffixes of its files, including the dot, in lower case.
    read : function of Path that returns a RawScan
        Reads a file, which exists, is a regular file and is not empty. Raises ScanReadError if the file is
        invalid; an OSError is reported as a file that cannot be read.
    parts : function of Path that returns a tuple of Part
        The other files that belong to a file: its content is that of all of them, and they are no scans of
        their own. None by default. Raises ScanReadError and OSError.
    write_cloud : function of PointCloud that returns bytes, or None
        The content of a file; None if the format does not store point clouds. Raises InputError if a cloud
        lacks what the format requires.
    write_mesh : function of TriangleMesh that returns bytes, or None
        The same for meshes.
    recognise : function of Path that returns a bool, or None
        Whether a file is a scan, by a look at its first bytes; for suffixes that other files have too. A
        folder stands for those files in it that are recognised. None if every file of the suffixes is a scan.
        Raises OSError.
    members : Members or None
        How the scans in a file are read one by one; `read` reads all of them as one. None if a file is one
        scan.
    extra : Extra or None
        What must be installed to read the format; None if nothing more than pcretrieve.
    """

    suffixes: tuple[str, ...]
    read: Callable[[Path], RawScan]
    parts: Callable[[Path], tuple[Part, ...]] = _no_parts
    write_cloud: Callable[[PointCloud], bytes] | None = None
    write_mesh: Callable[[TriangleMesh], bytes] | None = None
    recognise: Callable[[Path], bool] | None = None
    members: Members | None = None
    extra: Extra | None = None
