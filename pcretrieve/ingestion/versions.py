"""The versions with which a signature was computed."""

from __future__ import annotations

from functools import cache
from importlib.metadata import version

from pcretrieve import __version__

__all__ = ["versions"]


@cache
def versions() -> dict[str, str]:
    """Versions of pcretrieve and of the libraries on which results depend, by package name."""
    # Not from metadata: a source folder on the path has no metadata, or the metadata of another version.
    others = ("open3d", "pytetwild", "numpy", "scipy")
    return {"pcretrieve": __version__} | {name: version(name) for name in others}
