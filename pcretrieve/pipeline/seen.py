"""The results of the stages of a scan, up to some stage."""

from __future__ import annotations

from dataclasses import dataclass

from pcretrieve.surface import SurfaceMarks
from pcretrieve.values import PointCloud, Step, TriangleMesh

__all__ = ["Seen"]


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """The results of the stages of a scan, up to some stage; lengths are in the unit of the scan."""

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
