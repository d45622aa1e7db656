"""Points and surfaces in the frame of the scan, or translated to the origin."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Generic, TypeVar

from pcretrieve.values import FloatArray, PointCloud, TriangleMesh

__all__ = ["Framed", "moved"]

V = TypeVar("V", PointCloud, TriangleMesh)


@dataclass(frozen=True, slots=True, eq=False)
class Framed(Generic[V]):
    """Points or a surface, and the origin of their coordinates.

    value: the points or the surface; unit of the scan.
    origin: (3,) float64 or None, the origin of the coordinates, in the frame of the scan; None if the
        coordinates are in this frame.
    """

    value: V
    origin: FloatArray | None = None

    def near_origin(self) -> Framed[V]:
        """The value with the mean of its points at the origin; unchanged if it has been moved already."""
        if self.origin is not None:
            return self
        points = self.value.points if isinstance(self.value, PointCloud) else self.value.vertices
        origin = points.mean(axis=0)
        return Framed(moved(self.value, -origin), origin)

    def in_scan(self) -> V:
        """The value in the frame of the scan."""
        return self.value if self.origin is None else moved(self.value, self.origin)


def moved(value: V, by: FloatArray) -> V:
    """Translate points or a surface.

    by: (3,) float64, the translation.
    """
    if isinstance(value, TriangleMesh):
        return replace(value, vertices=value.vertices + by)
    viewpoints = None if value.viewpoints is None else value.viewpoints + by
    return replace(value, points=value.points + by, viewpoints=viewpoints)
