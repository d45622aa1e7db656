"""Arrays come back to the last bit, and damage is noticed."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pcretrieve.catalogue.arrays import (
    SHORTEST_COMPRESSED,
    packed,
    packed_symmetric,
    packed_values,
    unpacked,
    unpacked_symmetric,
    unpacked_values,
)

RNG = np.random.default_rng(3)
ODD = np.array([0.0, -0.0, np.inf, -np.inf, np.nan, 5e-324, 1.7e308, -1.0])

ARRAYS: dict[str, NDArray[np.generic]] = {
    "numbers of every kind": ODD,
    "a large array": RNG.normal(size=(2, 40, 41)),
    "one below the length of compressed ones": np.ones(SHORTEST_COMPRESSED // 8 - 1),
    "faces": RNG.integers(0, 2**31 - 1, size=(500, 3)).astype(np.int32),
    "columns of a larger array": RNG.normal(size=(90, 90))[:, ::2],
    "big-endian numbers": RNG.normal(size=700).astype(">f8"),
    "nothing": np.empty((0, 3)),
    "one number": np.array(3.0),
    "small integers": np.arange(-128, 128).astype(np.int8),
}


def rows(pieces: list[bytes]) -> NDArray[np.uint8]:
    return np.frombuffer(b"".join(pieces), np.uint8).reshape(len(pieces), -1)


@pytest.mark.parametrize("name", ARRAYS)
def test_every_bit_comes_back(name: str) -> None:
    given = ARRAYS[name]
    first, second = unpacked(packed([given, given]))
    for found in (first, second):
        assert found.shape == given.shape
        assert found.dtype == given.dtype.newbyteorder("=")
        assert found.tobytes() == np.asarray(given, found.dtype).tobytes()


def test_bytes_do_not_depend_on_the_machine() -> None:
    assert packed([np.array([1.0])]).hex() == "0001000800000001000000000000000000f03f2e60367f"


def test_exponents_are_compressed_and_digits_are_not() -> None:
    matrix = RNG.normal(size=(61, 61))
    assert 0.85 < len(packed([matrix])) / matrix.nbytes < 0.95


@pytest.mark.parametrize("n", [1, 3])
@pytest.mark.parametrize("k", [1, 2, 61])
def test_rounding_of_symmetric_matrices_comes_back(n: int, k: int) -> None:
    half = RNG.normal(size=(n, k, k)) + 3
    matrices = half + half.transpose(0, 2, 1)
    rows, columns = np.tril_indices(k, -1)
    matrices[:, rows, columns] *= 1 + 4e-16 * RNG.integers(-9, 9, size=(n, len(rows)))
    packed_matrices = packed_symmetric(matrices)
    assert unpacked_symmetric(packed_matrices).tobytes() == matrices.tobytes()
    if k == 61:
        assert len(packed_matrices) < 0.52 * matrices.nbytes


def test_matrices_that_are_not_symmetric_come_back_too() -> None:
    matrices = np.concatenate([RNG.normal(size=(1, 9, 9)), np.resize(ODD, (1, 9, 9))])
    assert unpacked_symmetric(packed_symmetric(matrices)).tobytes() == matrices.tobytes()


def test_signatures_come_back_row_by_row() -> None:
    values = RNG.normal(size=(50, 23))
    assert unpacked_values(rows([packed_values(row) for row in values]), 23).tobytes() == values.tobytes()


@pytest.mark.parametrize("position", [0, 5, 8, 100, -5, -1])
def test_a_changed_byte_is_noticed(position: int) -> None:
    for pieces, unpack in (
        (packed([np.arange(50.0)]), unpacked),
        (packed([RNG.normal(size=(30, 30))]), unpacked),
        (packed_values(RNG.normal(size=23)), lambda blob: unpacked_values(rows([blob]), 23)),
    ):
        blob = bytearray(pieces)
        blob[position] ^= 16
        with pytest.raises(ValueError, match="checksum"):
            unpack(bytes(blob))


@pytest.mark.parametrize("length", [0, 3, 40, -1])
def test_missing_bytes_are_noticed(length: int) -> None:
    with pytest.raises(ValueError, match="checksum"):
        unpacked(packed([np.arange(50.0)])[:length])


def test_signatures_of_another_length_are_no_table() -> None:
    with pytest.raises(ValueError, match="there must be 4 values"):
        unpacked_values(rows([packed_values(np.ones(3))]), 4)
