"""The immutable values that are passed from stage to stage.

Arrays are copied, checked and made read-only when a value is made; functions that take such a value do not
check it again. Two values are equal if their arrays are, whatever their provenance. Conventions:

- lengths are in the unit of the file, coordinates are float64;
- the vertices of a face are in counter-clockwise order, seen from outside;
- the Laplace–Beltrami operator is positive semi-definite (−Δ u = λ u), eigenvalues ascend from λ_0 = 0.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from pcretrieve.arrays import FloatArray, IntArray
from pcretrieve.errors import InputError, ShapeError
from pcretrieve.values import Value, locked, numbers

if TYPE_CHECKING:
    from scipy.sparse import csc_array

__all__ = [
    "Eigenpairs",
    "Failure",
    "FloatArray",
    "IntArray",
    "LaplaceBeltrami",
    "Metric",
    "ModalSpectrum",
    "Need",
    "Neighbors",
    "PointCloud",
    "Shape",
    "Signature",
    "SignatureTable",
    "Step",
    "Surface",
    "TriangleMesh",
]

# The parts of a shape that a descriptor may need.
Need = Literal["spectrum", "eigenvectors", "mesh", "points"]

# How the values of two signatures are compared: by their logarithms, for positive values; as they are, for
# any; or as histograms, whose bins are not negative.
Metric = Literal["logarithms", "values", "histograms"]

_Part = TypeVar("_Part")

# Smallest ratio of the area of a face to the square of its longest edge. Below it cotangents of the angles
# exceed 1e8, and rounding errors of the stiffness matrix reach the size of its small eigenvalues.
SMALLEST_ASPECT = 1e-9


# Tolerance of the length of unit normals: files store them in single precision, and averages are not exact.
UNIT_TOLERANCE = 1e-3


@dataclass(frozen=True, slots=True)
class Step:
    """The record of one stage of the processing of one shape.

    Attributes
    ----------
    stage : str
        Name of the stage.
    seconds : float
        Wall-clock time.
    sizes : dict of str to float
        Counts, and lengths in the unit of the file.
    notes : tuple of str
        A sentence for each repair and each fallback, with its size. Empty if there was none.
    """

    stage: str
    seconds: float
    sizes: dict[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class PointCloud(Value):
    """A point cloud, in the unit of the file.

    Parameters
    ----------
    points : (n, 3) float64
        Coordinates.
    normals : (n, 3) float64 or None
        Unit normals that point out of the body.
    viewpoints : (n, 3) float64 or None
        Position of the sensor that measured each point, in the frame of the points. A (3,) array is the
        position of one sensor for all points.
    provenance : tuple of Step
        The stages that made the cloud, in order.
    """

    points: FloatArray
    normals: FloatArray | None = None
    viewpoints: FloatArray | None = None
    provenance: tuple[Step, ...] = field(default=(), compare=False)

    def __post_init__(self) -> None:
        points = locked("points", self.points, (None, 3))
        object.__setattr__(self, "points", points)
        n = len(points)
        if self.normals is not None:
            normals = locked("normals", self.normals, (n, 3))
            off = np.abs(np.linalg.norm(normals, axis=1) - 1) > UNIT_TOLERANCE  # (n,)
            if off.any():
                raise InputError(
                    f"normals must have unit length, got {off.sum()} of {n} that have not: "
                    "divide them by their length, or leave them out"
                )
            object.__setattr__(self, "normals", normals)
        if self.viewpoints is not None:
            viewpoints = numbers("viewpoints", self.viewpoints)
            if viewpoints.shape == (3,):
                viewpoints = np.broadcast_to(viewpoints, (n, 3))
            object.__setattr__(self, "viewpoints", locked("viewpoints", viewpoints, (n, 3)))

    @property
    def diagonal(self) -> float:
        """Diagonal of the axis-aligned bounding box, to which relative lengths in options refer."""
        return bounding_diagonal(self.points)

    def select(self, index: NDArray[Any]) -> PointCloud:
        """The points at `index` (a mask or positions), with their normals and viewpoints."""
        return replace(
            self,
            points=self.points[index],
            normals=None if self.normals is None else self.normals[index],
            viewpoints=None if self.viewpoints is None else self.viewpoints[index],
        )

    def after(self, step: Step) -> PointCloud:
        """The same cloud with one more step in its provenance."""
        return replace(self, provenance=(*self.provenance, step))


@dataclass(frozen=True, slots=True, eq=False)
class TriangleMesh(Value):
    """A triangulated surface, in the unit of the file.

    Parameters
    ----------
    vertices : (n, 3) float64
        Coordinates.
    faces : (m, 3) int32
        Vertex numbers of each triangle, counter-clockwise seen from outside.
    provenance : tuple of Step
        The stages that made the surface, in order.
    """

    vertices: FloatArray
    faces: IntArray
    provenance: tuple[Step, ...] = field(default=(), compare=False)

    def __post_init__(self) -> None:
        vertices = locked("vertices", self.vertices, (None, 3))
        faces = locked("faces", self.faces, (None, 3), np.int32)
        if faces.size and not (faces.min() >= 0 and faces.max() < len(vertices)):
            raise InputError(
                f"faces must name vertices 0 to {len(vertices) - 1}, got {faces.min()} to {faces.max()}"
            )
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)

    @property
    def diagonal(self) -> float:
        """Diagonal of the axis-aligned bounding box."""
        return bounding_diagonal(self.vertices)

    @property
    def area_vectors(self) -> FloatArray:
        """(m, 3) area vectors: outward normals of the faces, with the area as their length; unit length².

        The area vectors of a closed surface sum up to zero.
        """
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return np.cross(b - a, c - a) / 2

    @property
    def face_areas(self) -> FloatArray:
        """(m,) areas of the faces, unit length²."""
        areas: FloatArray = np.linalg.norm(self.area_vectors, axis=1)
        return areas

    @property
    def flat_faces(self) -> NDArray[np.bool_]:
        """(m,) mask of degenerate faces, whose area is too small for the gradients of linear elements."""
        corners = self.vertices[self.faces]  # (m, 3, 3)
        longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1, initial=0)  # (m,)
        return np.asarray(self.face_areas <= SMALLEST_ASPECT * longest**2)

    @property
    def area(self) -> float:
        """Total area, unit length²."""
        return float(self.face_areas.sum())

    @property
    def volume(self) -> float:
        """Signed enclosed volume, unit length³; positive if the faces are oriented outwards.

        Meaningful for closed surfaces only.
        """
        corner = self.vertices[self.faces[:, 0]] - self.vertices.mean(axis=0)
        return float(np.einsum("ij,ij->", corner, self.area_vectors) / 3)

    @property
    def euler_characteristic(self) -> int:
        """V − E + F, without unreferenced vertices: 2 for a sphere, 0 for a torus."""
        ends = self.faces.astype(np.int64), self.faces[:, [1, 2, 0]]  # (m, 3) each
        edges = np.minimum(*ends) * len(self.vertices) + np.maximum(
            *ends
        )  # (m, 3): one number for each unordered pair of vertices
        return len(np.unique(self.faces)) - len(np.unique(edges)) + len(self.faces)

    def after(self, step: Step) -> TriangleMesh:
        """The same surface with one more step in its provenance."""
        return replace(self, provenance=(*self.provenance, step))


@dataclass(frozen=True, slots=True, eq=False)
class LaplaceBeltrami(Value):
    """A discrete Laplace–Beltrami operator: the matrices of the generalised eigenvalue problem S u = λ M u.

    Attributes
    ----------
    stiffness : (n, n) sparse
        S, symmetric, dimensionless. With the natural (Neumann) boundary condition positive semi-definite,
        with S·1 = 0 on every connected component; with the Dirichlet boundary condition positive definite.
    mass : (n, n) sparse
        M, symmetric positive definite, 1ᵀM·1 = area; unit length².
    n_components : int
        Dimension of the null space of S: the number of connected components, or 0 with the Dirichlet boundary
        condition.
    nodes : (n,) int32 or None
        The nodes of the finite elements to which the rows belong, ascending: with the Dirichlet boundary
        condition, the interior nodes. None: all nodes.
    """

    stiffness: csc_array
    mass: csc_array
    n_components: int = 1
    nodes: IntArray | None = None

    def __post_init__(self) -> None:
        n = self.stiffness.shape[0]
        if not self.stiffness.shape == self.mass.shape == (n, n):
            raise InputError(
                f"stiffness and mass must be square and of one size, got shapes {self.stiffness.shape} "
                f"and {self.mass.shape}"
            )
        if not (np.isfinite(self.stiffness.data).all() and np.isfinite(self.mass.data).all()):
            raise InputError("stiffness and mass must be finite, got NaN or infinite entries")
        if not self.area > 0:
            raise InputError(f"mass must sum up to a positive area, got {self.area:g}")
        if self.nodes is not None:
            object.__setattr__(self, "nodes", locked("nodes", self.nodes, (n,), np.int32))

    @property
    def area(self) -> float:
        """1ᵀM·1, unit length²; with the Dirichlet boundary condition less than the area of the surface."""
        return float(self.mass.sum())


@dataclass(frozen=True, slots=True, eq=False)
class Eigenpairs(Value):
    """The smallest eigenpairs of a Laplace–Beltrami operator.

    Attributes
    ----------
    eigenvalues : (k,) float64
        Ascending; λ_0 = 0 with the Neumann boundary condition; unit length⁻².
    eigenvectors : (n, k) float64
        One eigenvector φ_i in each column, ΦᵀMΦ = I; unit length⁻¹. The eigenvector of λ_0 = 0 is the
        positive constant 1/√area.
    mass : (n, n) sparse
        M, the mass matrix of the inner product; unit length².
    largest_residual : float
        max ‖S φ − λ M φ‖ / (λ ‖M φ‖) over the pairs with λ > 0, dimensionless.
    iterations : int
        Number of solves with the shifted stiffness matrix: of a block of vectors (``krylov``), of one vector
        (``arpack``); 0 for ``dense``.
    solver : str
        The eigenvalue solver: ``krylov``, ``arpack`` or ``dense``.
    """

    eigenvalues: FloatArray
    eigenvectors: FloatArray
    mass: csc_array
    largest_residual: float = 0.0
    iterations: int = 0
    solver: str = ""

    def __post_init__(self) -> None:
        eigenvalues = locked("eigenvalues", self.eigenvalues, (None,))
        object.__setattr__(self, "eigenvalues", eigenvalues)
        eigenvectors = locked("eigenvectors", self.eigenvectors, (self.mass.shape[0], len(eigenvalues)))
        object.__setattr__(self, "eigenvectors", eigenvectors)

    @property
    def area(self) -> float:
        """1ᵀM·1, unit length²."""
        return float(self.mass.sum())


@dataclass(frozen=True, slots=True, eq=False)
class ModalSpectrum(Value):
    """The eigenvalues and the inner products of eigenfunctions that the spectral descriptors are made of.

    The catalogue stores it in the place of the eigenvectors, which are larger by orders of magnitude.

    Attributes
    ----------
    eigenvalues : (k,) float64
        Ascending, λ_0 = 0; unit length⁻².
    moments : (k, k) float64
        ⟨φ_i², φ_j⟩ = ∫ φ_i² φ_j in row i and column j; unit length⁻¹.
    area : float
        Area of the surface, unit length².
    overlaps : (k, k) float64 or None
        ⟨φ_i², φ_j²⟩ = ∫ φ_i² φ_j²; unit length⁻². None if the spectrum was stored by an early version.
    """

    eigenvalues: FloatArray
    moments: FloatArray
    area: float
    overlaps: FloatArray | None = None

    def __post_init__(self) -> None:
        eigenvalues = locked("eigenvalues", self.eigenvalues, (None,))
        k = len(eigenvalues)
        object.__setattr__(self, "eigenvalues", eigenvalues)
        object.__setattr__(self, "moments", locked("moments", self.moments, (k, k)))
        if self.overlaps is not None:
            object.__setattr__(self, "overlaps", locked("overlaps", self.overlaps, (k, k)))

    @classmethod
    def of(cls, pairs: Eigenpairs) -> ModalSpectrum:
        """The modal spectrum of eigenpairs.

        The integral ∫ f²g is discretised as Σ f_i² M_ij g_j with the mass matrix M (Ye and Yu, "A fast modal
        space transform for robust nonrigid shape retrieval", 2016, section 3), and ∫ f²g² as Σ f_i² M_ij
        g_j².

        Parameters
        ----------
        pairs : Eigenpairs
            k eigenpairs of a connected surface, the constant eigenfunction first.

        Returns
        -------
        ModalSpectrum
            In the unit of the eigenpairs.
        """
        phi = pairs.eigenvectors  # (n, k)
        squares = phi**2
        return cls(
            pairs.eigenvalues,
            squares.T @ (pairs.mass @ phi),
            pairs.area,
            overlaps=squares.T @ (pairs.mass @ squares),
        )

    def known_overlaps(self) -> FloatArray:
        """The overlaps, if they were stored.

        Returns
        -------
        (k, k) float64
            ⟨φ_i², φ_j²⟩; unit length⁻².

        Raises
        ------
        ShapeError
            If the spectrum was stored without overlaps.
        """
        if self.overlaps is None:
            raise ShapeError(
                "gone: this spectrum was stored without ⟨φ_i², φ_j²⟩, by an earlier pcretrieve: ingest the "
                "scans anew, or choose another descriptor",
                stage="signature",
            )
        return self.overlaps

    def scaled(self, area: float) -> ModalSpectrum:
        """The modal spectrum of the same surface after uniform scaling to another area."""
        factor = area / self.area
        return ModalSpectrum(
            self.eigenvalues / factor,
            self.moments / np.sqrt(factor),
            area,
            None if self.overlaps is None else self.overlaps / factor,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Surface(Value):
    """One of the surfaces that were reconstructed from a scan, with those of its parts that were kept.

    Attributes
    ----------
    area : float
        Positive; unit length² of the file. For the element ``points``, the integral of 1 by the mass matrix.
    spectrum : ModalSpectrum or None
        The modal spectrum of the surface scaled to unit area.
    mesh : TriangleMesh or None
        The triangles, in the unit of the file.
    eigenpairs : Eigenpairs or None
        The smallest eigenpairs of the surface scaled to unit area.
    """

    area: float
    spectrum: ModalSpectrum | None = None
    mesh: TriangleMesh | None = None
    eigenpairs: Eigenpairs | None = None

    def __post_init__(self) -> None:
        if not 0 < self.area < np.inf:
            raise InputError(f"the area of a surface must be positive and finite, got {self.area}")


@dataclass(frozen=True, slots=True, eq=False)
class Shape(Value):
    """A processed scan: the surfaces that were reconstructed from it, and its points.

    The properties are those of the first surface. Descriptors are given one shape for each surface, as
    `apart` makes them.

    Attributes
    ----------
    surfaces : tuple of Surface
        At least one surface; the first is exported and shown.
    cloud : PointCloud or None
        The filtered points with their normals, in the unit of the file. None for a mesh that was used without
        reconstruction, and if the points were not kept.
    provenance : tuple of Step
        All stages from the file to the spectra, in order.
    """

    surfaces: tuple[Surface, ...]
    cloud: PointCloud | None = None
    provenance: tuple[Step, ...] = field(default=(), compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "surfaces", tuple(self.surfaces))
        if not self.surfaces:
            raise InputError("a shape must have at least 1 surface, got none")

    @property
    def area(self) -> float:
        """The area of the first surface; unit length² of the file."""
        return self.surfaces[0].area

    @property
    def spectrum(self) -> ModalSpectrum:
        """The modal spectrum of the first surface, scaled to unit area. ShapeError if it was not kept."""
        return _kept("spectrum", self.surfaces[0].spectrum)

    @property
    def eigenpairs(self) -> Eigenpairs:
        """The eigenpairs of the first surface, scaled to unit area. ShapeError if they were not kept."""
        return _kept("eigenvectors", self.surfaces[0].eigenpairs)

    @property
    def mesh(self) -> TriangleMesh:
        """The first surface, in the unit of the file. ShapeError if it was not kept."""
        return _kept("mesh", self.surfaces[0].mesh)

    @property
    def points(self) -> PointCloud:
        """The filtered points, in the unit of the file. ShapeError if they were not kept."""
        return _kept("points", self.cloud)

    def apart(self) -> tuple[Shape, ...]:
        """One shape for each surface, each with the points of the scan."""
        return tuple(replace(self, surfaces=(surface,)) for surface in self.surfaces)


def _kept(part: Need, value: _Part | None) -> _Part:
    if value is None:
        raise ShapeError(
            f"gone: the shape must hold its {part}, but does not: not kept when it was stored, or not among "
            "the needs that the descriptor declares; process the scan anew, or choose another descriptor",
            stage="signature",
        )
    return value


@dataclass(frozen=True, slots=True, eq=False)
class Signature(Value):
    """A global shape descriptor: a short vector, invariant to isometric deformation of the surface.

    Attributes
    ----------
    values : (L,) float64
        Dimensionless, except for the scale ``absolute``. In the order stated by the method; the size, if it
        has a weight, is the last value.
    kind : str
        The method, such as ``r-bihdm``.
    digest : str
        Hash of the options; two signatures are comparable only if both their kinds and their digests are
        equal.
    deviation : (L,) float64 or None
        Error bar: standard deviation (ddof = 1) of each value over the surfaces reconstructed from one scan;
        for the metric ``logarithms``, of its logarithm. None if there is one surface only.
    metric : {"logarithms", "values", "histograms"}, default "logarithms"
        How two signatures of this kind are compared: by the logarithms of their values, which are positive;
        by the values as they are; or as histograms, whose bins are not negative.
    """

    values: FloatArray
    kind: str
    digest: str = ""
    deviation: FloatArray | None = None
    metric: Metric = "logarithms"

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", _suited(locked("values", self.values, (None,)), self.metric))
        if self.deviation is not None:
            deviation = locked("deviation", self.deviation, (len(self.values),))
            object.__setattr__(self, "deviation", deviation)


@dataclass(frozen=True, slots=True, eq=False)
class SignatureTable(Value):
    """Signatures of many shapes, of one kind.

    Attributes
    ----------
    ids : tuple of str, length N
        Identifiers of the shapes, distinct.
    values : (N, L) float64
        One signature in each row, in the units of `Signature`.
    kind, digest, metric : str
        Method, hash of the options, and metric, as in `Signature`.
    labels : tuple of (str or None), length N
        Class of each shape; None if unknown.
    """

    ids: tuple[str, ...]
    values: FloatArray
    kind: str
    digest: str = ""
    labels: tuple[str | None, ...] = ()
    metric: Metric = "logarithms"

    def __post_init__(self) -> None:
        object.__setattr__(self, "ids", tuple(self.ids))
        n = len(self.ids)
        if len(set(self.ids)) != n:
            raise InputError("ids must be distinct")
        object.__setattr__(self, "values", _suited(locked("values", self.values, (n, None)), self.metric))
        object.__setattr__(self, "labels", tuple(self.labels) or (None,) * n)
        if len(self.labels) != n:
            raise InputError(f"labels must be as many as ids ({n}), got {len(self.labels)}")

    def __len__(self) -> int:
        return len(self.ids)


def _suited(values: FloatArray, metric: Metric) -> FloatArray:
    """The values of signatures, if the metric can compare them."""
    if metric not in get_args(Metric):
        raise InputError(f"metric must be one of {', '.join(get_args(Metric))}, got {metric!r}")
    smallest = values.min(initial=np.inf)
    if metric == "logarithms" and smallest <= 0:
        raise InputError(f"signature values must be positive, got {smallest}")
    if metric == "histograms" and smallest < 0:
        raise InputError(f"the bins of a histogram must not be negative, got {smallest}")
    return values


@dataclass(frozen=True, slots=True, eq=False)
class Neighbors(Value):
    """The nearest neighbours of one query.

    Attributes
    ----------
    ids : tuple of str, length k
        Identifiers of the shapes, distinct, nearest first; equally near shapes in alphabetical order.
    distances : (k,) float64
        Distances to the query, not negative, ascending; dimensionless. May be infinite.
    """

    ids: tuple[str, ...]
    distances: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "ids", tuple(self.ids))
        distances = locked("distances", self.distances, (len(self.ids),), finite=False)
        if len(set(self.ids)) != len(self.ids):
            raise InputError("ids must be distinct")
        if not ((distances >= 0).all() and (distances[:-1] <= distances[1:]).all()):
            raise InputError("distances must ascend from 0 or more, got others; sort the shapes by distance")
        tied = distances[:-1] == distances[1:]
        if any(tie and self.ids[i] > self.ids[i + 1] for i, tie in enumerate(tied)):
            raise InputError("ids of equally distant shapes must be in alphabetical order, got another one")
        object.__setattr__(self, "distances", distances)

    def __len__(self) -> int:
        return len(self.ids)


@dataclass(frozen=True, slots=True)
class Failure:
    """Why a shape has no signature: the stage that failed, the name of the exception and its message."""

    shape_id: str
    stage: str
    error: str
    message: str


def bounding_diagonal(points: FloatArray) -> float:
    """Diagonal of the axis-aligned bounding box of (n, 3) points; 0 if there are no points."""
    return float(np.linalg.norm(np.ptp(points, axis=0))) if len(points) else 0.0
