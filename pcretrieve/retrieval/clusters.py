"""Index → clusters of its shapes, and a map of them in the plane."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import OptionError
from pcretrieve.retrieval.index import SignatureIndex
from pcretrieve.retrieval.scikit_learn import density_clusters, neighbour_embedding
from pcretrieve.values import FloatArray

__all__ = ["cluster_numbers", "plane_map"]

# Distance between the shapes on a map, so that none hides another: the width of a marker, or, of many shapes,
# this share of the mean spacing; and how often they are moved apart.
GAP = 0.024
SHARE = 0.6
N_ROUNDS = 60

GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))


def cluster_numbers(index: SignatureIndex, *, min_size: int = 3) -> NDArray[np.intp]:
    """Cluster the shapes of an index by the density of their whitened signatures (HDBSCAN).

    Returns (N,) intp: the number of the cluster of each shape of the index, from 1 for the largest, of equal
        ones that with the first shape; 0 for shapes in none.
    """
    if min_size < 2:
        raise OptionError(f"min_size must be at least 2, got {min_size}")
    found = density_clusters(index.contents.filter.points, min_size)
    sizes = np.bincount(found[found >= 0], minlength=int(found.max(initial=-1)) + 1)
    first = [int(np.argmax(found == number)) for number in range(len(sizes))]
    order = sorted(range(len(sizes)), key=lambda number: (-sizes[number], first[number]))
    numbers = np.zeros(len(sizes) + 1, dtype=np.intp)  # the last one for −1
    numbers[order] = np.arange(1, len(order) + 1)
    return numbers[found]


def plane_map(index: SignatureIndex, rows: NDArray[np.intp] | None = None) -> FloatArray:
    """Places in the plane at which shapes with near whitened signatures are near (t-SNE).

    rows: (n,) int, optional, rows of the index: only these shapes are placed.
    Returns (N, 2) float64: the place of each shape of the index, or of each row, within [0, 1]²; its axes
        have no meaning.
    """
    points = index.contents.filter.points
    places = neighbour_embedding(points if rows is None else points[rows])
    # The direction of the largest extent is across, as on screens.
    places = places @ np.linalg.svd(places - places.mean(axis=0), full_matrices=False)[2].T
    return _framed(_apart(_framed(places), min(GAP, SHARE / np.sqrt(len(places)))))


def _framed(places: FloatArray) -> FloatArray:
    """Places in the middle of [0, 1]², which they fill in one direction."""
    low, high = places.min(axis=0), places.max(axis=0)
    framed: FloatArray = (places - (low + high) / 2) / (float((high - low).max()) or 1.0) + 0.5
    return framed


def _apart(places: FloatArray, gap: float) -> FloatArray:
    """Move places apart that are nearer than a gap, half of the way each, several times."""
    from scipy.spatial import cKDTree

    # Equal places have no direction in which they could be moved apart: they are put on a small spiral.
    angle = GOLDEN_ANGLE * np.arange(len(places))
    places = places + 1e-6 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    for _ in range(N_ROUNDS):
        pairs = cKDTree(places).query_pairs(gap, output_type="ndarray")
        if not len(pairs):
            break
        apart = places[pairs[:, 0]] - places[pairs[:, 1]]
        length = np.linalg.norm(apart, axis=1, keepdims=True)
        step = apart / length * (gap - length) / 2
        np.add.at(places, pairs[:, 0], step / 2)
        np.add.at(places, pairs[:, 1], -step / 2)
    return places
