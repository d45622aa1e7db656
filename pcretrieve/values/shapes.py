"""A processed scan: its surfaces with their spectra and its grade, or the failure of the processing."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal, TypeVar, get_args

import numpy as np

from pcretrieve.errors import InputError, ShapeError, Stage
from pcretrieve.values.base import Value
from pcretrieve.values.geometry import PointCloud, Step, TriangleMesh
from pcretrieve.values.spectra import Eigenpairs, ModalSpectrum

# The parts of a shape that a descriptor may need. A spectrum has its overlaps only with the need "overlaps".
Need = Literal["spectrum", "overlaps", "eigenvectors", "mesh", "points"]

_Part = TypeVar("_Part")

GradeName = Literal["good", "poor", "incomplete"]


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
    """

    surfaces: tuple[Surface, ...]
    cloud: PointCloud | None = None
    provenance: tuple[Step, ...] = field(default=(), compare=False)
    grade: Grade | None = None

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
        from pcretrieve.draw.thumbnail import picture_html

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
        return tuple(replace(self, surfaces=(surface,)) for surface in self.surfaces)


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
