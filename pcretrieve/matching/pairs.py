"""A gallery that is ranked pair by pair."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

import numpy as np

from pcretrieve.errors import InputError, PcretrieveError, ShapeError, Stage
from pcretrieve.matching.matcher import Matcher
from pcretrieve.retrieval import DistanceBlock, Positions, nearest_of, position_of
from pcretrieve.values import Failure, FloatArray, Neighbors, Shape

__all__ = ["PairwiseIndex"]

logger = logging.getLogger(__name__)

_Result = TypeVar("_Result")


class PairwiseIndex:
    """The features of a gallery of shapes, which a matcher compares one by one: a `Ranking`."""

    def __init__(self, matcher: Matcher, ids: Iterable[str], shape_of: Callable[[str], Shape]) -> None:
        self.matcher = matcher
        features: dict[str, Any] = {}
        failures = []
        for shape_id in ids:
            if shape_id in features:
                raise InputError(f"ids must be distinct, {shape_id!r} comes twice")
            try:
                features[shape_id] = self._called(matcher.prepare, shape_of(shape_id))
                logger.info("prepared: %d shapes", len(features))
            except ShapeError as error:
                failures.append(
                    Failure(shape_id, str(error.stage or ""), type(error).__name__, error.message)
                )
        self.ids = tuple(features)
        made = list(features.values())
        self._learned = self._called(matcher.learn, made) if matcher.learn and made else None
        self.features = tuple(map(self._after_learning, made))
        self.failures = tuple(failures)

    def __len__(self) -> int:
        return len(self.ids)

    def query(self, shape: Shape, k: int = 10) -> Neighbors:
        """The shapes of the gallery nearest to any shape."""
        features = self._after_learning(self._called(self.matcher.prepare, shape))
        return nearest_of(self.ids, self._row(features), k)

    def nearest(self, shape_id: str, k: int = 10) -> Neighbors:
        """The shapes nearest to a shape of the gallery, itself included."""
        return nearest_of(self.ids, self._row(self.features[position_of(self.ids, shape_id)]), k)

    def blocks(self, queries: Positions | None = None) -> Iterator[DistanceBlock]:
        """Distances from shapes of the gallery to all of the gallery.

        queries: (Q,) intp, optional, positions in `ids`. By default all; of a symmetric distance, half are
            then computed.
        Yields DistanceBlock: one query; or all queries, by default.
        """
        if queries is not None:
            for position in queries:
                row = self._row(self.features[position])
                yield DistanceBlock(np.array([position]), row[np.newaxis])
            return
        n = len(self)
        distances = np.empty((n, n))
        for position, features in enumerate(self.features):
            start = position if self.matcher.symmetric else 0
            distances[position, start:] = self._row(features, start)
            if self.matcher.symmetric:
                distances[start:, position] = distances[position, start:]
            logger.info("compared with all: %d of %d shapes", position + 1, n)
        yield DistanceBlock(np.arange(n), distances)

    def _after_learning(self, features: Any) -> Any:
        """What the distance is given for a shape."""
        return features if self._learned is None else self._called(self._learned, features)

    def _row(self, query: Any, start: int = 0) -> FloatArray:
        """(N − start,) distances from the features of a query to those of the gallery."""
        return np.array(
            [self._called(self.matcher.distance, query, other) for other in self.features[start:]],
            dtype=np.float64,
        )

    def _called(self, function: Callable[..., _Result], *arguments: Any) -> _Result:
        """The result of a function of the matcher, which may be that of another package."""
        try:
            return function(*arguments)
        except (PcretrieveError, MemoryError):
            raise
        except Exception as error:
            raise ShapeError(
                f"the matcher {self.matcher.name!r} failed, {type(error).__name__}: {error}",
                stage=Stage.SIGNATURE,
            ) from error
