"""Signatures of labelled shapes, for tests."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pcretrieve.values import FloatArray, SignatureTable


def classes_of(n_shapes: int, n_each: int) -> list[str]:
    """The classes of shapes, so many shapes in each."""
    return [f"class {row // n_each:03}" for row in range(n_shapes)]


def table_of(logs: FloatArray, labels: Sequence[str | None] = ()) -> SignatureTable:
    """The table of some log-signatures, with ids in the order of the rows."""
    ids = tuple(f"T{row:04}" for row in range(len(logs)))
    return SignatureTable(ids, np.exp(logs), "r-bihdm", "3f2a", tuple(labels))


def posed_logs() -> FloatArray:
    """(60, 8) log-signatures of classes of six, which differ where poses do not, and less than those."""
    rng = np.random.default_rng(0)
    centres = np.repeat(rng.normal(size=(10, 8)) * np.geomspace(0.3, 0.02, 8), 6, axis=0)
    poses: FloatArray = rng.normal(size=(60, 8)) * np.geomspace(0.02, 1.0, 8)
    return centres + poses - 3
