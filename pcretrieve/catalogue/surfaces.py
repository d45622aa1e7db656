"""The surfaces of a shape ↔ the bytes that a catalogue stores of them."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from pcretrieve.catalogue.arrays import packed, packed_symmetric, unpacked, unpacked_symmetric
from pcretrieve.catalogue.opening import intact
from pcretrieve.catalogue.record import Record
from pcretrieve.catalogue.rows import Payload, Rows
from pcretrieve.errors import InputError
from pcretrieve.options import PipelineOptions
from pcretrieve.suggestions import did_you_mean
from pcretrieve.values import ModalSpectrum, Need, Shape, Step, Surface, TriangleMesh

__all__ = ["payloads_of", "read_shape", "stored_shape", "suggested_id", "unknown"]

# Number of ids that are compared with an unknown one, which takes less than 0.1 s.
N_COMPARED = 2000


def payloads_of(shape: Shape, options: PipelineOptions) -> dict[Payload, bytes]:
    """The arrays of all surfaces that a catalogue stores, by name."""
    # Imported here, because queries do not need this slow import.
    from pcretrieve.spectral import ELEMENTS

    keep, parts = options.catalogue.keep, shape.apart()
    spectra = [part.spectrum for part in parts]
    areas = np.array([part.area for part in parts])
    stored: dict[Payload, bytes] = {
        "spectra": packed([areas, np.stack([s.eigenvalues for s in spectra])]),
        "moments": packed([np.stack([s.moments for s in spectra])]),
    }
    # The overlaps of a point cloud cannot be computed from the mesh: its operator is that of the points.
    if "overlaps" in keep or ELEMENTS[options.spectral.element].needs == "points":
        stored["overlaps"] = packed_symmetric(np.stack([s.known_overlaps() for s in spectra]))
    if "meshes" in keep:
        meshes = [array for part in parts for array in (part.mesh.vertices, part.mesh.faces)]
        stored["meshes"] = packed(meshes)
    return stored


def read_shape(
    rows: Rows, own: PipelineOptions, shape_id: str, needs: Collection[Need]
) -> tuple[Record, Shape]:
    """Read a shape with some of its parts, and its record, in one transaction.

    Overlaps that were not stored are computed from the mesh. Parts that were not stored, and cannot be
    computed, are missing in the shape.
    """
    overlaps, with_mesh = "overlaps" in needs, bool({"mesh", "eigenvectors"} & set(needs))
    names: list[Payload] = ["spectra"]
    names += ["moments"] if overlaps or "spectrum" in needs else []
    names += ["overlaps"] if overlaps else []
    names += ["meshes"] if overlaps or with_mesh else []
    found = rows.read(shape_id, names)
    if found is None:
        raise unknown(rows, shape_id)
    record, stored = found
    if record.status != "done":
        raise InputError(f"shape {shape_id!r} has no surface: it failed in {record.stage}: {record.message}")
    with intact(rows.location, f"shape {shape_id!r}"):
        shape = stored_shape(stored, record.steps)
    surfaces = shape.surfaces
    if overlaps and "overlaps" not in stored:
        surfaces = tuple(_with_overlaps(surface, own.spectral.element) for surface in surfaces)
    if not with_mesh:
        surfaces = tuple(replace(surface, mesh=None) for surface in surfaces)
    return record, replace(shape, surfaces=surfaces, verdict=record.verdict)


def _with_overlaps(surface: Surface, element: str) -> Surface:
    """The surface with the overlaps of its eigenfunctions, from the mesh; unchanged without a mesh."""
    if surface.mesh is None or surface.spectrum is None:
        return surface
    from threadpoolctl import threadpool_limits

    from pcretrieve.spectral import unit_eigenpairs

    with threadpool_limits(limits=1):  # as in the pipeline, so that rounding errors are the same
        pairs = unit_eigenpairs(surface.mesh, len(surface.spectrum.eigenvalues), element)
        overlaps = ModalSpectrum.of(pairs).overlaps
    return replace(surface, spectrum=replace(surface.spectrum, overlaps=overlaps))


def unknown(rows: Rows, shape_id: str) -> InputError:
    """The error for an id that a store does not have."""
    return InputError(
        f"{rows.location} holds no shape {shape_id!r}; `pcretrieve list` names them"
        f"{suggested_id(rows, shape_id)}"
    )


def suggested_id(rows: Rows, shape_id: str) -> str:
    """The question whether the id of another shape was meant, as `did_you_mean` asks it."""
    return did_you_mean(shape_id, (record.id for record in rows.page(limit=N_COMPARED)))


def stored_shape(payloads: Mapping[Payload, bytes], provenance: tuple[Step, ...]) -> Shape:
    """The shape whose arrays are stored."""
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
