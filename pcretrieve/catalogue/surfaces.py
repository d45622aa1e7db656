"""The surfaces of a shape ↔ the arrays of its row."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcretrieve.types import ModalSpectrum, Shape, Step, TriangleMesh

__all__ = ["areas_of", "meshes_of", "row_arrays", "spectra_of"]

Arrays = Mapping[str, NDArray[Any]]


def row_arrays(shape: Shape) -> dict[str, Arrays]:
    """The arrays of all surfaces, by column of the row."""
    parts = shape.apart()
    return {
        "eigenvalues": {
            "values": np.stack([part.spectrum.eigenvalues for part in parts]),  # (s, k)
            "surface_areas": np.array([part.area for part in parts]),  # (s,)
        },
        "moments": {
            "values": np.stack([part.spectrum.moments for part in parts]),  # (s, k, k)
            "overlaps": np.stack([part.spectrum.known_overlaps() for part in parts]),
        },
        "mesh": {
            # The first surface without a number, as versions that kept no others stored it.
            f"{name}{number or ''}": getattr(part.mesh, name)
            for number, part in enumerate(parts)
            for name in ("vertices", "faces")
        },
    }


def areas_of(eigenvalues: Arrays, first: float) -> list[float]:
    """The areas of all surfaces, unit length² of the file; `first` is that of the first."""
    if "surface_areas" in eigenvalues:
        return list(eigenvalues["surface_areas"].tolist())
    return [first * area for area in _relative_areas(eigenvalues)]


def spectra_of(eigenvalues: Arrays, moments: Arrays) -> list[ModalSpectrum]:
    """The spectra of all surfaces, each of unit area."""
    values = np.atleast_2d(eigenvalues["values"])  # (s, k)
    n, k = values.shape
    areas = [1.0] * n if "surface_areas" in eigenvalues else _relative_areas(eigenvalues)
    # Earlier versions stored no overlaps.
    overlaps = moments["overlaps"].reshape(n, k, k) if "overlaps" in moments else [None] * n
    return [
        ModalSpectrum(*parts).scaled(1.0)
        for parts in zip(values, moments["values"].reshape(n, k, k), areas, overlaps, strict=True)
    ]


def meshes_of(mesh: Arrays, n_surfaces: int, provenance: tuple[Step, ...]) -> Sequence[TriangleMesh | None]:
    """The meshes of all surfaces; None where earlier versions stored that of the first alone."""
    return [
        TriangleMesh(mesh[f"vertices{number}"], mesh[f"faces{number}"], provenance)
        if f"vertices{number}" in mesh
        else None
        for number in ("", *range(1, n_surfaces))
    ]


def _relative_areas(eigenvalues: Arrays) -> list[float]:
    """The areas that earlier versions stored, that of the first surface being 1; before that, none at all."""
    n = len(np.atleast_2d(eigenvalues["values"]))
    return list(eigenvalues.get("areas", np.ones(n)).tolist())
