"""Arrays ↔ the bytes that a catalogue stores, without loss.

Numbers are stored little-endian, after a header with their type and shape. Large arrays are compressed after
their bytes have been regrouped: the first bytes of all numbers, then the second bytes, and so on, because
signs and exponents repeat, and digits do not. A checksum detects changes of the bytes.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcretrieve.values import FloatArray

__all__ = ["packed", "packed_symmetric", "packed_values", "unpacked", "unpacked_symmetric", "unpacked_values"]

DTYPES = tuple(np.dtype(name) for name in ("<f8", "<i4", "<i8", "|i1", "|u1"))

# Smallest number of bytes of an array that is compressed. Compression hardly reduces smaller arrays.
SHORTEST_COMPRESSED = 4096

# Compression level of zlib. See docs/decisions.md, LEVEL.
LEVEL = 1

# Header of an array: its type, its number of dimensions, whether it is compressed, its length in bytes.
HEADER = struct.Struct("<BBBI")
CHECKSUM = struct.Struct("<I")


def packed(arrays: Sequence[NDArray[Any]]) -> bytes:
    """Convert arrays to bytes."""
    parts = []
    for array in arrays:
        stored = np.asarray(array, array.dtype.newbyteorder("<"), order="C")
        compressed = stored.nbytes >= SHORTEST_COMPRESSED
        body = zlib.compress(_planes(stored), LEVEL) if compressed else stored.tobytes()
        parts += [
            HEADER.pack(DTYPES.index(stored.dtype), stored.ndim, compressed, len(body)),
            struct.pack(f"<{stored.ndim}I", *stored.shape),
            body,
        ]
    joined = b"".join(parts)
    return joined + CHECKSUM.pack(zlib.crc32(joined))


def unpacked(blob: bytes) -> list[NDArray[Any]]:
    """The inverse of `packed`."""
    end = len(blob) - CHECKSUM.size
    view = memoryview(blob)
    if end < 0 or CHECKSUM.unpack_from(blob, end)[0] != zlib.crc32(view[:end]):
        raise ValueError("its checksum does not fit")
    arrays, position = [], 0
    while position < end:
        kind, n_axes, compressed, n_bytes = HEADER.unpack_from(blob, position)
        shape = struct.unpack_from(f"<{n_axes}I", blob, position + HEADER.size)
        position += HEADER.size + 4 * n_axes
        body = view[position : position + n_bytes]
        dtype = DTYPES[kind]
        if compressed:
            planes = np.frombuffer(zlib.decompress(body), np.uint8).reshape(dtype.itemsize, -1)
            numbers = np.ascontiguousarray(planes.T).view(dtype)
        else:
            numbers = np.frombuffer(body, dtype)
        arrays.append(numbers.reshape(shape))
        position += n_bytes
    return arrays


def packed_symmetric(matrices: FloatArray) -> bytes:
    """Convert symmetric matrices to bytes, half as many as `packed` needs.

    matrices: (s, k, k) float64, matrices that are symmetric except for rounding errors, which are stored too.
    """
    bits = np.ascontiguousarray(matrices).view(np.int64)
    upper, lower = np.triu_indices(bits.shape[1]), np.tril_indices(bits.shape[1], -1)
    # The bits of neighbouring numbers are neighbouring integers, so that rounding errors are small integers.
    moved = bits[_each(lower)] - bits.transpose(0, 2, 1)[_each(lower)]
    small = moved.astype(np.int8)
    return packed([matrices[_each(upper)], small if (small == moved).all() else moved])


def unpacked_symmetric(blob: bytes) -> FloatArray:
    """The inverse of `packed_symmetric`.

    Returns (s, k, k) float64: the same matrices, to the bit.
    """
    above, moved = unpacked(blob)
    n, n_above = above.shape
    k = int(np.sqrt(2 * n_above))
    upper, lower = np.triu_indices(k), np.tril_indices(k, -1)
    bits = np.empty((n, k, k), np.int64)
    bits[_each(upper)] = above.view(np.int64)
    bits[_each(lower)] = bits.transpose(0, 2, 1)[_each(lower)] + moved
    return bits.view(np.float64)


def packed_values(values: FloatArray) -> bytes:
    """Convert the values of a signature to bytes that are fast to read.

    values: (L,) float64, the values.
    Returns bytes: 8 (L + 1) bytes: the values, and the exclusive or of their bits as a checksum.
    """
    words = np.ascontiguousarray(values, "<f8").view("<u8")
    return words.tobytes() + np.bitwise_xor.reduce(words, keepdims=True).tobytes()


def unpacked_values(rows: NDArray[np.uint8], n_values: int) -> FloatArray:
    """The inverse of `packed_values`, for many signatures.

    rows: (N, b) uint8, one result of `packed_values` in each row.
    Returns (N, L) float64: the same values, to the bit.
    """
    if rows.size != 8 * len(rows) * (n_values + 1):
        raise ValueError(f"there must be {n_values} values")
    words = np.ascontiguousarray(rows).reshape(len(rows), 8 * (n_values + 1)).view("<u8")  # (N, L + 1)
    if (np.bitwise_xor.reduce(words[:, :-1], axis=1) != words[:, -1]).any():
        raise ValueError("its checksum does not fit")
    return words[:, :-1].view(np.float64)


def _each(entries: tuple[NDArray[np.intp], NDArray[np.intp]]) -> tuple[Any, ...]:
    """The index of entries in each matrix of an array of matrices."""
    return (slice(None), *entries)


def _planes(array: NDArray[Any]) -> bytes:
    """The first bytes of all numbers, then the second bytes, and so on."""
    rows = array.reshape(-1).view(np.uint8).reshape(-1, array.itemsize)
    return np.ascontiguousarray(rows.T).tobytes()
