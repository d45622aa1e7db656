"""Matchers, which compare two shapes and have no vector for a single one, and galleries ranked by them."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar, get_args

import numpy as np
from scipy.spatial.distance import cityblock

from pcretrieve.errors import InputError, OptionError, PcretrieveError, ShapeError, Stage
from pcretrieve.matching.cm_bof import clock_distance, view_descriptors, view_words
from pcretrieve.matching.heat import heat_distance, heat_points, heat_set, word_frequencies
from pcretrieve.matching.meshsift import match_distance, mesh_features
from pcretrieve.retrieval import DistanceBlock, Positions, nearest_of, position_of
from pcretrieve.values import Failure, FloatArray, Need, Neighbors, Shape

_log = logging.getLogger(__name__)

_Result = TypeVar("_Result")


@dataclass(frozen=True, slots=True)
class Matcher:
    """The declaration of a method that compares two shapes and has no vector for a single one.

    name: value of the option `--matcher`.
    prepare: called once for each shape, with a shape that holds the parts in `needs`; returns the features of
        the shape, of any type that can be pickled.
    distance: from the features of a query to those of a shape of the gallery: not NaN, not negative, may be
        infinite.
    needs: the parts of a shape that `prepare` uses, as in `pcretrieve.descriptors.Descriptor`.
    symmetric: whether the distance from a to b is that from b to a, so that half of them need computing.
    learn: what is learned from the features of the gallery, such as a vocabulary. It is called once, for a
        gallery of at least one shape, and the function that it returns once for each shape of the gallery and
        each query: `distance` is given what this function returns. If it can be pickled, so can the index.
    """

    name: str
    prepare: Callable[[Shape], Any]
    distance: Callable[[Any, Any], float]
    needs: tuple[Need, ...]
    symmetric: bool = True
    learn: Callable[[Sequence[Any]], Callable[[Any], Any]] | None = None

    def __post_init__(self) -> None:
        known = [need for need in get_args(Need) if need != "eigenvectors"]
        if wrong := sorted(set(self.needs).difference(known)):
            raise OptionError(f"needs of a matcher must be of {', '.join(known)}, got {wrong[0]!r}")


#: The matchers of pcretrieve by name.
MATCHERS = {
    matcher.name: matcher
    for matcher in (
        Matcher("heat-hausdorff", heat_set, heat_distance, needs=("mesh",)),
        Matcher("hks-bow-gallery", heat_points, cityblock, needs=("mesh",), learn=word_frequencies),
        Matcher("mds-cm-bof", view_descriptors, clock_distance, needs=("mesh",), learn=view_words),
        Matcher("meshsift", mesh_features, match_distance, needs=("mesh",)),
    )
}


def known_matcher(matcher: str | Matcher) -> Matcher:
    """The matcher of a name, or the one that is given."""
    if isinstance(matcher, Matcher):
        return matcher
    if matcher not in MATCHERS:
        raise OptionError(f"there is no matcher {matcher!r}; there are {', '.join(MATCHERS)}")
    return MATCHERS[matcher]


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
                _log.info("prepared: %d shapes", len(features))
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
        """Distances from shapes of the gallery to all of the gallery, one query a block.

        By default, all queries in one block; of a symmetric distance, half are then computed.
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
            _log.info("compared with all: %d of %d shapes", position + 1, n)
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
        """The result of a function of the matcher, which may be one's own."""
        try:
            return function(*arguments)
        except (PcretrieveError, MemoryError):
            raise
        except Exception as error:
            raise ShapeError(
                f"the matcher {self.matcher.name!r} failed, {type(error).__name__}: {error}",
                stage=Stage.SIGNATURE,
            ) from error
