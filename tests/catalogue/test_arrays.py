"""Arrays come back to the last bit, and damage is noticed."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pcretrieve.catalogue.arrays import SHORTEST_COMPRESSED, packed, packed_values, unpacked, unpacked_values

RNG = np.random.default_rng(3)

ARRAYS: tuple[NDArray[np.generic], ...] = (
    np.array([0.0, -0.0, np.inf, -np.inf, np.nan, 5e-324, 1.7e308, -1.0]),
    RNG.normal(size=(2, 40, 41)),
    np.ones(SHORTEST_COMPRESSED // 8 - 1),
    RNG.integers(0, 2**31 - 1, size=(500, 3)).astype(np.int32),
    RNG.normal(size=(90, 90))[:, ::2],
    RNG.normal(size=700).astype(">f8"),
    np.empty((0, 3)),
    np.array(3.0),
    np.arange(-128, 128).astype(np.int8),
)


def test_every_bit_comes_back() -> None:
    for found, given in zip(unpacked(packed(ARRAYS)), ARRAYS, strict=True):
        assert found.shape == given.shape
        assert found.dtype == given.dtype.newbyteorder("=")
        assert found.tobytes() == np.asarray(given, found.dtype).tobytes()


def test_a_changed_byte_is_noticed() -> None:
    for pieces, unpack in (
        (packed([np.arange(50.0)]), unpacked),
        (packed([RNG.normal(size=(30, 30))]), unpacked),
        (packed_values(RNG.normal(size=23)), lambda blob: unpacked_values(blob, 1, 23)),
    ):
        for position in (0, 5, 8, 100, -5, -1):
            blob = bytearray(pieces)
            blob[position] ^= 16
            with pytest.raises(ValueError, match="checksum"):
                unpack(bytes(blob))
