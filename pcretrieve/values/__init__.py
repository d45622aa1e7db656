"""The immutable values that are passed from stage to stage.

Arrays are copied, checked and made read-only when a value is made; functions that take such a value do not
check it again. Two values are equal if their arrays are, whatever their provenance. Conventions:

- lengths are in the unit of the file, coordinates are float64;
- the vertices of a face are in counter-clockwise order, seen from outside;
- the Laplace–Beltrami operator is positive semi-definite (−Δ u = λ u), eigenvalues ascend from λ_0 = 0.
"""

from pcretrieve.arrays import (
    UPWARD,
    FloatArray,
    Grid,
    IntArray,
    Mask,
    area_vectors,
    bounding_diagonal,
    tangent_axes,
    unit_vectors,
)
from pcretrieve.arrays.open3d import RayScene
from pcretrieve.values.base import METRES, UNIT, SizeUnit, unit_of
from pcretrieve.values.geometry import (
    SENSOR_DISTANCE,
    PointCloud,
    Step,
    TriangleMesh,
    polygon_triangles,
    strip_triangles,
    welded,
)
from pcretrieve.values.shapes import (
    Decision,
    Eigenpairs,
    Failure,
    Grade,
    GradeName,
    LaplaceBeltrami,
    ModalSpectrum,
    Need,
    Shape,
    Surface,
)
from pcretrieve.values.signatures import Metric, Neighbors, Signature, SignatureTable

__all__ = [
    "METRES",
    "SENSOR_DISTANCE",
    "UNIT",
    "UPWARD",
    "Decision",
    "Eigenpairs",
    "Failure",
    "FloatArray",
    "Grade",
    "GradeName",
    "Grid",
    "IntArray",
    "LaplaceBeltrami",
    "Mask",
    "Metric",
    "ModalSpectrum",
    "Need",
    "Neighbors",
    "PointCloud",
    "RayScene",
    "Shape",
    "Signature",
    "SignatureTable",
    "SizeUnit",
    "Step",
    "Surface",
    "TriangleMesh",
    "area_vectors",
    "bounding_diagonal",
    "polygon_triangles",
    "strip_triangles",
    "tangent_axes",
    "unit_of",
    "unit_vectors",
    "welded",
]
