"""Clusters and maps by scikit-learn: points in, numbers of clusters or places in the plane out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pcretrieve.arrays import FloatArray

__all__ = ["density_clusters", "neighbour_embedding"]

# Effective number of neighbours of a point of t-SNE. See docs/decisions.md, PERPLEXITY.
PERPLEXITY = 30.0

# Least number of points of t-SNE; fewer are projected on their principal components.
FEWEST = 5

# Seed of t-SNE, which starts at the principal components.
SEED = 0


def density_clusters(points: FloatArray, min_size: int) -> NDArray[np.intp]:
    """Clusters of dense points by HDBSCAN, from the excess of mass (Campello, Moulavi and Sander, 2013).

    Parameters
    ----------
    points : (N, d) float64
        The points.
    min_size : int
        Least number of points of a cluster, at least 2.

    Returns
    -------
    (N,) intp
        The number of the cluster of each point, from 0; −1 for points between clusters.
    """
    if len(points) < min_size:
        return np.full(len(points), -1)
    from sklearn.cluster import HDBSCAN

    found = HDBSCAN(min_cluster_size=min_size, cluster_selection_method="eom", copy=True).fit_predict(points)
    return np.asarray(found, dtype=np.intp)


def neighbour_embedding(points: FloatArray) -> FloatArray:
    """Places in the plane at which near points are near, by t-SNE (van der Maaten and Hinton, 2008).

    Parameters
    ----------
    points : (N, d) float64
        The points.

    Returns
    -------
    (N, 2) float64
        The places, centred; only which are near each other has a meaning. Equal for equal points and order.
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
