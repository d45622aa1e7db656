"""Calibrated scores: the share of pairs of one class among the pairs of shapes that are at some distance.

Pairs are counted by distance, and the share of pairs of one class is made to decrease with the distance, by
isotonic regression (pool adjacent violators [1]_), which is the usual calibration of a classifier without a
model [2]_. Where there are labels, pairs of labelled shapes are counted. Without labels, pairs of mutual
neighbours stand for pairs of one class.

A whitening that was fitted to classes makes these classes more compact than others. Distances within classes
are then those after a whitening that was fitted to other classes (grouped cross-validation).

Certainty is estimated for an answer as a whole: each labelled shape is a query in the others,
once with its class among them, and once without. A logistic regression on the distance of the nearest shape,
and on its ratio to the distance of the nearest shape of another class, tells how often the nearest is right.

A collection with one scan of each person has no pair of one class. What distances in the metric of people
mean is known from simulated people, though: `Reference`. It counts as some pairs and some queries beside
those of the collection, so that it decides in a small collection, and hardly counts in a large one.

References
----------
.. [1] Barlow, Bartholomew, Bremner and Brunk, "Statistical inference under order restrictions", 1972.
.. [2] Zadrozny and Elkan, "Transforming classifier scores into accurate multiclass probability estimates",
   KDD 2002.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import InputError
from pcretrieve.options import RetrievalOptions
from pcretrieve.retrieval.covariances import LEAST_SHAPES, near_groups, neighbour_pairs
from pcretrieve.retrieval.distances import Positions, coordinates, pairwise
from pcretrieve.retrieval.people import RATES, Reference
from pcretrieve.retrieval.whitening import Arrays, Whitening, fit_whitening
from pcretrieve.values import FloatArray, SignatureTable

# Largest number of shapes whose pairs are counted, and the seed of the choice of their classes.
LARGEST = 1000
SEED = 0

# Least number of pairs of one class for scores, and the number of them in each interval of distances in which
# pairs are counted, of which there are at most a hundred.
LEAST_PAIRS = 10
PAIRS_PER_INTERVAL = 5
MOST_INTERVALS = 100

# Largest number of groups of classes, each of which is left out of a within-class whitening once.
MOST_FOLDS = 5

# Added to the pairs of one class and to the others in an interval (the prior of Jeffreys), so that no score
# is exactly 0 or 1.
PRIOR = 0.5

TINY = float(np.finfo(np.float64).tiny)

# Weight of a query whose class is not among the shapes, relative to one whose class is: one in eleven
# queries is of somebody new. Ridge penalty of the slopes of the regression. See docs/decisions.md, sure.
ABSENT = 0.1
RIDGE = 0.01

# Numbers of pairs of one class, of pairs of two classes and of queries of a collection that count as much as
# the reference: see docs/decisions.md, one scan each.
SAME_OF_REFERENCE = 30.0
APART_OF_REFERENCE = 10_000.0
QUERIES_OF_REFERENCE = 300.0

# Distances below this one are taken for it: the logarithm of zero is not finite.
CLOSEST = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class MatchScores(Arrays):
    """The score of a distance: the share of pairs of one class among all pairs that are as near.

    It is between 0 and 1, known at some ascending distances (m,), interpolated between them, and constant
    before the first and behind the last; it does not ascend. With labels there are also `coefficients` (3,)
    of the regression of certainty, and `limits` (r,), the distances at the false-match rates `RATES` of
    `n_apart` pairs of two classes.
    """

    distances: FloatArray
    scores: FloatArray
    reason: str
    coefficients: FloatArray = field(default_factory=lambda: np.zeros(0))
    limits: FloatArray = field(default_factory=lambda: np.zeros(0))
    n_apart: int = 0

    def __post_init__(self) -> None:
        distances = self._lock("distances", (None,))
        scores = self._lock("scores", (len(distances),))
        for name in ("coefficients", "limits"):
            self._lock(name, (None,))
        if (
            not len(distances)
            or (np.diff(distances) < 0).any()
            or (np.diff(scores) > 0).any()
        ):
            raise InputError(
                "scores must not ascend with the distance, and be at least one, got others"
            )

    def of(self, distances: FloatArray) -> FloatArray:
        """The scores (n,) of distances (n,), which may be infinite."""
        return np.interp(distances, self.distances, self.scores)

    def certainty(self, nearest: float, other: float) -> float | None:
        """How often an answer is right, from the distances to its class and to the next; None if unknown."""
        if not len(self.coefficients):
            return None
        return float(
            1
            / (
                1
                + np.exp(
                    -features(np.array([nearest]), np.array([other])) @ self.coefficients
                )[0]
            )
        )

    def limit(self, false_match_rate: float) -> float:
        """The distance below which a share of the pairs of two classes are, the false-match rate."""
        return (
            float(np.interp(false_match_rate, RATES, self.limits))
            if len(self.limits)
            else np.inf
        )


class _Sample(NamedTuple):
    """Shapes whose pairs are counted: their log-signatures (n, L), their classes, unless too few have one.

    sizes: number of shapes of each class in the table.
    """

    logs: FloatArray
    labels: list[str]
    sizes: Mapping[str, int]


class _Pairs(NamedTuple):
    """Distances (p,) of pairs, whether each is of one class, and how many pairs each stands for."""

    distances: FloatArray
    same: NDArray[np.bool_]
    weights: FloatArray


def fit_scores(
    table: SignatureTable,
    whitening: Whitening,
    options: RetrievalOptions | None = None,
    *,
    reference: Reference | None = None,
) -> MatchScores | None:
    """Estimate the score of a distance from the pairs of some shapes of a table; None if they are too few.

    reference: what distances after this whitening mean, if that is known.
    """
    options = options or RetrievalOptions()
    sample = _sample(table, LEAST_PAIRS if reference is None else 0)
    n_classes = len(set(sample.labels))
    why = (
        "share of pairs of one class among pairs as near, of {} pairs of "
        + f"{n_classes} classes"
    )
    groups, parts = list[_Group](), list[_Pairs]()
    if n_classes and whitening.kind != "within-class":
        groups = [
            _group(sample, np.arange(len(sample.labels)), whitening, options.distance)
        ]
    elif n_classes >= 4:
        groups = list(_left_out(sample, options, table))
        why += ", each left out of the whitening"
    elif len(sample.logs) >= LEAST_SHAPES:
        parts = [_mutual_pairs(sample.logs, whitening, options.distance)]
        why = "share of mutual neighbours among pairs as near, of {} pairs without labels"
    parts = parts or [_class_pairs(sample, group) for group in groups]
    if not parts:
        return None
    pairs = _joined(parts)
    reason, apart = why.format(len(pairs.same)), pairs.distances[~pairs.same]
    if groups and reference is not None:
        reason += " and of simulated people"
        pairs = _joined([pairs, _known_pairs(reference, pairs, len(sample.labels))])
    if pairs.same.sum() < LEAST_PAIRS or pairs.same.all():
        return None
    if not groups:
        return MatchScores(*_shares(pairs), reason)
    trials = Trials(
        *(np.concatenate(part) for part in zip(*map(_trials, groups), strict=True))
    )
    n_apart = len(apart)
    limits = np.quantile(apart, RATES)
    if reference is not None:
        n_apart += round(APART_OF_REFERENCE)
        limits = _limits(apart, reference)
    return MatchScores(
        *_shares(pairs), reason, fitted_coefficients(trials, reference), limits, n_apart
    )


def _joined(parts: Sequence[_Pairs]) -> _Pairs:
    return _Pairs(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def _known_pairs(reference: Reference, own: _Pairs, n_shapes: int) -> _Pairs:
    """The pairs of a reference, in the ratio in which they are in a collection.

    own, n_shapes: its pairs and the number of its shapes, as if each had a second one of its class.
    """
    ratio = (~own.same).sum() / (own.same.sum() + n_shapes)
    known = np.diff(RATES)
    same = np.repeat([True, False], [len(reference.same), len(known)])
    weights = np.append(
        np.full(len(reference.same), 1 / len(reference.same)), ratio * known
    )
    distances = np.append(reference.same, reference.apart[1:])
    return _Pairs(distances, same, SAME_OF_REFERENCE * weights)


def _limits(apart: FloatArray, reference: Reference) -> FloatArray:
    """(r,) the distances below which shares `RATES` of the pairs of two classes are."""
    distances = np.concatenate([apart, reference.apart])
    weights = np.ones(len(distances))
    weights[len(apart) :] = APART_OF_REFERENCE * np.diff(RATES, prepend=0.0)
    order = np.argsort(distances, kind="stable")
    shares = np.cumsum(weights[order])
    return np.asarray(np.interp(RATES, shares / shares[-1], distances[order]))


def _sample(table: SignatureTable, n_least: int) -> _Sample:
    """Choose the shapes whose pairs are counted: whole classes, up to a number of shapes of each.

    n_least: the least number of pairs of one class. With fewer, all shapes are chosen, without labels.
    """
    sizes = Counter(label for label in table.labels if label is not None)
    n_same = sum(size * (size - 1) // 2 for size in sizes.values())
    if len(sizes) < 2 or n_same < n_least:
        rows = np.arange(len(table))
        if len(table) > LARGEST:
            rows = near_groups(coordinates(table.values, table.metric), LARGEST)
        return _Sample(coordinates(table.values[rows], table.metric), [], {})
    names = sorted(sizes)
    chosen: set[str] = set()
    n_chosen = 0
    for number in np.random.default_rng(SEED).permutation(len(names)):
        # At least two classes, so that there are pairs of both kinds.
        if n_chosen >= LARGEST and len(chosen) > 1:
            break
        chosen.add(names[number])
        n_chosen += min(sizes[names[number]], LARGEST)
    kept: Counter[str] = Counter()
    rows_of: dict[int, str] = {}
    for row, label in enumerate(table.labels):
        if label is not None and label in chosen and kept[label] < LARGEST:
            kept[label] += 1
            rows_of[row] = label
    return _Sample(
        coordinates(table.values[list(rows_of)], table.metric),
        list(rows_of.values()),
        sizes,
    )


def _shares(pairs: _Pairs) -> tuple[FloatArray, FloatArray]:
    """Distances, ascending, and the score at each of them."""
    from scipy.optimize import isotonic_regression

    order = np.argsort(pairs.distances, kind="stable")
    distances, same = pairs.distances[order], pairs.same[order]
    ours = np.where(same, pairs.weights[order], 0.0)
    # Intervals with equal numbers of pairs of one class, and one behind the farthest of them. Ends between
    # equal distances are moved behind these.
    n_intervals = max(1, min(MOST_INTERVALS, int(same.sum()) // PAIRS_PER_INTERVAL))
    found = np.cumsum(ours)
    ends = np.searchsorted(found, found[-1] * np.arange(1, n_intervals) / n_intervals)
    ends = np.append(ends, np.flatnonzero(same)[-1])
    ends = np.unique(np.searchsorted(distances, distances[ends], side="right"))
    number = np.searchsorted(ends, np.arange(len(distances)), side="right")
    n_same, total = _counts(number, ours, pairs.weights[order])
    ends = isotonic_regression(n_same / total, weights=total, increasing=False).blocks
    pool = np.searchsorted(ends, number, side="right") - 1  # of each pair
    n_same, total = _counts(pool, ours, pairs.weights[order])
    # The score of a pool is that of the mean distance of its pairs of one class; the last pool may have none.
    first = distances[np.searchsorted(pool, np.arange(len(total)))]
    middle = np.where(
        n_same > 0, np.bincount(pool, ours * distances) / np.maximum(n_same, TINY), first
    )
    # The prior moves small pools more than others.
    return middle, np.minimum.accumulate((n_same + PRIOR) / (total + 2 * PRIOR))


def _counts(
    number: NDArray[np.intp], ours: FloatArray, every: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The weights of the pairs of one class, and of all pairs, in each interval."""
    n = int(number[-1]) + 1
    return np.bincount(number, ours, n).astype(np.float64), np.bincount(
        number, every, n
    ).astype(np.float64)


class _Group(NamedTuple):
    """Distances (n, n) between some labelled shapes, and the number (n,) of the class of each of them."""

    distances: FloatArray
    codes: Positions
    names: list[str]


def _group(
    sample: _Sample, rows: Positions, whitening: Whitening, distance: str
) -> _Group:
    points = whitening.apply(sample.logs[rows])
    names, codes = np.unique([sample.labels[row] for row in rows], return_inverse=True)
    return _Group(pairwise(distance, points, points), codes, names.tolist())


def _left_out(
    sample: _Sample, options: RetrievalOptions, table: SignatureTable
) -> Iterator[_Group]:
    """Each group of classes, whitened by what shapes of the other classes differ by."""
    classes, codes = np.unique(sample.labels, return_inverse=True)
    n_folds = min(MOST_FOLDS, len(classes) // 2)
    fold = (np.random.default_rng(SEED).permutation(len(classes)) % n_folds)[codes]
    for number in range(n_folds):
        rows, others = np.flatnonzero(fold == number), np.flatnonzero(fold != number)
        labels = [sample.labels[row] for row in others]
        try:
            fitted = fit_whitening(
                "within-class",
                sample.logs[others],
                labels,
                shrinkage=options.shrinkage,
                one_unit=table.has_one_unit,
            )
        except InputError:
            continue  # the other classes have one shape each, or equal ones
        yield _group(sample, rows, fitted, options.distance)


def _class_pairs(sample: _Sample, group: _Group) -> _Pairs:
    """The pairs of some labelled shapes, each of which stands for the pairs of the whole table."""
    codes = group.codes
    # (n,) shapes of the class, here and in the table.
    here = np.bincount(codes)[codes].astype(np.float64)
    there = np.array([sample.sizes[name] for name in group.names], dtype=np.float64)[
        codes
    ]
    n_table = float(sum(sample.sizes.values()))
    within = (there - 1) / np.maximum(here - 1, 1)
    between = (n_table - there) / np.maximum(len(codes) - here, 1)
    first, second = np.triu_indices(len(codes), k=1)
    same = codes[first] == codes[second]
    weights = (
        np.where(same, within[first] + within[second], between[first] + between[second])
        / 2
    )
    return _Pairs(group.distances[first, second], same, weights)


class Trials(NamedTuple):
    """Queries (t, 3) by their features, whether the nearest shape was of their class, and their weights."""

    features: FloatArray
    right: NDArray[np.bool_]
    weights: FloatArray


def features(nearest: FloatArray, other: FloatArray) -> FloatArray:
    """(t, 3) 1, the logarithm of the distance of the nearest shape, and of its ratio to the next class."""
    near, far = np.maximum(nearest, CLOSEST), np.maximum(other, CLOSEST)
    return np.column_stack([np.ones(len(near)), np.log(near), np.log(far / near)])


def _trials(group: _Group) -> Trials:
    """Each shape as a query in the others, with and without its class."""
    codes = group.codes
    same = codes[:, np.newaxis] == codes
    is_found = same.sum(axis=1) > 1
    tried = []
    for is_absent in (False, True):
        apart = np.where(
            same if is_absent else np.eye(len(codes), dtype=bool), np.inf, group.distances
        )
        found = codes[apart.argmin(axis=1)]
        nearest = apart.min(axis=1)
        other = np.where(found[:, np.newaxis] == codes, np.inf, apart).min(axis=1)
        used = np.isfinite(other) & (is_absent | is_found)
        # Somebody new among those who can be found: none, if each class has one shape.
        weights = np.full(len(codes), ABSENT * is_found.mean() if is_absent else 1.0)
        tried.append(
            Trials(features(nearest, other)[used], (found == codes)[used], weights[used])
        )
    return Trials(*(np.concatenate(part) for part in zip(*tried, strict=True)))


def fitted_coefficients(trials: Trials, reference: Reference | None = None) -> FloatArray:
    """(3,) coefficients of the logistic regression; none if all answers are right, or all wrong.

    reference: what is likely before any query, a normal distribution, instead of a ridge about zero.
    """
    from scipy.optimize import minimize

    expected, precision = np.zeros(3), np.diag([0.0, 2 * RIDGE, 2 * RIDGE])
    if reference is not None:
        expected = reference.coefficients
        precision = QUERIES_OF_REFERENCE * reference.information
    elif trials.right.all() or not trials.right.any():
        return np.zeros(0)
    signed = np.where(trials.right, -1.0, 1.0)[:, np.newaxis] * trials.features

    def loss(slopes: FloatArray) -> tuple[float, FloatArray]:
        wrong, unlike = signed @ slopes, slopes - expected
        value = trials.weights @ np.logaddexp(0, wrong) + unlike @ precision @ unlike / 2
        slope = (trials.weights / (1 + np.exp(-wrong))) @ signed + precision @ unlike
        return float(value), slope

    # A nearer shape and a farther next class never make an answer less sure.
    bounds = [(None, None), (None, 0.0), (0.0, None)]
    return minimize(loss, expected, jac=True, bounds=bounds).x


def _mutual_pairs(logs: FloatArray, whitening: Whitening, distance: str) -> _Pairs:
    """All pairs, of which those of mutual neighbours stand for pairs of one class."""
    # Against all other pairs, not distant ones alone.
    points = whitening.apply(logs)
    found = neighbour_pairs(points)
    mutual = np.zeros((len(points), len(points)), dtype=bool)
    mutual[found.first, found.second] = mutual[found.second, found.first] = True
    first, second = np.triu_indices(len(points), k=1)
    distances = pairwise(distance, points, points)[first, second]
    return _Pairs(distances, mutual[first, second], np.ones(len(first)))
