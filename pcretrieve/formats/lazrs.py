"""Points that were compressed by LASzip → their bytes, by lazrs."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

__all__ = ["chunk_sizes", "decompressed"]


def chunk_sizes(data: bytes, start: int, record: bytes) -> list[int]:
    """The sizes of the chunks of a LAZ file.

    start: position of the points; bytes.
    Returns list of int: of each chunk, in bytes.
    """
    import lazrs

    file = io.BytesIO(data)
    file.seek(start)
    with _errors():
        return [n_bytes for _, n_bytes in lazrs.read_chunk_table(file, lazrs.LazVlr(record))]


def decompressed(
    data: bytes, start: int, record: bytes, n_points: int, n_bytes: int, at_once: int
) -> NDArray[np.uint8]:
    """Decompress the points of a LAZ file.

    start: position of the points; bytes.
    Returns (n, b) uint8: the bytes of the points.
    """
    import lazrs

    file = io.BytesIO(data)
    file.seek(start)
    parts = []
    with _errors():
        points = lazrs.LasZipDecompressor(file, record)
        for first in range(0, n_points, at_once):
            part = np.zeros((min(at_once, n_points - first), n_bytes), dtype=np.uint8)
            points.decompress_many(part)
            parts.append(part)
    return np.concatenate(parts) if parts else np.zeros((0, n_bytes), dtype=np.uint8)


@contextmanager
def _errors() -> Iterator[None]:
    """Raise the exceptions of lazrs as ValueError."""
    try:
        yield
    except (MemoryError, KeyboardInterrupt, SystemExit):
        raise
    # A panic of lazrs is no Exception of Python.
    except BaseException as error:
        raise ValueError(str(error) or type(error).__name__) from error
