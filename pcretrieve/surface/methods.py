"""The methods of surface reconstruction, of pcretrieve and of other packages, by name."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

from pcretrieve.errors import ReconstructionError, Stage
from pcretrieve.names import NAMES
from pcretrieve.options import SurfaceOptions
from pcretrieve.plugins import Registry, named
from pcretrieve.surface.body import SurfaceMarks, body_surfaces
from pcretrieve.surface.reconstruct import poisson_surface
from pcretrieve.values import PointCloud, Step, TriangleMesh

__all__ = ["SURFACE_METHODS", "SurfaceMethod", "surfaces"]

Reconstructed = tuple[TriangleMesh, SurfaceMarks | None]


@dataclass(frozen=True, slots=True)
class SurfaceMethod:
    """The declaration of a method of surface reconstruction, beside its function.

    Attributes
    ----------
    name : str
        Value of the option `surface.method`.
    make : function of (PointCloud, SurfaceOptions) that returns an iterable
        Called with points that have normals, whose centre is near the origin. It gives one or more surfaces,
        each as a tuple of a TriangleMesh, closed and oriented outwards unless it is remeshed, and
        `SurfaceMarks` or None. The signature is the mean over the surfaces, and two surfaces or more give an
        error bar.
    """

    name: str
    make: Callable[[PointCloud, SurfaceOptions], Iterable[Reconstructed]]


def _poisson(cloud: PointCloud, options: SurfaceOptions) -> Iterator[Reconstructed]:
    yield poisson_surface(cloud, options), None


GROWTH = SurfaceMethod("growth", body_surfaces)
POISSON = SurfaceMethod("poisson", _poisson)

SURFACE_METHODS: Registry[SurfaceMethod] = Registry(
    NAMES["surface method"], {method.name: method for method in (GROWTH, POISSON)}, named(SurfaceMethod)
)


def surfaces(cloud: PointCloud, options: SurfaceOptions) -> Iterator[Reconstructed]:
    """Reconstruct the surfaces of a cloud by the method of the options.

    Yields mesh : TriangleMesh: with the provenance of the cloud and a step ``surface``; unit of the file.
    """
    record, n = SURFACE_METHODS[options.method], 0
    started = time.perf_counter()
    with SURFACE_METHODS.blamed(record.name, Stage.SURFACE):
        for mesh, marks in record.make(cloud, options):
            n += 1
            if not mesh.provenance:
                step = Step("surface", time.perf_counter() - started, {"faces": len(mesh.faces)})
                mesh = replace(mesh, provenance=(*cloud.provenance, step))
            yield mesh, marks
            started = time.perf_counter()
    if not n:
        raise ReconstructionError(f"{SURFACE_METHODS.called(record.name)} made no surface")
