"""The surfaces of a shape ↔ the bytes that a catalogue stores of them."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np

from pcretrieve.catalogue.arrays import packed, packed_symmetric, unpacked, unpacked_symmetric
from pcretrieve.catalogue.opening import intact
from pcretrieve.catalogue.record import Record
from pcretrieve.catalogue.rows import Payload, Rows
from pcretrieve.errors import InputError
from pcretrieve.types import ModalSpectrum, Need, Shape, Step, Surface, TriangleMesh

__all__ = ["payloads_of", "read_shape", "unknown"]


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


def read_shape(rows: Rows, path: Path, shape_id: str, needs: Collection[Need]) -> tuple[Record, Shape]:
    """A shape with the parts that are needed and no others, and its record at the same moment.

    `path` is that of the catalogue, for messages. InputError if there is no shape of that id, or it failed;
    CatalogueError if its bytes are damaged.
    """
    names: list[Payload] = ["spectra"]
    names += ["moments", "overlaps"] if "spectrum" in needs else []
    names += ["meshes"] if {"mesh", "eigenvectors"} & set(needs) else []
    found = rows.read(shape_id, names)
    if found is None:
        raise unknown(path, shape_id)
    record, stored = found
    if record.status != "done":
        raise InputError(f"shape {shape_id!r} has no surface: it failed in {record.stage}: {record.message}")
    with intact(path, f"shape {shape_id!r}"):
        return record, _shape(stored, record.steps)


def unknown(path: Path, shape_id: str) -> InputError:
    """The error for an id that a catalogue does not hold."""
    return InputError(f"{path} holds no shape {shape_id!r}; `pcretrieve list` names them")


def _shape(payloads: Mapping[Payload, bytes], provenance: tuple[Step, ...]) -> Shape:
    """The shape that was stored. A mesh is None where version 1 had that of the first surface alone."""
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
