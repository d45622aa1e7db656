"""Two views → candidates of the rigid motion between them, by feature matching and random sampling."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pcretrieve.options import MergeOptions
from pcretrieve.points.register.motions import moved, turned
from pcretrieve.points.register.views import View
from pcretrieve.values import FloatArray

__all__ = ["candidate_motions", "distinct"]

# Number of points of a view, those with the most distinctive features, that are matched with another view,
# and number of matches of each point.
KEY_POINTS, LOOK_ALIKES = 1500, 4

# Smallest distance of two points that determine a motion, in voxels; and the largest
# differences of two corresponding pairs of points: of their distances, in voxels,
# and of the cosines between their line and their normals.
SHORTEST_PAIR, PAIR_LENGTH, PAIR_COSINE = 10, 1.5, 0.2

# Number of motions that are scored, and number of points of each view for the score.
MOST_MOTIONS, FEW_POINTS = 1500, 200

# Tolerance of the score, in units of the option `reach`; larger than 1, because the
# candidates are approximate.
ROUGH = 2

# Largest difference of two motions that are refined to the same motion: cosine of the angle (25 degrees), and
# distance in voxels.
SAME_COSINE, SAME_CELLS = 0.906, 10


def candidate_motions(
    first: View,
    second: View,
    features: tuple[FloatArray, FloatArray],
    scale: float,
    options: MergeOptions,
    rng: np.random.Generator,
) -> FloatArray:
    """Candidates of the rigid motion between two views.

    Two oriented points determine a rigid motion. Random pairs of points of one view are matched with pairs of
    points of the other view that have similar features, equal distances and equal angles between their
    normals. The resulting motions are scored by the range images of both views: by the points that agree,
    minus the points that contradict.

    features: tuple of (k, 33) float64, the features of their points.
    scale: the length to which relative options refer; unit of the points.
    Returns (m, 4, 4) float64: at most `n_candidates` distinct motions of `second` into the frame of `first`,
        highest score first.
    """
    cell = options.cell * scale
    here, there = _look_alikes(*features)  # (l,), (l,)
    one, two = rng.integers(len(here), size=(2, options.n_tries))
    length, cosines, frame, middle = _pairs(first, here[one], here[two])
    other_length, other_cosines, other_frame, other_middle = _pairs(second, there[one], there[two])
    # The dissimilarity of two pairs; 1 is the largest that is accepted.
    unlike = np.maximum(
        np.abs(length - other_length) / (PAIR_LENGTH * cell),
        np.abs(cosines - other_cosines).max(axis=1) / PAIR_COSINE,
    )  # (n_tries,)
    unlike[np.minimum(length, other_length) < SHORTEST_PAIR * cell] = np.inf
    chosen = np.argsort(unlike, kind="stable")[: min(MOST_MOTIONS, int((unlike < 1).sum()))]

    motions: FloatArray = np.tile(np.eye(4), (len(chosen), 1, 1))
    motions[:, :3, :3] = frame[chosen] @ other_frame[chosen].transpose(0, 2, 1)
    motions[:, :3, 3] = middle[chosen] - np.einsum("mij,mj->mi", motions[:, :3, :3], other_middle[chosen])
    tolerance = ROUGH * options.reach * scale
    score = _scores(first, second, motions, tolerance)
    score += _scores(second, first, np.linalg.inv(motions).astype(np.float64), tolerance)
    order = np.argsort(-score, kind="stable")
    best = motions[order[score[order] > 0]]
    return best[distinct(best, second, cell, most=options.n_candidates)]


def distinct(motions: FloatArray, view: View, cell: float, *, most: int) -> list[int]:
    """Select distinct motions of a view.

    motions: (m, 4, 4) float64, motions, best first.
    cell: edge of a voxel; unit of the points.
    """
    kept: list[int] = []
    middles = moved(motions, view.points.mean(axis=0, keepdims=True))[:, 0]  # (m, 3)
    for number, motion in enumerate(motions):
        if len(kept) == most:
            break
        cosine = (np.einsum("mij,ij->m", motions[kept, :3, :3], motion[:3, :3]) - 1) / 2
        apart = np.linalg.norm(middles[kept] - middles[number], axis=1)
        if not ((cosine > SAME_COSINE) & (apart < SAME_CELLS * cell)).any():
            kept.append(number)
    return kept


def _look_alikes(first: FloatArray, second: FloatArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """(l,) and (l,) positions of points of two views with similar features."""
    usual = np.concatenate([first, second]).mean(axis=0)
    alike = []
    for features, others in ((first, second), (second, first)):
        # Features near the mean, such as those of a plane, are not distinctive.
        keys = np.argsort(-np.linalg.norm(features - usual, axis=1), kind="stable")[:KEY_POINTS]
        distance = (others**2).sum(axis=1) - 2 * features[
            keys
        ] @ others.T  # (keys, n): squared, minus a constant
        n = min(LOOK_ALIKES, len(others))
        alike.append((np.repeat(keys, n), np.argpartition(distance, n - 1, axis=1)[:, :n].ravel()))
    (here, there), (back, forth) = alike
    return np.concatenate([here, forth]), np.concatenate([there, back])


def _pairs(
    view: View, one: NDArray[np.intp], two: NDArray[np.intp]
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """The lengths (n,), cosines (n, 3), frames (n, 3, 3) and midpoints (n, 3) of pairs of oriented points."""
    line = view.points[two] - view.points[one]
    length: FloatArray = np.linalg.norm(line, axis=1)
    line /= np.maximum(length, np.finfo(float).tiny)[:, None]
    start, end = (np.einsum("ij,ij->i", view.normals[ends], line) for ends in (one, two))
    between = np.einsum("ij,ij->i", view.normals[one], view.normals[two])
    up = view.normals[one] + view.normals[two] - (start + end)[:, None] * line
    up /= np.maximum(np.linalg.norm(up, axis=1), np.finfo(float).tiny)[:, None]
    frame = np.stack([line, up, np.cross(line, up)], axis=2)
    return length, np.stack([start, end, between], axis=1), frame, (view.points[one] + view.points[two]) / 2


def _scores(first: View, second: View, motions: FloatArray, tolerance: float) -> FloatArray:
    """(m,) fraction of points of `second` that agree with the image of `first`, minus contradictions."""
    few = second.sample[:FEW_POINTS]
    said = first.image.compare(
        moved(motions, second.points[few]), turned(motions, second.normals[few]), tolerance=tolerance
    )
    return np.asarray(said.agrees.mean(axis=1) - said.contradicts.mean(axis=1))
