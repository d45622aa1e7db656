"""Matchers, which compare two shapes and have no vector for a single one, and all distances by them."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np
from scipy.spatial.distance import cityblock

from pcretrieve.errors import OptionError, PcretrieveError, ShapeError, Stage
from pcretrieve.shrec.cm_bof import clock_distance, view_descriptors, view_words
from pcretrieve.shrec.heat import heat_distance, heat_points, heat_set, word_frequencies
from pcretrieve.shrec.meshsift import match_distance, mesh_features
from pcretrieve.values import FloatArray, Need, Shape

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Matcher:
    """The declaration of a method that compares two shapes and has no vector for a single one.

    name: the argument `matcher` of `pcretrieve.matrix`.
    prepare: called once for each shape, with a shape that holds the parts in `needs`; returns its features.
    distance: from the features of a query to those of a shape of the gallery: not NaN, not negative, may be
        infinite.
    needs: the parts of a shape that `prepare` uses, as in `pcretrieve.descriptors.Descriptor`.
    symmetric: whether the distance from a to b is that from b to a, so that half of them need computing.
    learn: what is learned from the features of all shapes, such as a vocabulary. It returns a function that
        is called once for each shape: `distance` is given what this function returns.
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
            raise OptionError(
                f"needs of a matcher must be of {', '.join(known)}, got {wrong[0]!r}"
            )


#: The matchers of pcretrieve by name.
MATCHERS = {
    matcher.name: matcher
    for matcher in (
        Matcher("heat-hausdorff", heat_set, heat_distance, needs=("mesh",)),
        Matcher(
            "hks-bow-gallery",
            heat_points,
            cityblock,
            needs=("mesh",),
            learn=word_frequencies,
        ),
        Matcher(
            "mds-cm-bof",
            view_descriptors,
            clock_distance,
            needs=("mesh",),
            learn=view_words,
        ),
        Matcher("meshsift", mesh_features, match_distance, needs=("mesh",)),
    )
}


def known_matcher(matcher: str | Matcher) -> Matcher:
    """The matcher of a name, or the one that is given."""
    if isinstance(matcher, Matcher):
        return matcher
    if matcher not in MATCHERS:
        raise OptionError(
            f"there is no matcher {matcher!r}; there are {', '.join(MATCHERS)}"
        )
    return MATCHERS[matcher]


def match_all(
    matcher: Matcher,
    ids: Iterable[str],
    shape_of: Callable[[str], Shape],
) -> tuple[tuple[str, ...], FloatArray]:
    """The ids and all distances (N, N) of some shapes, without those to which a matcher cannot be applied."""
    features: dict[str, Any] = {}
    for shape_id in ids:
        try:
            features[shape_id] = _called(
                matcher.name, matcher.prepare, shape_of(shape_id)
            )
            _log.info("prepared: %d shapes", len(features))
        except ShapeError as error:
            _log.warning("left out %s: %s", shape_id, error.message)
    compared = list(features.values())
    if matcher.learn and compared:
        learned = _called(matcher.name, matcher.learn, compared)
        compared = [_called(matcher.name, learned, each) for each in compared]
    distances = np.empty((len(compared), len(compared)))
    for row, query in enumerate(compared):
        start = row if matcher.symmetric else 0
        others = compared[start:]
        distances[row, start:] = [
            _called(matcher.name, matcher.distance, query, each) for each in others
        ]
        if matcher.symmetric:
            distances[start:, row] = distances[row, start:]
        _log.info("compared with all: %d of %d shapes", row + 1, len(compared))
    return tuple(features), distances


def _called(name: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """The result of a function of a matcher, which may be one's own."""
    try:
        return function(*arguments)
    except (PcretrieveError, MemoryError):
        raise
    except Exception as error:
        raise ShapeError(
            f"the matcher {name!r} failed, {type(error).__name__}: {error}",
            stage=Stage.SIGNATURE,
        ) from error
