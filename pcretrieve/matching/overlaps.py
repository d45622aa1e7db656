"""Distances of histograms without zeros, compiled."""

from __future__ import annotations

import numpy as np
from numba import njit

from pcretrieve.values import IntArray

__all__ = ["smallest_mean"]


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
