"""The record that declares a pairwise matcher, and the matchers by name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np
from numba import njit

from pcretrieve.errors import OptionError
from pcretrieve.matching.cm_bof import clock_distance, view_descriptors, view_words
from pcretrieve.matching.heat import heat_distance, heat_points, heat_set, word_distance, word_frequencies
from pcretrieve.matching.meshsift import match_distance, mesh_features
from pcretrieve.values import IntArray, Need, Shape


@dataclass(frozen=True, slots=True)
class Matcher:
    """The declaration of a method that compares two shapes and has no vector for a single one.

    Attributes
    ----------
    name : str
        Value of the option `--matcher`.
    prepare : function of Shape
        Called once for each shape, with a shape that holds the parts in `needs`; returns the features of the
        shape, of any type that can be pickled.
    distance : function of (features, features) that returns float
        The distance from a query to a shape of the gallery: not NaN, not negative, may be infinite.
    needs : tuple of {"spectrum", "overlaps", "mesh", "points"}
        The parts of a shape that `prepare` uses, as in `pcretrieve.descriptors.Descriptor`: `Shape.spectrum`,
        its overlaps, `Shape.mesh`, or `Shape.points`, which the catalogue does not store.
    symmetric : bool, default True
        Whether the distance from a to b is that from b to a, so that half of the distances need computing.
    learn : function of a sequence of features that returns a function of features, optional
        What is learned from the features of the gallery, such as a vocabulary. It is called once, for a
        gallery of at least one shape, and the function that it returns once for each shape of the gallery and
        each query: `distance` is given what this function returns. If it can be pickled, so can the index. By
        default the features as they are.

    Raises
    ------
    OptionError
        If there is no such need.
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


HEAT_HAUSDORFF = Matcher("heat-hausdorff", heat_set, heat_distance, needs=("mesh",))
HKS_BOW_GALLERY = Matcher(
    "hks-bow-gallery", heat_points, word_distance, needs=("mesh",), learn=word_frequencies
)
MDS_CM_BOF = Matcher("mds-cm-bof", view_descriptors, clock_distance, needs=("mesh",), learn=view_words)
MESHSIFT = Matcher("meshsift", mesh_features, match_distance, needs=("mesh",))


#: The matchers of pcretrieve by name.
MATCHERS = {matcher.name: matcher for matcher in (HEAT_HAUSDORFF, HKS_BOW_GALLERY, MDS_CM_BOF, MESHSIFT)}


def known_matcher(matcher: str | Matcher) -> Matcher:
    """The matcher of a name, or the one that is given."""
    if isinstance(matcher, Matcher):
        return matcher
    if matcher not in MATCHERS:
        raise OptionError(f"there is no matcher {matcher!r}; there are {', '.join(MATCHERS)}")
    return MATCHERS[matcher]


@njit(cache=True)
def smallest_mean(
    starts: IntArray,
    words: IntArray,
    counts: IntArray,
    other_starts: IntArray,
    other_words: IntArray,
    other_counts: IntArray,
    exchanges: IntArray,
) -> float:
    """The smallest mean distance of the histograms of two forms.

    exchanges: (r, k) int32, for each rotation and each view of the other form, the view of the first form.
    """
    n_views = len(starts) - 1
    # Several rotations compare the same two views, whose distance is computed once.
    known = np.full((n_views, n_views), -1.0)
    smallest = np.inf
    for rotation in range(len(exchanges)):
        total = 0.0
        for view in range(n_views):
            turned = exchanges[rotation, view]
            if known[turned, view] < 0:
                i, end = starts[turned], starts[turned + 1]
                j, other_end = other_starts[view], other_starts[view + 1]
                size = counts[i:end].sum()
                other_size = other_counts[j:other_end].sum()
                common = 0
                while i < end and j < other_end:
                    if words[i] == other_words[j]:
                        common += min(counts[i], other_counts[j])
                        i += 1
                        j += 1
                    elif words[i] < other_words[j]:
                        i += 1
                    else:
                        j += 1
                larger = max(size, other_size)
                known[turned, view] = 1 - common / larger if larger > 0 else 0.0
            total += known[turned, view]
        smallest = min(smallest, total)
    return smallest / n_views
