"""MDS-CM-BOF: bags of visual words in 66 views of canonical forms, compared by clock matching.

A canonical form is seen from 66 directions, and each depth picture is described by the frequencies of visual
words: SIFT descriptors that are drawn from the gallery. Two forms are compared in the 24 positions of an
octahedron, since the principal axes of a form have neither order nor sign that is reliable: what is the
nearest position depends on both shapes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.adapters.opencv import sift_descriptors
from pcretrieve.matching.canonical import canonical_form
from pcretrieve.values import FloatArray, IntArray, Shape

__all__ = ["ViewDescriptors", "ViewWords", "clock_distance", "view_descriptors", "view_words"]

# Number of visual words. See docs/decisions.md, VOCABULARY.
VOCABULARY = 1500


class ViewDescriptors(NamedTuple):
    """The SIFT descriptors in the views of a canonical form.

    starts: (67,) int32, the descriptors of view k are the rows ``starts[k]`` to ``starts[k + 1]``.
    descriptors: (p, 128) uint8, the descriptors.
    """

    starts: IntArray
    descriptors: NDArray[np.uint8]


class ViewWords(NamedTuple):
    """The frequencies of the visual words in the views of a canonical form, without zeros.

    starts: (67,) int32, the words of view k are at positions ``starts[k]`` to ``starts[k + 1]`` of the other
        arrays.
    words: (w,) int32, numbers of the words, ascending in each view.
    counts: (w,) int32, frequencies of the words.
    """

    starts: IntArray
    words: IntArray
    counts: IntArray


def view_descriptors(shape: Shape) -> ViewDescriptors:
    """The SIFT descriptors in 66 depth pictures of the canonical form of a shape [1]_.

    Of the settings that the article leaves open, or that differ: shortest paths over faces instead of fast
    marching; forms of at most 1000 faces, which are drawn themselves; pictures of 128 × 128 pixels instead of
    256 × 256; principal axes without the measure of rectilinearity; and OpenCV's default settings of SIFT.
    See docs/decisions.md, VOCABULARY. Requires the extra ``pcretrieve[views]``.

    References
    ----------
    .. [1] Z. Lian, A. Godil, X. Sun and J. Xiao, "CM-BOF: visual similarity-based 3D shape retrieval using
       clock matching and bag-of-features", Machine Vision and Applications 24 (2013); and Z. Lian et al.,
       "Non-rigid 3D shape retrieval using multidimensional scaling and bag-of-features", ICIP 2010.
    """
    # Imported here because the module's numba functions are compiled on import.
    from pcretrieve.matching.views import depth_pictures

    views = list(sift_descriptors(depth_pictures(canonical_form(shape.mesh))))
    starts = np.cumsum([0, *map(len, views)])
    return ViewDescriptors(starts.astype(np.int32), np.concatenate(views).astype(np.uint8))


def view_words(gallery: Sequence[ViewDescriptors]) -> Callable[[ViewDescriptors], ViewWords]:
    """Draw the visual words from the descriptors of a gallery, at random, as published."""
    rng = np.random.default_rng(0)
    every = np.concatenate([shape.descriptors for shape in gallery])  # (p, 128)
    words = every[rng.choice(len(every), min(VOCABULARY, len(every)), replace=False)]
    return partial(_counted, words.astype(np.float64))


def clock_distance(query: ViewWords, other: ViewWords) -> float:
    """The distance of two canonical forms, in the best of 24 positions.

    For views with frequencies a and b, the distance is 1 − Σ min(a, b) / max(Σ a, Σ b), and 0 for two views
    without words. The distances of corresponding views are averaged, for each of the 24 rotations of an
    octahedron, and the smallest average is the distance.
    """
    # Imported here because the module's numba functions are compiled on import.
    from pcretrieve.matching.overlaps import smallest_mean
    from pcretrieve.matching.views import exchanges

    return float(smallest_mean(*query, *other, exchanges()))


def _counted(vocabulary: FloatArray, made: ViewDescriptors) -> ViewWords:
    """How often each word is the nearest one to the descriptors of each view."""
    squares = (vocabulary**2).sum(axis=1)
    products = made.descriptors.astype(np.float64) @ vocabulary.T  # (p, W)
    nearest = (squares - 2 * products).argmin(axis=1)
    found = [np.unique(nearest[start:end], return_counts=True) for start, end in pairwise(made.starts)]
    starts = np.cumsum([0, *(len(words) for words, _ in found)])
    words, counts = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return ViewWords(starts.astype(np.int32), words.astype(np.int32), counts.astype(np.int32))
