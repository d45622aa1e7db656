"""Clusters, maps and ball trees by scikit-learn: points in, clusters, places or neighbours out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pcretrieve.arrays import FloatArray

__all__ = ["BallTreeSearch", "density_clusters", "neighbour_embedding"]

# Effective number of neighbours of a point of t-SNE. See docs/decisions.md, PERPLEXITY.
PERPLEXITY = 30.0

# Least number of points of t-SNE; fewer are projected on their principal components.
FEWEST = 5

# Seed of t-SNE, which starts at the principal components.
SEED = 0


class BallTreeSearch:
    """Euclidean nearest neighbours by a ball tree (Omohundro, 1989), in double precision.

    points: (N, L) float64, the points, at least one. The squares of their distances do not overflow.
    """

    def __init__(self, points: FloatArray) -> None:
        from sklearn.neighbors import BallTree

        self._tree = BallTree(points)

    def __str__(self) -> str:
        return "ball tree of scikit-learn"

    def nearest(self, point: FloatArray, k: int) -> tuple[NDArray[np.intp], float]:
        """Points that are the nearest, apart from rounding errors.

        point: (1, L) float64, the query.
        Returns rows : (k,) intp: the points.
        """
        distances, rows = self._tree.query(point, k)
        return rows[0], float(distances[0, -1])

    def within(self, point: FloatArray, radius: float) -> NDArray[np.intp]:
        """The points within a radius, apart from rounding errors.

        point: (1, L) float64, the query.
        Returns (n,) intp: the points.
        """
        (rows,) = self._tree.query_radius(point, radius)
        return np.asarray(rows, dtype=np.intp)


def density_clusters(points: FloatArray, min_size: int) -> NDArray[np.intp]:
    """Clusters of dense points by HDBSCAN, from the excess of mass (Campello, Moulavi and Sander, 2013).

    points: (N, d) float64, the points.
    Returns (N,) intp: the number of the cluster of each point, from 0; −1 for points between clusters.
    """
    if len(points) < min_size:
        return np.full(len(points), -1)
    from sklearn.cluster import HDBSCAN

    found = HDBSCAN(min_cluster_size=min_size, cluster_selection_method="eom", copy=True).fit_predict(points)
    return np.asarray(found, dtype=np.intp)


def neighbour_embedding(points: FloatArray) -> FloatArray:
    """Places in the plane at which near points are near, by t-SNE (van der Maaten and Hinton, 2008).

    points: (N, d) float64, the points.
    Returns (N, 2) float64: the places, centred; only which are near each other has a meaning. Equal for equal
        points and order.
    """
    centred = points - points.mean(axis=0)
    directions, sizes, _ = np.linalg.svd(centred, full_matrices=False)
    principal = np.zeros((len(points), 2))
    principal[:, : min(2, len(sizes))] = (directions * sizes)[:, :2]
    if len(points) < FEWEST or not sizes[0]:
        return principal
    from sklearn.manifold import TSNE

    perplexity = min(PERPLEXITY, (len(points) - 1) / 3)
    start = (1e-4 * principal / principal.std()).astype(np.float32)
    places = TSNE(perplexity=perplexity, init=start, random_state=SEED).fit_transform(points)
    return np.asarray(places - places.mean(axis=0), dtype=np.float64)
