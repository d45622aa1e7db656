"""A processed scan: its surfaces with operators and spectra, and its grade; or the failure of processing."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal, TypeVar, get_args

import numpy as np

from pcretrieve.arrays import FloatArray, IntArray
from pcretrieve.errors import InputError, ShapeError, Stage
from pcretrieve.values.base import Value, check_type
from pcretrieve.values.geometry import PointCloud, Step, TriangleMesh

if TYPE_CHECKING:
    from scipy.sparse import csc_array


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
        if not (
            np.isfinite(self.stiffness.data).all() and np.isfinite(self.mass.data).all()
        ):
            raise InputError(
                "stiffness and mass must be finite, got NaN or infinite entries"
            )
        if not self.area > 0:
            raise InputError(f"mass must sum up to a positive area, got {self.area:g}")
        if self.nodes is not None:
            self._lock("nodes", (n,), np.int32)

    @property
    def area(self) -> float:
        """1ᵀM·1, unit length²; with the Dirichlet boundary condition less than the area of the surface."""
        return float(self.mass.sum())

    def __repr__(self) -> str:
        return (
            f"LaplaceBeltrami({self.mass.shape[0]:,} nodes; area {self.area:.4g} units²)"
        )


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
        Number of solves with the shifted stiffness matrix for a block of vectors; 0 for ``dense``.
    solver : str
        The eigenvalue solver: ``krylov`` or ``dense``.
    """

    eigenvalues: FloatArray
    eigenvectors: FloatArray
    mass: csc_array
    largest_residual: float = 0.0
    iterations: int = 0
    solver: str = ""

    def __post_init__(self) -> None:
        k = len(self._lock("eigenvalues", (None,)))
        self._lock("eigenvectors", (self.mass.shape[0], k))

    @property
    def area(self) -> float:
        """1ᵀM·1, unit length²."""
        return float(self.mass.sum())

    def lowest(self, n: int) -> Eigenpairs:
        """The first `n` eigenpairs, or all if there are fewer."""
        return replace(
            self, eigenvalues=self.eigenvalues[:n], eigenvectors=self.eigenvectors[:, :n]
        )

    def __repr__(self) -> str:
        return (
            f"Eigenpairs({len(self.eigenvalues)} pairs on {len(self.eigenvectors):,} nodes, "
            f"eigenvalues {self.eigenvalues[0]:.4g} to {self.eigenvalues[-1]:.4g} units⁻²)"
        )


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
        k = len(self._lock("eigenvalues", (None,)))
        self._lock("moments", (k, k))
        if self.overlaps is not None:
            self._lock("overlaps", (k, k))

    @classmethod
    def of(cls, pairs: Eigenpairs | ModalSpectrum) -> ModalSpectrum:
        """The modal spectrum of eigenpairs; a modal spectrum itself.

        The integral ∫ f²g is discretised as Σ f_i² M_ij g_j with the mass matrix M (Ye and Yu, "A fast modal
        space transform for robust nonrigid shape retrieval", 2016, section 3), and ∫ f²g² as Σ f_i² M_ij
        g_j². The constant eigenfunction is first; the unit is that of the eigenpairs.
        """
        check_type("pairs", pairs, Eigenpairs, ModalSpectrum)
        if isinstance(pairs, ModalSpectrum):
            return pairs
        phi = pairs.eigenvectors  # (n, k)
        squares = phi**2
        moments, overlaps = (
            squares.T @ (pairs.mass @ other) for other in (phi, squares)
        )  # (k, k)
        return cls(pairs.eigenvalues, moments, pairs.area, overlaps)

    def known_overlaps(self) -> FloatArray:
        """(k, k) ⟨φ_i², φ_j²⟩; ShapeError if the spectrum was stored without overlaps."""
        if self.overlaps is None:
            raise ShapeError(
                "gone: this spectrum has no overlaps ⟨φ_i², φ_j²⟩: neither they nor the mesh were kept when "
                "the shape was stored, or overlaps are not among the needs that the descriptor declares; "
                'ingest again with catalogue.keep = ["overlaps"], or choose another descriptor',
                stage=Stage.SIGNATURE,
            )
        return self.overlaps

    def __repr__(self) -> str:
        return (
            f"ModalSpectrum({len(self.eigenvalues)} eigenvalues {self.eigenvalues[0]:.4g} to "
            f"{self.eigenvalues[-1]:.4g} units⁻²; area {self.area:.4g} units²)"
        )

    def scaled(self, area: float) -> ModalSpectrum:
        """The modal spectrum of the same surface after uniform scaling to another area."""
        factor = area / self.area
        overlaps = None if self.overlaps is None else self.overlaps / factor
        return ModalSpectrum(
            self.eigenvalues / factor, self.moments / np.sqrt(factor), area, overlaps
        )


# The parts of a shape that a descriptor may need. A spectrum has its overlaps only with the need "overlaps".
Need = Literal["spectrum", "overlaps", "eigenvectors", "mesh", "points"]

_Part = TypeVar("_Part")

GradeName = Literal["good", "poor", "incomplete"]

# What a person may decide about a scan: to scan again, that it will do, or nothing but a note.
Decision = Literal["rescan", "accept", "note"]


@dataclass(frozen=True, slots=True)
class Grade:
    """Whether the signature of a shape can be relied on, from checks of its points and its surface.

    Attributes
    ----------
    name : {"good", "poor", "incomplete"}
        "poor": the expected error is so large that the nearest shape may be the wrong one. "incomplete": a
        part of the body is missing that a person would see missing.
    error : float
        The log-signature error that is expected from what was filled in, cut off or thinly sampled, and from
        noise; dimensionless, comparable to the distance ``log`` of `SignatureIndex`. Two poses of a body are
        about 0.1 apart, two similar bodies 0.5. It is not `Signature.errors`, the error bar over the
        surfaces of one scan.
    reasons : tuple of str
        The checks that led to the grade, each with its measurement, most severe first; empty if good.

    Raises
    ------
    InputError
        If there is no such grade, or the error is negative or not finite.
    """

    name: GradeName
    error: float
    reasons: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.name not in get_args(GradeName):
            raise InputError(
                f"a grade must be one of {', '.join(get_args(GradeName))}, got {self.name!r}"
            )
        if not (self.error >= 0 and math.isfinite(self.error)):
            raise InputError(
                f"an expected error must be at least 0 and finite, got {self.error}"
            )
        object.__setattr__(self, "reasons", tuple(self.reasons))

    def __str__(self) -> str:
        if not self.reasons:
            return self.name
        return f"{self.name}, may answer wrongly: {'; '.join(self.reasons)}"

    @property
    def is_good(self) -> bool:
        """Whether the grade is "good"."""
        return self.name == "good"


@dataclass(frozen=True, slots=True, eq=False)
class Surface(Value):
    """One of the surfaces that were reconstructed from a scan, with the parts that were kept.

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
            raise InputError(
                f"the area of a surface must be positive and finite, got {self.area}"
            )


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
        All stages from the file to the spectra, and the checks, in order.
    grade : Grade or None
        Whether the signature can be relied on; None if that is not known.
    number : int or None
        Of a shape that `apart` has made of a scan with several surfaces: which of them it has, from 0.
    """

    surfaces: tuple[Surface, ...]
    cloud: PointCloud | None = None
    provenance: tuple[Step, ...] = field(default=(), compare=False)
    grade: Grade | None = None
    number: int | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "surfaces", tuple(self.surfaces))
        if not self.surfaces:
            raise InputError("a shape must have at least 1 surface, got none")

    def __repr__(self) -> str:
        n = len(self.surfaces)
        first = self.surfaces[0]
        parts = {
            "mesh": first.mesh,
            "spectrum": first.spectrum,
            "eigenpairs": first.eigenpairs,
        }
        held = [
            name
            for name, part in (parts | {"points": self.cloud}).items()
            if part is not None
        ]
        surfaces = "1 surface" if n == 1 else f"{n} surfaces"
        return f"Shape({surfaces} with {', '.join(held) or 'nothing kept'}; area {self.area:.4g} file units²)"

    def _repr_html_(self) -> str:
        from pcretrieve.draw.pictures import picture_html

        mesh = self.surfaces[0].mesh
        return picture_html(None, repr(self)) if mesh is None else mesh._repr_html_()

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
        if len(self.surfaces) == 1:
            return (self,)
        return tuple(
            replace(self, surfaces=(surface,), number=number)
            for number, surface in enumerate(self.surfaces)
        )


def _kept(part: Need, value: _Part | None) -> _Part:
    if value is None:
        raise ShapeError(
            f"gone: the shape must hold its {part}, but does not: not kept when it was stored, or not among "
            "the needs that the descriptor declares; process the scan again, or choose another descriptor",
            stage=Stage.SIGNATURE,
        )
    return value


@dataclass(frozen=True, slots=True)
class Failure:
    """Why a shape has no signature: the stage that failed, the name of the exception and its message."""

    shape_id: str
    stage: str
    error: str
    message: str
