"""The records by which pcretrieve and other packages declare stages: filters of points and of surfaces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pcretrieve.errors import OptionError
from pcretrieve.options.model import Options

if TYPE_CHECKING:
    from pcretrieve.values import PointCloud, TriangleMesh

__all__ = ["PointFilter", "SurfaceFilter", "Value"]

#: What a stage takes and gives: points, points with normals, a surface, or its spectrum.
Value = Literal["points", "normals", "surface", "spectrum"]


@dataclass(frozen=True, slots=True)
class PointFilter:
    """The declaration of a stage from points to points, beside its function.

    Attributes
    ----------
    name : str
        Name of the stage in the option `pipeline.stages`.
    apply : function of (PointCloud, Options) that returns a PointCloud
        Called with the points and the options of the stage. It keeps normals and sensor positions with their
        points, as `PointCloud.select` does. If it adds no `Step` to the provenance, the pipeline does.
    options : type, default Options
        Class of the options of the stage, derived from `pcretrieve.options.Options`, which has none.
    takes, gives : {"points", "normals"}, default "points"
        Points, or points with normals that point outwards. Points that have normals are given with normals
        by all filters.
    near_origin : bool, default False
        False: the function is called with coordinates in the frame of the scan. True: the points are moved so
        that their mean is near the origin, which functions in single precision need.

    Raises
    ------
    OptionError
        If `takes` or `gives` has another value, `options` is no class of options, or the name is ``stages``.
    """

    name: str
    apply: Callable[[PointCloud, Any], PointCloud]
    options: type[Options] = Options
    takes: Value = "points"
    gives: Value = "points"
    near_origin: bool = False

    def __post_init__(self) -> None:
        if not {self.takes, self.gives} <= {"points", "normals"}:
            raise OptionError(
                f"a filter of points must take and give 'points' or 'normals', got {self.takes!r} and "
                f"{self.gives!r}"
            )
        _check(self.name, self.options)


@dataclass(frozen=True, slots=True)
class SurfaceFilter:
    """The declaration of a stage from surface to surface, beside its function.

    Attributes
    ----------
    name : str
        Name of the stage in the option `pipeline.stages`.
    apply : function of (TriangleMesh, Options) that returns a TriangleMesh
        Called with each surface of a scan, oriented outwards, and the options of the stage. If it adds no
        `Step` to the provenance, the pipeline does.
    options : type, default Options
        Class of the options of the stage, derived from `pcretrieve.options.Options`, which has none.
    near_origin : bool, default False
        As of a `PointFilter`, for the vertices.
    of_kept : bool, default True
        Whether a mesh that is used without reconstruction (`surface.mode`) is filtered too.

    Raises
    ------
    OptionError
        If `options` is no class of options, or the name is ``stages``.
    """

    name: str
    apply: Callable[[TriangleMesh, Any], TriangleMesh]
    options: type[Options] = Options
    near_origin: bool = False
    of_kept: bool = True

    takes: ClassVar[Value] = "surface"
    gives: ClassVar[Value] = "surface"

    def __post_init__(self) -> None:
        _check(self.name, self.options)


def _check(name: str, options: object) -> None:
    if name == "stages":
        raise OptionError("a filter must not have the name 'stages', which is that of the option: rename it")
    if not (isinstance(options, type) and issubclass(options, Options)):
        raise OptionError(
            f"options of a filter must be a class derived from pcretrieve.options.Options, got {options!r}"
        )
