"""The surfaces of a shape ↔ the bytes that a catalogue stores of them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pcretrieve.catalogue.arrays import packed, packed_symmetric, unpacked, unpacked_symmetric
from pcretrieve.catalogue.rows import Payload
from pcretrieve.types import ModalSpectrum, Shape, Step, Surface, TriangleMesh

__all__ = ["payloads_of", "shape_of"]


def payloads_of(shape: Shape) -> dict[Payload, bytes]:
    """The arrays of all surfaces, by the names that they are stored under."""
    parts = shape.apart()
    spectra = [part.spectrum for part in parts]
    meshes = [array for part in parts for array in (part.mesh.vertices, part.mesh.faces)]
    return {
        "spectra": packed(
            [np.array([part.area for part in parts]), np.stack([s.eigenvalues for s in spectra])]
        ),
        "moments": packed([np.stack([s.moments for s in spectra])]),
        "overlaps": packed_symmetric(np.stack([s.known_overlaps() for s in spectra])),
        "meshes": packed(meshes),
    }


def shape_of(payloads: Mapping[Payload, bytes], provenance: tuple[Step, ...]) -> Shape:
    """The shape that was stored, with as much of its surfaces as `payloads` hold.

    A mesh that was not stored is None: version 1 had that of the first surface alone. ValueError, KeyError or
    zlib.error if the bytes are damaged.
    """
    areas, eigenvalues = unpacked(payloads["spectra"])  # (s,), (s, k)
    n = len(areas)
    spectra: list[ModalSpectrum | None] = [None] * n
    meshes: list[TriangleMesh | None] = [None] * n
    if "moments" in payloads:
        (moments,) = unpacked(payloads["moments"])  # (s, k, k)
        overlaps = unpacked_symmetric(payloads["overlaps"]) if "overlaps" in payloads else [None] * n
        spectra = [
            ModalSpectrum(values, m, 1.0, o)
            for values, m, o in zip(eigenvalues, moments, overlaps, strict=True)
        ]
    if "meshes" in payloads:
        arrays = unpacked(payloads["meshes"])
        kept = [TriangleMesh(*parts, provenance) for parts in zip(arrays[::2], arrays[1::2], strict=True)]
        meshes = [*kept, *meshes[len(kept) :]]
    surfaces = (Surface(*parts) for parts in zip(areas.tolist(), spectra, meshes, strict=True))
    return Shape(tuple(surfaces), provenance=provenance)
