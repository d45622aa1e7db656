"""The frozen values that flow from stage to stage.

Arrays are copied in, checked once and locked; everything behind this door trusts them. Conventions:

- lengths are in the unit of the file, coordinates are float64;
- faces are counter-clockwise seen from outside;
- the Laplace–Beltrami operator is positive semi-definite (−Δ u = λ u), eigenvalues ascend from λ₀ = 0.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcretrieve.errors import InputError

if TYPE_CHECKING:
    from scipy.sparse import csc_array

__all__ = [
    "Describable",
    "Eigenpairs",
    "Failure",
    "FloatArray",
    "IntArray",
    "LaplaceBeltrami",
    "ModalSpectrum",
    "Neighbors",
    "PointCloud",
    "Signature",
    "SignatureTable",
    "Step",
    "TriangleMesh",
]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int32]

# A face flatter than this (its area over its longest edge squared) has cotangents beyond 1e8, and a
# stiffness matrix loses the digits that the small eigenvalues live in.
SMALLEST_ASPECT = 1e-9


# Normals come from files with single precision, and from averages.
UNIT_TOLERANCE = 1e-3


def _numbers(name: str, values: ArrayLike) -> NDArray[Any]:
    """The values as an array of real numbers, of whatever shape and type."""
    try:
        array = np.asarray(values)
    except ValueError as error:  # rows of different lengths
        raise InputError(f"{name} must be an array of numbers: {error}") from error
    if array.dtype.kind not in "iuf":
        raise InputError(f"{name} must be an array of numbers, got one of type {array.dtype}")
    return array


def _locked(
    name: str, values: ArrayLike, shape: tuple[int | None, ...], dtype: type[np.generic] = np.float64
) -> NDArray[Any]:
    """A private, read-only copy of `values`, with None in `shape` for any length."""
    given = _numbers(name, values)
    wanted = "(" + ", ".join("n" if length is None else str(length) for length in shape) + ")"
    if given.ndim != len(shape) or any(
        length not in (None, found) for length, found in zip(shape, given.shape, strict=True)
    ):
        raise InputError(f"{name} must have shape {wanted}, got {given.shape}")
    if not np.isfinite(given).all():
        bad = int((~np.isfinite(given)).sum())
        raise InputError(f"{name} must be finite, got {bad} values that are NaN or infinite")
    with np.errstate(invalid="ignore", over="ignore"):  # what does not fit is found below
        array = np.array(given, dtype=dtype, order="C")
    if np.issubdtype(dtype, np.integer) and (array != given).any():
        bad = int((array != given).sum())
        raise InputError(f"{name} must be whole numbers below 2³¹, got {bad} that are not")
    array.flags.writeable = False
    return array


class _Value:
    """Pickled as what it was made of, so that arrays are checked and locked again where they arrive."""

    __slots__ = ()

    def __reduce__(self) -> tuple[type, tuple[Any, ...]]:
        return type(self), tuple(getattr(self, part.name) for part in fields(self))  # type: ignore[arg-type]


@dataclass(frozen=True, slots=True)
class Step:
    """What one stage did to one shape.

    Attributes
    ----------
    stage : str
    seconds : float
        Wall-clock time.
    sizes : dict of str to float
        Counts, and lengths in the unit of the file.
    notes : tuple of str
        Every repair and every fallback, in words, with its size. Empty where nothing was touched.
    """

    stage: str
    seconds: float
    sizes: dict[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class PointCloud(_Value):
    """Points, in the unit of the file.

    Parameters
    ----------
    points : (n, 3) float64
    normals : (n, 3) float64 or None
        Unit length, pointing out of the body.
    viewpoints : (n, 3) float64 or None
        Position of the sensor that saw each point, in the frame of the points. A (3,) array is one sensor
        for all of them.
    provenance : tuple of Step
        How these points came to be.
    """

    points: FloatArray
    normals: FloatArray | None = None
    viewpoints: FloatArray | None = None
    provenance: tuple[Step, ...] = ()

    def __post_init__(self) -> None:
        points = _locked("points", self.points, (None, 3))
        object.__setattr__(self, "points", points)
        n = len(points)
        if self.normals is not None:
            normals = _locked("normals", self.normals, (n, 3))
            off = np.abs(np.linalg.norm(normals, axis=1) - 1) > UNIT_TOLERANCE  # (n,)
            if off.any():
                raise InputError(
                    f"normals must have unit length, got {off.sum()} of {n} that have not: "
                    "divide them by their length, or leave them out"
                )
            object.__setattr__(self, "normals", normals)
        if self.viewpoints is not None:
            viewpoints = _numbers("viewpoints", self.viewpoints)
            if viewpoints.shape == (3,):
                viewpoints = np.broadcast_to(viewpoints, (n, 3))
            object.__setattr__(self, "viewpoints", _locked("viewpoints", viewpoints, (n, 3)))

    @property
    def diagonal(self) -> float:
        """Diagonal of the axis-aligned bounding box: the length that relative options refer to."""
        return bounding_diagonal(self.points)

    def select(self, index: NDArray[Any]) -> PointCloud:
        """The points at `index` (a mask or positions), with all that belongs to them."""
        return replace(
            self,
            points=self.points[index],
            normals=None if self.normals is None else self.normals[index],
            viewpoints=None if self.viewpoints is None else self.viewpoints[index],
        )

    def after(self, step: Step) -> PointCloud:
        """The same cloud, with one more step in its provenance."""
        return replace(self, provenance=(*self.provenance, step))


@dataclass(frozen=True, slots=True, eq=False)
class TriangleMesh(_Value):
    """A triangulated surface, in the unit of the file.

    Parameters
    ----------
    vertices : (n, 3) float64
    faces : (m, 3) int32
        Vertex numbers, counter-clockwise seen from outside.
    provenance : tuple of Step
        How this surface came to be.
    """

    vertices: FloatArray
    faces: IntArray
    provenance: tuple[Step, ...] = ()

    def __post_init__(self) -> None:
        vertices = _locked("vertices", self.vertices, (None, 3))
        faces = _locked("faces", self.faces, (None, 3), np.int32)
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
        """(m, 3) normals of the faces, as long as these are large, unit length².

        Those of a closed surface add up to zero.
        """
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return np.cross(b - a, c - a) / 2

    @property
    def face_areas(self) -> FloatArray:
        """(m,) areas, unit length²."""
        areas: FloatArray = np.linalg.norm(self.area_vectors, axis=1)
        return areas

    @property
    def flat_faces(self) -> NDArray[np.bool_]:
        """(m,) faces without an area to speak of, in which no gradient can be computed."""
        corners = self.vertices[self.faces]  # (m, 3, 3)
        longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1, initial=0)  # (m,)
        return np.asarray(self.face_areas <= SMALLEST_ASPECT * longest**2)

    @property
    def area(self) -> float:
        """Total area, unit length²."""
        return float(self.face_areas.sum())

    @property
    def volume(self) -> float:
        """Signed enclosed volume, unit length³; positive where the faces point outwards.

        Means something for closed surfaces only.
        """
        corner = self.vertices[self.faces[:, 0]] - self.vertices.mean(axis=0)
        return float(np.einsum("ij,ij->", corner, self.area_vectors) / 3)

    @property
    def euler_characteristic(self) -> int:
        """V − E + F, over the vertices that some face uses: 2 for a sphere, 0 for a torus."""
        ends = self.faces.astype(np.int64), self.faces[:, [1, 2, 0]]  # (m, 3) each
        edges = np.minimum(*ends) * len(self.vertices) + np.maximum(*ends)  # (m, 3): a number for each pair
        return len(np.unique(self.faces)) - len(np.unique(edges)) + len(self.faces)

    def after(self, step: Step) -> TriangleMesh:
        """The same surface, with one more step in its provenance."""
        return replace(self, provenance=(*self.provenance, step))


@dataclass(frozen=True, slots=True, eq=False)
class LaplaceBeltrami(_Value):
    """A discrete Laplace–Beltrami operator S u = λ M u.

    Attributes
    ----------
    stiffness : (n, n) sparse
        Symmetric positive semi-definite, S·1 = 0 on every connected component; dimensionless. Natural
        (Neumann) boundary condition. With Dirichlet boundary positive definite.
    mass : (n, n) sparse
        Symmetric positive definite, 1ᵀM·1 = area; unit length².
    n_components : int
        Connected components, each of which brings one zero eigenvalue; 0 with Dirichlet boundary, which
        leaves no null space.
    nodes : (n,) int32 or None
        The node that each row is of, ascending: with Dirichlet boundary, those inside. None: all of them.
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
            object.__setattr__(self, "nodes", _locked("nodes", self.nodes, (n,), np.int32))

    @property
    def area(self) -> float:
        """1ᵀM·1, unit length²; with Dirichlet boundary less than the area of the surface."""
        return float(self.mass.sum())


@dataclass(frozen=True, slots=True, eq=False)
class Eigenpairs(_Value):
    """The lowest eigenpairs of a Laplace–Beltrami operator.

    Attributes
    ----------
    eigenvalues : (k,) float64
        Ascending, λ₀ = 0 if there is a zero mode; unit length⁻².
    eigenvectors : (n, k) float64
        ΦᵀMΦ = I; unit length⁻¹. φ₀ of a zero mode is the positive constant 1/√area.
    mass : (n, n) sparse
        The mass matrix that they are orthonormal in; unit length².
    largest_residual : float
        max ‖S φ − λ M φ‖ / (λ ‖M φ‖) over the pairs with λ > 0.
    iterations : int
        Solves with the shifted matrix: of a block of vectors (``krylov``), of one (``arpack``); none by
        ``dense``.
    solver : str
        Who found them: ``krylov``, ``arpack`` or ``dense``.
    """

    eigenvalues: FloatArray
    eigenvectors: FloatArray
    mass: csc_array
    largest_residual: float = 0.0
    iterations: int = 0
    solver: str = ""

    def __post_init__(self) -> None:
        eigenvalues = _locked("eigenvalues", self.eigenvalues, (None,))
        object.__setattr__(self, "eigenvalues", eigenvalues)
        eigenvectors = _locked("eigenvectors", self.eigenvectors, (self.mass.shape[0], len(eigenvalues)))
        object.__setattr__(self, "eigenvectors", eigenvectors)

    @property
    def area(self) -> float:
        """1ᵀM·1, unit length²."""
        return float(self.mass.sum())


@dataclass(frozen=True, slots=True, eq=False)
class ModalSpectrum(_Value):
    """What the spectral descriptors need of a surface, and all that is stored of one.

    Attributes
    ----------
    eigenvalues : (k,) float64
        Ascending, λ₀ = 0; unit length⁻².
    moments : (k, k) float64
        ⟨φ_i², φ_j⟩, row i and column j; unit length⁻¹.
    area : float
        Unit length².
    overlaps : (k, k) float64 or None
        ⟨φ_i², φ_j²⟩; unit length⁻². None where an earlier pcretrieve stored the spectrum.
    """

    eigenvalues: FloatArray
    moments: FloatArray
    area: float
    overlaps: FloatArray | None = None

    def __post_init__(self) -> None:
        eigenvalues = _locked("eigenvalues", self.eigenvalues, (None,))
        k = len(eigenvalues)
        object.__setattr__(self, "eigenvalues", eigenvalues)
        object.__setattr__(self, "moments", _locked("moments", self.moments, (k, k)))
        if self.overlaps is not None:
            object.__setattr__(self, "overlaps", _locked("overlaps", self.overlaps, (k, k)))

    @classmethod
    def of(cls, pairs: Eigenpairs) -> ModalSpectrum:
        """Of eigenpairs, with ∫ f²g taken as Σ f_i² D_ij g_j (Ye and Yu, section 3), and ∫ f²g² alike."""
        phi = pairs.eigenvectors  # (n, k)
        squares = phi**2
        return cls(
            pairs.eigenvalues,
            squares.T @ (pairs.mass @ phi),
            pairs.area,
            overlaps=squares.T @ (pairs.mass @ squares),
        )

    def known_overlaps(self) -> FloatArray:
        """The overlaps.

        Raises
        ------
        InputError
            If the spectrum has none.
        """
        if self.overlaps is None:
            raise InputError(
                "this spectrum was stored without ⟨φ_i², φ_j²⟩, by an earlier pcretrieve: ingest the scans "
                "anew, or take another descriptor"
            )
        return self.overlaps

    def scaled(self, area: float) -> ModalSpectrum:
        """Of the same surface, enlarged or shrunk to another area."""
        factor = area / self.area
        return ModalSpectrum(
            self.eigenvalues / factor,
            self.moments / np.sqrt(factor),
            area,
            None if self.overlaps is None else self.overlaps / factor,
        )


class Describable(Protocol):
    """What a descriptor may ask of a shape; the catalogue reads what is asked for, and nothing else.

    Attributes
    ----------
    spectrum : ModalSpectrum
        Of the surface scaled to unit area.
    area : float
        Of the surface; unit length² of the file.
    mesh : TriangleMesh
        The surface, in the unit of the file.
    others : tuple of ModalSpectrum
        Of further surfaces made of the same scan, each scaled as the first one was.
    """

    @property
    def spectrum(self) -> ModalSpectrum: ...
    @property
    def area(self) -> float: ...
    @property
    def mesh(self) -> TriangleMesh: ...
    @property
    def others(self) -> tuple[ModalSpectrum, ...]: ...


@dataclass(frozen=True, slots=True, eq=False)
class Signature(_Value):
    """A short vector that does not change when the body moves.

    Attributes
    ----------
    values : (L,) float64
        Positive; dimensionless, but for the scale ``absolute``. In the order that its method states; where
        size has a weight, its value comes last.
    kind : str
        The method that made it, such as ``r-bihdm``.
    digest : str
        Fingerprint of the options that made it; signatures compare only where kinds and digests agree.
    deviation : (L,) float64 or None
        Error bar: standard deviation of the logarithm of each value over the surfaces that were made of the
        scan. None where there was one.
    """

    values: FloatArray
    kind: str
    digest: str = ""
    deviation: FloatArray | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", _locked("values", self.values, (None,)))
        if self.deviation is not None:
            deviation = _locked("deviation", self.deviation, (len(self.values),))
            object.__setattr__(self, "deviation", deviation)


@dataclass(frozen=True, slots=True, eq=False)
class SignatureTable(_Value):
    """Signatures of many shapes, all of one kind.

    Attributes
    ----------
    ids : tuple of str, length N
        Distinct.
    values : (N, L) float64
        One signature a row; positive, dimensionless.
    kind, digest : str
        As in `Signature`.
    labels : tuple of (str or None), length N
        Class of each shape, where known.
    """

    ids: tuple[str, ...]
    values: FloatArray
    kind: str
    digest: str = ""
    labels: tuple[str | None, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "ids", tuple(self.ids))
        n = len(self.ids)
        if len(set(self.ids)) != n:
            raise InputError("ids must be distinct")
        object.__setattr__(self, "values", _locked("values", self.values, (n, None)))
        if self.values.size and self.values.min() <= 0:
            raise InputError(f"signature values must be positive, got {self.values.min()}")
        object.__setattr__(self, "labels", tuple(self.labels) or (None,) * n)
        if len(self.labels) != n:
            raise InputError(f"labels must be as many as ids ({n}), got {len(self.labels)}")

    def __len__(self) -> int:
        return len(self.ids)


@dataclass(frozen=True, slots=True, eq=False)
class Neighbors(_Value):
    """The shapes nearest to one query.

    Attributes
    ----------
    ids : tuple of str, length k
    distances : (k,) float64
        Ascending; ties by id.
    """

    ids: tuple[str, ...]
    distances: FloatArray


@dataclass(frozen=True, slots=True)
class Failure:
    """Why a shape has no signature: the stage, the exception's name, and its message."""

    shape_id: str
    stage: str
    error: str
    message: str


def bounding_diagonal(points: FloatArray) -> float:
    """Diagonal of the axis-aligned bounding box of (n, 3) points; 0 where there are none."""
    return float(np.linalg.norm(np.ptp(points, axis=0))) if len(points) else 0.0
