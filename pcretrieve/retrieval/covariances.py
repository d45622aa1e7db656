"""Covariances of what shapes differ by: within labelled classes, or between nearest neighbours.

A covariance is shrunk towards that of uncorrelated values. In this target all values have the same variance
if they have one unit, as logarithms have; otherwise each value has its own variance, so that the result does
not depend on the units (targets B and D of Schäfer and Strimmer, Statistical Applications in Genetics and
Molecular Biology 2005). See docs/decisions.md, one_unit. Within classes, the intensity is the one at which
classes that are left out are most likely.

Without labels, two shapes form a pair if each is among the other's k nearest after k-reciprocal re-ranking.
The weight of a pair has two factors. The squared Jaccard index of the two neighbourhoods is small for pairs
between classes, which share few neighbours. The inverse squared length of the difference makes all
differences unit vectors (spatial-sign covariance; Visuri, Koivunen and Oja, Journal of Statistical Planning
and Inference 2000), so that a few distant pairs do not dominate the covariance.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pcretrieve.errors import InputError, OptionError
from pcretrieve.options import Shrinkage
from pcretrieve.retrieval.distances import (
    BLOCK_DISTANCES,
    CHUNK,
    DistanceBlock,
    Positions,
)
from pcretrieve.retrieval.reranking import nearest_matrix, neighbour_lists, rerank
from pcretrieve.values import FloatArray

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Regularisation of the covariance, which limits the amplification of noise in directions of small variance.
# Within classes it is estimated instead.
DEFAULT_SHRINKAGE = {
    "neighbours": 0.20,  # intensity towards the mean variance times the identity
    "pca": 0.01,  # times the largest eigenvalue, added to all eigenvalues (Tikhonov)
}

# Intensities that are tried within classes, and the number of groups of classes, each of which is left out
# once. With fewer than two classes, none can be left out: the intensity is then UNTESTED.
INTENSITIES = (0.0003, 0.001, 0.003, 0.01, 0.03, 0.1, 0.3)
N_GROUPS = 4
UNTESTED = 0.1

# Smallest variance of a value in the target, relative to the mean variance: the covariance must be invertible
# also if a value is the same for all shapes of each class.
LEAST_VARIANCE = 1e-9

# Least numbers of shapes and of pairs for a whitening by neighbours.
LEAST_SHAPES = 24
LEAST_PAIRS = 10


class Fit(NamedTuple):
    """The shapes (n, L) of a whitening, and their regularised covariance; None if nothing can be learned."""

    shapes: FloatArray
    covariance: FloatArray | None
    shrinkage: float
    reason: str


def checked_shrinkage(kind: str, shrinkage: Shrinkage) -> float:
    """The shrinkage of a whitening, or its default, after a check of its range."""
    value = DEFAULT_SHRINKAGE.get(kind, 1.0) if shrinkage == "auto" else float(shrinkage)
    if not 0 < value <= 1:
        raise OptionError(f"shrinkage must lie in (0, 1], got {value}")
    return value


def scatter_matrix(logs: FloatArray, mean: FloatArray) -> FloatArray:
    """N − 1 times the covariance (L, L) of many shapes (N, L), of which no centred copy is made."""
    scatter = np.zeros((len(mean), len(mean)))
    for start in range(0, len(logs), CHUNK):
        centred = logs[start : start + CHUNK] - mean
        scatter += centred.T @ centred
    return scatter


def covariance_of(logs: FloatArray) -> FloatArray:
    """The covariance (L, L) of many shapes (N, L)."""
    return scatter_matrix(logs, logs.mean(axis=0)) / (len(logs) - 1)


def _shrunk(
    covariance: FloatArray, intensity: float, *, one_unit: bool = True
) -> FloatArray:
    """A covariance C shrunk towards that of uncorrelated values, (1 − s) C + s T.

    one_unit: whether all values have one unit. The target T is then tr(C)/L I, otherwise the diagonal of C.
    """
    variances = np.diag(covariance)
    mean = variances.mean()
    target = (
        np.full(len(variances), mean)
        if one_unit
        else np.maximum(variances, LEAST_VARIANCE * mean)
    )
    return (1 - intensity) * covariance + intensity * np.diag(target)


def within_class_covariance(
    logs: FloatArray,
    labels: Sequence[str | None] | None,
    shrinkage: Shrinkage,
    *,
    one_unit: bool,
) -> Fit:
    """Of log-signatures (N, L), those in classes of at least two, and their shrunk pooled covariance."""
    members = _members(labels or ())
    fitted = logs[np.concatenate(members)]  # class after class
    check_distinct("within-class", fitted)
    classes = np.repeat(np.arange(len(members)), [len(rows) for rows in members])
    residuals = np.concatenate([logs[rows] - logs[rows].mean(axis=0) for rows in members])
    pooled = _pooled(residuals, classes)
    if np.trace(pooled) == 0:
        raise InputError(
            "within-class whitening needs shapes that differ within their class, got equal signatures in "
            "every class; use the whitening 'pca' or 'none'"
        )
    used = (
        shrinkage
        if shrinkage != "auto"
        else _likeliest_shrinkage(residuals, classes, one_unit=one_unit)
    )
    reason = f"within-class: {len(members)} classes of {len(fitted)} shapes"
    return Fit(fitted, _shrunk(pooled, used, one_unit=one_unit), used, reason)


def check_distinct(kind: str, logs: FloatArray) -> None:
    """InputError if all log-signatures (N, L) are equal."""
    if (logs == logs[:1]).all():
        raise InputError(
            f"{kind} whitening needs at least 2 distinct shapes, got {len(logs)} shapes and no two distinct; "
            "add shapes, or use the whitening 'none'"
        )


def _members(labels: Sequence[str | None]) -> list[list[int]]:
    """The rows of each class of at least two shapes."""
    rows: dict[str, list[int]] = {}
    for row, label in enumerate(labels):
        if label is not None:
            rows.setdefault(label, []).append(row)
    classes = [rows[label] for label in sorted(rows) if len(rows[label]) > 1]
    if not classes:
        raise InputError(
            f"within-class whitening needs a class with at least 2 shapes, got {len(rows)} classes and none "
            "so large; label more shapes, or use the whitening 'pca' or 'none'"
        )
    return classes


def _pooled(values: FloatArray, classes: Positions) -> FloatArray:
    """(L, L) pooled within-class covariance of residuals (n, L), without bias."""
    return np.asarray(values.T @ values / (len(values) - len(np.unique(classes))))


def _likeliest_shrinkage(
    residuals: FloatArray, classes: Positions, *, one_unit: bool
) -> float:
    """The shrinkage at which the residuals (n, L) of classes that are left out are most likely."""
    n_classes = int(classes[-1]) + 1
    n_groups = min(N_GROUPS, n_classes)
    if n_groups < 2:
        return UNTESTED
    group = np.random.default_rng(1).permutation(n_classes) % n_groups
    likelihood = np.zeros(len(INTENSITIES))
    for left_out in range(n_groups):
        is_out = group[classes] == left_out
        pooled, tested = (
            _pooled(residuals[some], classes[some]) for some in (~is_out, is_out)
        )
        if np.trace(pooled) == 0:
            continue
        n_free = is_out.sum() - (group == left_out).sum()
        for number, intensity in enumerate(INTENSITIES):
            covariance = _shrunk(pooled, intensity, one_unit=one_unit)
            deviance = np.linalg.slogdet(covariance)[1] + np.trace(
                np.linalg.solve(covariance, tested)
            )
            likelihood[number] -= n_free * deviance
    return INTENSITIES[int(np.argmax(likelihood))]


def neighbour_covariance(
    logs: FloatArray, shrinkage: Shrinkage, compared: Positions | None = None
) -> Fit:
    """The covariance of the differences of neighbours among log-signatures (N, L), or why there is none.

    compared: the coordinates by which neighbours are found; by default all.
    """
    if len(logs) < LEAST_SHAPES:
        reason = f"none, because {len(logs)} shapes are too few to learn from neighbours ({LEAST_SHAPES})"
        return Fit(logs, None, 0.0, reason)
    used = checked_shrinkage("neighbours", shrinkage)
    pairs = neighbour_pairs(logs, compared)
    n_pairs = len(pairs.weights)
    if n_pairs < LEAST_PAIRS:
        reason = f"none, because only {n_pairs} pairs of shapes are mutual neighbours ({LEAST_PAIRS})"
        return Fit(logs, None, 0.0, reason)
    differences = logs[pairs.first] - logs[pairs.second]  # (P, L)
    covariance = (differences * pairs.weights[:, np.newaxis]).T @ differences
    covariance /= np.trace(covariance)
    reason = (
        f"neighbours: {n_pairs} pairs, each among the other's {pairs.n_neighbors} nearest"
    )
    return Fit(logs, _shrunk(covariance, used), used, reason)


# --- pairs of neighbours --------------------------------------------------------------------------------

# Largest number k of neighbours that is tried: the neighbourhoods of an isolated class of c shapes are equal
# for k = c − 1.
MOST_NEIGHBORS = 12

# Least share of the largest overlap of neighbourhoods that counts as equal to it: a few shapes decide which
# is the largest. See docs/decisions.md, number of neighbours.
AS_MUCH = 0.95

# k₁, k₂ and λ of the re-ranking: smaller sets than for a query, because a wrong pair does more harm than a
# missing one. See docs/decisions.md, K_RECIPROCAL.
PAIRING = (8, 3, 0.3)

# Of more shapes than this, pairs are searched within groups of near shapes, so that the classes in the sample
# are complete, unlike those in a random sample.
LARGEST = 4000
N_NEAR_GROUPS = 40
SEEDS_AT_ONCE = 5

# Differences are no shorter than this share of the longest one, so that copies of one shape weigh no more
# than other pairs.
SHORTEST = 1e-4


class NeighbourPairs(NamedTuple):
    """Pairs of near shapes by their positions (P,), with weights (P,) for their squared differences."""

    first: Positions
    second: Positions
    weights: FloatArray
    n_neighbors: int


def neighbour_pairs(
    logs: FloatArray, compared: Positions | None = None
) -> NeighbourPairs:
    """The pairs of shapes, given as log-signatures (N, L), that are among each other's nearest.

    compared: the coordinates by which they are found; by default all.
    """
    from scipy.sparse import triu

    known = logs if compared is None else logs[:, compared]
    rows = np.arange(len(logs)) if len(logs) <= LARGEST else near_groups(known, LARGEST)
    # So that ties do not depend on the order of the table.
    rows = rows[np.lexsort(logs[rows].T)]
    points = np.ascontiguousarray(logs[rows])
    lists = neighbour_lists(_blocks(np.ascontiguousarray(known[rows])), len(points))
    order = rerank(lists, parameters=PAIRING)
    k = _number_of_neighbors(order)
    near = nearest_matrix(order, k)
    overlap = triu(_jaccard(near).multiply(near.T), k=1).tocoo()
    lengths = np.linalg.norm(points[overlap.row] - points[overlap.col], axis=1)
    kept = lengths > 0
    lengths = np.maximum(lengths[kept], SHORTEST * lengths.max(initial=0))
    weights = overlap.data[kept] ** 2 / lengths**2
    return NeighbourPairs(rows[overlap.row[kept]], rows[overlap.col[kept]], weights, k)


def _jaccard(near: csr_array) -> csr_array:
    """For each edge of a graph of neighbours, the Jaccard index of the neighbourhoods of its ends."""
    size = near.indptr[1]  # of the first row, and of all
    common: csr_array = (near @ near.T).multiply(near).tocsr()
    common.data /= 2 * size - common.data
    return common


def _number_of_neighbors(order: Positions) -> int:
    """The largest number of neighbours at which neighbourhoods overlap about as much as at any other."""
    n, length = order.shape
    # Without the edges from each shape to itself, whose Jaccard index is 1.
    overlaps = {
        k: (_jaccard(nearest_matrix(order, k)).sum() - n) / (n * k)
        for k in range(1, min(MOST_NEIGHBORS + 1, length))
    }
    least = AS_MUCH * max(overlaps.values())
    return max(k for k, overlap in overlaps.items() if overlap >= least)


def _blocks(points: FloatArray) -> Iterator[DistanceBlock]:
    """Euclidean distances by matrix products: faster than `pairwise`, and exact enough for pairs."""
    points = points - points.mean(axis=0)
    squares = np.einsum("ij,ij->i", points, points)  # (N,)
    step = max(1, BLOCK_DISTANCES // max(1, len(points)))
    for start in range(0, len(points), step):
        rows = np.arange(start, min(start + step, len(points)))
        gaps = squares[rows, np.newaxis] + squares - 2 * (points[rows] @ points.T)
        yield DistanceBlock(rows, np.sqrt(np.maximum(gaps, 0)))


def near_groups(logs: FloatArray, largest: int) -> Positions:
    """The rows (n,), ascending, of the log-signatures (N, L) nearest to a few that are chosen at random."""
    seeds = np.random.default_rng(0).choice(len(logs), N_NEAR_GROUPS, replace=False)
    size = largest // N_NEAR_GROUPS
    squares = np.einsum("ij,ij->i", logs, logs)  # (N,)
    near = []
    # Several seeds in each pass over the table, which takes as long as for one.
    for some in np.array_split(seeds, len(seeds) // SEEDS_AT_ONCE):
        gaps = squares - 2 * (logs[some] @ logs.T)  # (s, N)
        near += [np.argpartition(row, size)[:size] for row in gaps]
    return np.unique(np.concatenate(near))
