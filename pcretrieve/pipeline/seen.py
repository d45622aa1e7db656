"""The results of the stages of a scan, up to some stage."""

from __future__ import annotations

from dataclasses import dataclass

from pcretrieve.surface import SurfaceMarks
from pcretrieve.types import PointCloud, Step, TriangleMesh

__all__ = ["Seen"]


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """The results of the stages of a scan, up to some stage; lengths are in the unit of the scan.

    Attributes
    ----------
    scan : PointCloud or None
        The raw points; None if the scan is a mesh that is used without reconstruction.
    cloud : PointCloud or None
        The filtered points, with normals after the stage `orient`.
    mesh : TriangleMesh or None
        The first surface.
    marks : SurfaceMarks or None
        Where the topology of the first surface was changed.
    others : tuple of TriangleMesh
        Further surfaces of the same scan.
    """

    scan: PointCloud | None = None
    cloud: PointCloud | None = None
    mesh: TriangleMesh | None = None
    marks: SurfaceMarks | None = None
    others: tuple[TriangleMesh, ...] = ()

    @property
    def surface(self) -> TriangleMesh:
        """The first surface; TypeError if there is none yet."""
        if self.mesh is None:
            raise TypeError("there must be a surface after the last stage, there is none")
        return self.mesh

    @property
    def steps(self) -> tuple[Step, ...]:
        """The steps of all stages so far, in order."""
        cloud = self.cloud if self.cloud is not None else self.scan
        before = () if cloud is None else cloud.provenance
        first = before if self.mesh is None else self.mesh.provenance
        further = (mesh.provenance[len(before) :] for mesh in self.others)
        return (*first, *(step for steps in further for step in steps))
