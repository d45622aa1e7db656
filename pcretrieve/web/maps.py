"""The places of shapes on the map of the collection, which are computed once, beside the requests."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as NotYet
from threading import Lock
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.retrieval import SignatureIndex, plane_map
from pcretrieve.values import FloatArray

__all__ = ["Layout", "Maps"]

# Largest number of shapes on a map: t-SNE takes about 15 s for so many, and more could not be told apart.
MOST_SHAPES = 2_000

SEED = 0

# Longest time for which a request waits for a map; seconds.
PATIENCE = 1.0


class Layout(NamedTuple):
    """Places of shapes.

    rows: (n,) int, the shapes, as rows of the index.
    places: (n, 2) float64, the place of each, within [0, 1]².
    """

    rows: NDArray[np.intp]
    places: FloatArray


class Maps:
    """The map that was computed last; any thread may ask for one."""

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="pcretrieve-map")
        self._lock = Lock()
        self._key: object = None
        self._layout: Future[Layout] | None = None

    def of(self, index: SignatureIndex) -> Layout | None:
        """The map of an index, of a random sample if it is large."""
        points = index.contents.filter.points
        key = len(index), hash(tuple(index.ids)), float(points.sum())
        with self._lock:
            if self._layout is None or key != self._key:
                self._key, self._layout = key, self._thread.submit(_layout, index)
            layout = self._layout
        try:
            return layout.result(PATIENCE)
        except NotYet:
            return None

    def close(self) -> None:
        """End the thread."""
        self._thread.shutdown(cancel_futures=True)


def _layout(index: SignatureIndex) -> Layout:
    rows = np.arange(len(index))
    if len(rows) > MOST_SHAPES:
        rows = np.sort(np.random.default_rng(SEED).choice(rows, MOST_SHAPES, replace=False))
    return Layout(rows, plane_map(index, rows))
