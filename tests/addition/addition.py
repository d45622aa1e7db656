"""A package that adds one of every kind to pcretrieve."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.sparse import csc_array
from scipy.spatial import ConvexHull

from pcretrieve.descriptors import Descriptor
from pcretrieve.matching import Matcher
from pcretrieve.options import Options, SignatureOptions, SurfaceOptions
from pcretrieve.points import PointFilter
from pcretrieve.spectral import ELEMENTS, Assembled, Element
from pcretrieve.surface import SurfaceFilter, SurfaceMethod
from pcretrieve.values import FloatArray, PointCloud, Shape, Signature, TriangleMesh


def girth(shape: Shape, options: SignatureOptions) -> Signature:
    """Quantiles of the distance of the vertices from their mean; unit length of the file."""
    reach = np.linalg.norm(shape.mesh.vertices - shape.mesh.vertices.mean(axis=0), axis=1)
    return Signature(np.quantile(reach, np.linspace(0.1, 0.9, options.n_values)), kind="girth")


def soft(mesh: TriangleMesh) -> Assembled:
    """Linear elements of a material of half the stiffness."""
    linear = ELEMENTS["linear"].assemble(mesh)
    return linear._replace(stiffness=csc_array(linear.stiffness / 2))


class CutOptions(Options):
    """Points → points below a plane."""

    height: float = 0.0
    """The z coordinate of the plane; unit of the file."""


def cut(cloud: PointCloud, options: CutOptions) -> PointCloud:
    """The points below a horizontal plane."""
    return cloud.select(cloud.points[:, 2] < options.height)


class StretchOptions(Options):
    """Surface → higher or lower surface."""

    factor: Annotated[float, Field(gt=0)] = 2.0
    """Height of the surface after the stage relative to the height before it."""


def stretch(mesh: TriangleMesh, options: StretchOptions) -> TriangleMesh:
    """The surface with other z coordinates."""
    return replace(mesh, vertices=mesh.vertices * [1, 1, options.factor])


def hull(cloud: PointCloud, options: SurfaceOptions) -> Iterator[tuple[TriangleMesh, None]]:
    """The convex hull of the points."""
    found = ConvexHull(cloud.points)
    rank = np.empty(len(cloud.points), dtype=np.int32)
    rank[found.vertices] = np.arange(len(found.vertices))
    apart = np.einsum("ij,ij->i", found.equations[:, :3], np.cross(*_sides(cloud.points[found.simplices])))
    faces = np.where(apart[:, None] < 0, found.simplices[:, ::-1], found.simplices)
    yield TriangleMesh(cloud.points[found.vertices], rank[faces]), None


def _sides(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    return corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]


def height(shape: Shape) -> float:
    """Extent along the z axis; unit length of the file."""
    return float(np.ptp(shape.mesh.vertices[:, 2]))


def taller(query: float, other: float) -> float:
    """How much a query is taller than a shape of the gallery; unit length of the file."""
    return max(0.0, query - other)


GIRTH = Descriptor("girth", girth, needs=("mesh",))
SOFT = Element("soft", soft)
HULL = SurfaceMethod("hull", hull)
CUT = PointFilter("cut", cut, CutOptions)
STRETCH = SurfaceFilter("stretch", stretch, StretchOptions)
TALLER = Matcher("taller", height, taller, needs=("mesh",), symmetric=False)
