"""Arrays and the surfaces of a shape ↔ the bytes that a catalogue stores, without loss.

Numbers are stored little-endian, after a header with their type and shape. Large arrays are compressed after
their bytes have been regrouped: the first bytes of all numbers, then the second bytes, and so on, because
signs and exponents repeat, and digits do not. A checksum detects changes of the bytes.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcretrieve.catalogue.records import Payload, damaged
from pcretrieve.options import PipelineOptions
from pcretrieve.values import (
    FloatArray,
    ModalSpectrum,
    Shape,
    Step,
    Surface,
    TriangleMesh,
)

DTYPES = tuple(np.dtype(name) for name in ("<f8", "<i4", "<i8", "|i1", "|u1"))

# Smallest number of bytes of an array that is compressed. Compression hardly reduces smaller arrays.
SHORTEST_COMPRESSED = 4096

# Compression level of zlib. See docs/decisions.md, LEVEL.
LEVEL = 1

# Largest compression ratio of all arrays of a blob together. Most ratios are below 10.
MOST_RATIO = 100
# Number of bytes to which any blob may expand.
ANY_SIZE = 1 << 24

# Largest number of surfaces of a shape: `reconstructions`, which is 2 by default, and hardly ever above 10.
MOST_SURFACES = 1000

# Header of an array: its type, its number of dimensions, whether it is compressed, its length in bytes.
HEADER = struct.Struct("<BBBI")
CHECKSUM = struct.Struct("<I")


def packed(arrays: Sequence[NDArray[Any]]) -> bytes:
    """Convert arrays to bytes."""
    parts = []
    for array in arrays:
        stored = np.asarray(array, array.dtype.newbyteorder("<"), order="C")
        compressed = stored.nbytes >= SHORTEST_COMPRESSED
        body = stored.tobytes()
        if compressed:
            planes = np.frombuffer(body, np.uint8).reshape(-1, stored.itemsize).T
            body = zlib.compress(planes.tobytes(), LEVEL)
        parts += [
            HEADER.pack(DTYPES.index(stored.dtype), stored.ndim, compressed, len(body)),
            struct.pack(f"<{stored.ndim}I", *stored.shape),
            body,
        ]
    joined = b"".join(parts)
    return joined + CHECKSUM.pack(zlib.crc32(joined))


def unpacked(blob: bytes, most: int) -> list[NDArray[Any]]:
    """The inverse of `packed`, of at most so many arrays."""
    end = len(blob) - CHECKSUM.size
    view = memoryview(blob)
    if end < 0 or CHECKSUM.unpack_from(blob, end)[0] != zlib.crc32(view[:end]):
        raise ValueError("its checksum does not fit")
    arrays: list[NDArray[Any]] = []
    most_bytes = max(ANY_SIZE, MOST_RATIO * len(blob))
    position, n_declared = 0, 0
    while position < end:
        if len(arrays) == most:
            raise ValueError(f"it holds more than {most} arrays")
        kind, n_axes, compressed, n_bytes = HEADER.unpack_from(blob, position)
        shape = struct.unpack_from(f"<{n_axes}I", blob, position + HEADER.size)
        position += HEADER.size + 4 * n_axes
        body = view[position : position + n_bytes]
        dtype = DTYPES[kind]
        # An array without values may have long sides too, by which readers allocate.
        n_declared += math.prod((*(max(side, 1) for side in shape), dtype.itemsize))
        if n_declared > most_bytes:
            raise ValueError(f"it declares more than {most_bytes} bytes in {len(blob)}")
        if compressed:
            size = math.prod((*shape, dtype.itemsize))
            # One more does not fit the shape.
            expanded = zlib.decompressobj().decompress(body, size + 1)
            planes = np.frombuffer(expanded, np.uint8).reshape(dtype.itemsize, -1)
            numbers = np.ascontiguousarray(planes.T).view(dtype)
        else:
            numbers = np.frombuffer(body, dtype)
        arrays.append(numbers.reshape(shape))
        position += n_bytes
    return arrays


def packed_values(values: FloatArray) -> bytes:
    """The values (L,) of a signature as 8 (L + 1) bytes: the last are the exclusive or of all, a checksum."""
    words = np.ascontiguousarray(values, "<f8").view("<u8")
    return words.tobytes() + np.bitwise_xor.reduce(words, keepdims=True).tobytes()


def unpacked_values(blob: bytes | bytearray, n: int, n_values: int) -> FloatArray:
    """The inverse of `packed_values` for n signatures, one after the other: (n, L) float64, to the bit."""
    if len(blob) != 8 * n * (n_values + 1):
        raise ValueError(f"there must be {n_values} values")
    words = np.frombuffer(blob, "<u8").reshape(n, n_values + 1)
    if (np.bitwise_xor.reduce(words[:, :-1], axis=1) != words[:, -1]).any():
        raise ValueError("its checksum does not fit")
    return words[:, :-1].view(np.float64)


# --- shapes ---------------------------------------------------------------------------------------------


@contextmanager
def intact(location: str, what: str) -> Iterator[None]:
    """Convert errors due to invalid bytes to the error for a damaged catalogue."""
    try:
        yield
    except (KeyError, ValueError, struct.error, zlib.error) as error:
        raise damaged(location, f"{what} cannot be read: {error}") from error


def payloads_of(shape: Shape, options: PipelineOptions) -> dict[Payload, bytes]:
    """The arrays of all surfaces that a catalogue stores, by name."""
    keep, parts = options.catalogue.keep, shape.apart()
    spectra = [part.spectrum for part in parts]
    areas = np.array([part.area for part in parts])
    stored: dict[Payload, bytes] = {
        "spectra": packed([areas, np.stack([s.eigenvalues for s in spectra])]),
        "moments": packed([np.stack([s.moments for s in spectra])]),
    }
    # The overlaps of a point cloud cannot be computed from the mesh: its operator is that of the points.
    if "overlaps" in keep or options.spectral.of_points:
        stored["overlaps"] = packed([np.stack([s.known_overlaps() for s in spectra])])
    if "meshes" in keep:
        meshes = [
            array for part in parts for array in (part.mesh.vertices, part.mesh.faces)
        ]
        stored["meshes"] = packed(meshes)
    return stored


def stored_shape(
    payloads: Mapping[Payload, bytes], provenance: tuple[Step, ...]
) -> Shape:
    """The shape whose arrays are stored."""
    areas, eigenvalues = unpacked(payloads["spectra"], 2)  # (s,), (s, k)
    n = len(areas)
    if n > MOST_SURFACES:
        raise ValueError(f"it declares {n} surfaces, {MOST_SURFACES} may be")
    spectra: list[ModalSpectrum | None] = [None] * n
    meshes: list[TriangleMesh | None] = [None] * n
    if "moments" in payloads:
        (moments,) = unpacked(payloads["moments"], 1)  # (s, k, k)
        overlaps: Any = [None] * n
        if "overlaps" in payloads:
            (overlaps,) = unpacked(payloads["overlaps"], 1)  # (s, k, k)
        spectra = [
            ModalSpectrum(values, m, 1.0, o)
            for values, m, o in zip(eigenvalues, moments, overlaps, strict=True)
        ]
    if "meshes" in payloads:
        arrays = unpacked(payloads["meshes"], 2 * n)
        kept = [
            TriangleMesh(*parts, provenance)
            for parts in zip(arrays[::2], arrays[1::2], strict=True)
        ]
        meshes = [*kept, *meshes[len(kept) :]]
    surfaces = (
        Surface(*parts) for parts in zip(areas.tolist(), spectra, meshes, strict=True)
    )
    return Shape(tuple(surfaces), provenance=provenance)
